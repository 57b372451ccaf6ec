"""A machine folder: which files it holds, and all of them read, with all problems reported at once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from thetacomp.campaign import Campaign, CampaignSettings, CorrelationTable, MachineFolder
from thetacomp.errors import InputError, Problem
from thetacomp.machine import Machine
from thetacomp.reading import campaigns, comparisons
from thetacomp.reading.columns import TABLES, match, schema
from thetacomp.reading.correlations import correlation_table
from thetacomp.reading.machine_file import machine_from_toml, settings_from_toml
from thetacomp.reading.problems import ProblemList, UnreadableError, nearest, quoted
from thetacomp.reading.recording import FILE as RECORDING
from thetacomp.reading.recording import read_recording
from thetacomp.reading.sources import Source, from_sheet, read_source
from thetacomp.reading.tables import Table, load
from thetacomp.reading.tracker_files import is_tracker_file, tracker_table
from thetacomp.reading.workbook import Workbook

MACHINE = "machine.toml"
SETTINGS = "campaign.toml"
CORRELATIONS = ("parameter_correlations.csv", "sensor_correlations.csv")
_NOTES = (".md", ".txt", ".pdf", ".png", ".jpg", ".jpeg", ".svg")
_SYSTEM = ("thumbs.db", "desktop.ini")


@dataclass
class _Tables:
    """The tables that one campaign's folder holds, and where each comes from."""

    getters: dict[str, tuple[str, Callable[[], Source]]] = field(default_factory=dict)

    def add(self, name: str, file: str, getter: Callable[[], Source], problems: ProblemList) -> None:
        if name in self.getters:
            problems.error(
                "two-sources",
                file,
                f"the table {name} also stands in {self.getters[name][0]}.",
                "keep one of the two.",
            )
        else:
            self.getters[name] = (file, getter)


def check_folder(path: Path) -> tuple[MachineFolder | None, tuple[Problem, ...]]:
    """Read a machine folder. Returns it (None where there are errors), and all errors and warnings."""
    problems = ProblemList()
    folder = _read(Path(path), problems)
    return (None if problems.has_errors else folder), problems.collected()


def read_folder(path: Path | str) -> MachineFolder:
    """Read a machine folder. Raises InputError with all errors; warnings are dropped (see check_folder)."""
    folder, problems = check_folder(Path(path))
    if folder is None:
        raise InputError([problem for problem in problems if problem.severity == "error"])
    return folder


def read_machine(path: Path) -> Machine:
    """Read a `machine.toml` on its own. Raises InputError with all errors."""
    problems = ProblemList()
    machine = machine_from_toml(Path(path), Path(path).name, problems)
    problems.raise_errors()
    assert machine is not None
    return machine


def _read(root: Path, problems: ProblemList) -> MachineFolder | None:
    entries = _entries(root, root.name or ".", problems)
    if entries is None:
        return None
    machine = _machine(root, entries, problems)
    found = _campaigns(root, entries, machine, problems)
    correlations = [_correlations(root / name, problems) if name in entries else None for name in CORRELATIONS]
    _report_unknown(entries, problems)
    if machine is None:
        return None
    if found and not problems.has_errors:
        if correlations == [None, None]:
            _something_measured(found, RECORDING in entries, problems)
        comparisons.compare(MachineFolder(machine, found), RECORDING in entries, problems)
    return MachineFolder(machine, found, *correlations)


def _something_measured(found: tuple[Campaign, ...], recorded: bool, problems: ProblemList) -> None:
    """Temperatures alone make no model; one error for the folder instead of a warning for each campaign."""
    if any(getattr(campaign, table) is not None for campaign in found for table in campaigns.MEASURED):
        return
    problems.drop("nothing-measured")
    problems.error(
        "nothing-measured",
        RECORDING if recorded else "campaigns",
        "no campaign has measured errors: there are only temperatures, and a model cannot be made from them.",
        "name the columns of the errors under [recording.drift]."
        if recorded
        else "add sweeps.csv (errors over position), parameters.csv (separated lines) or drift.csv (errors at a fixed"
        " position) to campaigns/<date>/, or a sheet of that name.",
    )


def _entries(folder: Path, label: str, problems: ProblemList) -> dict[str, Path] | None:
    """Files and folders by name, without those of the operating system and Office's lock files."""
    try:
        listed = sorted(folder.iterdir())
    except NotADirectoryError:
        problems.error("not-a-folder", label, "found a file, expected a folder.", "name the machine folder.")
        return None
    except FileNotFoundError:
        problems.error("missing-file", label, "there is no such folder.", "check the path.")
        return None
    except OSError as exc:
        problems.error("unreadable-file", label, f"cannot be opened ({exc.strerror}).", "check the access rights.")
        return None
    kept = (entry for entry in listed if not entry.name.startswith((".", "~$")))
    return {entry.name: entry for entry in kept if entry.name.lower() not in _SYSTEM}


def _machine(root: Path, entries: dict[str, Path], problems: ProblemList) -> Machine | None:
    if MACHINE not in entries:
        problems.error(
            "missing-file",
            MACHINE,
            f"there is no {MACHINE} in the folder; found {quoted(entries) or 'nothing'}.",
            f"write {MACHINE} with [machine], [[axes]] and [[sensors]] (see docs/machine_folder.md).",
        )
        return None
    return machine_from_toml(root / MACHINE, MACHINE, problems)


def _campaigns(
    root: Path, entries: dict[str, Path], machine: Machine | None, problems: ProblemList
) -> tuple[Campaign, ...]:
    has_folders, has_recording = "campaigns" in entries, RECORDING in entries
    if has_folders and has_recording:
        problems.error(
            "two-sources",
            RECORDING,
            "there are campaigns/ and a recording.toml.",
            "keep one of the two in a machine folder.",
        )
        return ()
    if has_recording:
        return read_recording(root / RECORDING, machine, problems) if machine is not None else ()
    if has_folders:
        return _campaign_folders(root / "campaigns", machine, problems)
    loose = [name for name in entries if Path(name).stem.lower() in TABLES or name.lower().endswith(".xlsx")]
    like = [f"'{name}'" for name in entries if name != MACHINE and nearest(name, ("campaigns", RECORDING))]
    hint = f" Perhaps {', '.join(like)} is meant." if like else ""
    problems.error(
        "no-campaigns",
        "campaigns",
        f"there is no folder campaigns/ (nor a {RECORDING}).{hint}",
        f"move {quoted(loose)} into campaigns/<date>/."
        if loose
        else "put each campaign's tables into campaigns/<date>/.",
    )
    return ()


def _campaign_folders(path: Path, machine: Machine | None, problems: ProblemList) -> tuple[Campaign, ...]:
    entries = _entries(path, "campaigns", problems)
    if entries is None:
        return ()
    folders = {name: entry for name, entry in entries.items() if entry.is_dir()}
    for name in sorted(set(entries) - set(folders)):
        if not _is_note(name):
            problems.warning(
                "unknown-file",
                f"campaigns/{name}",
                "the file is outside the folder of a campaign and is not read.",
                "move it into campaigns/<date>/.",
            )
    if not folders:
        problems.error(
            "no-campaigns",
            "campaigns",
            "the folder holds no campaign.",
            "make one folder for each campaign, like campaigns/2026-03-02/, with its tables in it.",
        )
    found = (_campaign(folders[name], name, machine, problems) for name in sorted(folders))
    return tuple(campaign for campaign in found if campaign is not None)


def _campaign(folder: Path, name: str, machine: Machine | None, problems: ProblemList) -> Campaign | None:
    place = f"campaigns/{name}"
    entries = _entries(folder, place, problems)
    if entries is None:
        return None
    tables, settings = _Tables(), CampaignSettings()
    good = True
    exported = [(f"{place}/{file}", path) for file, path in entries.items() if is_tracker_file(file)]
    for file, path in entries.items():
        label = f"{place}/{file}"
        stem, kind = path.stem.lower(), path.suffix.lower()
        if file == SETTINGS:
            found = settings_from_toml(path, label, problems)
            good &= found is not None
            settings = found or settings
        elif kind in (".csv", ".parquet") and stem in TABLES:
            tables.add(stem, label, partial(read_source, path, label), problems)
        elif kind == ".xlsx":
            good &= _add_sheets(path, label, tables, machine, problems)
        elif not is_tracker_file(file) and not _is_note(file):
            _report_unknown_table(label, stem, kind, problems)
    if "temperatures" not in tables.getters and good:
        problems.error(
            "missing-table",
            place,
            f"there is no table of temperatures; found {quoted(entries) or 'nothing'}.",
            "add temperatures.csv (t_s and one column a sensor), or a sheet `temperatures` in an .xlsx file.",
        )
    if machine is None:
        for label, getter in tables.getters.values():
            try:
                getter()
            except UnreadableError as refusal:
                problems.refuse(label, refusal)
        return None
    loaded: dict[str, Table] = {}
    for table, (label, getter) in tables.getters.items():
        read = load(getter, label, table, schema(table, machine), problems)
        if read is not None:
            loaded[table] = read
    unread = set(tables.getters) - set(loaded)
    _join_exported(exported, loaded, unread, settings, place, problems)
    campaign = campaigns.build(name, place, settings, loaded, machine, problems, unread)
    return campaign if good and not unread else None


def _join_exported(
    exported: list[tuple[str, Path]],
    loaded: dict[str, Table],
    unread: set[str],
    settings: CampaignSettings,
    place: str,
    problems: ProblemList,
) -> None:
    """Exported tracker points and the planned ones become the table `tracker`; what stays unread is added there."""
    planned = loaded.pop("tracker_points", None)
    if exported and "tracker" in loaded:
        problems.error(
            "two-sources",
            exported[0][0],
            f"the table tracker also stands in {loaded['tracker'].file}.",
            "keep one of the two.",
        )
    elif exported and "tracker_points" not in unread:
        joined = tracker_table(exported, planned, settings.tracker, place, problems)
        if joined is not None:
            loaded["tracker"] = joined
        else:
            unread.add("tracker")
    elif planned is not None:
        problems.warning(
            "unknown-file",
            planned.file,
            "planned points are read only together with exported points (tracker*.txt); this file is not read.",
            "add the exported points, or move it away.",
        )


def _add_sheets(path: Path, label: str, tables: _Tables, machine: Machine | None, problems: ProblemList) -> bool:
    """Take up the sheets of a workbook that are named like tables."""
    try:
        workbook = Workbook(path)
    except UnreadableError as refusal:
        problems.refuse(label, refusal)
        return False
    unknown = []
    for sheet in workbook.sheets:
        table = sheet.strip().lower()
        file = f"{label}, sheet '{sheet}'"
        if table in TABLES:
            tables.add(table, file, partial(from_sheet, workbook, sheet, file), problems)
        elif not workbook.is_empty(sheet):
            unknown.append(sheet)
    if unknown:
        problems.warning(
            "unknown-sheet",
            label,
            f"the sheets {quoted(unknown)} are not read; sheets are named {', '.join(TABLES)}.",
            _renaming(workbook, unknown, machine) or "rename the sheets that hold tables.",
        )
    return True


def _renaming(workbook: Workbook, sheets: list[str], machine: Machine | None) -> str:
    """The name that a single unread sheet should have, where its headers are those of a table of errors."""
    if machine is None or len(sheets) != 1:
        return ""
    try:
        source = from_sheet(workbook, sheets[0], "")
    except UnreadableError:
        return ""
    for table in campaigns.MEASURED:
        if match(source, schema(table, machine), ProblemList()) is not None:
            return f"its columns are those of {table}: rename the sheet to '{table}'."
    return ""


def _is_note(name: str) -> bool:
    path = Path(name)
    return path.suffix.lower() in (*_NOTES, "") and path.stem.lower() not in TABLES


def _report_unknown_table(label: str, stem: str, kind: str, problems: ProblemList) -> None:
    if stem in TABLES:
        message, fix = f"tables are .csv, .xlsx or .parquet, not '{kind}'; this file is not read.", "save it as CSV."
    else:
        message = f"the file is not read{nearest(stem, TABLES)}."
        fix = f"tables are named {', '.join(TABLES)}; rename it or move it away."
    problems.warning("unknown-file", label, message, fix)


def _report_unknown(entries: dict[str, Path], problems: ProblemList) -> None:
    known = (MACHINE, RECORDING, "campaigns", *CORRELATIONS)
    for name, entry in entries.items():
        data_beside_recording = RECORDING in entries and entry.suffix.lower() in (".csv", ".xlsx", ".parquet")
        if name not in known and not entry.is_dir() and not _is_note(name) and not data_beside_recording:
            problems.warning(
                "unknown-file",
                name,
                f"the file is not read{nearest(name, known)}.",
                "rename it, or move it away.",
            )


def _correlations(path: Path, problems: ProblemList) -> CorrelationTable | None:
    return correlation_table(path, path.name, problems)

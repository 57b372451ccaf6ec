"""`thetacomp iso230`: the tests of ISO 230-2 and ISO 230-3 that the data allow, one page each."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from thetacomp.cli.common import JsonOption, Outcome, run

if TYPE_CHECKING:
    from thetacomp.campaign import Campaign, MachineFolder
    from thetacomp.machine import Machine
    from thetacomp.standards.campaign_tests import Evaluated, Refused

TABLES = (".csv", ".xlsx", ".parquet")


def iso230(
    source: Annotated[
        Path,
        typer.Argument(metavar="DIR", help="Machine folder, or a table of positioning deviations.", show_default=False),
    ],
    out: Annotated[Path, typer.Option("--out", help="Where the pages go; made where it does not exist.")],
    campaign: Annotated[
        list[str] | None, typer.Option("--campaign", help="Campaign to evaluate; repeat for more. Default: all.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Evaluate positioning (ISO 230-2) and thermal tests (ISO 230-3), and say what the data do not allow."""

    def work() -> Outcome:
        from thetacomp.errors import AnalysisError
        from thetacomp.files import write_files
        from thetacomp.outputs import output_folder
        from thetacomp.report.iso230 import OWN, iso230_files

        lone = source.suffix.lower() in TABLES and not source.is_dir() and not campaign
        with output_folder(out, [source], OWN) as fresh:
            machine, done, refused = _from_table(source) if lone else _from_folder(source, campaign or [])
            if not done:
                raise AnalysisError("\n".join(["no test can be evaluated:", *_reasons(refused)]))
            files = iso230_files(machine, done)
            write_files(fresh, files)
        return _outcome(done, refused, tuple(out / name for name in files))

    run(work, as_json)


def _from_folder(path: Path, names: list[str]) -> tuple[Machine | None, list[Evaluated], list[Refused]]:
    from thetacomp.reading import read_folder
    from thetacomp.standards.campaign_tests import campaign_tests

    folder = read_folder(path)
    done: list[Evaluated] = []
    refused: list[Refused] = []
    for campaign in _chosen(folder, names):
        found, lost = campaign_tests(folder.machine, campaign)
        done += found
        refused += lost
    return folder.machine, done, refused


def _chosen(folder: MachineFolder, names: list[str]) -> tuple[Campaign, ...]:
    from thetacomp.errors import AnalysisError

    known = [campaign.name for campaign in folder.campaigns]
    unknown = [name for name in names if name not in known]
    if unknown:
        raise AnalysisError(f"there is no campaign {', '.join(unknown)}; the folder has {', '.join(known)}.")
    return tuple(c for c in folder.campaigns if not names or c.name in names)


def _from_table(path: Path) -> tuple[Machine | None, list[Evaluated], list[Refused]]:
    from thetacomp.errors import AnalysisError
    from thetacomp.reading import read_positioning
    from thetacomp.standards.campaign_tests import POSITIONING, Evaluated, Refused
    from thetacomp.standards.instrument import Instrument
    from thetacomp.standards.iso230_2 import positioning

    done: list[Evaluated] = []
    refused: list[Refused] = []
    for readings in read_positioning(path):
        title = POSITIONING.format(readings.axis)
        try:
            done.append(Evaluated(title, positioning(readings), Instrument()))
        except AnalysisError as reason:
            refused.append(Refused("", title, str(reason)))
    return None, done, refused


def _outcome(done: list[Evaluated], refused: list[Refused], paths: tuple[Path, ...]) -> Outcome:
    from thetacomp.standards.figure_rows import figure_rows

    pages = [path for path in paths if path.suffix == ".html"]
    lines: list[str] = []
    tests = []
    for test, page in zip(done, pages, strict=True):
        name = test.campaign.name if test.campaign is not None else ""
        lines += [f"{name}: {test.title}" if name else test.title, f"  {_short(test)}", f"  {page}"]
        figures = [asdict(row) for row in figure_rows(test)]
        remarks = list(test.result.remarks)
        tests.append({"title": test.title, "campaign": name, "page": str(page), "figures": figures, "remarks": remarks})
    if refused:
        lines += ["", "not evaluated:", *_reasons(refused)]
    lines += ["", f"all figures in {paths[0]}"]
    data = {"tests": tests, "not_evaluated": [asdict(one) for one in refused], "files": [str(path) for path in paths]}
    return Outcome("\n".join(lines), data)


def _reasons(refused: list[Refused]) -> list[str]:
    return [f"  {f'{one.campaign}: ' if one.campaign else ''}{one.test}: {one.reason}" for one in refused]


def _short(test: Evaluated) -> str:
    """The main figures of a test in one line."""
    from thetacomp.standards.iso230_2 import Positioning

    if isinstance(test.result, Positioning):
        figures = test.result.figures
        known = {"A": figures.A_um, "R": figures.R_um, "E": figures.E_um, "M": figures.M_um, "B": figures.B_um}
        return ", ".join(f"{symbol} = {value:.4g} µm" for symbol, value in known.items() if value == value)
    hours = (test.result.end_s - test.result.start_s) / 3600
    lines = [line for line in test.result.lines if not test.result.axis or line.quantity == "length"]
    words = (f"{f'{x.quantity} {x.place}'.strip()} {x.period:.1f} {x.unit}" for x in lines)
    return f"range in {hours:.1f} h: {', '.join(words)}"

"""`thetacomp keypoints`: the sensor strategies on their own, from measurements or from published tables."""

from __future__ import annotations

import math
import shutil
import textwrap
from collections.abc import Sequence
from dataclasses import asdict
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from thetacomp.cli.common import JsonOption, Outcome, run

if TYPE_CHECKING:
    from thetacomp.campaign import CorrelationTable
    from thetacomp.machine import Machine
    from thetacomp.preparation import Prepared
    from thetacomp.sensors.key_points import AxisKeyPoints, StrategyTable
    from thetacomp.sensors.selection import Method

NARROWEST, WIDEST = 60, 100
MEASURED, PUBLISHED = "measurements", "correlation tables"


class MethodName(StrEnum):
    """How key points are chosen from measurements."""

    WEIGHTED = "weighted"
    PAPER = "paper"
    EXACT = "exact"


class SearchScore(StrEnum):
    """What the exact search makes as small as possible."""

    HELD_OUT = "held_out"
    RESIDUAL = "residual"
    WORST_CAMPAIGN = "worst_campaign"


def keypoints(
    folder: Annotated[Path | None, typer.Argument(metavar="[DIR]", help="Machine folder.", show_default=False)] = None,
    method: Annotated[
        MethodName,
        typer.Option(
            help="weighted: by µm over the travel, held out. paper: by regret of correlation. exact: proven best."
        ),
    ] = MethodName.WEIGHTED,
    parameter_correlations: Annotated[
        Path | None,
        typer.Option("--parameter-correlations", help="Table of parameters against sensors; replaces measurements."),
    ] = None,
    sensor_correlations: Annotated[
        Path | None, typer.Option("--sensor-correlations", help="Table of sensors against each other.")
    ] = None,
    machine: Annotated[
        Path | None, typer.Option("--machine", help="machine.toml that says which sensors sit on which drive.")
    ] = None,
    sensors: Annotated[
        int | None, typer.Option(min=1, help="exact: only the best set of so many sensors. Default: the curve 1 to 6.")
    ] = None,
    score: Annotated[SearchScore, typer.Option(help="exact: the quantity to be minimised.")] = SearchScore.HELD_OUT,
    budget_s: Annotated[
        float | None, typer.Option("--budget-s", min=0.0, help="exact: most seconds for each number of sensors.")
    ] = None,
    train: Annotated[
        list[str] | None, typer.Option("--train", help="Campaign to choose by; repeat for more. Default: all.")
    ] = None,
    mix: Annotated[
        bool, typer.Option("--mix", help="Use campaigns of different modes or active tables together.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Choose the sensors that matter, and say for every sensor why it stayed or went."""
    if (parameter_correlations is None) != (sensor_correlations is None):
        raise typer.BadParameter("--parameter-correlations and --sensor-correlations belong together: give both.")
    if parameter_correlations is None and folder is None:
        raise typer.BadParameter("give a machine folder, or both correlation tables.")
    if machine is not None and folder is not None:
        raise typer.BadParameter("--machine is for correlation tables without a folder; a folder has its machine.toml.")
    exact = method is MethodName.EXACT
    if exact and parameter_correlations is not None:
        raise typer.BadParameter("--method exact needs measurements: published correlations have nothing to hold out.")
    if not exact and (sensors is not None or budget_s is not None or score is not SearchScore.HELD_OUT):
        raise typer.BadParameter("--sensors, --score and --budget-s belong to --method exact.")
    if parameter_correlations is not None and (train or mix):
        raise typer.BadParameter("--train and --mix choose campaigns: published correlations have none.")
    if parameter_correlations is not None and sensor_correlations is not None:
        tables = (parameter_correlations, sensor_correlations)
        run(lambda: _from_tables(tables, folder, machine), as_json)
    elif exact and folder is not None:
        from thetacomp.cli.keypoints_exact import Search, exact_key_points

        measured = folder
        searched = Search(sensors, score.value, budget_s)
        run(lambda: exact_key_points(measured, train or (), mix, searched, as_json), as_json)
    elif folder is not None:
        path = folder
        run(lambda: _from_folder(path, method, train or (), mix), as_json)


def _from_tables(tables: tuple[Path, Path], folder: Path | None, machine: Path | None) -> Outcome:
    from thetacomp.reading import read_correlations, read_folder, read_machine
    from thetacomp.sensors.selection import key_points_from_correlations

    known: Machine | None = None
    if folder is not None:
        known = read_folder(folder).machine
    elif machine is not None:
        known = read_machine(machine)
    parameters, sensors = read_correlations(tables[0]), read_correlations(tables[1])
    found = key_points_from_correlations(parameters, sensors, known)
    notes = [_about_the_rule(parameters)]
    if known is None:
        notes.append("No --machine: drives are not known, so the middle of each group represents it.")
    return _outcome([(PUBLISHED, found)], notes)


def _from_folder(path: Path, method: MethodName, train: Sequence[str], mix: bool) -> Outcome:
    from thetacomp.preparation import prepare
    from thetacomp.reading import read_folder
    from thetacomp.sensors.selection import key_points, key_points_from_correlations

    folder = read_folder(path)
    notes: list[str] = []
    found: list[tuple[str, tuple[AxisKeyPoints, ...]]] = []
    if folder.parameter_correlations is not None and folder.sensor_correlations is not None:
        published = key_points_from_correlations(
            folder.parameter_correlations, folder.sensor_correlations, folder.machine
        )
        found.append((PUBLISHED, published))
        notes.append(_about_the_rule(folder.parameter_correlations))
    prepared = prepare(folder, train, mix=mix)
    way: Method = "paper" if method is MethodName.PAPER else "weighted"
    found.append((MEASURED, tuple(key_points(folder.machine, states, way) for states in prepared.training)))
    return _outcome(found, [*notes, *_about_the_sign(prepared), *prepared.screening_notes])


def _about_the_rule(table: CorrelationTable) -> str:
    return (
        f"The choice from correlation tables weighs all {len(table.rows)} parameters alike, even those without any"
        " relation: use it to follow a publication. For your own machine use measurements."
    )


def _about_the_sign(prepared: Prepared) -> list[str]:
    campaigns = [prepared.folder.campaign(name) for name in prepared.train]
    unproven = [c.name for c in campaigns if c.settings.sign == "unproven"]
    if not unproven:
        return []
    return [f"Sign unproven in campaign {', '.join(unproven)}. The choice of sensors does not depend on the sign."]


def _outcome(found: list[tuple[str, tuple[AxisKeyPoints, ...]]], notes: list[str]) -> Outcome:
    """All axes as text and as data. The tables of one axis follow its result."""
    parts = [_summary(found)]
    axes: list[dict[str, Any]] = []
    for source, results in found:
        for result in results:
            parts.append(_axis_text(source, result))
            axes.append({"source": source, **_data(result)})
    parts += [textwrap.fill(note, _width()) for note in notes]
    return Outcome("\n\n".join(parts), {"axes": axes, "notes": notes})


def _data(result: AxisKeyPoints) -> dict[str, Any]:
    data = asdict(result)
    data["left_out"] = [{"parameter": name, "reason": reason} for name, reason in result.left_out]
    for table in data["tables"]:
        table["verdicts"] = table.pop("decisions")  # the key that scripts know
    return data


def _axis_name(axis: str) -> str:
    return f"axis {axis}" if axis else "drift at a fixed position"


def _summary(found: list[tuple[str, tuple[AxisKeyPoints, ...]]]) -> str:
    lines = ["Key points"]
    for source, results in found:
        for result in results:
            chosen = ", ".join(result.key_points) or "none"
            lines.append(f"  {_axis_name(result.axis)}, from {source} ({result.method}): {chosen}")
    return "\n".join(lines)


def _axis_text(source: str, result: AxisKeyPoints) -> str:
    name = _axis_name(result.axis)
    title = f"{name[0].upper()}{name[1:]}, from {source}, method {result.method}"
    smallest = result.smallest_correlation
    inside = "" if math.isnan(smallest) else f" (smallest |r| inside: {smallest:.2f})"
    groups = "; ".join(", ".join(group) for group in result.groups) or "none"
    lines = [title, "=" * len(title)]
    lines += _wrapped("Key points:   ", ", ".join(result.key_points) or "none")
    lines += _wrapped("Main factors: ", (", ".join(result.main_factors) or "none") + inside)
    lines += _wrapped("Groups:       ", groups)
    for name, reason in result.left_out:
        lines += _wrapped("Left out:     ", f"{name}: {reason}")
    for table in result.tables:
        if table.decisions:
            lines += ["", *_table_text(table)]
    return "\n".join(lines)


def _table_text(table: StrategyTable) -> list[str]:
    """One strategy: those that stay first; reasons are wrapped, so a narrow console shows them in full."""
    title = table.strategy[0].upper() + table.strategy[1:]
    width = max(len(v.sensor) for v in table.decisions)
    digits = 2 if "|r|" in table.figure_name else 1
    lines = _wrapped("", f"{title}: {table.figure_name}")
    without_figure: dict[str, list[str]] = {}
    for decision in sorted(table.decisions, key=lambda v: not v.stays):
        if math.isnan(decision.figure) and not decision.stays:
            without_figure.setdefault(decision.reason, []).append(decision.sensor)
            continue
        stays = "stays" if decision.stays else "goes "
        head = f"  {decision.sensor:<{width}}  {stays}  {decision.figure:6.{digits}f}  "
        lines += _wrapped(head, decision.reason)
    for reason, sensors in without_figure.items():
        lines += _wrapped("  ", f"{', '.join(sensors)}: {reason}")
    return lines


def _width() -> int:
    # One column less than the console: a full line makes a Windows console add an empty one.
    return max(NARROWEST, min(shutil.get_terminal_size((WIDEST + 1, 24)).columns - 1, WIDEST))


def _wrapped(head: str, text: str) -> list[str]:
    return textwrap.wrap(text, _width(), initial_indent=head, subsequent_indent=" " * len(head)) or [head.rstrip()]

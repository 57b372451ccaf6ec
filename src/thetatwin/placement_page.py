"""What `thetacomp place` leaves behind: tables, pictures and one page that opens without a network."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape

from thetacomp import __version__
from thetacomp.arrays import Floats
from thetacomp.report.rendering import inline_svg, render
from thetacomp.report.tables import number
from thetatwin.conditions import Conditions
from thetatwin.mounting import Mounting
from thetatwin.placement_figures import accuracy, machine_with_sensors
from thetatwin.sensor_places import STRATEGIES, Placement, existing_margin_um
from thetatwin.virtual import VirtualMachine

PLACES, ACCURACY, PAGE = "places.csv", "accuracy.csv", "placement.html"
_ERRORS = ("error_dX_um", "error_dY_um", "error_dZ_um", "error_um")


def write_placement(
    out: Path, machine: VirtualMachine, conditions: Conditions, mounting: Mounting, placement: Placement, seed: int
) -> tuple[Path, ...]:
    """Write `places.csv`, `accuracy.csv`, `placement.html` and the figures as SVG and PNG; returns the paths."""
    folder = out / "figures"
    folder.mkdir(parents=True, exist_ok=True)
    paths = [out / PLACES, out / ACCURACY, out / PAGE]
    _write(paths[0], places_table(placement))
    _write(paths[1], accuracy_table(placement))
    drawn = {}
    tool_length_mm = conditions.work.tool_length_mm
    for figure in (machine_with_sensors(machine, placement, tool_length_mm), accuracy(placement)):
        files = render(figure)
        svg, png = folder / f"{figure.name}.svg", folder / f"{figure.name}.png"
        svg.write_text(files.svg, encoding="utf-8", newline="\n")
        png.write_bytes(files.png)
        paths += [svg, png]
        drawn[figure.name] = (figure, Markup(inline_svg(files.svg, figure.name, str(escape(figure.title)))))
    environment = Environment(
        loader=PackageLoader("thetacomp.report", "templates"), autoescape=True, undefined=StrictUndefined,
        trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    environment.filters["number"] = number
    page = environment.get_template("placement.html.j2").render(
        machine=machine.description, conditions=conditions, mounting=mounting, placement=placement, figures=drawn,
        strategies=STRATEGIES, seed=seed, version=__version__, margin=existing_margin_um(placement),
        positions=3 ** len(machine.description.axes),
    )  # fmt: skip
    paths[2].write_text(page, encoding="utf-8", newline="\n")
    return tuple(paths)


def places_table(placement: Placement) -> list[Sequence[str]]:
    """Every strategy's places in order, with the error that the first k of them leave."""
    free = placement.candidates
    head = ("strategy", "rank", "part", "side", "x_mm", "y_mm", "z_mm", "nearest_sensor", "distance_mm", *_ERRORS)
    rows: list[Sequence[str]] = [head]
    for choice in placement.choices:
        for rank, i in enumerate(choice.chosen, start=1):
            place = (free.part[i], free.side[i], *(f"{x + 0.0:.1f}" for x in free.at_mm[i]))
            near = (placement.nearest_id[i], f"{placement.nearest_mm[i]:.0f}")
            rows.append((choice.strategy, str(rank), *place, *near, *_texts(choice.curve.judged_um[rank])))
    return rows


def accuracy_table(placement: Placement) -> list[Sequence[str]]:
    """Error against number of sensors: each strategy, the existing sensors in their best order, random places."""
    head = ("strategy", "sensors", "last_added", *_ERRORS, "error_on_states_used_um")
    rows: list[Sequence[str]] = [head]
    curves = [(c.strategy, c.curve, [str(r) for r in range(1, len(c.chosen) + 1)]) for c in placement.choices]
    for name, curve, added in (*curves, ("existing", placement.existing, list(placement.existing_ids))):
        for k, error in enumerate(curve.judged_um):
            last = added[k - 1] if k else ""
            rows.append((name, str(k), last, *_texts(error), f"{curve.promised_um[k, 3]:.2f}"))
    rows += [("random", str(k), "", *_texts(error), "") for k, error in enumerate(placement.random_um)]
    return rows


def _texts(values: Floats) -> tuple[str, ...]:
    return tuple(f"{v:.2f}" for v in values)


def _write(path: Path, rows: Sequence[Sequence[str]]) -> None:
    path.write_text("\n".join(",".join(row) for row in rows) + "\n", encoding="utf-8", newline="\n")

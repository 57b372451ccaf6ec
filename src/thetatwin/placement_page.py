"""What `thetacomp place` leaves behind: tables, pictures and one page that opens without a network."""

from __future__ import annotations

from collections.abc import Sequence

from thetacomp.arrays import Floats
from thetacomp.report.page_writer import page
from thetacomp.report.rendering import draw
from thetacomp.table_file import Number, csv_text, fixed
from thetatwin.conditions import Conditions
from thetatwin.mounting import Mounting
from thetatwin.placement_figures import accuracy, machine_with_sensors
from thetatwin.sensor_places import STRATEGIES, Placement, existing_margin_um
from thetatwin.virtual_machine import VirtualMachine

PLACES, ACCURACY, PAGE = "places.csv", "accuracy.csv", "placement.html"
OWN = (PLACES, ACCURACY, PAGE, "figures/machine.*", "figures/accuracy.*")
_ERRORS = ("error_dX_um", "error_dY_um", "error_dZ_um", "error_um")


def placement_files(
    machine: VirtualMachine, conditions: Conditions, mounting: Mounting, placement: Placement, seed: int
) -> dict[str, str | bytes]:
    """`places.csv`, `accuracy.csv`, `placement.html` and the figures as SVG and PNG, by file name."""
    drawings = draw([machine_with_sensors(machine, placement, conditions.work.tool_length_mm), accuracy(placement)])
    text = page(
        "thetatwin/placement.html.j2",
        machine=machine.description, conditions=conditions, mounting=mounting, placement=placement,
        figures=drawings.inline(), strategies=STRATEGIES, seed=seed, margin=existing_margin_um(placement),
        positions=3 ** len(machine.description.axes),
    )  # fmt: skip
    return {
        PLACES: csv_text(*places_table(placement)),
        ACCURACY: csv_text(*accuracy_table(placement)),
        PAGE: text,
        **drawings.files(),
    }


def places_table(placement: Placement) -> tuple[Sequence[str], list[Sequence[str]]]:
    """Every strategy's places in order, with the error that the first k of them leave."""
    free = placement.candidates
    head = ("strategy", "rank", "part", "side", "x_mm", "y_mm", "z_mm", "nearest_sensor", "distance_mm", *_ERRORS)
    rows: list[Sequence[str]] = []
    for choice in placement.choices:
        for rank, i in enumerate(choice.chosen, start=1):
            place = (free.part[i], free.side[i], *(fixed(x + 0.0, 1) for x in free.at_mm[i]))
            near = (placement.nearest_id[i], fixed(placement.nearest_mm[i], 0))
            rows.append((choice.strategy, Number(rank), *place, *near, *_texts(choice.curve.judged_um[rank])))
    return head, rows


def accuracy_table(placement: Placement) -> tuple[Sequence[str], list[Sequence[str]]]:
    """Error against number of sensors: each strategy, the existing sensors in their best order, random places."""
    head = ("strategy", "sensors", "last_added", *_ERRORS, "error_on_states_used_um")
    rows: list[Sequence[str]] = []
    curves = [(c.strategy, c.curve, [str(r) for r in range(1, len(c.chosen) + 1)]) for c in placement.choices]
    for name, curve, added in (*curves, ("existing", placement.existing, list(placement.existing_ids))):
        for k, error in enumerate(curve.judged_um):
            last = added[k - 1] if k else ""
            rows.append((name, Number(k), last, *_texts(error), fixed(curve.promised_um[k, 3], 2)))
    rows += [("random", Number(k), "", *_texts(error), "") for k, error in enumerate(placement.random_um)]
    return head, rows


def _texts(values: Floats) -> tuple[str, ...]:
    return tuple(fixed(v, 2) for v in values)

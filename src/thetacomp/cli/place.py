"""`thetacomp place`: where sensors are most informative, from the field of the virtual machine."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from thetacomp.cli.common import DONE, NOT_FIT, JsonOption, Outcome, run
from thetacomp.extras import require

if TYPE_CHECKING:
    from thetatwin.sensor_places import Placement


def place(
    out: Annotated[Path, typer.Option(help="Folder for tables, pictures and page; it is made if needed.")],
    preset: Annotated[str, typer.Option(help="standard, hard, or the path of a TOML file of conditions.")] = "standard",
    mounting: Annotated[
        str, typer.Option(help="TOML file that says where nothing can be mounted; tk6920_mounting is bundled.")
    ] = "tk6920_mounting",
    sensors: Annotated[int, typer.Option(min=1, max=50, help="Number of sensors to place.")] = 15,
    seed: Annotated[int, typer.Option(min=0, help="Work and hall are drawn from it: same seed, same places.")] = 1,
    as_json: JsonOption = False,
) -> None:
    """Choose places for sensors on the virtual machine, and compare them with those that are there."""
    run(lambda: _work(out, preset, mounting, sensors, seed), as_json)


def _work(out: Path, preset: str, mounting_name: str, sensors: int, seed: int) -> Outcome:
    require("twin")
    from thetacomp.files import write_files
    from thetacomp.outputs import output_folder
    from thetatwin.conditions import load_conditions
    from thetatwin.description import load_description
    from thetatwin.mounting import load_mounting
    from thetatwin.placement_page import OWN, PAGE, placement_files
    from thetatwin.sensor_places import existing_margin_um, place_sensors
    from thetatwin.virtual_machine import build

    conditions = load_conditions(preset)
    description = load_description(conditions.machine)
    mounting = load_mounting(mounting_name, description)
    with output_folder(out, [Path(preset), Path(mounting_name)], OWN) as fresh:
        machine = build(description)
        placement = place_sensors(machine, conditions, mounting, sensors, seed)
        files = placement_files(machine, conditions, mounting, placement, seed)
        write_files(fresh, files)
    paths = tuple(out / name for name in files)
    n, chosen_um, existing_um = existing_margin_um(placement)
    better = chosen_um < existing_um
    verdict = (
        f"{n} sensors at the chosen places leave {chosen_um:.1f} µm,"
        f" {n} existing ones (best of {len(placement.existing_ids)}) {existing_um:.1f} µm,"
        f" none {placement.existing.judged_um[0, 3]:.1f} µm."
        + ("" if better else " NOT BETTER: keep the existing places.")
    )
    lines = [
        f"{description.name}, preset {conditions.name}, seed {seed}: {len(placement.candidates.part)} places looked at",
        *_lines(placement),
        verdict,
        "Error: RMS of the tool over all positions, on hours of work that were not used for choosing.",
        f"Open {out / PAGE}; tables and pictures are in {out}.",
    ]
    return Outcome("\n".join(lines), _data(placement, paths, better, seed), DONE if better else NOT_FIT)


def _lines(placement: Placement) -> list[str]:
    free, best = placement.candidates, placement.choice("displacement")
    lines = [
        f"{'rank':>4}  {'part':<10} {'side':<6} {'X mm':>7} {'Y mm':>7} {'Z mm':>7}  {'nearest sensor':<18}"
        f" {'X µm':>6} {'Y µm':>6} {'Z µm':>6}"
    ]
    for rank, i in enumerate(best.chosen, start=1):
        x, y, z = free.at_mm[i] + 0.0
        near = f"{placement.nearest_id[i]}, {placement.nearest_mm[i]:.0f} mm"
        error = best.curve.judged_um[rank]
        lines.append(
            f"{rank:>4}  {free.part[i]:<10} {free.side[i]:<6} {x:>7.0f} {y:>7.0f} {z:>7.0f}  {near:<18}"
            f" {error[0]:>6.1f} {error[1]:>6.1f} {error[2]:>6.1f}"
        )
    return lines


def _data(placement: Placement, paths: tuple[Path, ...], better: bool, seed: int) -> dict[str, object]:
    free = placement.candidates
    names = ("dX_um", "dY_um", "dZ_um", "vector_um")

    def errors(curve: object) -> list[dict[str, float]]:
        return [dict(zip(names, row, strict=True)) for row in curve.tolist()]  # type: ignore[attr-defined]

    return {
        "files": [str(path) for path in paths],
        "seed": seed,
        "candidates": len(free.part),
        "noise_K": placement.noise_K,
        "better_than_existing": better,
        "strategies": {
            choice.strategy: {
                "places": [
                    {
                        "part": free.part[i], "side": free.side[i],
                        "at_mm": free.at_mm[i].tolist(),
                        "nearest_sensor": placement.nearest_id[i], "distance_mm": placement.nearest_mm[i],
                    }
                    for i in choice.chosen
                ],
                "errors": errors(choice.curve.judged_um),
            }
            for choice in placement.choices
        },
        "existing": {"order": list(placement.existing_ids), "errors": errors(placement.existing.judged_um)},
        "random": {"errors": errors(placement.random_um)},
        "greedy_checks": [vars(check) for check in placement.checks],
    }  # fmt: skip

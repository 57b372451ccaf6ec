"""`thetacomp twin`: a virtual machine and its campaigns as a machine folder, the truth next to it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from thetacomp.cli.common import JsonOption, Outcome, run
from thetacomp.extras import require


def twin(
    out: Annotated[Path, typer.Option(help="Machine folder to write; the truth goes to OUT-truth next to it.")],
    preset: Annotated[str, typer.Option(help="standard, hard, or the path of a TOML file of conditions.")] = "standard",
    seed: Annotated[int, typer.Option(min=0, help="Same seed, same bytes.")] = 1,
    campaigns: Annotated[int, typer.Option(min=1, max=26, help="Number of campaigns; the first is the paper's.")] = 4,
    places: Annotated[
        Path | None, typer.Option(help="A places.csv of `thetacomp place`: the machine then carries these sensors.")
    ] = None,
    strategy: Annotated[str, typer.Option(help="Whose places of that table; see `thetacomp place`.")] = "displacement",
    as_json: JsonOption = False,
) -> None:
    """Write a virtual boring and milling machine with its measured campaigns: a machine to try things on."""
    run(lambda: _work(out, preset, seed, campaigns, places, strategy), as_json)


def _work(out: Path, preset: str, seed: int, campaigns: int, places: Path | None, strategy: str) -> Outcome:
    require("twin")
    from thetacomp.files import Files
    from thetatwin.campaigns import Record, make_twin, plan_campaigns
    from thetatwin.conditions import load_conditions
    from thetatwin.description import load_description
    from thetatwin.picture import campaign_figure, figure_content
    from thetatwin.sensor_sets import read_places, with_sensors
    from thetatwin.virtual_machine import build
    from thetatwin.writer import refuse_filled, truth_folder, write_twin

    refuse_filled(out)
    conditions = load_conditions(preset)
    description = load_description(conditions.machine)
    if places is not None:
        description = with_sensors(description, read_places(places, strategy))
    machine = build(description)
    made = make_twin(machine, conditions, seed)

    def pictures(record: Record) -> Files:
        figure = campaign_figure(machine, record, conditions.work.tool_length_mm)
        return {name: figure_content(figure, name) for name in ("machine.png", "machine.svg")}

    records = write_twin(out, made, plan_campaigns(made, campaigns), pictures)
    picture = truth_folder(out) / "machine.png"
    lines = [f"{out}: {machine.description.name}, preset {conditions.name}, seed {seed}"]
    if places is not None:
        lines[0] += f", {len(description.sensors)} sensors of {places} ({strategy})"
    for record in records:
        points = int((record.truth.axis >= 0).sum())
        lines.append(
            f"  {record.plan.name}: {record.plan.kind} duty, chiller {record.plan.chiller},"
            f" {record.truth.t_s[-1] / 3600:.1f} h, {points} sweep points"
        )
    lines.append(f"The truth is in {truth_folder(out)}; no other command reads it. Picture: {picture}")
    data = {
        "folder": str(out),
        "truth": str(truth_folder(out)),
        "preset": conditions.name,
        "seed": seed,
        "campaigns": [record.plan.name for record in records],
        "sensors": [sensor.id for sensor in description.sensors],
    }
    return Outcome("\n".join(lines), data)

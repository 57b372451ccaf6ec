"""Campaigns: repeatable to the bit, right in sign, with the truth apart."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from thetacomp.arrays import Floats
from thetacomp.cli.main import app
from thetacomp.errors import AnalysisError
from thetacomp.reading import check_folder, read_folder
from thetatwin.campaigns import Record, Twin, make_twin, plan_campaigns, run_campaign
from thetatwin.conditions import load_conditions
from thetatwin.picture import campaign_figure, figure_content
from thetatwin.virtual_machine import VirtualMachine
from thetatwin.writer import truth_folder, write_twin


@pytest.fixture(scope="module")
def written(twin: Twin, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, tuple[Record, ...]]:
    folder = tmp_path_factory.mktemp("twin") / "machine"
    return folder, write_twin(folder, twin, plan_campaigns(twin, 2))


def contents(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def test_the_same_seed_writes_the_same_bytes(
    coarse: VirtualMachine, written: tuple[Path, tuple[Record, ...]], twin: Twin, tmp_path: Path
) -> None:
    folder, _ = written
    again = make_twin(coarse, twin.conditions, twin.seed)
    write_twin(tmp_path / "machine", again, plan_campaigns(again, 2))
    assert contents(tmp_path / "machine") == contents(folder)
    assert contents(truth_folder(tmp_path / "machine")) == contents(truth_folder(folder))


def test_another_seed_is_another_machine_in_another_hall(coarse: VirtualMachine, twin: Twin) -> None:
    other = make_twin(coarse, twin.conditions, twin.seed + 1)
    one, two = (run_campaign(t, plan_campaigns(t, 1)[0]) for t in (twin, other))
    assert not np.allclose(one.truth.geometry, two.truth.geometry)
    assert not np.allclose(one.temperature_degC, two.temperature_degC, equal_nan=True)


def test_a_campaign_does_not_depend_on_how_many_are_made(written: tuple[Path, tuple[Record, ...]], twin: Twin) -> None:
    second = run_campaign(twin, plan_campaigns(twin, 5)[1])
    assert np.array_equal(second.measured_um, written[1][1].measured_um, equal_nan=True)


def test_the_folder_is_read_without_any_problem(written: tuple[Path, tuple[Record, ...]]) -> None:
    folder, records = written
    assert check_folder(folder)[1] == ()
    read = read_folder(folder)
    assert read.machine.sensor_ids == tuple(f"theta_{k}" for k in range(1, 16))
    campaign = read.campaigns[0]
    assert campaign.sweeps is not None
    # 2 cold rounds, 8 in the warm-up, 4 in the cool-down, of three axes
    assert campaign.sweeps.sweep.max() + 1 == 42
    truth = records[0].truth
    seen = np.isfinite(records[0].measured_um).all(axis=1) & (truth.axis >= 0)
    assert campaign.sweeps.error_um == pytest.approx(records[0].measured_um[seen], abs=0.0501)


def test_nothing_of_the_truth_is_in_the_machine_folder(written: tuple[Path, tuple[Record, ...]]) -> None:
    folder, _ = written
    names = {p.name for p in folder.rglob("*") if p.is_file()}
    assert names == {"machine.toml", "campaign.toml", "temperatures.csv", "sweeps.csv", "drift.csv", "duty.csv"}
    assert folder not in truth_folder(folder).parents


def test_a_filled_folder_is_not_overwritten(written: tuple[Path, tuple[Record, ...]], twin: Twin) -> None:
    with pytest.raises(AnalysisError, match="already exists and is not empty"):
        write_twin(written[0], twin, plan_campaigns(twin, 1))


def test_measured_is_true_within_the_tracker(written: tuple[Path, tuple[Record, ...]]) -> None:
    """Measured change since the cold block against the true one: E = actual - commanded, same sign, same size."""
    record = written[1][0]
    truth = record.truth
    cold = truth.t_s <= record.reference_s
    for axis in range(3):
        own = (truth.axis == axis) & np.isfinite(record.measured_um).all(axis=1)
        late = own & (truth.sweep == truth.sweep[own & (truth.t_s < 9.8 * 3600)].max())
        for d in range(3):
            measured = np.median(record.measured_um[late, d]) - np.median(record.measured_um[own & cold, d])
            exact = np.median(truth.thermal[late, d]) - np.median(truth.thermal[own & cold, d])
            assert measured == pytest.approx(exact, abs=20.0)
    assert np.ptp(truth.thermal[:, :3], axis=0).max() > 200.0


def test_true_components_rebuild_the_true_thermal_error(written: tuple[Path, tuple[Record, ...]], twin: Twin) -> None:
    folder, records = written
    table = pd.read_csv(truth_folder(folder) / "campaigns" / records[0].plan.name / "components.csv")
    assert set(table.component) == {f"E{d}{a}" for d in "XYZ" for a in "XYW"}
    late = table[table.component == "EZW"].iloc[-5]
    truth, record = records[0].truth, records[0]
    own = (truth.axis == 2) & (np.abs(truth.t_s - late.t_s) < 60)  # heat moves on by microns a minute
    poses = record.history.poses(twin.machine, np.full(int(own.sum()), record.begin_s + record.reference_s))
    before = twin.machine.tool_error_um(poses, {k: v[own] for k, v in truth.positions_mm.items()}, 150.0)
    line = late.intercept_um + late.slope_um_per_m * (truth.positions_mm["W"][own] - late.p0_mm) / 1000.0
    assert line == pytest.approx(truth.thermal[own, 2] - before[:, 2], abs=late.shape_um + 2.0)


def test_a_perfect_correction_takes_the_thermal_error_away(
    written: tuple[Path, tuple[Record, ...]], twin: Twin
) -> None:
    plan = plan_campaigns(twin, 1)[0]
    truth = written[1][0].truth

    def perfect(t_read: Floats, reading: Floats, t_s: Floats, positions: Mapping[str, Floats]) -> Floats:
        assert reading.shape == (len(t_read), 15)
        return -truth.thermal[:, :3]

    record = run_campaign(twin, plan, perfect)
    assert np.array_equal(record.temperature_degC, written[1][0].temperature_degC, equal_nan=True)
    left = record.measured_um[truth.t_s > record.reference_s] - truth.geometry[truth.t_s > record.reference_s, :3]
    spread = np.nanpercentile(np.abs(left - np.nanmedian(left, axis=0)), 95)
    assert spread < 50.0  # what the tracker's own errors leave, against some 300 µm of heat


def test_the_hard_preset_changes_the_cooling_and_breaks_sensors(coarse: VirtualMachine) -> None:
    hard = make_twin(coarse, load_conditions("hard"), 3)
    plans = plan_campaigns(hard, 4)
    records = [run_campaign(hard, plan) for plan in plans]
    assert all(len(np.unique(r.work.chiller)) == 2 for r in records)
    assert any(r.faults for r in records)
    assert all(", later " in plan.chiller for plan in plans)


def test_the_picture_is_drawn_without_a_display(
    coarse: VirtualMachine, written: tuple[Path, tuple[Record, ...]]
) -> None:
    figure = campaign_figure(coarse, written[1][0], 150.0)
    data = figure_content(figure, "machine.png")
    assert data.startswith(b"\x89PNG")
    assert len(data) > 50_000
    assert data == figure_content(campaign_figure(coarse, written[1][0], 150.0), "again.png")
    assert "Displacement since cold" in figure_content(figure, "machine.svg").decode()


def test_the_command_refuses_a_filled_folder_and_an_unknown_preset_at_once(tmp_path: Path) -> None:
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "something").write_text("x", encoding="utf-8")
    result = CliRunner().invoke(app, ["twin", "--out", str(tmp_path / "full")])
    assert result.exit_code == 1
    assert "is not empty" in result.output
    result = CliRunner().invoke(app, ["twin", "--out", str(tmp_path / "new"), "--preset", "soft"])
    assert result.exit_code == 1
    assert "neither a file nor one of the bundled standard, hard" in result.output


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_the_command_writes_a_machine(tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["twin", "--out", str(tmp_path / "m"), "--campaigns", "1", "--seed", "4"])
    assert result.exit_code == 0, result.output
    assert check_folder(tmp_path / "m")[1] == ()
    assert (tmp_path / "m-truth" / "machine.png").exists()
    assert (tmp_path / "m-truth" / "machine.svg").exists()

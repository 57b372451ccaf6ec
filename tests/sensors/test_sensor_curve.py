"""Accuracy against number of sensors: the proven sets, their shares, the files, the picture, the command."""

from __future__ import annotations

import csv
import itertools
import json
import signal
import subprocess
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from thetacomp.analysis import analyze_folder
from thetacomp.arrays import Floats
from thetacomp.axis_states import AxisStates, axis_states
from thetacomp.campaign import Campaign, CampaignSettings, Drift, MachineFolder
from thetacomp.cli.main import app
from thetacomp.errors import AnalysisError
from thetacomp.files import write_files
from thetacomp.machine import Machine, Sensor
from thetacomp.model.temperatures import Temperatures
from thetacomp.moments import summarise
from thetacomp.report.analysis_files import table_files
from thetacomp.report.figures_sensors import accuracy_over_sensors
from thetacomp.sensors.sensor_curve import campaign_summaries, enough, sensor_curve
from thetacomp.sensors.subset import best_subset
from thetacomp.separation import separate_all

SENSORS = ("a", "b", "c", "d", "e")
# The truth: DX follows a and d, DZ follows d alone; b is nearly a copy of a; c and e tell nothing.
UM_PER_K = {"dX": (4.0, 0.0, 0.0, -3.0, 0.0), "dZ": (0.0, 0.0, 0.0, 2.0, 0.0)}


def campaign(seed: int, rows: int = 60, noise_um: float = 0.5) -> Campaign:
    rng = np.random.default_rng(seed)
    t_s = np.arange(rows) * 600.0
    rise_K = np.cumsum(rng.normal(0, 0.4, (rows, 5)), axis=0)
    rise_K -= rise_K[0]
    rise_K[1:, 1] = rise_K[1:, 0] + rng.normal(0, 0.3, rows - 1)
    error = np.full((rows, 3), np.nan)
    for column, name in ((0, "dX"), (2, "dZ")):
        error[:, column] = rise_K @ np.array(UM_PER_K[name])
        error[1:, column] += rng.normal(0, noise_um, rows - 1)
    return Campaign(
        f"c{seed}",
        CampaignSettings(instrument="probe", reference_s=0.0),
        Temperatures(t_s, SENSORS, 20.0 + rise_K),
        drift=Drift(t_s, error),
    )


@cache
def folder(*seeds: int, rows: int = 60) -> MachineFolder:
    machine = Machine(name="five", axes=(), sensors=tuple(Sensor(id=name, role="structure") for name in SENSORS))
    return MachineFolder(machine, tuple(campaign(seed, rows) for seed in seeds))


def states_of(measured: MachineFolder) -> AxisStates:
    separations = separate_all(measured.machine, measured.campaigns).components
    (states,) = axis_states(measured, separations, [c.name for c in measured.campaigns])
    return states


def held_out_um(states: AxisStates, columns: tuple[int, ...]) -> float:
    """RMS of the error vector with each campaign left out, by plain least squares on the rows (NumPy)."""
    x = np.column_stack([np.ones(len(states)), states.rise_K[:, columns]])
    total = 0.0
    for label in np.unique(states.campaign):
        out = states.campaign == label
        coef = np.linalg.lstsq(x[~out], states.intercept_um[~out], rcond=None)[0]
        total += float(np.sum((states.intercept_um[out] - x[out] @ coef) ** 2))
    return float(np.sqrt(total / len(states)))


def test_every_point_is_the_best_of_all_sets_by_brute_force() -> None:
    states = states_of(folder(1, 2, 3, 4))
    assert not states.exact_zero  # drift: with a constant, as the fit
    curve = sensor_curve(states)
    assert [p.count for p in curve.points] == [1, 2, 3, 4]
    for point in curve.points:
        errors = {s: held_out_um(states, s) for s in itertools.combinations(range(5), point.count)}
        best = min(errors, key=lambda s: errors[s])
        assert point.sensors == tuple(SENSORS[j] for j in best)
        assert point.held_out_um == pytest.approx(errors[best], rel=1e-9)
        assert point.score_um == pytest.approx(point.held_out_um, rel=1e-9)
        assert point.proven
        assert point.residual_um < point.held_out_um


def test_the_curve_bends_where_the_truth_has_its_sensors() -> None:
    curve = sensor_curve(states_of(folder(1, 2, 3, 4)))
    assert curve.best == 2
    assert curve.points[1].sensors == ("a", "d")
    # noise of 0.5 µm in two directions is all that remains: 0.5 sqrt(2) = 0.71
    assert curve.points[1].held_out_um == pytest.approx(0.71, abs=0.05)
    assert curve.points[0].held_out_um > 3.0


def test_shares_name_the_sensors_that_are_chosen_whatever_campaigns_are_drawn() -> None:
    shares = sensor_curve(states_of(folder(1, 2, 3, 4))).shares
    assert shares is not None
    told = dict(zip(shares.sensors, shares.share, strict=True))
    assert told == {"a": 1.0, "b": 0.0, "c": 0.0, "d": 1.0, "e": 0.0}
    assert (shares.count, shares.draws) == (2, 200)


def test_where_the_error_is_zero_at_the_reference_the_search_runs_through_zero() -> None:
    """Twice the rows, half of them negated, has the mean zero: the same as regression without a constant."""
    states = replace(states_of(folder(1, 2, 3)), exact_zero=True)
    point = sensor_curve(states, [2]).points[0]
    used = ~states.cold
    x, y = states.rise_K[:, [0, 3]], states.intercept_um
    total = 0.0
    for label in np.unique(states.campaign):
        out = used & (states.campaign == label)
        coef = np.linalg.lstsq(x[used & ~out], y[used & ~out], rcond=None)[0]
        total += float(np.sum((y[out] - x[out] @ coef) ** 2))
    assert point.sensors == ("a", "d")
    assert point.held_out_um == pytest.approx(np.sqrt(total / used.sum()), rel=1e-9)


def test_score_residual_and_worst_campaign_are_passed_on() -> None:
    states = states_of(folder(1, 2, 3, 4))
    residual = sensor_curve(states, [2], "residual").points[0]
    assert residual.score_um == pytest.approx(residual.residual_um)
    worst = sensor_curve(states, [2], "worst_campaign").points[0]
    assert worst.score_um >= worst.held_out_um
    assert worst.worst_campaign in {"c1", "c2", "c3", "c4"}


def test_a_long_log_is_searched_from_summaries_of_its_campaigns() -> None:
    states = states_of(folder(1, 2, 3, rows=3000))
    summaries = campaign_summaries(states)
    assert [s.count for s in summaries] == [3000, 3000, 3000]
    assert sensor_curve(states, [2]).points[0].sensors == ("a", "d")


def test_a_sensor_that_a_campaign_lacks_is_no_candidate() -> None:
    states = states_of(folder(1, 2, 3))
    lost = np.where((states.campaign == 1)[:, None] & (np.arange(5) == 0), np.nan, states.rise_K)
    curve = sensor_curve(replace(states, rise_K=lost), [2])
    assert curve.points[0].sensors == ("b", "d")


def test_too_many_sensors_or_too_few_campaigns_are_told() -> None:
    with pytest.raises(AnalysisError, match=r"6 sensors cannot be chosen from 5"):
        sensor_curve(states_of(folder(1, 2, 3)), [6])
    with pytest.raises(AnalysisError, match="two campaigns"):
        sensor_curve(states_of(folder(1)))


def test_stopping_early_is_told() -> None:
    rounds = iter([False, False, True])
    curve = sensor_curve(states_of(folder(1, 2, 3)), stop=lambda: next(rounds, True))
    assert len(curve.points) < 4
    assert curve.shares is None
    assert any("stopped" in note for note in curve.notes)


def test_a_stopped_search_gives_the_bound_below_what_it_found() -> None:
    rng = np.random.default_rng(8)
    names = [f"s{j}" for j in range(40)]
    parts = [summarise(rng.normal(size=(60, 40)), rng.normal(size=(60, 1)), names, ["y"], f"c{k}") for k in range(3)]
    found = best_subset(parts, 6, stop=lambda: True)
    assert not found.proven
    assert 0.0 <= found.bound < found.score


def test_enough_is_the_fewest_within_five_percent() -> None:
    point = sensor_curve(states_of(folder(1, 2, 3)), [1]).points[0]
    errors = [3.0, 1.04, 1.0, 1.2]
    points = [replace(point, count=k + 1, held_out_um=error) for k, error in enumerate(errors)]
    assert enough(points) == 2


def test_analyze_writes_the_curve_and_draws_it(tmp_path: Path) -> None:
    analysis = analyze_folder(folder(1, 2, 3))
    write_files(tmp_path, table_files(analysis))
    with (tmp_path / "sensor_curve.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [row["count"] for row in rows if row["sensors"]] == ["1", "2", "3", "4"]
    assert rows[1]["sensors"] == "a d"
    assert {row["sensor"]: row["share_percent"] for row in rows if row["sensor"]}["d"] == "100"
    (figure,) = accuracy_over_sensors(analysis)
    assert figure.section == "sensor_curve"
    left, right = figure.figure.axes
    assert [label.get_text() for label in left.get_xticklabels()][1] == "2\na\nd"
    held_out = next(line for line in left.get_lines() if line.get_label() == "campaigns left out")
    drawn: Floats = np.asarray(held_out.get_ydata(), dtype=float)
    np.testing.assert_allclose(drawn, [p.held_out_um for p in analysis.sensor_curves[0].points])
    assert right.get_title(loc="left") == "campaigns resampled 200 times"


def test_no_curve_where_campaigns_are_too_few() -> None:
    code = (
        "import sys\n"
        "from importlib.resources import files\n"
        "from thetacomp.analysis import analyze_folder\n"
        "from thetacomp.reading import read_folder\n"
        "analysis = analyze_folder(read_folder(files('thetacomp.examples') / 'tk6920'))\n"
        "assert analysis.sensor_curves == ()\n"
        "assert 'numba' not in sys.modules and 'sklearn' not in sys.modules\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=200, check=False)
    assert done.returncode == 0, done.stderr


def written(root: Path) -> Path:
    """The folder of three campaigns as files."""
    ids = "".join(f'[[sensors]]\nid = "{name}"\nrole = "structure"\n' for name in SENSORS)
    root.mkdir()
    (root / "machine.toml").write_text(f'format = 1\n[machine]\nname = "five"\n{ids}', encoding="utf-8")
    for one in folder(1, 2, 3).campaigns:
        home = root / "campaigns" / one.name
        home.mkdir(parents=True)
        assert one.drift is not None
        for name, head, values in (
            ("temperatures", "t_s," + ",".join(SENSORS), one.temperatures.value_degC),
            ("drift", "t_s,dX_um,dZ_um", one.drift.error_um[:, [0, 2]]),
        ):
            table = np.column_stack([one.temperatures.t_s, values])
            np.savetxt(home / f"{name}.csv", table, delimiter=",", header=head, comments="", fmt="%.6f")
    return root


def test_the_command_prints_curve_and_shares(tmp_path: Path) -> None:
    path = written(tmp_path / "machine")
    done = CliRunner().invoke(app, ["keypoints", str(path), "--method", "exact"])
    assert done.exit_code == 0, done.output
    assert "Enough (within 5 % of the best): 2." in done.stdout
    assert "a 100 %" in done.stdout
    done = CliRunner().invoke(app, ["keypoints", str(path), "--method", "exact", "--sensors", "2", "--json"])
    (axis,) = json.loads(done.stdout)["axes"]
    (point,) = axis["points"]
    assert point["sensors"] == ["a", "d"]
    assert point["proven"] is True
    assert axis["shares"]["draws"] == 200


def test_the_command_tells_the_bound_when_the_time_is_up_or_ctrl_c_comes(tmp_path: Path) -> None:
    from thetacomp.cli import keypoints_exact

    path = written(tmp_path / "machine")
    done = CliRunner().invoke(
        app, ["keypoints", str(path), "--method", "exact", "--sensors", "3", "--budget-s", "0", "--json"]
    )
    (axis,) = json.loads(done.stdout)["axes"]
    point = axis["points"][0]
    assert point["bound_um"] <= point["score_um"]
    assert point["proven"] == (point["bound_um"] == point["score_um"])
    before = signal.getsignal(signal.SIGINT)
    with keypoints_exact._interruptible() as stopped:
        assert not stopped()
        signal.raise_signal(signal.SIGINT)
        assert stopped()
    assert signal.getsignal(signal.SIGINT) is before


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--sensors", "2"], "belong to --method exact"),
        (["--method", "exact", "--sensors", "0"], "--sensors"),
    ],
)
def test_options_that_do_not_fit_are_bad_usage(tmp_path: Path, arguments: list[str], said: str) -> None:
    done = CliRunner().invoke(app, ["keypoints", str(tmp_path), *arguments])
    assert done.exit_code == 2
    assert said in done.output

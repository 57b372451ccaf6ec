"""The stated reach of a plan against simulated measurements, down to what the analysis makes of them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from plan_machines import SHORT, boring_machine, mill, three
from scipy.spatial.transform import Rotation

from thetacomp.arrays import CARTESIAN
from thetacomp.machine import Axis
from thetacomp.planning.foundation import propose_targets, rigid_rows, tool_reach_mm
from thetacomp.planning.options import PlanOptions
from thetacomp.planning.setup import Setup, make_setup
from thetacomp.planning.timetable import COLD_ROUNDS
from thetacomp.planning.uncertainty import line_covariance, visible_changes
from thetacomp.planning.writer import make_plan, write_plan
from thetacomp.reading import read_folder
from thetacomp.separation import separate_campaign

STATION = PlanOptions(
    tracker_u_um=15.0, tracker_u_um_per_m=6.0, tracker_at_mm=(1500.0, 1500.0, -5000.0), park_mm={"W": 500.0}
)


def seen_from(setup: Setup, point_mm: np.ndarray) -> float:
    """Standard uncertainty in µm at a place, from its definition."""
    distance_m = np.linalg.norm(point_mm - np.array(setup.options.tracker_at_mm)) / 1000.0
    return (setup.options.tracker_u_um + setup.options.tracker_u_um_per_m * distance_m) / 2.0


def station_motion(rng: np.random.Generator, setup: Setup) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What one round believes of the station: each target read twice, best rigid motion by singular values (Kabsch).

    Returns rotation vector (3,) in µrad, the centre of the targets in mm, and the shift of that centre in µm. The
    station did not move, so all of it is error. This is another way than the normal equations of the plan.
    """
    places = np.array([target.at_mm for target in propose_targets(setup)])
    sd = np.array([seen_from(setup, place) for place in places])
    weight = sd**-2 / np.sum(sd**-2)
    read = places + rng.normal(size=(2, *places.shape)).mean(axis=0) * sd[:, None] / 1000.0
    centre, shifted = weight @ places, weight @ read
    rotation, _ = Rotation.align_vectors(read - shifted, places - centre, weights=weight)
    return rotation.as_rotvec() * 1e6, centre, (shifted - centre) * 1000.0


def simulated(rng: np.random.Generator, setup: Setup, axis_name: str) -> dict[str, np.ndarray]:
    """One heated round against the cold rounds with nothing but errors of the instrument: (3,) for each quantity."""
    axis = setup.of(axis_name)
    position = np.repeat(axis.target_mm, 2)
    places = np.array([setup.tool_mm({**setup.park_mm, axis_name: p}) for p in position])
    sd = np.array([seen_from(setup, place) for place in places])
    p0 = np.mean(axis.axis.travel_mm)
    lever = (position - p0) / 1000.0
    middle = setup.tool_mm({**setup.park_mm, axis_name: p0})
    rounds = []
    for _ in range(1 + COLD_ROUNDS):
        angle = rng.normal(size=3) * setup.options.tracker_u_um_per_m / 2.0
        error = rng.normal(size=(len(position), 3)) * sd[:, None] + np.outer(lever, angle)
        fit = np.polyfit(lever, error, 1)  # slope, intercept
        turn, centre, shift = station_motion(rng, setup)

        def station(place, turn=turn, centre=centre, shift=shift):
            return shift + np.cross(turn, (place - centre) / 1000.0)

        at_ends = [fit[1] + fit[0] * lever[k] + station(places[k]) for k in (0, len(position) - 1)]
        rounds.append(np.stack([fit[0], fit[1], fit[1] + station(middle), *at_ends]))
    changes = rounds[0] - np.mean(rounds[1:], axis=0)
    return dict(zip(("slope", "intercept", "drift", "low", "high"), changes, strict=True))


@pytest.mark.parametrize("axis", ["Y", "W"])
def test_the_closed_form_agrees_with_a_monte_carlo(axis: str) -> None:
    setup = make_setup(boring_machine(), STATION)
    rng = np.random.default_rng(20260302)
    runs = [simulated(rng, setup, axis) for _ in range(1000)]
    scatter = {name: np.std([run[name] for run in runs], axis=0) for name in runs[0]}
    # 1000 runs know a standard deviation to 2.2 %; 7 % are more than three times that.
    for row in visible_changes(setup, propose_targets(setup)):
        if row.axis == axis:
            k = CARTESIAN.index(row.direction)
            assert row.slope_se_um_per_m == pytest.approx(scatter["slope"][k], rel=0.07)
            assert row.intercept_se_um == pytest.approx(scatter["intercept"][k], rel=0.07)
            assert row.drift_se_um == pytest.approx(scatter["drift"][k], rel=0.07)
            assert row.end_se_um == pytest.approx(max(scatter["low"][k], scatter["high"][k]), rel=0.07)


def test_line_covariance_in_a_case_that_is_done_by_hand() -> None:
    # Two points 1 m apart around P0, each with 3 µm: I is their mean, 3/√2; S their difference over 1 m, 3 √2.
    covariance = line_covariance(np.array([500.0, 1500.0]), np.array([3.0, 3.0]), 1000.0)
    assert covariance == pytest.approx(np.diag([4.5, 18.0]))


def test_analyze_states_what_the_plan_promised_and_scatters_by_it(tmp_path: Path) -> None:
    """The empty tables are filled with instrument noise over a known machine, read back, and separated."""
    options = PlanOptions(duration_h=3.0, cool_h=0.0, mode="no cooling", tracker_u_um=10.0, tracker_u_um_per_m=6.0)
    machine = mill(Axis(name="X", direction="+X", travel_mm=(0.0, 2000.0)))
    plan = make_plan(machine, options)
    write_plan(plan, TOML.encode(), tmp_path / "plan")
    folder = tmp_path / "plan" / "machine_folder"
    place = folder / "campaigns" / "planned"
    (place / "temperatures.csv").write_text("t_s,t1,t2\n0,20,20\n7200,24,20.1\n20000,28,20.2\n", "utf-8")
    sweeps = (place / "sweeps.csv").read_text("utf-8").splitlines()
    (place / "sweeps.csv").write_text("\n".join([sweeps[0], *(s.replace(",,,", ",1,2,3", 1) for s in sweeps[1:])]))
    filled = read_folder(folder)
    campaign = filled.campaigns[0]
    points = campaign.sweeps
    assert points is not None
    lever = (points.position_mm - 1000.0) / 1000.0
    shape = 20 * lever**3 - 8 * lever + 3 * points.direction
    rng = np.random.default_rng(5)
    found: dict[str, list[np.ndarray]] = {"I": [], "S": [], "I se": [], "S se": []}
    for _ in range(60):
        angle = rng.normal(size=(points.sweep.max() + 1, 3)) * 3.0
        noise = rng.normal(size=(len(lever), 3)) * (10.0 + 6.0 * 5.0) / 2.0
        error = shape[:, None] + noise + angle[points.sweep] * lever[:, None]
        for part in separate_campaign(filled.machine, replace(campaign, sweeps=replace(points, error_um=error))):
            hot = ~part.cold
            assert list(part.cold) == [True] * COLD_ROUNDS + [False] * 3
            found["I"].append(part.intercept_um[hot])
            found["S"].append(part.slope_um_per_m[hot])
            found["I se"].append(part.intercept_se_um[hot])
            found["S se"].append(part.slope_se_um_per_m[hot])
    row = plan.visible_changes[0]
    # 180 components know a standard deviation to 5 %; the sweeps of one component share their cold block.
    assert np.std(found["I"]) == pytest.approx(row.intercept_se_um, rel=0.15)
    assert np.std(found["S"]) == pytest.approx(row.slope_se_um_per_m, rel=0.15)
    assert np.median(found["I se"]) == pytest.approx(row.intercept_se_um, rel=0.10)
    assert np.median(found["S se"]) == pytest.approx(row.slope_se_um_per_m, rel=0.10)


TOML = """\
format = 1
[machine]
name = "mill"
[[axes]]
name = "X"
direction = "+X"
travel_mm = [0.0, 2000.0]
[[sensors]]
id = "t1"
role = "drive"
[[sensors]]
id = "t2"
role = "ambient"
"""


def test_a_small_turn_moves_a_point_by_the_cross_product() -> None:
    rng = np.random.default_rng(3)
    point, centre, shift_um, turn_urad = rng.normal(size=(4, 3)) * 1000.0
    moved = rigid_rows(point, centre) @ np.concatenate([shift_um, turn_urad])
    assert moved == pytest.approx(shift_um + np.cross(turn_urad, (point - centre) / 1000.0))


def test_more_points_and_a_nearer_tracker_help() -> None:
    def worst(options: PlanOptions) -> float:
        setup = make_setup(mill(), options)
        return max(row.visible_um for row in visible_changes(setup, propose_targets(setup)))

    base = PlanOptions(tracker_distance_mm=6000.0)
    assert worst(replace(base, points=41)) < worst(base)
    assert worst(replace(base, tracker_distance_mm=2000.0)) < worst(base)
    assert worst(replace(base, tracker_u_um_per_m=12.0)) > worst(base)


def test_the_targets_stand_around_the_reach_of_the_tool_below_it_and_not_on_one_line() -> None:
    for vertical in CARTESIAN:
        setup = make_setup(boring_machine(), replace(SHORT, vertical=vertical))
        low, high = tool_reach_mm(setup)
        places = np.array([target.at_mm for target in propose_targets(setup)])
        up = CARTESIAN.index(vertical)
        assert (places[:, up] < low[up]).all()
        flat = [k for k in range(3) if k != up]
        assert (places[:, flat].min(axis=0) < low[flat]).all()
        assert (places[:, flat].max(axis=0) > high[flat]).all()
        spread = np.linalg.svd(places - places.mean(axis=0), compute_uv=False)
        assert spread[1] > 1000.0


def test_a_reversed_direction_turns_the_tool_and_not_the_axis() -> None:
    setup = make_setup(mill(), SHORT)  # its Y runs along -Y, from -500 to 0
    assert setup.tool_mm({"X": 10.0, "Y": -200.0, "Z": 30.0}).tolist() == [10.0, 200.0, 30.0]
    turned = make_setup(mill(*three(z="-Z")), SHORT)
    assert turned.of("Z").target_mm == setup.of("Z").target_mm
    assert (setup.of("Z").park_mm, turned.of("Z").park_mm) == (594.0, 6.0)  # away from the workpiece, both

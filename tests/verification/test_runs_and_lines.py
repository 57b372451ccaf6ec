"""What a verification takes from separations and campaigns: points, facts, straightness, squareness, by hand."""

from __future__ import annotations

import re
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from thetacomp.arrays import Floats
from thetacomp.campaign import Campaign, CampaignSettings, MachineFolder
from thetacomp.errors import AnalysisError
from thetacomp.machine import Axis, Machine, Sensor
from thetacomp.model.temperatures import Temperatures
from thetacomp.verification.expected_error import Expected
from thetacomp.verification.runs import chosen, facts, run_points, zero_scatter
from thetacomp.verification.straightness import END_POINTS, LEAST_SQUARES, squareness, straightness

AXES = (
    Axis(name="X", direction="+X", travel_mm=(0, 1000)),
    Axis(name="Y", direction="-Y", travel_mm=(0, 1000)),
    Axis(name="Z", direction="+Z", travel_mm=(0, 1000)),
    Axis(name="W", direction="+Z", travel_mm=(0, 1000)),
)
MACHINE = Machine(name="m", axes=AXES, sensors=(Sensor(id="t1", role="drive"), Sensor(id="t2", role="ambient")))


def part(component: str, campaign: str, **values: Any) -> Any:
    """A separation with four states, the first one cold, as far as a test needs it."""
    drift = component.startswith("D")
    given: dict[str, Any] = {
        "component": component, "campaign": campaign, "direction": component[1],
        "axis": None if drift else component[2:],
        "t_s": np.array([0.0, 100.0, 200.0, 300.0]), "sweep": np.arange(4), "zero_t_s": np.array([0.0]),
        "cold": np.array([True, False, False, False]), "slope_um_per_m": np.zeros(4), "points": None,
    }  # fmt: skip
    return SimpleNamespace(**(given | values))


# --- lines ------------------------------------------------------------------------------------------------------------


def points(heights_um: list[float], outlier: int | None = None, targets: int = 5) -> Any:
    """A parabola a sweep that is `height` high over its end points, on a tilted line; read out and back."""
    place = np.linspace(0.0, 1000.0, targets)
    place = np.concatenate([place, place[::-1]])
    sweep = np.repeat(np.arange(len(heights_um)), len(place))
    position = np.tile(place, len(heights_um))
    shape = 4.0 * position * (1000.0 - position) / 1e6
    error = np.repeat(heights_um, len(place)) * shape + 0.3 * position + 7.0
    out = np.zeros(len(sweep), dtype=bool)
    if outlier is not None:
        error[outlier] += 500.0
        out[outlier] = True
    return SimpleNamespace(sweep=sweep, position_mm=position, error_um=error, outlier=out)


def test_straightness_is_the_mean_of_the_cold_and_the_largest_of_the_heated_sweeps() -> None:
    """On the end points a parabola is as high as it is; so it is on the least-squares line, parallel to the chord."""
    cold = np.array([True, True, False, False, False])
    sweeps = {"sweep": np.arange(5), "cold": cold}
    parts = [
        part("EYX", "a", **sweeps, points=points([2.0, 4.0, 5.0, 9.0, 6.0], outlier=33)),
        part("EYX", "b", **sweeps, points=points([1.0, 1.0, 8.0, 3.0, 2.0])),
        part("EYX", "c", **sweeps, points=points([7.0, 9.0, 3.0, 4.0, 1.0])),
        part("EXX", "a", **sweeps, points=points([1.0] * 5)), part("EXX", "c", **sweeps, points=points([1.0] * 5)),
    ]  # fmt: skip
    found = straightness(MACHINE, parts, ["a", "b"], ["c"])
    assert [(s.component, s.line) for s in found] == [("EYX", LEAST_SQUARES), ("EYX", END_POINTS)]
    for one in found:
        assert (one.cold_off_um, one.off_um) == (pytest.approx(2.0), pytest.approx(9.0))
        assert (one.cold_on_um, one.on_um) == (pytest.approx(8.0), pytest.approx(4.0))


def test_straightness_needs_points_in_both_runs_and_three_positions_in_a_sweep() -> None:
    both = [part("EYX", name, points=points([1.0, 2.0, 3.0, 4.0])) for name in ("a", "c")]
    assert straightness(MACHINE, both[:1], ["a"], ["c"]) == ()
    assert straightness(MACHINE, [both[0], part("EYX", "c")], ["a"], ["c"]) == ()
    assert straightness(MACHINE, [part("DY", n, points=points([1.0] * 4)) for n in ("a", "c")], ["a"], ["c"]) == ()
    two = [part("EYX", name, points=points([1.0, 2.0, 3.0, 4.0], targets=2)) for name in ("a", "c")]
    assert all(np.isnan([s.cold_off_um, s.off_um]).all() for s in straightness(MACHINE, two, ["a"], ["c"]))
    three = [part("EYX", name, points=points([1.0, 2.0, 3.0, 4.0], targets=3)) for name in ("a", "c")]
    assert straightness(MACHINE, three, ["a"], ["c"])[1].off_um == pytest.approx(4.0)


def slopes(*values: float) -> dict[str, Floats]:
    return {"slope_um_per_m": np.array(values)}


def test_tilt_is_the_largest_slope_of_either_sign_over_the_campaigns_of_a_run() -> None:
    parts = [
        part("EYX", "a", **slopes(0.0, -9.0, 2.0, np.nan)), part("EYX", "b", **slopes(0.0, 5.0, 7.0, 1.0)),
        part("EYX", "c", **slopes(0.0, 1.0, -3.0, 2.0)), part("EXX", "a", **slopes(0.0, 50.0, 0.0, 0.0)),
        part("DX", "a", **slopes(0.0, 60.0, 0.0, 0.0)),
    ]  # fmt: skip
    (tilt,) = squareness(MACHINE, parts, ["a", "b"], ["c"])
    assert (tilt.name, tilt.off_urad, tilt.on_urad) == ("EYX", 9.0, 3.0)
    (lost,) = squareness(MACHINE, [part("EYX", "a", **slopes(*[np.nan] * 4))], ["a"], ["c"])
    assert np.isnan([lost.off_urad, lost.on_urad]).all()


def test_the_angle_of_two_axes_is_the_sum_of_both_tilts_along_the_positive_directions_at_one_time() -> None:
    """Y runs along -Y: its tilt counts with the other sign. The tilt of X is read at the times of Y, between its own.

    EXY at 0, 100, 200, 300 s is 0, -4, -8, -2; EYX, measured 50 s later, is 2, 6, 10 between: -EXY + EYX.
    """
    later = {"t_s": np.array([50.0, 150.0, 250.0, 350.0])}
    parts = [
        part("EXY", "a", **slopes(0.0, -4.0, -8.0, -2.0)),
        part("EYX", "a", **later, **slopes(0.0, 4.0, 8.0, 12.0)),
    ]
    *tilts, angle = squareness(MACHINE, parts, ["a"], ["a"])
    assert [s.name for s in tilts] == ["EXY", "EYX"]
    assert (angle.name, angle.off_urad) == ("X-Y", pytest.approx(max(0.0, 4.0 + 2.0, 8.0 + 6.0, 2.0 + 10.0)))


def test_of_several_campaigns_the_largest_change_counts_and_one_that_lacks_a_line_is_passed_over() -> None:
    parts = [
        part("EXY", "a", **slopes(0.0, -1.0, -2.0, -3.0)), part("EYX", "a", **slopes(0.0, 1.0, 2.0, 3.0)),
        part("EXY", "b", **slopes(0.0, 99.0, 99.0, 99.0)),
        part("EXY", "c", **slopes(0.0, 2.0, 5.0, 1.0)), part("EYX", "c", **slopes(0.0, -2.0, -5.0, -1.0)),
        part("EXY", "d", **slopes(*[np.nan] * 4)), part("EYX", "d", **slopes(*[np.nan] * 4)),
    ]  # fmt: skip
    angle = squareness(MACHINE, parts, ["a", "b", "c"], ["b", "d"])[-1]
    assert (angle.off_urad, np.isnan(angle.on_urad)) == (10.0, True)
    # The same tilts with one sign cancel on this pair of axes.
    same = [part("EXY", "a", **slopes(0.0, 5.0, 5.0, 5.0)), part("EYX", "a", **slopes(0.0, 5.0, 5.0, 5.0))]
    assert squareness(MACHINE, same, ["a"], ["a"])[-1].off_urad == 0.0


def test_two_axes_along_one_direction_have_no_angle() -> None:
    parts = [part(c, "a", **slopes(0.0, 1.0, 2.0, 3.0)) for c in ("EZZ", "EZW", "EXZ", "EZX")]
    assert [s.name for s in squareness(MACHINE, parts, ["a"], ["a"])] == ["EXZ", "EZX", "X-Z"]


# --- runs -------------------------------------------------------------------------------------------------------------


def campaign(name: str, compensation: str, **settings: Any) -> Campaign:
    t_s = np.array([0.0, 100.0, 200.0, 300.0, 400.0])
    heat = np.array([[20.0, 22.0], [24.0, 21.0], [21.0, 22.0], [22.0, np.nan], [90.0, 22.0]])
    given = CampaignSettings(compensation=compensation, **settings)  # type: ignore[arg-type]
    return Campaign(name, given, Temperatures(t_s, ("t1", "t2"), heat))


def folder(*campaigns: Campaign) -> MachineFolder:
    return MachineFolder(MACHINE, campaigns)


def test_the_campaigns_of_both_runs_in_the_order_of_the_command() -> None:
    made = folder(campaign("a", "off"), campaign("b", "off"), campaign("c", "on"))
    off, on = chosen(made, ["b", "a"], ["c"])
    assert ([c.name for c in off], [c.name for c in on]) == (["b", "a"], ["c"])


@pytest.mark.parametrize(
    ("off", "on", "message"),
    [
        ([], ["c"], "a verification needs a run with compensation off and one with it on"),
        (["a"], [], "a verification needs a run with compensation off and one with it on"),
        (["x"], ["y"], "there is no campaign x, y; the folder has a, b, c, d"),
        (["a"], ["b"], 'campaign b is named with --on, but its campaign.toml says compensation = "off"'),
        (["c"], ["c"], "campaign c is named twice"),
        (["a", "b", "a"], ["c"], "campaign a is named twice"),
        (["a"], ["c", "d"], "the campaigns named with --on have different active tables (c: 'pitch, sag', d: 'pitch')"),
    ],
)
def test_names_that_contradict_the_folder_are_refused(off: list[str], on: list[str], message: str) -> None:
    made = folder(
        campaign("a", "off"), campaign("b", "off"), campaign("c", "on", active_tables=("sag", "pitch")),
        campaign("d", "on", active_tables=("pitch",)),
    )  # fmt: skip
    with pytest.raises(AnalysisError, match=re.escape(message)):
        chosen(made, off, on)


def test_the_order_of_active_tables_makes_no_difference() -> None:
    made = folder(
        campaign("a", "off"), campaign("c", "on", active_tables=("sag", "pitch")),
        campaign("d", "on", active_tables=("pitch", "sag")),
    )  # fmt: skip
    assert len(chosen(made, ["a"], ["c", "d"])[1]) == 2


def states(exact_zero: bool = True) -> Any:
    """Three campaigns, five states; the points of a component stand in no order."""
    state = np.array([4, 0, 1, 1, 3, 2, 4])
    return SimpleNamespace(
        campaigns=("a", "b", "c"), campaign=np.array([0, 0, 1, 1, 2]), cold=np.array([True, False, False, True, False]),
        exact_zero=exact_zero, t_s=np.array([0.0, 10.0, 20.0, 30.0, 40.0]), p0_mm=250.0,
        samples=(
            SimpleNamespace(
                state=state, lever_m=0.1 * np.arange(7), value_um=10.0 * np.arange(7),
                noise_sd_um=np.array([9.0, 9.0, 1.0, 1.0, 9.0, 4.0, 9.0]),
            ),
        ),
        __len__=None,
    )  # fmt: skip


class States(SimpleNamespace):
    def __len__(self) -> int:
        return len(self.t_s)


def table(exact_zero: bool = True) -> Any:
    return States(**vars(states(exact_zero)))


def test_points_of_a_run_are_those_of_its_heated_states_in_order() -> None:
    expected = Expected(np.arange(7.0), -np.arange(7.0), left_um=2.5, campaigns=3)
    found = run_points(table(), 0, ["a", "b"], expected)
    assert found is not None
    assert found.value_um.tolist() == [20.0, 30.0, 50.0]
    assert found.state.tolist() == [0, 0, 1]
    assert (found.campaign.tolist(), found.t_s.tolist(), found.p0_mm) == ([0, 1], [10.0, 20.0], 250.0)
    assert found.noise_sd_um == pytest.approx(np.sqrt((1.0 + 1.0 + 16.0) / 3.0))
    assert (found.intercept_um.tolist(), found.slope_um_per_m.tolist()) == ([2.0, 3.0, 5.0], [-2.0, -3.0, -5.0])
    np.testing.assert_allclose(found.expected_um, found.intercept_um + found.slope_um_per_m * found.lever_m)
    assert (found.left_um, found.law_campaigns) == (2.5, 3)
    # Where the zero is a measurement like any other, cold states are states.
    whole = run_points(table(exact_zero=False), 0, ["a", "b"], expected)
    assert whole is not None
    assert whole.value_um.tolist() == [10.0, 20.0, 30.0, 50.0, 40.0]
    assert run_points(table(), 0, ["none"], expected) is None


def test_points_without_an_expected_error_are_left_out_unless_none_has_one() -> None:
    intercept, slope = np.arange(7.0), np.arange(7.0)
    intercept[2], slope[3] = np.nan, np.nan
    found = run_points(table(), 0, ["a", "b", "c"], Expected(intercept, slope))
    assert found is not None
    assert found.value_um.tolist() == [50.0, 0.0, 60.0]
    assert found.explained
    nothing = np.full(7, np.nan)
    whole = run_points(table(), 0, ["a", "b", "c"], Expected(nothing, nothing))
    assert whole is not None
    assert whole.value_um.tolist() == [20.0, 30.0, 50.0, 0.0, 60.0]
    assert not whole.explained
    zero = run_points(table(), 0, ["a"], Expected(np.zeros(7), np.zeros(7)))
    assert zero is not None
    assert not zero.explained


def test_the_scatter_of_the_zero_is_pooled_over_the_campaigns_of_the_run() -> None:
    """Variances 9 / 2 and 36 / 3 of one and of two cold sweeps; a campaign without heat tells nothing."""
    se, twice = {"intercept_se_um": np.full(4, 3.0)}, {"intercept_se_um": np.array([0.0, 0.0, 6.0, 6.0])}
    none = {"slope_se_um_per_m": np.full(4, np.nan)}
    parts = [
        part("EYX", "a", **se, **none), part("EYX", "b", **twice, **none, cold=np.array([True, True, False, False])),
        part("EYX", "c", **se, **none), part("EXX", "a", **twice, **none),
        part("EYX", "d", **twice, **none, cold=np.full(4, True)),
    ]  # fmt: skip
    assert zero_scatter(parts, "EYX", ["a", "b", "d"]) == (pytest.approx(np.sqrt((4.5 + 12.0) / 2)), 0.0)
    assert zero_scatter(parts[::-1], "EYX", ["a", "b", "d"]) == zero_scatter(parts, "EYX", ["a", "b", "d"])


def test_facts_of_a_run_by_hand() -> None:
    """Zero at 0 and 100 s: t1 22 °C, t2 21.5; the last sweep is at 300 s, so the 90 °C at 400 s are not of the run."""
    one = campaign("a", "off", mode="dry", active_tables=("pitch",), instrument="tracker")
    zero = {"zero_t_s": np.array([0.0, 100.0])}
    parts = [part("EXX", "a", **zero), part("EYX", "a", **zero), part("DX", "a", **zero), part("EXX", "other")]
    found = facts([one], parts)
    assert (found.campaigns, found.mode, found.tables, found.instrument) == (("a",), "dry", ("pitch",), "tracker")
    assert found.hours == pytest.approx(250.0 / 3600.0)
    assert found.start_degC == pytest.approx((22.0 + 21.5) / 2)
    assert found.heated_sweeps == 3  # one sweep has two components; drift is no sweep
    # t1 goes from -2 K to +2 K, the first of equals; t2 from -0.5 K to +0.5 K.
    assert dict(found.rises_K) == {"t1": pytest.approx(-2.0), "t2": pytest.approx(0.5)}
    assert [name for name, _ in found.rises_K] == ["t1", "t2"]


def test_the_facts_of_several_campaigns_are_the_longest_and_the_largest() -> None:
    calm, warm = campaign("a", "off"), campaign("b", "off")
    value = warm.temperatures.value_degC + np.array([[0.0, 0.0], [0.0, -9.0], [0.0, 0.0], [0.0, 0.0], [0.0, 0.0]])
    warm = Campaign("b", warm.settings, Temperatures(warm.temperatures.t_s, ("t1", "t2"), value + 1.0))
    longer = {"t_s": np.array([0.0, 100.0, 200.0, 350.0])}
    found = facts([calm, warm], [part("EXX", "b"), part("EXX", "a", **longer)])
    assert found.hours == pytest.approx(350.0 / 3600.0)
    assert found.start_degC == pytest.approx((21.0 + 22.0) / 2)
    assert dict(found.rises_K) == {"t1": pytest.approx(4.0), "t2": pytest.approx(-10.0)}
    assert [name for name, _ in found.rises_K] == ["t2", "t1"]
    assert found.heated_sweeps == 6
    other = facts([warm, calm], [part("EXX", "b"), part("EXX", "a", **longer)])
    assert (other.rises_K, other.hours, other.start_degC) == (found.rises_K, found.hours, found.start_degC)

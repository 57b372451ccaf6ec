"""The sensor strategies and the default choice of key points."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from thetacomp.arrays import Floats, Ints
from thetacomp.campaign import CorrelationTable
from thetacomp.errors import AnalysisError
from thetacomp.folds import fold_numbers
from thetacomp.machine import Axis, Machine, Sensor
from thetacomp.sensors import strategies
from thetacomp.sensors.correlation import correlations, effective_count, full_symmetric, p_value, pair_p_value
from thetacomp.sensors.holdout import HoldOut, line_targets
from thetacomp.sensors.key_points import AxisKeyPoints
from thetacomp.sensors.parameters import INTERCEPT, SLOPE, Parameter, ParameterTable, correlation_tables
from thetacomp.sensors.selection import (
    drive_sensors,
    key_points_from_correlations,
    paper_key_points,
    select_key_points,
)


def ids(count: int) -> tuple[str, ...]:
    return tuple(f"t{i}" for i in range(count))


def table(value: Floats, rise_K: Floats, campaign: Ints | None = None, axis: str = "X") -> ParameterTable:
    """Columns of `value`: intercept and slope of EXX, of EYX, … over a travel of 2 m with P0 in the middle."""
    kinds = (INTERCEPT, SLOPE)
    parameters = tuple(Parameter(f"E{'XYZ'[i // 2]}{axis}", kinds[i % 2], -1.0, 1.0) for i in range(value.shape[1]))
    if campaign is None:
        campaign = np.zeros(len(value), dtype=np.int64)
    return ParameterTable(axis, parameters, value, ids(rise_K.shape[1]), rise_K, campaign)


def warm_ups(rng: np.random.Generator, campaigns: int = 4, states: int = 12) -> tuple[Floats, Floats, Ints]:
    """Two heat sources with duty of their own in every campaign, first-order rises: (n,), (n,) in K, campaign (n,)."""
    t_h = np.arange(states, dtype=float)
    spindle = np.concatenate([rng.uniform(3, 12) * -np.expm1(-t_h / 1.5) for _ in range(campaigns)])
    drive = np.concatenate([rng.uniform(2, 10) * -np.expm1(-t_h / 4.0) for _ in range(campaigns)])
    return spindle, drive, np.repeat(np.arange(campaigns), states)


# --- correlations and significance


def test_correlations_agree_with_numpy_and_skip_missing_values() -> None:
    rng = np.random.default_rng(0)
    a, b = rng.normal(500.0, 1.0, (40, 3)), rng.normal(-80.0, 2.0, (40, 4))
    expected = np.corrcoef(a, b, rowvar=False)[:3, 3:]
    assert correlations(a, b)[0] == pytest.approx(expected, abs=1e-12)
    a[rng.random(a.shape) < 0.2] = np.nan
    b[rng.random(b.shape) < 0.2] = np.nan
    r, count = correlations(a, b)
    for i in range(3):
        for j in range(4):
            good = np.isfinite(a[:, i]) & np.isfinite(b[:, j])
            assert count[i, j] == good.sum()
            assert r[i, j] == pytest.approx(np.corrcoef(a[good, i], b[good, j])[0, 1], abs=1e-12)


def test_a_constant_has_no_correlation() -> None:
    x = np.column_stack([np.full(10, 19.3), np.arange(10.0), np.full(10, np.nan)])
    r, _ = correlations(x, x)
    assert np.isfinite(r).tolist() == [[False] * 3, [False, True, False], [False] * 3]


def test_p_value_agrees_with_scipy() -> None:
    rng = np.random.default_rng(2)
    x, y = rng.normal(size=(2, 12))
    expected = stats.pearsonr(x, y)
    assert p_value(np.array(expected.statistic), np.array(12.0)) == pytest.approx(expected.pvalue, rel=1e-9)
    assert p_value(np.array([0.99, np.nan, 1.0]), np.array([2.0, 9.0, 9.0])).tolist() == [1.0, 1.0, 0.0]


def test_effective_count_of_slow_noise() -> None:
    """Independent AR(1) series, a = 0.95: n (1 - a²) / (1 + a²) pairs, so 5 % of them pass at 5 %."""
    rng = np.random.default_rng(4)
    n, a = 2000, 0.95
    noise = rng.normal(size=(n, 600))
    for i in range(1, n):
        noise[i] += a * noise[i - 1]
    x, y, campaign = noise[:, :300], noise[:, 300:], np.zeros(n, dtype=np.int64)
    r, count = correlations(x, y)
    effective = effective_count(x, y, count, campaign)
    assert np.median(effective) == pytest.approx(n * (1 - a * a) / (1 + a * a), rel=0.1)
    # The 300 x 300 pairs share series; their rate still settles near 5 %. Uncorrected it is above 60 %.
    assert np.mean(p_value(r, effective) < 0.05) == pytest.approx(0.05, abs=0.012)
    assert np.mean(p_value(r, count) < 0.05) > 0.6


def test_short_series_keep_their_count() -> None:
    x = np.arange(50.0)[:, None]
    assert effective_count(x, x, np.array([[50.0]]), np.zeros(50, dtype=np.int64))[0, 0] == 50.0


def test_one_triangle_is_enough() -> None:
    lower = CorrelationTable(("a", "b"), ("a", "b"), np.array([[1.0, np.nan], [0.7, 1.0]]))
    assert full_symmetric(lower, ("b", "a", "c")).tolist()[0][:2] == [1.0, 0.7]
    assert np.isnan(full_symmetric(lower, ("b", "a", "c"))[0, 2])


# --- the strategies


def test_main_factor_by_hand() -> None:
    r = np.array([[0.9, -0.8, 0.1], [0.2, 0.95, 0.85]])
    found = strategies.main_factor("X", ids(3), ("EXX intercept", "EXX slope"), r, np.array([30.0, 10.0]), 0.10)
    # Weighted by 30 and 10 µm: (30·0 + 10·0.75)/40, (30·0.1 + 10·0)/40, (30·0.8 + 10·0.1)/40.
    assert [v.figure for v in found.decisions] == pytest.approx([0.1875, 0.075, 0.625])
    assert found.kept == ("t0", "t1")
    assert "within 0.05 of the best |r| for EXX intercept (30 µm)" in found.decisions[0].reason
    assert "loses most in EXX intercept (30 µm): |r| 0.10, best 0.90" in found.decisions[2].reason


def test_main_factor_paper_by_hand() -> None:
    r = np.array([[0.90, -0.85, 0.30], [0.90, 0.95, 0.94]])
    found = strategies.main_factor_paper("X", ids(3), ("EXX intercept", "EXX slope"), r)
    assert [v.figure for v in found.decisions] == pytest.approx([0.05, 0.05, 0.60])
    assert found.kept == ("t0", "t1")
    assert "up to 0.12 stays (2 × smallest 0.05 + 0.02)" in found.figure_name
    assert strategies.main_factor_paper("X", ids(3), ("a", "b"), r, 0.60).kept == ids(3)
    assert strategies.main_factor_paper("X", ids(3), ("a", "b"), r, 0.04).kept == ()


def test_groups_are_complete_linkage() -> None:
    """t0-t1 and t1-t2 are close, t0-t2 are not: single linkage would chain all three."""
    r = np.array([[1.0, 0.97, 0.80], [0.97, 1.0, -0.96], [0.80, -0.96, 1.0]])
    assert strategies.correlation_groups(ids(3), r, 0.95) == (("t0", "t1"), ("t2",))
    assert strategies.correlation_groups(ids(3), r, 0.80) == (ids(3),)
    assert strategies.correlation_groups(ids(1), np.ones((1, 1)), 0.9) == (("t0",),)
    assert strategies.correlation_groups((), np.ones((0, 0)), 0.9) == ()


def test_representative_is_on_the_drive_else_the_medoid() -> None:
    r = np.array([[1.0, 0.97, 0.96], [0.97, 1.0, 0.99], [0.96, 0.99, 1.0]])
    by_medoid, groups = strategies.mutual_irrelevance("X", ids(3), r)
    assert (by_medoid.kept, groups) == (("t1",), (ids(3),))
    by_drive, _ = strategies.mutual_irrelevance("X", ids(3), r, ("t9", "t2"))
    assert by_drive.kept == ("t2",)
    assert "drive of axis X" in by_drive.decisions[2].reason
    assert [v.figure for v in by_drive.decisions] == [0.96, 0.99, 1.0]


def test_fewest_sensors_stops_when_the_gain_is_small() -> None:
    errors = {(): 100.0, (0,): 40.0, (1,): 30.0, (2,): 35.0, (1, 0): 20.0, (1, 2): 29.0, (1, 0, 2): 19.1}
    found = strategies.fewest_sensors("X", ids(3), lambda s: errors[tuple(s)], 3, "one campaign left out")
    assert found.kept == ("t1", "t0")
    assert "30.0 -> 20.0 µm" in found.decisions[1].reason
    assert "no gain of 5 %" in found.decisions[2].reason
    limited = strategies.fewest_sensors("X", ids(3), lambda s: errors[tuple(s)], 1, "")
    assert limited.kept == ("t1",)
    assert "the limit of 1 sensor for this number of states" in limited.decisions[1].reason


def test_maximum_sensitivity_and_nearest_linear() -> None:
    t = np.linspace(0.0, 2 * np.pi, 41)
    rise = np.column_stack([10 * np.sin(t), 4 * np.sin(t - 0.5), np.full(41, np.nan), np.full(41, 3.0)])
    spans = strategies.maximum_sensitivity("X", ids(4), rise)
    assert [v.figure for v in spans.decisions] == pytest.approx([20.0, 8.0, np.nan, 0.0], abs=0.05, nan_ok=True)
    assert spans.kept == ("t0",)
    linear = strategies.nearest_linear("X", ids(4), rise, 7 * np.sin(t)[:, None], np.array([14.0]))
    # sin t over sin(t - d) is an ellipse: largest deviation from its line sin d of the half range.
    expected = [0.0, 100.0 * np.sin(0.5) / 2.0]
    assert [v.figure for v in linear.decisions[:2]] == pytest.approx(expected, abs=1.0)
    assert linear.kept == ("t0",)


# --- hold-out


def test_hold_out_error_equals_the_plain_way() -> None:
    rng = np.random.default_rng(8)
    spindle, drive, campaign = warm_ups(rng)
    rise = np.column_stack([spindle, drive, spindle + drive]) + rng.normal(0, 0.2, (48, 3))
    value = np.column_stack([5 * spindle + rng.normal(0, 3, 48), 4 * drive + rng.normal(0, 3, 48)])
    value[[3, 17], [0, 1]] = np.nan
    states = table(value, rise, campaign)
    target, owner = line_targets(states, [True, True])
    hold_out = HoldOut(rise, target, owner, fold_numbers(campaign).index)
    lever_m = np.linspace(-1.0, 1.0, 2001)
    squares = []
    for out in range(4):
        good = np.isfinite(value).all(axis=1)
        train, test = good & (campaign != out), good & (campaign == out)
        x = np.column_stack([np.ones(48), rise[:, [0, 2]]])
        b, *_ = np.linalg.lstsq(x[train], value[train], rcond=None)
        residual = value[test] - x[test] @ b
        squares += [(line**2).mean() for line in residual[:, :1] + residual[:, 1:] * lever_m]
    assert hold_out.rms_um([0, 2]) == pytest.approx(np.sqrt(np.mean(squares)), rel=1e-3)


def test_what_is_held_out() -> None:
    assert fold_numbers(np.array([3, 3, 7])).index.tolist() == [0, 0, 1]
    assert fold_numbers(np.zeros(8, dtype=np.int64)).index.tolist() == list(range(8))
    long = fold_numbers(np.zeros(1000, dtype=np.int64))
    assert np.bincount(long.index).tolist() == [200] * 5
    assert (np.diff(long.index) >= 0).all()


# --- the default choice


def two_source_machine(seed: int, noise_um: float = 2.0) -> tuple[ParameterTable, tuple[str, ...]]:
    """Sensors 0-2 near the spindle, 3-5 near the drive, 6 constant, 7 dead, 8 and 9 noise."""
    rng = np.random.default_rng(seed)
    spindle, drive, campaign = warm_ups(rng)
    n = len(spindle)
    near = [gain * source + rng.normal(0, 0.05, n) for source in (spindle, drive) for gain in (1.0, 0.8, 0.6)]
    other = [np.full(n, 0.2), np.full(n, np.nan), *rng.normal(0, 1.0, (2, n))]
    value = np.column_stack([6.0 * spindle, 8.0 * drive, 0 * drive, 0 * drive]) + rng.normal(0, noise_um, (n, 4))
    return table(value, np.column_stack([*near, *other]), campaign), ("t4",)


def test_both_sources_are_found_and_the_rest_is_explained() -> None:
    for seed in range(5):
        states, drives = two_source_machine(seed)
        found = select_key_points(states, drives)
        assert len(found.key_points) == 2, seed
        assert "t4" in found.key_points  # of 3, 4, 5 the one on the drive
        assert set(found.key_points) & {"t0", "t1", "t2"}
        assert {name for name, _ in found.left_out} == {"EYX intercept", "EYX slope"}
        assert all("not significant" in reason for _, reason in found.left_out)
        decisions = {v.sensor: v for v in found.tables[0].decisions}
        assert set(decisions) == set(states.sensors)
        assert decisions["t6"].reason == "does not change"
        assert decisions["t7"].reason == "no reading in the campaigns of this axis"
        assert not decisions["t8"].stays
        assert all(v.reason for t in found.tables for v in t.decisions)


def test_the_choice_is_deterministic() -> None:
    assert repr(select_key_points(*two_source_machine(1))) == repr(select_key_points(*two_source_machine(1)))


def test_a_parameter_counts_by_its_um() -> None:
    """A slope of 1 µm/m (range 1 µm) must not outvote an intercept of 60 µm, though both are clean."""
    rng = np.random.default_rng(6)
    spindle, drive, campaign = warm_ups(rng)
    value = np.column_stack([8.0 * spindle, 0.1 * drive])
    weights = {
        v.sensor: v.figure
        for v in select_key_points(table(value, np.column_stack([spindle, drive]), campaign)).tables[0].decisions
    }
    assert weights["t0"] < 0.05 < weights["t1"]


def noise(seed: int) -> AxisKeyPoints:
    rng = np.random.default_rng(seed)
    return select_key_points(table(rng.normal(0.0, 20.0, (8, 6)), rng.normal(0.0, 3.0, (8, 30))))


def test_pure_noise_does_not_vote_and_what_slips_through_is_warned_of() -> None:
    """8 states, 30 sensors, 6 parameters of noise: the published trap (median R² 0.986 with 3 of 30)."""
    results = [noise(seed) for seed in range(200)]
    voting = sum(6 - len(result.left_out) for result in results)
    # 5 % of 1200 rows may pass by design; 60 ± 7.5 (one standard deviation).
    assert voting <= 80
    assert any(result.key_points for result in results)
    for result in results:
        assert len(result.key_points) <= 1
        for decision in result.tables[2].decisions:
            assert not decision.stays or "chance can look like a cause" in decision.reason


def test_slow_noise_of_a_long_recording_does_not_vote() -> None:
    rng = np.random.default_rng(12)
    walk = rng.normal(size=(6000, 18)).cumsum(axis=0)
    found = select_key_points(table(walk[:, :2], walk[:, 2:]))
    assert found.key_points == ()
    assert "independent ones" in found.left_out[0][1]


def test_one_sensor_eight_states() -> None:
    rise = np.array([0.0, 1.1, 2.7, 4.5, 5.2, 6.3, 7.5, 8.3])
    value = np.column_stack([-26.0 * rise, -7.0 * rise]) + np.random.default_rng(0).normal(0, 4, (8, 2))
    value[5, 0] = np.nan
    found = select_key_points(table(value, rise[:, None]))
    assert (found.key_points, found.groups) == (("t0",), (("t0",),))
    assert np.isnan(found.smallest_correlation)
    assert "only 7 states" in found.tables[2].decisions[0].reason


@pytest.mark.parametrize("states", [1, 2])
def test_too_few_states_choose_nothing(states: int) -> None:
    rise = np.arange(float(states))[:, None]
    found = select_key_points(table(np.hstack([rise, rise]), rise))
    assert found.key_points == ()
    assert len(found.left_out) == 2


def test_no_usable_sensor() -> None:
    found = select_key_points(table(np.arange(20.0).reshape(10, 2), np.full((10, 3), np.nan)))
    assert found.key_points == ()
    assert found.left_out[0][1] == "no sensor can be used"
    assert [v.reason for v in found.tables[0].decisions] == ["no reading in the campaigns of this axis"] * 3


def test_number_of_inputs_is_limited_by_the_states() -> None:
    rng = np.random.default_rng(9)
    for n, limit in ((9, 1), (10, 2), (15, 3), (60, 4)):
        rise = rng.normal(0.0, 3.0, (n, 6))
        value = np.column_stack([rise @ np.full(6, 10.0), rise @ np.arange(6.0)])
        found = select_key_points(table(value, rise))
        assert len(found.key_points) <= limit


def test_sixty_sensors_thirty_states() -> None:
    rng = np.random.default_rng(10)
    spindle, drive, campaign = warm_ups(rng, 3, 10)
    mixing = rng.uniform(0, 1, (2, 60))
    rise = np.column_stack([spindle, drive]) @ mixing + rng.normal(0, 0.1, (30, 60))
    value = np.column_stack([6 * spindle, 3 * drive, 2 * drive, spindle, drive, drive]) + rng.normal(0, 1, (30, 6))
    found = select_key_points(table(value, rise, campaign))
    assert 2 <= len(found.key_points) <= 4
    assert len(found.tables[0].decisions) == 60


@pytest.mark.shared_data("caiviac_fl_thermal/data.xlsx")
def test_spindle_recording(shared_data) -> None:  # type: ignore[no-untyped-def]
    """11,115 rows, 16 sensors, 5 displacements: a choice that beats no sensor when whole campaigns are held out."""
    calamine = pytest.importorskip("python_calamine")
    rows = calamine.CalamineWorkbook.from_path(str(shared_data)).get_sheet_by_index(0).to_python()[1:]
    data = np.array(rows, dtype=float)
    campaign = np.repeat(np.arange(6), np.diff([0, 1951, 3871, 5791, 7711, 9631, 11115]))
    parameters = tuple(Parameter(f"D{i}", INTERCEPT, 0.0, 0.0) for i in range(1, 6))
    states = ParameterTable("", parameters, data[:, 2:7] - data[0, 2:7], ids(16), data[:, 7:] - data[0, 7:], campaign)
    found = select_key_points(states)
    # ch1 follows no thermometer: its held-out least squares error (6.9 µm) is that of the training mean (6.5 µm).
    assert "D1 intercept" in dict(found.left_out)
    assert 2 <= len(found.key_points) <= 4
    none_um = float(found.tables[2].figure_name.split()[-1].rstrip(")"))
    assert found.tables[2].decisions[len(found.key_points) - 1].figure < none_um / 2


# --- the paper's way on measured states, tables and names


def test_paper_way_on_measured_states() -> None:
    states, drives = two_source_machine(2)
    found = paper_key_points(states, drives)
    assert found.method == "paper"
    assert {v.sensor for v in found.tables[0].decisions} == set(states.sensors)
    assert found.key_points


def test_correlation_tables_of_measured_states() -> None:
    states, _ = two_source_machine(3)
    parameter, sensor = correlation_tables([states])
    assert parameter.rows[:2] == ("EXX intercept", "EXX slope")
    assert parameter.columns == sensor.rows == sensor.columns == tuple(s for s in ids(10) if s not in ("t6", "t7"))
    expected = np.corrcoef(states.value[:, 0], states.rise_K[:, 2])[0, 1]
    assert parameter.value[0, 2] == pytest.approx(expected, abs=1e-12)
    assert correlation_tables([])[0].rows == ()


def correlation_table(rows: tuple[str, ...], columns: tuple[str, ...], value: object) -> CorrelationTable:
    return CorrelationTable(rows, columns, np.array(value, dtype=float))


def test_tables_without_a_common_sensor_are_refused() -> None:
    with pytest.raises(AnalysisError, match="no sensor in common"):
        key_points_from_correlations(
            correlation_table(("EXX slope",), ("a",), [[0.9]]), correlation_table(("b",), ("b",), [[1.0]])
        )


def test_a_row_that_is_no_component_is_refused() -> None:
    with pytest.raises(AnalysisError, match=r"'I_xx'.*EYX slope"):
        key_points_from_correlations(
            correlation_table(("I_xx",), ("a",), [[0.9]]), correlation_table(("a",), ("a",), [[1.0]])
        )


def test_axes_of_rows_and_sensors_missing_in_the_second_table() -> None:
    rows = ("EXX slope", "DX intercept", "EZW1 slope")
    first = correlation_table(rows, ("a", "b"), [[0.9, 0.95], [0.8, 0.7], [np.nan, np.nan]])
    found = key_points_from_correlations(first, correlation_table(("a",), ("a",), [[1.0]]))
    assert [r.axis for r in found] == ["X", "", "W1"]
    assert [r.key_points for r in found] == [("a",), ("a",), ()]
    assert ("b", "is not in the table of sensor correlations") in found[0].left_out
    assert ("EZW1 slope", "has no correlation with any sensor") in found[2].left_out


def test_drive_sensors() -> None:
    machine = Machine(
        name="M",
        axes=(Axis(name="X", direction="+X", travel_mm=(0, 1), sensor="scale"),),
        sensors=(
            Sensor(id="nut", role="drive", axis="X"),
            Sensor(id="scale", role="structure", axis="X"),
            Sensor(id="bed", role="structure", axis="X"),
        ),
    )
    assert drive_sensors(machine, "X") == ("scale", "nut")
    assert drive_sensors(machine, "") == drive_sensors(None, "X") == ()


def test_a_smooth_long_record_keeps_two_states_a_campaign() -> None:
    """Two campaigns of smooth ramps: the lag-1 formula alone would leave about one independent pair of 4000."""
    campaign = np.repeat([0, 1], 2000)
    ramp = np.tile(1 - np.exp(-np.arange(2000) / 1e5), 2)[:, None]
    n = effective_count(ramp, ramp, np.array([[4000.0]]), campaign)
    assert n[0, 0] == pytest.approx(5.0)
    assert p_value(np.array([[0.9999]]), n)[0, 0] < 1e-4


def test_two_sensors_that_work_against_each_other_are_key_points_together() -> None:
    """A frame that lowers the tool and a bed that lifts it, 75 and 11 µm/K: alone neither correlates with the drift."""
    t_s = np.tile(1188.0 * np.arange(18), 2)
    scale, campaign = np.repeat([1.0, 0.9], 18), np.repeat([0, 1], 18)
    frame, bed = 11.4 * scale * -np.expm1(-t_s / 6800.0), 80.0 * scale * -np.expm1(-t_s / 4500.0)
    noise = np.random.default_rng(3).normal(0.0, 0.02, (36, 3))
    rise = np.column_stack([frame, bed, np.sin(t_s)]) + noise
    value = np.column_stack([-75.0 * frame + 10.7 * bed, np.zeros(36)])
    assert np.abs(correlations(value[:, :1], rise)[0]).max() < 0.4
    found = select_key_points(table(value, rise, campaign))
    assert found.key_points == ("t0", "t1")
    assert "EXX intercept" not in dict(found.left_out)
    reasons = [d.reason for t in found.tables for d in t.decisions if d.sensor == "t0"]
    assert reasons[0] == "explains EXX intercept together with t1 only"
    assert reasons[2].endswith("only both together help")


def test_the_chance_of_a_pair_is_that_of_an_f_test() -> None:
    rng = np.random.default_rng(4)
    x, y = rng.normal(size=(30, 3)), rng.normal(size=30)
    r, count = correlations(y[:, None], x)
    chance = pair_p_value(r[0], correlations(x, x)[0], count[0])
    for a, b in ((0, 1), (0, 2), (1, 2)):
        design = np.column_stack([np.ones(30), x[:, [a, b]]])
        left = y - design @ np.linalg.lstsq(design, y, rcond=None)[0]
        share = 1.0 - left @ left / np.sum((y - y.mean()) ** 2)
        assert chance[a, b] == pytest.approx(stats.f.sf(share / (1.0 - share) * 27.0 / 2.0, 2, 27))
        assert chance[b, a] == pytest.approx(chance[a, b])
    assert (np.diag(chance) == 1.0).all()


def test_a_pair_by_chance_is_no_key_point() -> None:
    """Noise against six sensors of noise: 300 tables, fewer than one in twenty with key points."""
    rng = np.random.default_rng(5)
    found = 0
    for _ in range(300):
        value = np.column_stack([rng.normal(size=20), np.zeros(20)])
        found += bool(select_key_points(table(value, rng.normal(size=(20, 6)))).main_factors)
    assert found <= 30

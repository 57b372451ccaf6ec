"""ISO 230-2 against two published evaluations with raw data, closed forms, and a plain implementation in this file.

Published examples (numbers only), both measured on real axes:

1. github.com/anderssandstrom/ecmccomgui, tools/iso230-2/example_report_ISO230_2.md, commit
   a258c9db305285e4cf956750eb4b822d17494a4f: an axis of a neutron slit set, 5 targets, 5 runs in both directions. The
   report prints raw data and results in mm to 1e-5. Its bidirectional E (0.00845) does not follow from its own means
   (largest 0.00552, smallest -0.00742: E = 0.01294), so E is taken from the second example.
2. github.com/anderssandstrom/ecmc_cfg_tool, owis_openloop_RLS.md, commit e94650c27ef2fe4c3a0d4ae05230298d1ede2e3e:
   a linear stage, 8 targets, 5 runs in both directions. Its bidirectional repeatability is a root of squares, as its
   notes say, which is not that of ISO 230-2; R is taken from the first example.
"""

from __future__ import annotations

import math
import statistics

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from thetacomp.arrays import Floats
from thetacomp.errors import AnalysisError
from thetacomp.standards.instrument import Instrument
from thetacomp.standards.iso230_2 import AxisFigures, Positioning, Readings, positioning

# Example 1: measured positions in mm, rows targets, columns runs.
SLIT_TARGETS_MM = (15.0, 25.0, 35.0, 45.0, 55.0)
SLIT_UP_MM = (
    (15.00067, 15.00169, 15.0021, 15.00393, 15.00332),
    (24.99964, 24.99964, 24.99862, 25.00005, 24.99924),
    (35.00025, 34.99291, 34.99719, 34.99964, 34.99536),
    (44.9978, 44.99943, 44.9982, 44.99881, 44.99657),
    (55.00289, 55.00085, 55.00717, 55.00819, 55.00044),
)
SLIT_DOWN_MM = (
    (15.00475, 15.00475, 15.00495, 15.00638, 15.00679),
    (24.9974, 24.99842, 24.9974, 24.99822, 24.99862),
    (34.98965, 34.9925, 34.99332, 34.99413, 34.99332),
    (44.9978, 44.99841, 44.99881, 44.99841, 45.00024),
    (55.00268, 55.00289, 55.00696, 55.00574, 55.00289),
)
# Example 2: deviations in 0.01 µm, rows runs, columns targets.
STAGE_TARGETS_MM = (-5.0, -3.54578, -1.78508, -0.66663, 0.87005, 2.40306, 3.39152, 5.0)
STAGE_UP = (
    (-342, -182, -105, -60, -457, -389, 570, -293),
    (-220, -207, -117, -60, -506, -365, 594, -317),
    (-244, -231, -129, -60, -481, -389, 594, -220),
    (-293, -231, -81, -12, -432, -413, 594, -293),
    (-269, -256, -129, -36, -506, -413, 594, -317),
)
STAGE_DOWN = (
    (-24, 37, 212, 233, -139, -96, 838, 98),
    (-24, 62, 139, 233, -164, -96, 887, 98),
    (-24, 62, 139, 184, -164, -47, 911, 98),
    (-73, 13, 212, 233, -213, -96, 936, 0),
    (-98, 62, 212, 233, -164, -145, 887, 24),
)
# Both reports print to 0.01 µm: the printed result is off by up to 0.005, and so is each reading. Propagated at worst:
MEAN_UM, REVERSAL_UM, S_UM = 0.01, 0.015, 0.011
R_UM, A_UM = 0.04, 0.04


def readings(targets_mm: Floats, up_um: Floats, down_um: Floats, axis: str = "X") -> Readings:
    """Readings in the order in which an axis is measured: out, back, out, … `up_um`, `down_um` (targets, runs)."""
    m, n = up_um.shape
    order = np.arange(m)
    return Readings(
        axis=axis,
        target_mm=np.concatenate([np.concatenate([targets_mm, targets_mm[::-1]]) for _ in range(n)]),
        run=tuple(str(j + 1) for j in range(n) for _ in range(2 * m)),
        direction=np.tile(np.repeat([1, -1], m), n).astype(np.int64),
        deviation_um=np.concatenate([np.concatenate([up_um[order, j], down_um[order[::-1], j]]) for j in range(n)]),
    )


def slit() -> Positioning:
    targets = np.array(SLIT_TARGETS_MM)
    up, down = (1000.0 * (np.array(x) - targets[:, None]) for x in (SLIT_UP_MM, SLIT_DOWN_MM))
    return positioning(readings(targets, up, down))


def stage() -> Positioning:
    up, down = (np.array(x, dtype=float).T / 100.0 for x in (STAGE_UP, STAGE_DOWN))
    return positioning(readings(np.array(STAGE_TARGETS_MM), up, down))


def test_published_slit_axis_target_by_target() -> None:
    found = slit().targets
    assert found.mean_up_um == pytest.approx([2.34, -0.56, -2.93, -1.84, 3.90], abs=MEAN_UM)
    assert found.mean_down_um == pytest.approx([5.52, -1.99, -7.42, -1.27, 4.23], abs=MEAN_UM)
    assert found.mean_um == pytest.approx([3.93, -1.27, -5.17, -1.55, 4.07], abs=MEAN_UM)
    assert found.reversal_um == pytest.approx([-3.18, 1.43, 4.49, -0.57, -0.33], abs=REVERSAL_UM)
    assert found.s_up_um == pytest.approx([1.30, 0.54, 3.04, 1.08, 3.58], abs=S_UM)
    assert found.s_down_um == pytest.approx([0.98, 0.58, 1.74, 0.92, 1.99], abs=S_UM)
    assert found.repeatability_up_um == pytest.approx([5.20, 2.16, 12.16, 4.33, 14.34], abs=R_UM)
    assert found.repeatability_down_um == pytest.approx([3.93, 2.31, 6.96, 3.67, 7.94], abs=R_UM)
    assert found.repeatability_um == pytest.approx([7.75, 3.66, 14.04, 4.57, 14.34], abs=R_UM)


def test_published_slit_axis_as_a_whole() -> None:
    found = slit().figures
    assert found.B_um == pytest.approx(4.49, abs=REVERSAL_UM)
    assert found.B_mean_um == pytest.approx(0.37, abs=REVERSAL_UM)
    assert (found.R_um, found.R_up_um, found.R_down_um) == pytest.approx((14.34, 14.34, 7.94), abs=R_UM)
    assert (found.E_up_um, found.E_down_um) == pytest.approx((6.84, 12.94), abs=2 * MEAN_UM)
    assert found.E_um == pytest.approx(12.94, abs=2 * MEAN_UM)  # from the report's own means, see above
    assert found.M_um == pytest.approx(9.24, abs=2 * MEAN_UM)
    assert (found.A_um, found.A_up_um, found.A_down_um) == pytest.approx((21.97, 20.08, 19.10), abs=A_UM)


def test_published_stage() -> None:
    result = stage()
    found, targets = result.figures, result.targets
    mean_up_um = [-2.73, -2.21, -1.12, -0.46, -4.76, -3.94, 5.89, -2.88]
    mean_down_um = [-0.49, 0.47, 1.83, 2.23, -1.69, -0.96, 8.92, 0.63]
    reversal_um = [-2.25, -2.69, -2.95, -2.69, -3.08, -2.98, -3.03, -3.52]
    assert targets.mean_up_um == pytest.approx(mean_up_um, abs=MEAN_UM)
    assert targets.mean_down_um == pytest.approx(mean_down_um, abs=MEAN_UM)
    assert targets.mean_um == pytest.approx([-1.61, -0.87, 0.35, 0.89, -3.22, -2.45, 7.41, -1.12], abs=MEAN_UM)
    assert targets.reversal_um == pytest.approx(reversal_um, abs=REVERSAL_UM)
    larger = np.maximum(targets.repeatability_up_um, targets.repeatability_down_um)
    assert larger == pytest.approx([1.88, 1.11, 1.60, 0.87, 1.27, 1.38, 1.45, 1.90], abs=R_UM)
    assert found.A_um == pytest.approx(15.04, abs=A_UM)
    assert found.E_um == pytest.approx(13.68, abs=2 * MEAN_UM)
    assert found.M_um == pytest.approx(10.63, abs=2 * MEAN_UM)
    assert found.B_um == pytest.approx(3.52, abs=REVERSAL_UM)
    assert found.B_mean_um == pytest.approx(-2.90, abs=REVERSAL_UM)
    assert max(found.R_up_um, found.R_down_um) == pytest.approx(1.90, abs=R_UM)


def plain(up: list[list[float]], down: list[list[float]]) -> dict[str, float]:
    """The definitions of the standard once more, with Python's own statistics, target by target."""
    up_mean, down_mean = [statistics.mean(x) for x in up], [statistics.mean(x) for x in down]
    up_s, down_s = [statistics.stdev(x) for x in up], [statistics.stdev(x) for x in down]
    back = [a - b for a, b in zip(up_mean, down_mean, strict=True)]
    both = [(a + b) / 2 for a, b in zip(up_mean, down_mean, strict=True)]
    tops_up = [m + 2 * s for m, s in zip(up_mean, up_s, strict=True)]
    tops_down = [m + 2 * s for m, s in zip(down_mean, down_s, strict=True)]
    lows_up = [m - 2 * s for m, s in zip(up_mean, up_s, strict=True)]
    lows_down = [m - 2 * s for m, s in zip(down_mean, down_s, strict=True)]
    return {
        "A_um": max(tops_up + tops_down) - min(lows_up + lows_down),
        "A_up_um": max(tops_up) - min(lows_up),
        "A_down_um": max(tops_down) - min(lows_down),
        "R_um": max(max(2 * a + 2 * b + abs(c), 4 * a, 4 * b) for a, b, c in zip(up_s, down_s, back, strict=True)),
        "R_up_um": 4 * max(up_s),
        "R_down_um": 4 * max(down_s),
        "E_um": max(up_mean + down_mean) - min(up_mean + down_mean),
        "E_up_um": max(up_mean) - min(up_mean),
        "E_down_um": max(down_mean) - min(down_mean),
        "M_um": max(both) - min(both),
        "B_um": max(abs(b) for b in back),
        "B_mean_um": statistics.mean(back),
    }


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**31), runs=st.integers(5, 7), targets=st.integers(5, 12))
def test_any_data_give_what_a_plain_implementation_gives(seed: int, runs: int, targets: int) -> None:
    rng = np.random.default_rng(seed)
    up, down = rng.normal(0, 5, (2, targets, runs))
    found = positioning(readings(np.linspace(0, 1500, targets), up, down)).figures
    for name, value in plain(up.tolist(), down.tolist()).items():
        assert getattr(found, name) == pytest.approx(value, rel=1e-9, abs=1e-9), name


def test_closed_form_of_a_straight_error_with_reversal_and_a_known_scatter() -> None:
    """x↑ = 10 p, x↓ = 10 p - 3 (p in m, 1 m), readings ±1 and 0: s = 1 µm; E = 13, M = 10, B = 3, R = 7, A = 17."""
    targets = np.array([0.0, 250.0, 500.0, 750.0, 1000.0])
    scatter = np.array([-1.0, 1.0, 0.0, 1.0, -1.0])
    up = targets[:, None] / 100.0 + scatter
    found = positioning(readings(targets, up, up - 3.0))
    expected = AxisFigures(
        A_um=17.0, A_up_um=14.0, A_down_um=14.0, R_um=7.0, R_up_um=4.0, R_down_um=4.0,
        E_um=13.0, E_up_um=10.0, E_down_um=10.0, M_um=10.0, B_um=3.0, B_mean_um=3.0,
    )  # fmt: skip
    assert vars(found.figures) == pytest.approx(vars(expected))
    assert found.run_drift_um == pytest.approx(0.0)


def five(n: int = 5, m: int = 5, length_mm: float = 1000.0) -> Readings:
    rng = np.random.default_rng(3)
    return readings(np.linspace(0, length_mm, m), *rng.normal(0, 1, (2, m, n)))


def without(data: Readings, keep: np.ndarray) -> Readings:
    runs = tuple(name for name, stays in zip(data.run, keep, strict=True) if stays)
    return Readings(data.axis, data.target_mm[keep], runs, data.direction[keep], data.deviation_um[keep])


def test_four_runs_are_refused_and_the_message_says_how_many_are_missing() -> None:
    with pytest.raises(AnalysisError, match=r"axis X: 4 runs in each direction \(1, 2, 3, 4\).*measure 1 more"):
        positioning(five(4))


def test_one_direction_is_refused() -> None:
    data = five()
    with pytest.raises(AnalysisError, match="no reading with approach -"):
        positioning(without(data, data.direction == 1))


def test_a_target_that_lacks_one_run_is_named() -> None:
    data = five()
    gone = (data.target_mm == 500.0) & (np.array(data.run) == "3") & (data.direction == -1)
    with pytest.raises(AnalysisError, match="target 500 mm has no reading in run 3, approach -"):
        positioning(without(data, ~gone))
    value = np.where(gone, np.nan, data.deviation_um)  # an empty cell is the same as no row
    empty = Readings(data.axis, data.target_mm, data.run, data.direction, value)
    with pytest.raises(AnalysisError, match="target 500 mm has no reading in run 3, approach -"):
        positioning(empty)


def test_unequal_targets_are_named() -> None:
    data = five()
    moved = np.where((np.array(data.run) == "2") & (data.target_mm == 250.0), 260.0, data.target_mm)
    with pytest.raises(AnalysisError, match=r"target 250 mm has no reading in run 2, approach \+") as refusal:
        positioning(Readings(data.axis, moved, data.run, data.direction, data.deviation_um))
    assert "target 260 mm has no reading in run 1" in str(refusal.value)


def test_a_target_read_twice_in_one_run_is_named() -> None:
    data = five()
    run = tuple("4" if name == "5" else name for name in data.run)
    with pytest.raises(AnalysisError, match=r"target 0 mm was read twice in run 4, approach \+"):
        positioning(Readings(data.axis, data.target_mm, run, data.direction, data.deviation_um))


def test_fewer_than_five_targets_and_unequal_numbers_of_runs_are_refused() -> None:
    with pytest.raises(AnalysisError, match="4 target positions"):
        positioning(five(m=4))
    data = five(6)
    with pytest.raises(AnalysisError, match=r"6 runs with approach \+, 5 with approach -"):
        positioning(without(data, ~((np.array(data.run) == "6") & (data.direction == -1))))


def test_runs_that_are_numbered_anew_at_every_turn_are_the_same() -> None:
    data = five()
    turned = tuple(str(2 * int(r) - (d == 1)) for r, d in zip(data.run, data.direction.tolist(), strict=True))
    again = Readings(data.axis, data.target_mm, turned, data.direction, data.deviation_um)
    assert positioning(again).figures == positioning(data).figures


def test_beyond_two_metres_one_run_gives_e_m_b_but_neither_r_nor_a() -> None:
    data = five(5, 13, 3000.0)
    first = positioning(without(data, np.array(data.run) == "1"))
    whole = positioning(data)
    for result in (first, whole):
        assert math.isnan(result.figures.A_um)
        assert math.isnan(result.figures.R_um)
        assert "more than 2 m" in result.remarks[0]
    assert whole.figures.E_um == first.figures.E_um
    up, down = data.deviation_um[:13], data.deviation_um[13:26][::-1]
    assert whole.figures.E_um == pytest.approx(max(up.max(), down.max()) - min(up.min(), down.min()))
    assert whole.figures.B_um == pytest.approx(np.abs(up - down).max())


def test_a_section_of_a_long_axis_is_evaluated_and_called_a_section() -> None:
    result = positioning(five(5, 11, 2000.0), travel_mm=4000.0)
    assert math.isfinite(result.figures.A_um)
    assert any("from 0 to 2000 mm, not for the whole axis" in remark for remark in result.remarks)


def test_too_few_targets_per_metre_and_drift_between_the_runs_are_told() -> None:
    assert any("3.3 targets per metre" in remark for remark in positioning(five(5, 5, 1500.0)).remarks)
    data = five()
    warming = data.deviation_um + 20.0 * np.array([float(name) for name in data.run])
    drifting = positioning(Readings(data.axis, data.target_mm, data.run, data.direction, warming))
    assert drifting.run_drift_um == pytest.approx(80.0, abs=2.0)
    assert any("not settled" in remark for remark in drifting.remarks)
    assert not any("not settled" in remark for remark in positioning(data).remarks)


def test_uncertainty_of_a_difference_is_that_of_two_readings() -> None:
    """Two readings of ± 15 µm: root of the sum of squares; the far one, 2 m away at 6 µm/m, is ± 27 µm."""
    tracker = Instrument("tracker", 15.0, 6.0)
    assert tracker.difference_u_um() == pytest.approx(15.0 * math.sqrt(2.0))
    assert tracker.difference_u_um(2000.0) == pytest.approx(math.hypot(15.0, 27.0))
    assert Instrument().difference_u_um(2000.0) is None
    assert (tracker.reading_u_um(), tracker.reading_u_um(2000.0)) == (15.0, 27.0)
    assert Instrument("tracker", 15.0).reading_u_um(2000.0) == 15.0
    assert Instrument(u_um_per_m=6.0).reading_u_um(2000.0) is None

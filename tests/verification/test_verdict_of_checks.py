"""Checks and causes from figures made by hand: each limit just kept and just broken, each cause alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from thetacomp.machine import Axis, Machine, Sensor
from thetacomp.verification.diagnosis import causes, checks, not_followed, remarks, undecided
from thetacomp.verification.outcome import (
    BeforeAfter,
    Check,
    HarmMap,
    PooledShare,
    RunFacts,
    Share,
    ShareKind,
    Statistic,
)

NAN = float("nan")
X, Y = (Axis(name="X", direction="+X", travel_mm=(0, 1)), Axis(name="Y", direction="+Y", travel_mm=(0, 1)))
MACHINE = Machine(name="m", axes=(X, Y), sensors=(Sensor(id="t1", role="drive"),))
OFF = RunFacts(("a",), "dry", ("pitch",), "tracker", 8.0, 8, 20.0, (("t1", 8.0), ("t2", 2.0)))
ON = replace(OFF, campaigns=("b",))


def row(
    component: str, before_um: float = 10.0, after_um: float = 1.0, like_um: float = NAN, low: float = NAN
) -> BeforeAfter:
    """The same figures for all three statistics."""
    percent = 100 * (1 - after_um / before_um) if before_um else NAN
    like = 100 * (1 - after_um / like_um)
    one = Statistic("", before_um, like_um, after_um, percent, like, low, 99.0)
    return BeforeAfter(component, 8, 8, tuple(replace(one, kind=kind) for kind in ("max", "p95", "rms")))


def share(component: str, value: float = 1.0, kind: ShareKind = "applied", **changes: object) -> Share:
    made = Share(component, "all", value, value - 0.05, value + 0.05, 50.0, 40.0, 1.0, 1.0, True, kind, 0.025, 8.0, 1.0)
    return replace(made, **changes)  # type: ignore[arg-type]


def harm(component: str, largest_um: float, limit_um: float, at_mm: float = 300.0, at_s: float = 7200.0) -> HarmMap:
    return HarmMap(component, np.zeros(1), np.zeros(1), np.zeros((1, 1)), limit_um, largest_um, at_s, at_mm)


def checked(**given: object) -> dict[str, Check]:
    values = {
        "off": OFF, "on": ON, "rows": [row("EXX")], "shares": [], "harm": [], "heat_ratio": 1.0, "model_mode": None,
        **given,
    }  # fmt: skip
    return {check.name: check for check in checks(**values)}  # type: ignore[arg-type]


def test_all_checks_of_a_good_run_are_passed_and_there_is_no_cause() -> None:
    found = checked(shares=[share("EXX")], harm=[harm("EXX", 1.0, 2.0)])
    assert list(found) == [
        "operating mode", "active tables", "heat", "axis X: RMS on / RMS off at equal heat",
        "applied share of the correction", "harm by position",
    ]  # fmt: skip
    assert all(check.passed for check in found.values())
    assert causes(list(found.values()), OFF, ON, [share("EXX")], MACHINE, None) == ()


@pytest.mark.parametrize(
    ("off", "on", "model", "passed", "found"),
    [
        ("dry", "dry", None, True, "'dry'"),
        ("dry", "dry", "dry", True, "'dry'"),
        ("dry", "oil", None, False, "off 'dry', on 'oil'"),
        ("dry", "dry", "oil", False, "off 'dry', on 'dry', model 'oil'"),
    ],
)
def test_modes_of_both_runs_and_of_the_model_are_one(
    off: str, on: str, model: str | None, passed: bool, found: str
) -> None:
    check = checked(off=replace(OFF, mode=off), on=replace(ON, mode=on), model_mode=model)["operating mode"]
    assert (check.passed, check.found) == (passed, found)


@pytest.mark.parametrize(
    ("off", "on", "passed"),
    [
        (("pitch", "sag"), ("sag", "pitch"), True),
        (("pitch",), ("pitch", "temperature"), True),
        (("pitch", "temperature"), ("pitch", "temperature"), False),
        (("pitch",), ("pitch", "sag"), False),
        (("pitch", "sag"), ("pitch",), False),
        ((), (), True),
    ],
)
def test_tables_are_the_same_but_for_the_one_under_test(
    off: tuple[str, ...], on: tuple[str, ...], passed: bool
) -> None:
    runs = replace(OFF, tables=off), replace(ON, tables=on)
    check = checked(off=runs[0], on=runs[1])["active tables"]
    assert check.passed == passed
    told = [cause.text for cause in causes([check], *runs, [], MACHINE, None)]
    if "temperature" in off:
        assert told == ["temperature compensation was active in the run that is named as the uncompensated one"]
    elif not passed:
        run = "on" if "sag" in on else "off"
        assert told == [f"different tables were active in the control: sag active only with compensation {run}"]


@pytest.mark.parametrize(("ratio", "passed"), [(0.49, False), (0.5, True), (2.0, True), (2.01, False)])
def test_heat_of_half_to_twice_can_be_scaled(ratio: float, passed: bool) -> None:
    check = checked(heat_ratio=ratio)["heat"]
    assert (check.passed, check.found, check.required) == (passed, f"on {100 * ratio:.0f} % of off", "50 to 200 %")


@pytest.mark.parametrize(("rise_K", "passed"), [(6.3, False), (6.4, True), (10.0, True), (10.1, False)])
def test_heat_that_nothing_scales_is_the_rise_of_the_sensor_that_rose_most(rise_K: float, passed: bool) -> None:
    """Of off it is t1, 8 K: 0.8 to 1.25 times as far are 6.4 to 10 K; the order of the other run's list is nothing."""
    check = checked(heat_ratio=NAN, on=replace(ON, rises_K=(("t2", 50.0), ("t1", rise_K))))["heat"]
    assert check.passed == passed
    assert f"t1 rose {rise_K / 8.0:.2f} times as far" in check.found


def test_heat_without_any_sensor_is_no_like_heat() -> None:
    for off, on in ((replace(OFF, rises_K=()), ON), (OFF, replace(ON, rises_K=()))):
        assert not checked(off=off, on=on, heat_ratio=NAN)["heat"].passed
    assert not checked(off=replace(OFF, rises_K=(("t1", 0.0),)), heat_ratio=NAN)["heat"].passed


def test_each_axis_is_judged_by_the_root_of_its_squares_at_like_heat() -> None:
    """X: √(3² + 4²) = 5 on against √(6² + 8²) = 10 off at like heat; drift is a group of its own."""
    rows = [
        row("EXX", 1.0, 3.0, like_um=6.0), row("EYX", 1.0, 4.0, like_um=8.0), row("DX", 9.0, 4.6),
        row("EZY", 10.0, 5.1), row("EXW", 0.0, 1.0),
    ]  # fmt: skip
    found = checked(rows=rows)
    limit = "RMS on / RMS off at equal heat"
    assert [(name, check.found, check.passed) for name, check in found.items() if limit in name] == [
        (f"axis X: {limit}", "0.50", True),
        (f"drift: {limit}", "0.51", False),
        (f"axis Y: {limit}", "0.51", False),
        (f"axis W: {limit}", "nan", False),
    ]


@pytest.mark.parametrize(
    ("one", "passed", "found"),
    [
        (row("column_X", 10.0, 4.0, 8.0, low=0.1), True, "50 %, at least 0 %"),
        (row("column_X", 10.0, 4.0, 8.0, low=0.0), False, "50 %, at least 0 %"),
        (row("column_X", 10.0, 9.0), True, "10 % (no interval)"),
        (row("column_X", 10.0, 10.0), False, "0 % (no interval)"),
    ],
)
def test_the_column_is_surely_better(one: BeforeAfter, passed: bool, found: str) -> None:
    check = checked(rows=[one])["column deviation X: reduction"]
    assert (check.passed, check.found) == (passed, found)
    assert "axis" not in " ".join(checked(rows=[one]))


def test_the_worst_harm_is_that_furthest_above_its_own_limit() -> None:
    maps = [harm("EXX", 30.0, 29.0), harm("EYX", 12.0, 8.0), harm("DZ", 5.0, 9.0)]
    check = checked(harm=maps)["harm by position"]
    assert (check.passed, check.found) == (False, "+12 µm, EYX at 300 mm, 2.0 h")
    assert checked(harm=[harm("DZ", 9.0, 9.0)])["harm by position"].found == "+9 µm, DZ, 2.0 h"
    assert checked(harm=[harm("DZ", 9.0, 9.0)])["harm by position"].passed


# --- shares -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("unexplained_um", "usual_um", "followed"),
    [(10.0, 1.0, True), (10.1, 1.0, False), (10.1, 4.04, True), (10.1, 4.03, False)],
)
def test_what_no_share_explains_is_large_and_larger_than_usual(
    unexplained_um: float, usual_um: float, followed: bool
) -> None:
    """More than a quarter of 40 µm RMS, and more than 2.5 times what remains with compensation off."""
    assert not_followed(share("EXX", unexplained_um=unexplained_um, usual_um=usual_um)) != followed


def test_a_share_that_is_applied_is_good_whatever_it_leaves() -> None:
    lost = {"unexplained_um": 30.0}
    applied, partly = share("EXX", **lost), share("EYX", 0.5, "partly", **lost)
    assert checked(shares=[applied])["applied share of the correction"].passed
    check = checked(shares=[applied, partly])["applied share of the correction"]
    assert (check.passed, check.found) == (False, "EYX not constant (0.50)")
    for kind in ("partly", "too strong", "unclear"):
        assert checked(shares=[share("EXX", 0.5, kind)])["applied share of the correction"].passed  # type: ignore[arg-type]
    for kind in ("reversed", "doubled", "not active"):
        check = checked(shares=[share("EXX", 0.0, kind)])["applied share of the correction"]  # type: ignore[arg-type]
        assert (check.passed, check.found) == (False, f"EXX {kind} (0.00)")


def test_good_shares_are_told_by_their_range_and_four_bad_ones_by_three() -> None:
    good = checked(shares=[share("EXX", 0.9), share("EYX", 1.1)])["applied share of the correction"]
    assert good.found == "0.90 to 1.10"
    bad = [share(f"E{d}X", -1.0, "reversed") for d in "XYZ"]
    assert checked(shares=bad)["applied share of the correction"].found.endswith("EZX reversed (-1.00)")
    four = checked(shares=[*bad, share("EXY", -1.0, "reversed")])["applied share of the correction"]
    assert four.found.endswith("EZX reversed (-1.00) …")


def test_what_is_too_small_to_judge_is_not_judged() -> None:
    small = share("EXX", -1.0, "reversed", material=False)
    assert "applied share of the correction" not in checked(shares=[small])
    assert checked(shares=[small, share("EYX")])["applied share of the correction"].found == "1.00 to 1.00"


@pytest.mark.parametrize(
    ("intercept", "slope", "label"),
    [
        (("applied", 1.0), ("reversed", -1.0), "slope of EXX"),
        (("reversed", -1.0), ("applied", 1.0), "intercept of EXX"),
        (("reversed", -1.0), ("reversed", -0.95), "EXX"),
        (("reversed", -1.2), ("reversed", -0.8), "EXX"),
    ],
)
def test_intercept_and_slope_are_told_apart_where_they_went_different_ways(
    intercept: tuple[ShareKind, float], slope: tuple[ShareKind, float], label: str
) -> None:
    """Apart means: intervals (± 0.05) that do not overlap, and different kinds."""
    shares = [
        share("EXX", 0.1, "reversed"),
        share("EXX", intercept[1], intercept[0], part="intercept"),
        share("EXX", slope[1], slope[0], part="slope"),
    ]
    check = checked(shares=shares)["applied share of the correction"]
    assert check.found.startswith(f"{label} reversed")
    (cause,) = causes([check], OFF, ON, shares, MACHINE, None)
    assert cause.components == (label,)


def test_overlapping_intervals_of_intercept_and_slope_are_one_share() -> None:
    shares = [
        share("EXX", 1.0), share("EXX", 0.8, "partly", part="intercept", low=0.6, high=0.9),
        share("EXX", 1.0, part="slope", low=0.9, high=1.1),
    ]  # fmt: skip
    assert checked(shares=shares)["applied share of the correction"].found == "1.00 to 1.00"
    apart = [shares[0], replace(shares[1], high=0.89), shares[2]]
    assert checked(shares=apart)["applied share of the correction"].found == "0.80 to 1.00"


FAILED = Check("applied share of the correction", False, "bad", "")


def kinds_of(shares: list[Share], *failed: Check) -> list[tuple[str, tuple[str, ...]]]:
    return [(c.kind, c.components) for c in causes([*failed, FAILED], OFF, ON, shares, MACHINE, None)]


def test_every_kind_of_share_is_a_cause_of_its_name_in_order_of_weight() -> None:
    shares = [
        share("EXX", 0.5, "partly"), share("EYX", 1.5, "too strong"), share("EXY", 0.0, "not active"),
        share("EYY", 2.0, "doubled"), share("EZY", -1.0, "reversed"), share("DX"), share("DY", 0.4, "unclear"),
    ]  # fmt: skip
    assert kinds_of(shares) == [
        ("reversed", ("EZY",)), ("doubled", ("EYY",)), ("not active", ("EXY",)), ("partly", ("EXX",)),
        ("too strong", ("EYX",)),
    ]  # fmt: skip


def test_beside_a_share_that_is_not_constant_odd_shares_have_the_same_cause() -> None:
    lost = share("EXX", 0.4, "unclear", unexplained_um=30.0, usual_um=2.0)
    shares = [lost, share("EYX", 0.5, "partly"), share("EZX", 1.5, "too strong"), share("EXY", -1.0, "reversed")]
    found = causes([FAILED], OFF, ON, shares, MACHINE, None)
    assert [(c.kind, c.components) for c in found] == [("reversed", ("EXY",)), ("relation", ("EXX", "EYX", "EZX"))]
    assert found[1].text.endswith("(EXX: 30 µm RMS unexplained, 2 µm with compensation off)")
    assert found[1].text.startswith("axis X (EXX, EYX, EZX): no constant share")


def test_what_is_concerned_is_told_as_all_as_an_axis_or_by_names() -> None:
    wrong = [share(name, -1.0, "reversed") for name in ("EXX", "EYX")]
    texts = {
        (): "all 2 components that can be judged: the comp",
        ("EXY",): "axis X (EXX, EYX): the comp",
        ("EZX",): "EXX, EYX: the comp",
    }
    for others, text in texts.items():
        (cause,) = causes([FAILED], OFF, ON, [*wrong, *map(share, others)], MACHINE, None)
        assert cause.text.startswith(text)
        assert cause.text.endswith("(applied shares -1.00 to -1.00)")
    (cause,) = causes([FAILED], OFF, ON, [wrong[0], share("EXY")], MACHINE, None)
    assert cause.text.startswith("EXX: the comp")
    assert cause.text.endswith("(applied share -1.00 (95 %: -1.05 to -0.95))")


def test_other_causes_stand_before_the_shares_and_another_mode_silences_them() -> None:
    wrong = [share("EXX", -1.0, "reversed")]
    heat, mode = Check("heat", False, "on 30 % of off", ""), Check("operating mode", False, "", "")
    assert kinds_of(wrong, heat) == [("heat", ()), ("reversed", ("EXX",))]
    assert kinds_of(wrong, mode) == [("mode", ())]
    assert causes([heat], OFF, ON, [], MACHINE, None)[0].text.endswith("comparable: on 30 % of off")
    told = causes([mode], OFF, replace(ON, mode="oil"), [], MACHINE, "wet")[0].text
    assert "'dry' with compensation off, 'oil' with compensation on, 'wet' in the training of the model" in told
    assert "training" not in causes([mode], OFF, ON, [], MACHINE, None)[0].text


def test_a_failure_without_a_share_to_blame_is_the_model_or_unknown() -> None:
    for shares, text in (([share("EXX")], "the model does not follow this run well"), ([], "no cause can be found")):
        (cause,) = causes([FAILED, Check("kept", True, "good", "")], OFF, ON, shares, MACHINE, None)
        assert (cause.kind, cause.components) == ("model", ())
        assert text in cause.text
        assert cause.text.endswith("(applied share of the correction: bad)")


def test_a_go_remarks_on_parts_that_are_weak_or_strong_and_a_no_go_on_none() -> None:
    shares = [share("EXX", 0.6, "partly"), share("EYX", 1.5, "too strong"), share("EZX"), share("EXY", 0.2, "unclear")]
    assert [text.split(",")[0] for text in remarks(shares, go=True)] == [
        "EXX: share 0.60 (95 %: 0.55 to 0.65)", "EYX: share 1.50 (95 %: 1.45 to 1.55)"
    ]  # fmt: skip
    assert remarks(shares, go=False) == ()


@pytest.mark.parametrize(
    ("components", "who"),
    [
        (("EXX", "EYY"), "all"),
        (("EXX", "EXY"), "those in X"),
        (("EXX", "EYX"), "those of axis X"),
        (("DX", "DY"), "those of the drift"),
    ],
)
def test_a_cause_states_the_share_of_components_together(components: tuple[str, ...], who: str) -> None:
    wrong = [share(name, -1.0, "reversed") for name in components]
    group = PooledShare(components, -1.05, -1.4, -0.7, "reversed", components)
    good = replace(group, kind="applied", value=1.0)
    (cause,) = causes([FAILED], OFF, ON, [*wrong, share("EZY")], MACHINE, None, [group, good])
    assert cause.text.endswith(f"(applied shares -1.00 to -1.00; {who} together -1.05 (95 %: -1.40 to -0.70))")


def test_a_no_go_with_open_shares_does_not_call_the_sign_right() -> None:
    """Nothing is known of sign and activity: neither that they are wrong, nor that the model alone is to blame."""
    (cause,) = causes([FAILED], OFF, ON, [share("EXX", 0.4, "unclear"), share("EYX", 1.4, "unclear")], MACHINE, None)
    assert (cause.kind, cause.components) == ("model", ())
    assert "too poorly to tell whether the correction arrives, and with which sign" in cause.text
    assert "sign test of the commissioning sheet" in cause.fix
    (cause,) = causes([FAILED], OFF, ON, [share("EXX"), share("EYX", 1.4, "unclear")], MACHINE, None)
    assert "no wrong sign or size of the correction is visible" in cause.text


def test_an_open_share_of_a_go_is_a_note() -> None:
    shares = [share("EXX"), share("EYX", 0.4, "unclear"), share("EZX", 0.4, "unclear", material=False)]
    (note,) = undecided(shares)
    assert note.startswith("EYX: the applied share stays open")
    assert undecided([share("EXX"), share("EYX", 0.5, "partly")]) == ()


@pytest.mark.parametrize(("chance", "followed"), [(1.0, False), (4.0, False), (4.2, True)])
def test_what_few_sweeps_make_by_chance_is_no_proof_of_another_relation(chance: float, followed: bool) -> None:
    """41 µm are 4.1 times the usual 10."""
    assert not_followed(share("EXX", unexplained_um=41.0, usual_um=10.0, chance=chance)) != followed


def test_what_nobody_can_know_to_be_usual_is_no_proof_of_another_relation() -> None:
    assert not not_followed(share("EXX", unexplained_um=30.0, usual_um=NAN))

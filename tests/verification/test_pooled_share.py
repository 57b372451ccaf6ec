"""Shares of several components together: the mean by hand, what it may name, and what keeps a group from deciding."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from thetacomp.arrays import Floats
from thetacomp.verification.applied_share import shares
from thetacomp.verification.outcome import Share
from thetacomp.verification.pooled_share import with_pooled
from thetacomp.verification.runs import RunPoints

NAN = float("nan")
NINE = tuple(f"E{d}{a}" for a in "XYW" for d in "XYZ")


def share(component: str, value: float, sd: float = 0.3, freedom: float = 1.0, **changes: object) -> Share:
    """A share whose own interval, wide as Student's t of one degree of freedom is, holds every case."""
    half = float(stats.t.ppf(0.975, freedom)) * sd
    made = Share(
        component, "all", value, value - half, value + half, 50.0, 40.0, 1.0, 1.0, True, "unclear", sd, freedom, 1.0
    )
    return replace(made, **changes)  # type: ignore[arg-type]


def kinds(found: tuple[Share, ...]) -> dict[str, str]:
    return {one.component: one.kind for one in found}


def test_the_mean_and_its_interval_by_hand() -> None:
    """Weights 1 / (0.3² + 0.1²) and 1 / (0.6² + 0.1²), shares that agree, 3 + 5 degrees of freedom, and a tenth."""
    found, (group,) = with_pooled([share("EXX", -1.0, 0.3, 3.0), share("EYX", -1.2, 0.6, 5.0)])
    weight = np.array([1 / 0.10, 1 / 0.37])
    value = float(weight @ [-1.0, -1.2] / weight.sum())
    half = np.hypot(stats.t.ppf(0.975, 8.0) / np.sqrt(weight.sum()), 1.959964 * 0.1)
    assert (group.value, group.low, group.high) == pytest.approx((value, value - half, value + half))
    assert kinds(found) == {"EXX": "reversed", "EYX": "reversed"}


@pytest.mark.parametrize(
    ("centre", "kind"), [(-1.0, "reversed"), (0.0, "not active"), (1.0, "applied"), (2.0, "doubled")]
)
def test_all_components_decide_what_none_does_alone(centre: float, kind: str) -> None:
    values = centre + np.array([0.2, -0.3, 0.1, 0.25, -0.1, -0.2, 0.05, 0.0, -0.15])
    found, (group,) = with_pooled([share(name, value) for name, value in zip(NINE, values, strict=True)])
    assert set(kinds(found).values()) == {kind}
    assert (group.kind, group.components, group.named) == (kind, NINE, NINE)
    assert group.low < centre < group.high
    assert group.high - group.low < 1.0


def test_scatter_beyond_the_standard_deviations_widens_the_interval() -> None:
    """Birge: the same mean with shares that lie 2.5 of their standard deviations from it."""
    near, far = ([share(n, v, 0.2, 3.0) for n, v in zip(NINE, 1.0 + s * SIGNS, strict=True)] for s in (0.05, 0.5))
    (_, (tight,)), (_, (wide,)) = with_pooled(near), with_pooled(far)
    assert tight.value == pytest.approx(wide.value, abs=1e-9)
    assert wide.high - wide.low > 1.5 * (tight.high - tight.low)


SIGNS = np.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0, 1.0, -1.0, 0.0])


def test_a_sure_sign_is_a_wrong_sign_and_a_part_is_never_named_together() -> None:
    for centre, kind in ((-1.6, "reversed"), (0.5, "unclear"), (1.5, "unclear")):
        found, _ = with_pooled([share(name, centre) for name in NINE])
        assert set(kinds(found).values()) == {kind}
    found, (group,) = with_pooled([share(name, -1.4, 0.6) for name in NINE])
    assert group.low < -1.0 < group.high < -0.5
    assert set(kinds(found).values()) == {"reversed"}


def test_one_direction_or_one_axis_is_told_where_not_all_agree() -> None:
    z = {name: -1.0 if name[1] == "Z" else 1.0 for name in NINE}
    found, _ = with_pooled([share(name, value, 0.2) for name, value in z.items()])
    assert {name for name, kind in kinds(found).items() if kind == "reversed"} == {"EZX", "EZY", "EZW"}
    x = {name: 0.0 if name[2] == "X" else 1.0 for name in NINE}
    found, _ = with_pooled([share(name, value, 0.2) for name, value in x.items()])
    assert {name for name, kind in kinds(found).items() if kind == "not active"} == {"EXX", "EYX", "EZX"}


def test_a_group_with_a_component_of_another_kind_or_far_away_decides_nothing() -> None:
    good = [share(name, 1.0) for name in ("EXX", "EXY", "EXW")]
    clear = share("EXX", -1.0, kind="reversed")
    for odd in (clear, share("EXX", -1.0, 0.2)):
        found, groups = with_pooled([odd, *good[1:]])
        assert not any("EXX" in group.components for group in groups)
        assert kinds(found)["EXX"] == odd.kind
    # Eight are right, one is reversed or clearly not active: no group of it decides.
    for odd in (share("EXX", -1.0), share("EXX", 0.5, kind="not active")):
        found, groups = with_pooled([odd, *(share(name, 1.0) for name in NINE[1:])])
        assert not any("EXX" in group.components for group in groups)
        assert kinds(found)["EYY"] == "applied"
        assert kinds(found)["EXX"] == odd.kind
    # A component that is clear by itself keeps its name; one that lies nearer to another case is not named.
    partly = share("EYX", 0.8, kind="partly")
    far = share("EZX", 0.3, 1.0)
    found, _ = with_pooled([*good, partly, far, *(share(n, 1.0) for n in NINE[3:] if n not in ("EXY", "EXW"))])
    assert (kinds(found)["EXX"], kinds(found)["EYX"], kinds(found)["EZX"]) == ("applied", "partly", "unclear")


def test_what_cannot_be_judged_takes_no_part() -> None:
    for lost in ({"material": False}, {"low": -np.inf, "high": np.inf}, {"sd": NAN}, {"part": "slope"}):
        found, groups = with_pooled([share(name, -1.0, **lost) for name in NINE])  # type: ignore[arg-type]
        assert groups == ()
        assert set(kinds(found).values()) == {"unclear"}
    assert with_pooled([share("EXX", -1.0, 0.01)])[1] == ()


# --- from points ------------------------------------------------------------------------------------------------------

LEVER_M = np.linspace(-1.0, 1.0, 5)


def warm_run(rng: np.random.Generator, gain: float, heat: Floats, campaigns: int) -> RunPoints:
    """Seven sweeps; what the law misses is a course of its own, a quarter of the error, alike from sweep to sweep."""
    states = len(heat)
    slow = np.cumsum(rng.standard_normal(states))
    miss = 0.25 * np.sqrt(np.mean(heat**2)) * slow / np.sqrt(np.mean(slow**2))
    value = 40.0 * (gain * heat + miss)
    return RunPoints(
        state=np.repeat(np.arange(states), 5),
        p0_mm=0.0,
        lever_m=np.tile(LEVER_M, states),
        value_um=np.repeat(value, 5),
        noise_sd_um=1.0,
        campaign=np.zeros(states, dtype=np.int64),
        t_s=3600.0 * np.arange(1.0, states + 1),
        intercept_um=40.0 * np.repeat(heat, 5),
        slope_um_per_m=np.zeros(5 * states),
        law_campaigns=campaigns,
    )


WARM_UP = 1.0 - np.exp(-np.arange(1.0, 8.0) / 2.0)
OTHER_DUTY = np.array([0.2, 0.7, 0.9, 0.5, 0.3, 0.8, 0.6])


def verified(gain_on: float, campaigns: int, on: Floats = OTHER_DUTY) -> tuple[Share, ...]:
    rng = np.random.default_rng(7)
    found: list[Share] = []
    for name in NINE:
        pair = warm_run(rng, 1.0, WARM_UP, campaigns), warm_run(rng, gain_on, on, campaigns)
        found += shares(name, *pair, 5.0, rng)
    return tuple(found)


@pytest.mark.parametrize(("gain_on", "kind"), [(2.0, "reversed"), (-1.0, "doubled"), (1.0, "not active")])
def test_a_law_of_two_campaigns_leaves_every_component_open_and_all_of_them_decide(gain_on: float, kind: str) -> None:
    alone = verified(gain_on, campaigns=2)
    assert sum(one.kind == "unclear" for one in alone) >= 7
    told, (group,) = with_pooled(alone)
    assert group.kind == kind
    assert group.low < 1.0 - gain_on < group.high
    assert sum(one.kind == kind for one in told) >= 8


def test_a_law_of_one_campaign_proves_nothing_in_another_duty() -> None:
    """Neither a name for all components, nor what would be usual; in the same duty both are known."""
    alone = verified(2.0, campaigns=1)
    assert all(np.isnan(one.sd) and np.isnan(one.usual_um) for one in alone)
    assert with_pooled(alone)[1] == ()
    assert all(np.isfinite([one.sd, one.usual_um]).all() for one in verified(2.0, campaigns=1, on=0.9 * WARM_UP))


def test_what_the_law_left_of_unseen_data_is_usual() -> None:
    rng = np.random.default_rng(3)
    off, on = warm_run(rng, 1.0, WARM_UP, 2), warm_run(rng, 0.0, OTHER_DUTY, 2)
    (plain,) = shares("EXX", off, on, 5.0, np.random.default_rng(1))
    (known,) = shares("EXX", replace(off, left_um=33.0), on, 5.0, np.random.default_rng(1))
    assert plain.usual_um < 33.0 == known.usual_um
    assert (plain.value, plain.low, plain.sd) == (known.value, known.low, known.sd)

"""The checks of the verdict, and the causes of a no-go by name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from thetacomp.machine import Machine
from thetacomp.verification.applied_share import ALL
from thetacomp.verification.outcome import (
    BeforeAfter,
    Cause,
    CauseKind,
    Check,
    HarmMap,
    PooledShare,
    RunFacts,
    Share,
    ShareKind,
    listed,
)

# As in the acceptance of a model: at least half of the error is gone.
MAX_RESIDUAL_RATIO = 0.5
MIN_HEAT, MAX_HEAT = 0.5, 2.0
# Without a law between temperature and error nothing can be scaled: the heat itself must be about the same.
LIKE_RISE, UNLIKE_RISE = 0.8, 1.25
# A model follows another campaign within some 20 % (RMS); more than this share is another relation.
RELATION_SHARE, RELATION_GROWTH = 0.25, 2.5
# The tables that carry the compensation under test go by this name in active_tables.
UNDER_TEST = "temperature"
WRONG: tuple[ShareKind, ...] = ("reversed", "doubled", "not active")

_WORDS: Mapping[str, tuple[str, str]] = {
    "reversed": (
        "the compensation works with the wrong sign: the residual is about twice the uncompensated error",
        "turn the sign of this register in the control (sign test of the commissioning sheet), then measure again.",
    ),
    "doubled": (
        "the compensation is applied twice: the error comes back with the opposite sign",
        "look for a second compensation of the same error (control and PLC, sag table and temperature compensation,"
        " a table that was left active), switch one off, then measure again.",
    ),
    "not active": (
        "the compensation was not active: the error is as large as without it",
        "check option, axis referenced, enable bits and whether the values reach the control, then measure again.",
    ),
    "partly": (
        "only a part of the correction arrives",
        "check scale and unit of the register, clamps and limits (replay of the export), and whether the machine was"
        " heated in the same way as with compensation off.",
    ),
    "too strong": (
        "more correction arrives than wanted",
        "check scale and unit of the register, and whether another table corrects part of the same error.",
    ),
    "relation": (
        "no constant share of the correction explains the residual: the relation between temperatures and error is not"
        " that of the run with compensation off (another cooling mode, another duty, a sensor moved or swapped)",
        "compare cooling, duty and sensors of both runs; measure with compensation off in that mode, and fit again.",
    ),
}


def checks(
    off: RunFacts,
    on: RunFacts,
    rows: Sequence[BeforeAfter],
    shares: Sequence[Share],
    harm: Sequence[HarmMap],
    heat_ratio: float,
    model_mode: str | None,
) -> tuple[Check, ...]:
    """All checks; the verdict is go where every one is passed."""
    out = [_mode_check(off, on, model_mode), _tables_check(off, on), _heat_check(off, on, heat_ratio)]
    components = [row for row in rows if not row.component.startswith("column")]
    for axis in dict.fromkeys(_axis(row.component) for row in components):
        own = [row.of("rms") for row in components if _axis(row.component) == axis]
        before = float(np.sqrt(sum(_like(s.like_before_um, s.before_um) ** 2 for s in own)))
        after = float(np.sqrt(sum(s.after_um**2 for s in own)))
        ratio = after / before if before > 0 else float("nan")
        label = f"axis {axis}" if axis else "drift"
        out.append(
            Check(
                f"{label}: RMS on / RMS off at equal heat",
                ratio <= MAX_RESIDUAL_RATIO,
                f"{ratio:.2f}",
                f"≤ {MAX_RESIDUAL_RATIO:g}",
            )
        )
    for row in rows:
        if row.component.startswith("column"):
            out.append(_proven(row))
    out += _share_check(shares) + _harm_check(harm)
    return tuple(out)


def causes(
    checked: Sequence[Check],
    off: RunFacts,
    on: RunFacts,
    shares: Sequence[Share],
    machine: Machine,
    model_mode: str | None,
    pooled: Sequence[PooledShare] = (),
) -> tuple[Cause, ...]:
    """The causes of a no-go; none where every check is passed. `pooled` are shares of several components together.

    Where the operating modes differ nothing is concluded from the shares: another mode imitates any of them.
    """
    if all(check.passed for check in checked):
        return ()
    failed = {check.name for check in checked if not check.passed}
    out: list[Cause] = []
    if "operating mode" in failed:
        out.append(_mode_cause(off, on, model_mode))
    if "active tables" in failed:
        out.append(_tables_cause(off, on))
    if "heat" in failed:
        out.append(
            Cause(
                "heat",
                (),
                "the two runs are not comparable: " + next(c.found for c in checked if c.name == "heat"),
                "repeat the run with compensation on with about the duty of the run with compensation off.",
            )
        )
    if "operating mode" not in failed:
        out += _share_causes(shares, machine, pooled)
    if not out:
        out.append(_unknown_cause([check for check in checked if not check.passed], shares))
    return tuple(out)


def remarks(shares: Sequence[Share], go: bool) -> tuple[str, ...]:
    """What a go leaves to be improved."""
    return tuple(
        f"{_label(share)}: share {_interval(share)}, {_WORDS[share.kind][0]}"
        for share in _judged(shares)
        if go and share.kind in ("partly", "too strong")
    )


def undecided(shares: Sequence[Share]) -> tuple[str, ...]:
    """What a go does not prove: a note where the applied share of some components stays open."""
    names = [_label(share) for share in _judged(shares) if share.kind == "unclear"]
    if not names:
        return ()
    return (
        f"{', '.join(names)}: the applied share stays open: its 95 % interval holds several of the cases right, not"
        " active, reversed and doubled",
    )


def not_followed(share: Share) -> bool:
    """True where no constant share explains the residual of a component."""
    return (
        share.unexplained_um > RELATION_SHARE * share.expected_rms_um
        and share.unexplained_um > max(RELATION_GROWTH, share.chance) * share.usual_um
    )


def _axis(component: str) -> str:
    return "" if component.startswith("D") else component[2:]


def _like(like_um: float, before_um: float) -> float:
    return like_um if np.isfinite(like_um) else before_um


def _mode_check(off: RunFacts, on: RunFacts, model_mode: str | None) -> Check:
    modes = {off.mode, on.mode} | ({model_mode} if model_mode is not None else set())
    found = f"off '{off.mode}', on '{on.mode}'" + (f", model '{model_mode}'" if model_mode is not None else "")
    found = f"'{off.mode}'" if len(modes) == 1 else found
    return Check("operating mode", len(modes) == 1, found, "the same")


def _tables_check(off: RunFacts, on: RunFacts) -> Check:
    # The compensation under test may stand among the tables of its own run, never in that without it.
    same = set(off.tables) == set(on.tables) - {UNDER_TEST}
    return Check(
        "active tables",
        same,
        f"off {listed(sorted(off.tables))}; on {listed(sorted(on.tables))}",
        f"the same; '{UNDER_TEST}' in on only",
    )


def _heat_check(off: RunFacts, on: RunFacts, heat_ratio: float) -> Check:
    if np.isfinite(heat_ratio):
        return Check(
            "heat",
            MIN_HEAT <= heat_ratio <= MAX_HEAT,
            f"on {100 * heat_ratio:.0f} % of off",
            f"{100 * MIN_HEAT:.0f} to {100 * MAX_HEAT:.0f} %",
        )
    sensor, rise_K = off.rises_K[0] if off.rises_K else ("", float("nan"))
    ratio = dict(on.rises_K).get(sensor, float("nan")) / rise_K if rise_K else float("nan")
    return Check(
        "heat",
        bool(LIKE_RISE <= ratio <= UNLIKE_RISE),
        f"no law between temperature and error is known, and {sensor} rose {ratio:.2f} times as far",
        f"{LIKE_RISE:g} to {UNLIKE_RISE:g} times, since nothing can be scaled",
    )


def _proven(row: BeforeAfter) -> Check:
    largest = row.of("max")
    low = largest.low_percent
    name = f"column deviation {row.component[-1]}: reduction"
    if not np.isfinite(low):
        percent = largest.reduction_percent
        return Check(name, percent > 0, f"{percent:.0f} % (no interval)", "> 0 %")
    return Check(name, low > 0, f"{largest.like_reduction_percent:.0f} %, at least {low:.0f} %", "surely > 0 %")


def _judged(shares: Sequence[Share]) -> list[Share]:
    """One entry a component; its intercept and slope separately where they differ."""
    out: list[Share] = []
    for component in dict.fromkeys(share.component for share in shares):
        own = [share for share in shares if share.component == component and share.material]
        parts = [share for share in own if share.part != ALL]
        apart = len(parts) == 2 and (parts[0].low > parts[1].high or parts[1].low > parts[0].high)
        differ = apart and parts[0].kind != parts[1].kind
        out += parts if differ else [share for share in own if share.part == ALL]
    return out


def _share_check(shares: Sequence[Share]) -> list[Check]:
    judged = _judged(shares)
    if not judged:
        return []
    wrong = [share for share in judged if share.kind in WRONG or (share.kind != "applied" and not_followed(share))]
    words = {id(s): s.kind if s.kind in WRONG else "not constant" for s in wrong}
    found = "; ".join(f"{_label(s)} {words[id(s)]} ({s.value:.2f})" for s in wrong[:3])
    found += " …" if len(wrong) > 3 else ""
    low, high = min(s.value for s in judged), max(s.value for s in judged)
    return [
        Check(
            "applied share of the correction", not wrong, found or f"{low:.2f} to {high:.2f}", "near 1; not -1, 0, 2"
        ),
    ]


def _harm_check(harm: Sequence[HarmMap]) -> list[Check]:
    if not harm:
        return []
    worst = max(harm, key=lambda one: one.largest_um - one.limit_um)
    place = "" if worst.component.startswith("D") else f" at {worst.largest_at_mm:.0f} mm"
    found = f"{worst.largest_um:+.0f} µm, {worst.component}{place}, {worst.largest_at_s / 3600:.1f} h"
    return [Check("harm by position", worst.largest_um <= worst.limit_um, found, f"≤ {worst.limit_um:.0f} µm")]


def _mode_cause(off: RunFacts, on: RunFacts, model_mode: str | None) -> Cause:
    parts = [f"'{off.mode}' with compensation off", f"'{on.mode}' with compensation on"]
    if model_mode is not None:
        parts.append(f"'{model_mode}' in the training of the model")
    return Cause(
        "mode",
        (),
        f"another operating mode: {', '.join(parts)}; cooling changes the relation between temperatures and error",
        "verify in the mode that the model was trained in, or measure and train the other mode with compensation off.",
    )


def _tables_cause(off: RunFacts, on: RunFacts) -> Cause:
    if UNDER_TEST in off.tables:
        text = "temperature compensation was active in the run that is named as the uncompensated one"
        return Cause("tables", (), text, "measure once more without it, or name the right campaign with --off.")
    lost = sorted(set(off.tables) - set(on.tables))
    added = sorted(set(on.tables) - set(off.tables) - {UNDER_TEST})
    parts = [f"{listed(lost)} active only with compensation off"] * bool(lost)
    parts += [f"{listed(added)} active only with compensation on"] * bool(added)
    return Cause(
        "tables",
        (),
        f"different tables were active in the control: {'; '.join(parts)}",
        "measure both runs with the same tables; a table that carries the compensation under test is named"
        f' "{UNDER_TEST}" in active_tables.',
    )


def _unknown_cause(failed: Sequence[Check], shares: Sequence[Share]) -> Cause:
    """What can be said where neither conditions nor shares name a cause."""
    fix = "look at the figures by position and time; train with this kind of duty as well, and verify again."
    if not shares:
        text = "without an error that the temperatures explain, no cause can be found"
    elif {share.kind for share in _judged(shares)} == {"unclear"}:
        text = (
            "the model follows these runs too poorly to tell whether the correction arrives, and with which sign: no"
            " applied share is known"
        )
        fix = (
            "prove the sign by the sign test of the commissioning sheet; train with more campaigns and this kind of"
            " duty, and verify again."
        )
    else:
        text = "no wrong sign or size of the correction is visible, so the model does not follow this run well"
    return Cause("model", (), f"{text} ({'; '.join(f'{check.name}: {check.found}' for check in failed)})", fix)


def _share_causes(shares: Sequence[Share], machine: Machine, pooled: Sequence[PooledShare]) -> list[Cause]:
    judged = _judged(shares)
    kinds: dict[CauseKind, list[Share]] = {
        "reversed": [],
        "doubled": [],
        "not active": [],
        "relation": [],
        "partly": [],
        "too strong": [],
    }
    changed = any(not_followed(share) for share in judged)
    for share in judged:
        # Where no share explains some components, an odd share of another one has the same cause.
        if not_followed(share) or (changed and share.kind in ("partly", "too strong")):
            kinds["relation"].append(share)
        elif share.kind != "applied" and share.kind != "unclear":
            kinds[share.kind].append(share)
    out = []
    for kind, found in kinds.items():
        if found:
            what, fix = _WORDS[kind]
            figures = "; ".join([_figures(kind, found), *(_together(group) for group in pooled if group.kind == kind)])
            text = f"{_who(found, judged, machine)}: {what} ({figures})"
            out.append(Cause(kind, tuple(_label(s) for s in found), text, fix))
    return out


def _label(share: Share) -> str:
    return share.component if share.part == ALL else f"{share.part} of {share.component}"


def _together(group: PooledShare) -> str:
    directions, axes = ({name[part] for name in group.components} for part in (slice(1, 2), slice(2, None)))
    one = "those in " + directions.pop() if len(directions) == 1 else _group_of_axis(axes)
    return f"{one} together {_interval(group)}"


def _group_of_axis(axes: set[str]) -> str:
    if len(axes) > 1:
        return "all"
    axis = axes.pop()
    return f"those of axis {axis}" if axis else "those of the drift"


def _interval(share: Share | PooledShare) -> str:
    return f"{share.value:.2f} (95 %: {share.low:.2f} to {share.high:.2f})"


def _figures(kind: str, found: Sequence[Share]) -> str:
    if kind == "relation":
        worst = max(found, key=lambda share: share.unexplained_um)
        return (
            f"{worst.component}: {worst.unexplained_um:.0f} µm RMS unexplained, {worst.usual_um:.0f} µm with"
            " compensation off"
        )
    if len(found) == 1:
        return f"applied share {_interval(found[0])}"
    low, high = min(s.value for s in found), max(s.value for s in found)
    return f"applied shares {low:.2f} to {high:.2f}"


def _who(found: Sequence[Share], judged: Sequence[Share], machine: Machine) -> str:
    """The components, named as a whole or as a whole axis where they are complete."""
    if len(found) > 1 and len(found) == len(judged):
        return f"all {len(found)} components that can be judged"
    names = [_label(share) for share in found]
    for axis in machine.axes:
        own = [share for share in judged if _axis(share.component) == axis.name]
        if len(own) > 1 and own == list(found):
            return f"axis {axis.name} ({', '.join(names)})"
    return ", ".join(names)

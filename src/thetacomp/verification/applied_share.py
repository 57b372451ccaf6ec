"""Which share of the wanted correction reached the machine, and repeated runs drawn from what it does not explain.

The error of a run is regressed on the error expected from its temperatures: `value = gain × expected + rest`. With
compensation off the gain is 1 (or what the model is wrong by), with it on it is 1 less the applied share:

    share = gain_off - gain_on      1 right, 0 not active, -1 reversed, 2 doubled

The rest of a state (a line: intercept and slope) is not independent from sweep to sweep: repeated runs are drawn with
the same heat, a rest that follows a first-order autoregression of the same size, and the noise of the instrument. Its
size is itself uncertain, which is drawn too (Student's t). All states of a campaign share the error of its cold zero.
Intervals are the observed value less the drawn deviations (basic bootstrap; Davison and Hinkley, Bootstrap Methods and
their Application, 1997, section 5.2.1).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import special

from thetacomp.arrays import Floats
from thetacomp.verification.outcome import Share, ShareKind
from thetacomp.verification.runs import RunPoints

NAN = float("nan")
DRAWS = 1000
MIN_STATES = 4  # with fewer sweeps the rest of a line fit is next to nothing, and so would be the interval
MOST_DRAWN_VALUES = 4_000_000  # a long drift record gets fewer draws, not more memory
MAX_CORRELATION = 0.9
SURE = 0.99
LIMITS_PERCENT = (2.5, 97.5)
WITHIN_ONE_SD_PERCENT = (15.87, 84.13)
ALL, INTERCEPT, SLOPE = "all", "intercept", "slope"
SPECIAL: tuple[tuple[float, ShareKind], ...] = (
    (-1.0, "reversed"),
    (0.0, "not active"),
    (1.0, "applied"),
    (2.0, "doubled"),
)
# The model itself is never right to better than this: a share of 0.92 does not prove a fault of the control.
MARGIN = 0.1
NEAR = 0.25
SAME_HEAT = 0.1
WIDEST = 1.0


@dataclass(frozen=True)
class Fit:
    """One run of one component: gains of the parts (p,), what they explain (n,) and the rest of every state (K, 2).

    `parts` names the columns of `design` (n, p); `rest_um` is the RMS of the rest over the measured points.
    """

    points: RunPoints
    parts: tuple[str, ...]
    design: Floats
    gains: Floats
    explained_um: Floats
    rest: Floats
    rest_um: float


def fit_run(points: RunPoints, separate_parts: bool) -> Fit:
    """Regress a run on its expected error; where none is known, every state is taken by itself."""
    if not points.explained:
        state_lines = _state_lines(points, points.value_um)
        explained = _values(points, state_lines)
        return Fit(points, (), np.zeros((len(explained), 0)), np.zeros(0), explained, np.zeros_like(state_lines), 0.0)
    if separate_parts:
        parts: tuple[str, ...] = (INTERCEPT, SLOPE)
        design = np.column_stack([points.intercept_um, points.slope_um_per_m * points.lever_m])
    else:
        parts, design = (ALL,), points.expected_um[:, None]
    gains: Floats = np.linalg.lstsq(design, points.value_um, rcond=None)[0].astype(np.float64)
    explained = design @ gains
    rest = _state_lines(points, points.value_um - explained)
    rest_um = float(np.sqrt(np.mean(_values(points, rest) ** 2)))
    return Fit(points, parts, design, gains, explained, rest, rest_um)


def repeated_runs(fit: Fit, rng: np.random.Generator, draws: int) -> Floats:
    """Values of repeated runs with the same heat, (draws, n)."""
    points, states = fit.points, len(fit.rest)
    freedom = max(states - max(len(fit.parts), 1), 1)
    covariance = fit.rest.T @ fit.rest / freedom
    root = _root(covariance)
    correlation = _autocorrelation(fit)
    scale = np.sqrt(freedom / rng.chisquare(freedom, draws))[:, None]
    rest = np.empty((draws, states, 2))
    for k in range(states):
        fresh = rng.standard_normal((draws, 2)) @ root.T * scale
        if k and points.campaign[k] == points.campaign[k - 1]:
            rest[:, k] = correlation * rest[:, k - 1] + np.sqrt(1.0 - correlation**2) * fresh
        else:
            rest[:, k] = fresh
    if any(points.zero_sd):
        # Every repeated run has its own cold block: its error stays in all states, and no rest of one shows it.
        first, own = np.unique(points.campaign, return_inverse=True)
        rest += (rng.standard_normal((draws, len(first), 2)) * points.zero_sd)[:, own]
    values = fit.explained_um + rest[:, points.state, 0] + rest[:, points.state, 1] * points.lever_m
    return np.asarray(values + points.noise_sd_um * rng.standard_normal(values.shape))


def draws_for(*runs: RunPoints) -> int:
    """How many repeated runs are drawn: as many for both runs of a comparison."""
    longest = max(len(run.value_um) for run in runs)
    return int(np.clip(MOST_DRAWN_VALUES // longest, 100, DRAWS))


def enough_states(*runs: RunPoints) -> bool:
    """True where every run has enough heated sweeps for an interval."""
    return min(len(run.t_s) for run in runs) >= MIN_STATES


def shares(
    component: str, off: RunPoints, on: RunPoints, least_um: float, rng: np.random.Generator
) -> tuple[Share, ...]:
    """The applied share of a component, and of its intercept and slope where both are at least `least_um` large.

    Empty where no error can be expected from the temperatures.
    """
    if not (off.explained and on.explained):
        return ()
    sizes = {
        ALL: float(np.abs(on.expected_um).max()),
        INTERCEPT: float(np.abs(on.intercept_um).max()),
        SLOPE: float(np.abs(on.slope_um_per_m * on.lever_m).max()),
    }
    both = min(sizes[INTERCEPT], sizes[SLOPE]) >= least_um
    out = []
    draws = draws_for(off, on)
    # One campaign cannot tell heat from time: of another course of heat its law proves nothing.
    foreign = off.law_campaigns == 1 and not _same_heat(off, on)
    split = (fit_run(off, separate_parts=True), fit_run(on, separate_parts=True)) if both else None
    for separate_parts in (False, True) if both else (False,):
        fits = split if separate_parts and split else (fit_run(off, False), fit_run(on, False))
        drawn = [_gains(fit, repeated_runs(fit, rng, draws)) - fit.gains for fit in fits]
        transfer_sd, freedom = _transfer(fits[0], fits[1]), _freedom(*fits)
        transfer = transfer_sd[:, None] * rng.standard_t(freedom, draws)
        # What no share explains is judged with intercept and slope free, so that one reversed register is no riddle.
        rests = split or fits
        for k, part in enumerate(fits[0].parts):
            value = float(fits[0].gains[k] - fits[1].gains[k])
            repeated = drawn[0][:, k] - drawn[1][:, k]
            low, high = (value - float(np.percentile(repeated + transfer[k], q)) for q in reversed(LIMITS_PERCENT))
            if not enough_states(off, on):
                low, high = -np.inf, np.inf
            material = sizes[part] >= least_um
            out.append(
                Share(
                    component=component,
                    part=part,
                    value=value,
                    low=low,
                    high=high,
                    size_um=sizes[part],
                    expected_rms_um=float(np.sqrt(np.mean(on.expected_um**2))),
                    unexplained_um=rests[1].rest_um,
                    usual_um=NAN if foreign else max(rests[0].rest_um * _unflattered(rests[0]), off.left_um),
                    material=material,
                    kind=classify(value, low, high),
                    sd=NAN if foreign else float(np.hypot(transfer_sd[k], _sd(repeated))),
                    freedom=freedom,
                    chance=_chance(*rests),
                )
            )
    return tuple(out)


def classify(value: float, low: float, high: float) -> ShareKind:
    """Name a share by its interval; "unclear" where the interval is too wide to decide between cases."""
    return "unclear" if high - low > WIDEST else named_share(value, low - MARGIN, high + MARGIN)


def named_share(value: float, low: float, high: float) -> ShareKind:
    """The only case that an interval holds, or what lies between the cases; "unclear" where it holds several."""
    possible = [(centre, kind) for centre, kind in SPECIAL if low <= centre <= high]
    if len(possible) > 1:
        return "unclear"
    if possible:
        centre, kind = possible[0]
        return kind if abs(value - centre) <= NEAR else "unclear"
    if value < 0.0:
        return "reversed"
    return "partly" if value < 1.0 else "too strong"


def _sd(drawn: Floats) -> float:
    """Standard deviation of drawn values (n,), from their percentiles: Student's t has far tails."""
    low, high = np.percentile(drawn, WITHIN_ONE_SD_PERCENT)
    return float(high - low) / 2.0


def _chance(off: Fit, on: Fit) -> float:
    """Largest ratio of the rests of two runs, on to off, that chance makes (F distribution of their states)."""
    own, other = (max(len(fit.rest) - len(fit.parts), 1) for fit in (on, off))
    return float(np.sqrt(special.fdtri(own, other, SURE)))


def _gains(fit: Fit, values: Floats) -> Floats:
    """Gains of many repeated runs, (draws, p), from values (draws, n)."""
    return np.asarray(values @ np.linalg.pinv(fit.design).T)


def _transfer(off: Fit, on: Fit) -> Floats:
    """Standard deviation of the shares (p,) from what the model is wrong by in one duty and not in the other.

    The model's own miss cancels where both runs have the same heat. Else it is taken to be as large along the expected
    error, where it hides in the gain, as it is across it, where it stands in the rest.
    """
    out = np.zeros(len(off.parts))
    if _same_heat(off.points, on.points):
        return out
    for fit in (off, on):
        size_um = np.sqrt(np.mean(fit.design**2, axis=0))
        out += (fit.rest_um * _unflattered(fit) / np.maximum(size_um, 1e-9)) ** 2
    return np.asarray(np.sqrt(out))


def _freedom(*fits: Fit) -> float:
    """How many independent states the rest of the shorter run holds, a first-order autoregression taken off."""
    counts = []
    for fit in fits:
        correlation = _autocorrelation(fit)
        counts.append(len(fit.rest) * (1.0 - correlation) / (1.0 + correlation) - len(fit.parts))
    return max(min(counts), 1.0)


def _same_heat(off: RunPoints, on: RunPoints) -> bool:
    """True where the same points follow the same expected error, up to a common factor, to a tenth of its size."""
    if len(off.expected_um) != len(on.expected_um):
        return False
    factor = float(off.expected_um @ on.expected_um) / max(float(on.expected_um @ on.expected_um), 1e-300)
    difference = float(np.sqrt(np.mean((off.expected_um - factor * on.expected_um) ** 2)))
    return difference <= SAME_HEAT * float(np.sqrt(np.mean(off.expected_um**2)))


def _unflattered(fit: Fit) -> float:
    """A fit with p gains to K states leaves less than the truth: this factor gives it back."""
    states = len(fit.rest)
    return float(np.sqrt(states / max(states - len(fit.parts), 1)))


def _state_lines(points: RunPoints, value_um: Floats) -> Floats:
    """Least-squares intercept and slope of every state, (K, 2); the mean alone where all points share one position."""
    out = np.zeros((len(points.t_s), 2))
    for k in range(len(points.t_s)):
        rows = points.state == k
        lever, value = points.lever_m[rows], value_um[rows]
        spread = lever - lever.mean()
        power = float(spread @ spread)
        slope = float(spread @ value) / power if power > 0 else 0.0
        out[k] = value.mean() - slope * lever.mean(), slope
    return out


def _values(points: RunPoints, lines: Floats) -> Floats:
    return np.asarray(lines[points.state, 0] + lines[points.state, 1] * points.lever_m)


def _root(covariance: Floats) -> Floats:
    value, vector = np.linalg.eigh(covariance)
    return np.asarray(vector * np.sqrt(np.maximum(value, 0.0)))


def _autocorrelation(fit: Fit) -> float:
    """Correlation of the rest from sweep to sweep, weighted in µm over the travel, corrected for few states.

    The estimate from K values is low by about (1 + 3 ρ) / K (Kendall 1954, for a fitted mean).
    """
    points, rest = fit.points, fit.rest
    if len(rest) < 3:
        return 0.0
    spread = points.lever_m.std()
    vector = rest * np.array([1.0, spread])
    same = points.campaign[1:] == points.campaign[:-1]
    power = float(np.sum(vector**2))
    if power <= 0 or not same.any():
        return 0.0
    value = float(np.sum((vector[1:] * vector[:-1])[same])) / power
    return float(np.clip(value + (1.0 + 3.0 * value) / len(rest), 0.0, max(MAX_CORRELATION, 1.0 - 5.0 / len(rest))))

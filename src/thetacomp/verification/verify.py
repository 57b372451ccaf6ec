"""The spine of a verification, readable from top to bottom: choose, screen, separate, expect, compare, judge.

Temperatures are screened as in `analyze`, by what the campaigns with compensation off teach. Axes are separated one by
one, even where the campaigns carry the joint form: what is compared is the whole error at the tool where the sweep was
measured, drift and tilt of the other axes included. The joint form takes these out of the axes. On eight machines of
rigid bodies with a perfect compensation it showed 20 and 39 % of the true column deviation (in X and Z; axis by axis
102 and 104 %), made the intervals of the shares twice as wide (0.48 instead of 0.22), and called three of the eight a
no-go.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from thetacomp.axis_states import axis_states
from thetacomp.campaign import Campaign, MachineFolder
from thetacomp.errors import AnalysisError
from thetacomp.model.document import ModelDocument
from thetacomp.screening.campaigns import screened
from thetacomp.separation import ComponentSeparation, separate_campaign
from thetacomp.standards.instrument import Instrument
from thetacomp.verification.applied_share import shares
from thetacomp.verification.before_after import before_after, over_points, over_states, state_line
from thetacomp.verification.diagnosis import causes, checks, remarks, undecided
from thetacomp.verification.expected_error import expected_from_fit, expected_from_model
from thetacomp.verification.harm import harm_map
from thetacomp.verification.outcome import HarmMap, Share, StateLine, VerificationResult
from thetacomp.verification.pooled_share import with_pooled
from thetacomp.verification.runs import (
    RunPoints,
    chosen,
    facts,
    run_points,
    without_expectation,
    zero_scatter,
)
from thetacomp.verification.straightness import squareness, straightness

SEED = 20120951
# An error below this share of the largest one is too small to judge its sign.
MATERIAL_SHARE = 0.1
HARM_SHARE = 0.25
NOISE_SIGMA = 3.0

Progress = Callable[[str], None]
Pair = tuple[RunPoints, RunPoints]


def verify_folder(
    folder: MachineFolder,
    off: Sequence[str],
    on: Sequence[str],
    model: ModelDocument | None = None,
    progress: Progress = lambda message: None,
) -> VerificationResult:
    """Compare campaigns measured with compensation off with others measured with it on.

    The expected uncompensated error comes from `model`, or is fitted to the campaigns of `off`. Raises AnalysisError
    where campaign.toml contradicts the names, or where the runs share no error component.
    """
    as_read = chosen(folder, off, on)
    progress("screening temperatures")
    screening = screened(folder, off, on)
    folder = screening.folder
    runs = [folder.campaign(c.name) for c in as_read[0]], [folder.campaign(c.name) for c in as_read[1]]
    progress("separating geometry and heat")
    separations = tuple(s for c in (*runs[0], *runs[1]) for s in separate_campaign(folder.machine, c))
    _refuse_empty(runs, separations)

    progress("relating temperatures and error with compensation off")
    pairs, notes = _pairs(folder, separations, off, on, model)
    sizes = {name: max(_size_um(pair[0]), _expected_um(pair[1])) for name, pair in pairs.items()}
    smallest_um = MATERIAL_SHARE * max(sizes.values(), default=0.0)

    progress("comparing off and on")
    rng = np.random.default_rng(SEED)
    rows, harm = [], []
    found_shares: list[Share] = []
    for name, (run_off, run_on) in pairs.items():
        rows.append(before_after(name, run_off, run_on, over_points, rng))
        unseen_um = max(_instrument_um(runs, run_on), NOISE_SIGMA * run_on.noise_sd_um)
        found_shares += shares(name, run_off, run_on, max(smallest_um, unseen_um), rng)
        harm.append(_harm(name, (run_off, run_on), unseen_um, sizes))
    told_shares, pooled = with_pooled(found_shares)
    columns = _columns(folder, pairs)
    rows += [before_after(label, *pairs[name], over_states, rng) for label, name in columns]

    fact_off, fact_on = (facts(campaigns, separations) for campaigns in runs)
    ratio = _heat_ratio(pairs)
    maps = tuple(one for one in harm if one is not None)
    model_mode = model.training.mode if model is not None else None
    checked = checks(fact_off, fact_on, rows, told_shares, maps, ratio, model_mode)
    found_causes = causes(checked, fact_off, fact_on, told_shares, folder.machine, model_mode, pooled)
    return VerificationResult(
        machine=folder.machine,
        off=fact_off,
        on=fact_on,
        pattern=f"model of {model.created[:10]}" if model is not None else "fit to the run with compensation off",
        heat_ratio=ratio,
        rows=tuple(rows),
        shares=told_shares,
        pooled=pooled,
        harm=maps,
        straightness=straightness(folder.machine, separations, off, on),
        squareness=squareness(folder.machine, separations, off, on),
        states_off=_lines(pairs, columns, 0),
        states_on=_lines(pairs, columns, 1),
        checks=checked,
        causes=found_causes,
        notes=(
            *screening.notes,
            *notes,
            *_unstated(runs),
            *remarks(told_shares, go=not found_causes),
            *(undecided(told_shares) if not found_causes else ()),
        ),
    )


def _refuse_empty(runs: tuple[list[Campaign], list[Campaign]], separations: Sequence[ComponentSeparation]) -> None:
    measured = {s.campaign for s in separations}
    empty = [c.name for campaigns in runs for c in campaigns if c.name not in measured]
    if empty:
        raise AnalysisError(
            f"campaign {', '.join(empty)} holds no sweeps, parameters or drift: there is nothing to compare."
            " Fix: put sweeps.csv, parameters.csv or drift.csv into it."
        )


def _pairs(
    folder: MachineFolder,
    separations: Sequence[ComponentSeparation],
    off: Sequence[str],
    on: Sequence[str],
    model: ModelDocument | None,
) -> tuple[dict[str, Pair], list[str]]:
    """Points off and on of every component that both runs measured, with the expected error."""
    pairs: dict[str, Pair] = {}
    notes: list[str] = []
    common = _common(separations, off, on, notes)
    if not common:
        raise AnalysisError(
            "the two runs share no error component. Fix: measure the same axes with compensation off and on."
        )
    for states in axis_states(folder, [s for s in separations if s.component in common], [*off, *on]):
        patterns, reasons = (
            expected_from_model(model, folder, states, separations)
            if model is not None
            else expected_from_fit(folder, states, off)
        )
        notes += reasons
        for k, component in enumerate(states.components):
            found = run_points(states, k, off, patterns[k]), run_points(states, k, on, patterns[k])
            if found[0] is None or found[1] is None:
                notes.append(f"{component}: no heated state in one of the runs; it is not compared")
                continue
            pair = (
                replace(found[0], zero_sd=zero_scatter(separations, component, off)),
                replace(found[1], zero_sd=zero_scatter(separations, component, on)),
            )
            if not (pair[0].explained and pair[1].explained):
                pair = without_expectation(pair[0]), without_expectation(pair[1])
            pairs[component] = pair
    if not pairs:
        raise AnalysisError("neither run has heated states. Fix: measure sweeps after the cold block as well.")
    return pairs, notes


def _common(
    separations: Sequence[ComponentSeparation], off: Sequence[str], on: Sequence[str], notes: list[str]
) -> set[str]:
    measured = {name: {s.component for s in separations if s.campaign == name} for name in (*off, *on)}
    everywhere = set.intersection(*measured.values())
    lost = sorted(set.union(*measured.values()) - everywhere)
    if lost:
        notes.append(f"{', '.join(lost)}: not measured in all campaigns of both runs; not compared")
    return everywhere


def _instrument_um(runs: tuple[list[Campaign], list[Campaign]], points: RunPoints) -> float:
    """Largest stated expanded uncertainty of a point at the far end of the travel; 0 where none is stated."""
    travel_mm = 1000.0 * float(np.ptp(points.lever_m))
    stated = [Instrument.of(c.settings).reading_u_um(travel_mm) for campaigns in runs for c in campaigns]
    return max(known or 0.0 for known in stated)


def _size_um(run: RunPoints) -> float:
    """Largest uncompensated error of the run without compensation: expected, or measured where none can be."""
    return _expected_um(run) if run.explained else float(np.abs(run.value_um).max())


def _expected_um(run: RunPoints) -> float:
    return float(np.abs(run.expected_um).max()) if run.explained else 0.0


def _harm(name: str, pair: Pair, noise_um: float, sizes: dict[str, float]) -> HarmMap | None:
    """Harm of one component; the limit is a quarter of the largest uncompensated error in its direction."""
    direction = max(size for other, size in sizes.items() if other[1] == name[1])
    return harm_map(name, *pair, max(HARM_SHARE * direction, noise_um))


def _columns(folder: MachineFolder, pairs: dict[str, Pair]) -> list[tuple[str, str]]:
    """`column_X` and `column_Z` with the component that they come from: what the axis along Y does to the tool."""
    vertical = [axis.name for axis in folder.machine.axes if axis.cartesian == "Y"]
    found = [(f"column_{d}", f"E{d}{name}") for name in vertical[:1] for d in ("X", "Z")]
    return [(label, component) for label, component in found if component in pairs]


def _heat_ratio(pairs: dict[str, Pair]) -> float:
    """Heat on / heat off: largest expected errors of all components; NaN where nothing can be expected."""
    known = [pair for pair in pairs.values() if pair[0].explained]
    if not known:
        return float("nan")
    off, on = (sum(float(np.abs(pair[k].expected_um).max()) for pair in known) for k in (0, 1))
    return on / off


def _lines(pairs: dict[str, Pair], columns: Sequence[tuple[str, str]], k: int) -> tuple[StateLine, ...]:
    named = [*columns, *((name, name) for name in pairs)]
    return tuple(state_line(label, pairs[component][k]) for label, component in named)


def _unstated(runs: tuple[list[Campaign], list[Campaign]]) -> list[str]:
    campaigns = [*runs[0], *runs[1]]
    notes = []
    if not any(c.settings.mode for c in campaigns):
        notes.append("no campaign states its operating mode: whether the cooling was the same is not known")
    if any(c.settings.instrument_u_um is None for c in campaigns):
        notes.append(
            "the uncertainty of a point (instrument_u_um) is not stated in every campaign: small errors are judged by"
            " their scatter only"
        )
    return notes

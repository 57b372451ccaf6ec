"""The two runs that are compared: which campaigns, whether their settings contradict, and their points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from thetacomp.arrays import Floats, Ints
from thetacomp.axis_states import AxisStates
from thetacomp.campaign import Campaign, MachineFolder
from thetacomp.errors import AnalysisError
from thetacomp.separation import ComponentSeparation
from thetacomp.verification.expected_error import Expected
from thetacomp.verification.outcome import RunFacts


@dataclass(frozen=True)
class RunPoints:
    """Thermal error of one component in one run, n points in K heated states; states count from 0 in order of time.

    `campaign` (K,) and `t_s` (K,) belong to the states. `intercept_um` and `slope_um_per_m`, each (n,), are the
    uncompensated error expected from the temperatures at each point, NaN where none is known. Their law was fitted to
    `law_campaigns` and leaves `left_um` (RMS) of data it has not seen (0: not known). `zero_sd` is the standard
    deviation (µm, µm/m) of the cold line that all states of a campaign are counted from.
    """

    state: Ints
    p0_mm: float
    lever_m: Floats
    value_um: Floats
    noise_sd_um: float
    campaign: Ints
    t_s: Floats
    intercept_um: Floats
    slope_um_per_m: Floats
    left_um: float = 0.0
    law_campaigns: int = 0
    zero_sd: tuple[float, float] = (0.0, 0.0)

    @property
    def expected_um(self) -> Floats:
        """The uncompensated error expected at each point, (n,)."""
        return self.intercept_um + self.slope_um_per_m * self.lever_m

    @property
    def explained(self) -> bool:
        """True where an expected error is known and is not zero throughout."""
        expected = self.expected_um
        return bool(len(expected)) and bool(np.isfinite(expected).all()) and bool(np.abs(expected).max() > 0)


def chosen(folder: MachineFolder, off: Sequence[str], on: Sequence[str]) -> tuple[list[Campaign], list[Campaign]]:
    """The campaigns of both runs. Raises AnalysisError where a name or campaign.toml contradicts the command."""
    known = [campaign.name for campaign in folder.campaigns]
    unknown = [name for name in (*off, *on) if name not in known]
    if unknown:
        raise AnalysisError(
            f"there is no campaign {', '.join(unknown)}; the folder has {', '.join(known)}."
            " Fix: use these names with --off and --on."
        )
    if not off or not on:
        raise AnalysisError("a verification needs a run with compensation off and one with it on. Fix: --off A --on B.")
    twice = sorted({name for name in (*off, *on) if [*off, *on].count(name) > 1})
    if twice:
        raise AnalysisError(f"campaign {', '.join(twice)} is named twice. Fix: name every campaign once.")
    runs = [folder.campaign(name) for name in off], [folder.campaign(name) for name in on]
    for campaigns, wanted, other in zip(runs, ("off", "on"), ("on", "off"), strict=True):
        wrong = [c.name for c in campaigns if c.settings.compensation != wanted]
        if wrong:
            raise AnalysisError(
                f"campaign {', '.join(wrong)} is named with --{wanted}, but its campaign.toml says"
                f' compensation = "{other}".'
                f' Fix: name it with the other option, or write compensation = "{wanted}" where that is the truth.'
            )
        for label, values in (
            ("operating modes", {c.name: c.settings.mode for c in campaigns}),
            ("active tables", {c.name: ", ".join(sorted(c.settings.active_tables)) for c in campaigns}),
        ):
            if len(set(values.values())) > 1:
                listed = ", ".join(f"{name}: '{value}'" for name, value in values.items())
                raise AnalysisError(
                    f"the campaigns named with --{wanted} have different {label} ({listed}); they are no single run."
                    " Fix: name campaigns of one kind, or correct campaign.toml."
                )
    return runs


def run_points(states: AxisStates, component: int, names: Sequence[str], expected: Expected) -> RunPoints | None:
    """Points of one component in the heated states of the named campaigns; None where there are none.

    `expected` holds what is expected for every sample of the component.
    """
    samples = states.samples[component]
    numbers = [k for k, name in enumerate(states.campaigns) if name in set(names)]
    heated = ~states.cold if states.exact_zero else np.ones(len(states), dtype=np.bool_)
    wanted = np.isin(states.campaign, numbers) & heated
    rows = np.flatnonzero(wanted[samples.state])
    finite = np.isfinite(expected.intercept_um[rows]) & np.isfinite(expected.slope_um_per_m[rows])
    if finite.any():
        # A gap of the temperatures leaves some points without an expected error: the others carry the comparison.
        rows = rows[finite]
    if not len(rows):
        return None
    rows = rows[np.argsort(samples.state[rows], kind="stable")]
    present, state = np.unique(samples.state[rows], return_inverse=True)
    return RunPoints(
        state=state.astype(np.int64),
        p0_mm=states.p0_mm,
        lever_m=samples.lever_m[rows],
        value_um=samples.value_um[rows],
        noise_sd_um=float(np.sqrt(np.mean(samples.noise_sd_um[rows] ** 2))),
        campaign=states.campaign[present],
        t_s=states.t_s[present],
        intercept_um=expected.intercept_um[rows],
        slope_um_per_m=expected.slope_um_per_m[rows],
        left_um=expected.left_um,
        law_campaigns=expected.campaigns,
    )


def zero_scatter(
    separations: Sequence[ComponentSeparation], component: str, names: Sequence[str]
) -> tuple[float, float]:
    """Standard deviation (µm, µm/m) of the cold line of a component, over the named campaigns.

    A heated state is one line less the mean of c cold ones, so `1 / (c + 1)` of its variance is that of the zero. Zero
    where the separation states no standard errors.
    """
    intercept: list[float] = []
    slope: list[float] = []
    for s in separations:
        if s.component != component or s.campaign not in names or s.cold.all():
            continue
        share = 1.0 / (np.count_nonzero(s.cold) + 1.0)
        for found, se in ((intercept, s.intercept_se_um), (slope, s.slope_se_um_per_m)):
            known = se[~s.cold & np.isfinite(se)]
            if len(known):
                found.append(share * float(np.mean(known**2)))
    return float(np.sqrt(np.mean(intercept or [0.0]))), float(np.sqrt(np.mean(slope or [0.0])))


def without_expectation(points: RunPoints) -> RunPoints:
    """The same points where no expected error is known."""
    nan = np.full(len(points.value_um), np.nan)
    return replace(points, intercept_um=nan, slope_um_per_m=nan)


def facts(campaigns: Sequence[Campaign], separations: Sequence[ComponentSeparation]) -> RunFacts:
    """Conditions of one run: how long, how warm at the reference, and how far every sensor rose after it."""
    names = [campaign.name for campaign in campaigns]
    own = [s for s in separations if s.campaign in names]
    rises: dict[str, float] = {}
    starts, hours = [], 0.0
    for campaign in campaigns:
        zero = next(s.zero_t_s for s in own if s.campaign == campaign.name)
        last_s = max(float(s.t_s.max()) for s in own if s.campaign == campaign.name)
        table = campaign.temperatures
        start_degC = table.at(zero).mean(axis=0)
        during = table.value_degC[(table.t_s >= zero.min()) & (table.t_s <= last_s)]
        hours = max(hours, (last_s - float(zero.mean())) / 3600.0)
        starts.append(float(np.nanmean(start_degC)) if np.isfinite(start_degC).any() else float("nan"))
        for j, sensor in enumerate(table.sensor_ids):
            change_K = during[:, j] - start_degC[j]
            known = change_K[np.isfinite(change_K)]
            if len(known):
                largest = float(known[int(np.argmax(np.abs(known)))])
                if abs(largest) > abs(rises.get(sensor, 0.0)):
                    rises[sensor] = largest
    settings = campaigns[0].settings
    return RunFacts(
        campaigns=tuple(names),
        mode=settings.mode,
        tables=settings.active_tables,
        instrument=settings.instrument,
        hours=hours,
        heated_sweeps=len(
            {(s.campaign, int(k)) for s in own if s.axis for k, cold in zip(s.sweep, s.cold, strict=True) if not cold}
        ),
        start_degC=float(np.mean(starts)),
        rises_K=tuple(sorted(rises.items(), key=lambda item: -abs(item[1]))),
    )

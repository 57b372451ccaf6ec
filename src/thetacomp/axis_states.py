"""The states of one moving axis from all campaigns, side by side with their temperatures: what models are fitted on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from thetacomp.arrays import Bools, Floats, Ints
from thetacomp.campaign import Campaign, MachineFolder
from thetacomp.errors import AnalysisError
from thetacomp.model.filters import InputLayout
from thetacomp.separation.component import ComponentSeparation, mean_square_m2
from thetacomp.temperature.history_track import HistoryTrack, history_layout, history_track
from thetacomp.temperature.trajectory import Trajectory, concatenated, measured_trajectory

DRIFT = ""
LINE_POSITIONS = 31


@dataclass(frozen=True)
class Samples:
    """Thermal errors of one component that a model is judged by, n samples.

    Measured points where sweeps exist, the separated line over the travel where only parameters do, the displacement
    itself for drift. `state` is the row of AxisStates; `lever_m` the distance from P0; `noise_sd_um` the scatter of
    the instrument; `history` (n, k) the inputs that AxisStates.layout describes. `drift_um` is the drift of that moment
    where it was separated on its own (joint form), else zero; it is no part of `value_um`.
    """

    state: Ints
    lever_m: Floats
    value_um: Floats
    elapsed_h: Floats
    rise_K: Floats
    noise_sd_um: Floats
    history: Floats
    drift_um: Floats

    def take(self, rows: Ints | Bools) -> Samples:
        """Some of the samples; `state` still names the same states."""
        return Samples(**{field.name: getattr(self, field.name)[rows] for field in fields(self)})


@dataclass(frozen=True)
class AxisStates:
    """States of one moving axis (`DRIFT` for a fixed position), n rows, c components, p sensors.

    `intercept_um`, `slope_um_per_m` and `bend_um_per_m2` are (n, c): a component is `intercept + slope u + bend u²`
    with u = (p - P0) / 1000; the bend is zero for what stays a line. They are referred to the cold state of their
    campaign; `cold_*` (n, c) is what was subtracted. `rise_K` (n, p) counts from `reference_degC` (n, p). Missing
    values are NaN. `exact_zero` says that S = I = 0 holds exactly at the reference, as in separated sweeps; in drift
    and in parameters from elsewhere the cold state is a measurement like any other, and with a common datum there is no
    zero of the campaign's own. `history` (n, k) holds the inputs of the law since the reference, whose own running
    inputs are `reference_history` (n, running); `layout` describes them (None, and no columns, where no sensor was
    read in all campaigns). `trajectory` is what the machine went through between the states.
    """

    axis: str
    components: tuple[str, ...]
    sensors: tuple[str, ...]
    campaigns: tuple[str, ...]
    campaign: Ints
    t_s: Floats
    elapsed_h: Floats
    cold: Bools
    p0_mm: float
    p_min_mm: float
    p_max_mm: float
    exact_zero: bool
    rise_K: Floats
    reference_degC: Floats
    reference_s: Floats
    intercept_um: Floats
    slope_um_per_m: Floats
    bend_um_per_m2: Floats
    cold_intercept_um: Floats
    cold_slope_um_per_m: Floats
    history: Floats
    reference_history: Floats
    layout: InputLayout | None
    trajectory: Trajectory
    samples: tuple[Samples, ...]

    def __len__(self) -> int:
        return len(self.t_s)

    @property
    def is_drift(self) -> bool:
        """True for drift at a fixed position: there is no slope."""
        return self.axis == DRIFT

    @property
    def label(self) -> str:
        """How notes and messages name the axis."""
        return "drift" if self.is_drift else f"axis {self.axis}"

    @property
    def half_travel_m(self) -> float:
        """Largest distance from P0 over the measured positions in metres."""
        return max(self.p_max_mm - self.p0_mm, self.p0_mm - self.p_min_mm) / 1000.0

    @property
    def line_intercept_um(self) -> Floats:
        """Intercepts (n, c) of the best lines over the travel, for a law without bends.

        In the joint form intercepts are zero and stay so: the drift is a component of its own.
        """
        joint = ~np.any(self.intercept_um, axis=0)
        lift_um = self.bend_um_per_m2 * mean_square_m2(self.p0_mm, self.p_min_mm, self.p_max_mm)
        return np.where(joint, self.intercept_um, self.intercept_um + lift_um)

    def targets(self) -> Floats:
        """What a model with bends is fitted to, (n, powers * c): intercepts, slopes, and bends where there are any.

        `curve_um` puts their predictions together.
        """
        if self.is_drift:
            return self.intercept_um
        bends = [self.bend_um_per_m2] if np.any(np.nan_to_num(self.bend_um_per_m2)) else []
        return np.hstack([self.intercept_um, self.slope_um_per_m, *bends])

    def take(self, rows: Ints) -> AxisStates:
        """The same table with some of its rows, each once, and with their samples."""
        chosen: dict[str, Any] = {name: getattr(self, name)[rows] for name in _BY_ROW}
        row_of = np.full(len(self), -1)
        row_of[rows] = np.arange(len(chosen["t_s"]))
        samples = tuple(_renumbered(samples, row_of) for samples in self.samples)
        passed = self.trajectory.between_states(chosen["campaign"], chosen["t_s"])
        return replace(self, samples=samples, trajectory=passed, **chosen)


def curve_um(parameters: Floats, component: int, components: int, lever_m: Floats) -> Floats:
    """Error (n,) of one of c components from parameters (n, powers * c) in the order of `AxisStates.targets`."""
    powers = parameters.shape[1] // components
    terms = [parameters[:, power * components + component] * lever_m**power for power in range(powers)]
    return np.asarray(np.sum(terms, axis=0))


def _renumbered(samples: Samples, row_of: Ints) -> Samples:
    """The samples of the rows that are kept, `row_of` (rows,) naming their new row or -1."""
    kept = samples.take(row_of[samples.state] >= 0)
    return replace(kept, state=row_of[kept.state])


def axis_states(
    folder: MachineFolder, separations: Sequence[ComponentSeparation], campaigns: Sequence[str]
) -> tuple[AxisStates, ...]:
    """Collect the states of every moving axis over the named campaigns, drift last.

    A component counts where every campaign that measured its axis has it. Raises AnalysisError where no component is
    left.
    """
    chosen = [s for s in separations if s.campaign in set(campaigns)]
    axes = [axis.name for axis in folder.machine.axes]
    groups = [(name, [s for s in chosen if s.axis == name]) for name in axes]
    groups.append((DRIFT, [s for s in chosen if s.axis is None]))
    return tuple(_collect(folder, axis, members, campaigns) for axis, members in groups if members)


def _collect(
    folder: MachineFolder, axis: str, members: Sequence[ComponentSeparation], campaigns: Sequence[str]
) -> AxisStates:
    names = tuple(name for name in campaigns if any(s.campaign == name for s in members))
    components = tuple(
        component
        for component in dict.fromkeys(s.component for s in members)
        if all(any(s.campaign == name and s.component == component for s in members) for name in names)
    )
    if not components:
        raise AnalysisError(
            f"axis {axis}: no error component was measured in all of its campaigns ({', '.join(names)})."
            " Fix: choose the campaigns with --train and --test."
        )
    p0_mm = next(s.p0_mm for s in members if s.component == components[0])
    zero = _common_reference_degC(folder, axis, names, members)
    layout = history_layout([folder.campaign(name) for name in names])
    zero_history = None
    if zero is not None:
        first = next(s for s in members if s.campaign == names[0])
        zero_history = _track(folder.campaign(names[0]), layout, first.zero_t_s, None).reference
    parts = [
        _campaign_states(folder, name, index, axis, components, members, p0_mm, zero, layout, zero_history)
        for index, name in enumerate(names)
    ]
    return _stack(parts, names)


def _common_reference_degC(
    folder: MachineFolder, axis: str, names: Sequence[str], members: Sequence[ComponentSeparation]
) -> Floats | None:
    """With a common datum all campaigns count from one temperature: that of the first. Else None: each has its own."""
    settings = {name: folder.campaign(name).settings.datum for name in names}
    if len(set(settings.values())) > 1:
        listed = ", ".join(f"{name}: {datum}" for name, datum in settings.items())
        raise AnalysisError(
            f"axis {axis or 'drift'}: campaigns with different datum cannot be used together ({listed})."
            " Fix: state the same datum in their campaign.toml, or choose campaigns with --train and --test."
        )
    if settings[names[0]] == "campaign":
        return None
    first = next(s for s in members if s.campaign == names[0])
    return _zero_degC(folder.campaign(names[0]), folder.machine.sensor_ids, first)


def _zero_degC(campaign: Campaign, sensors: tuple[str, ...], s: ComponentSeparation) -> Floats:
    """Temperatures (sensors,) while the zero of the errors was measured: both zeros belong to the same moments."""
    return np.asarray(campaign.temperatures.padded(sensors).at(s.zero_t_s).mean(axis=0))


def _campaign_states(
    folder: MachineFolder,
    name: str,
    index: int,
    axis: str,
    components: tuple[str, ...],
    members: Sequence[ComponentSeparation],
    p0_mm: float,
    zero_degC: Floats | None,
    layout: InputLayout | None,
    zero_history: Floats | None,
) -> AxisStates:
    campaign, sensors = folder.campaign(name), folder.machine.sensor_ids
    own = [next(s for s in members if s.campaign == name and s.component == c) for c in components]
    states = np.unique(np.concatenate([s.sweep for s in own]))
    n, c = len(states), len(components)
    intercept, slope, bend, cold_intercept, cold_slope = (np.full((n, c), np.nan) for _ in range(5))
    t_s = np.full(n, np.nan)
    cold = np.zeros(n, dtype=bool)
    for k, s in enumerate(own):
        rows = np.searchsorted(states, s.sweep)
        shift_m = (p0_mm - s.p0_mm) / 1000.0
        own_bend = np.zeros(len(rows)) if s.bend_um_per_m2 is None else s.bend_um_per_m2
        intercept[rows, k] = s.intercept_um + s.slope_um_per_m * shift_m + own_bend * shift_m**2
        slope[rows, k] = s.slope_um_per_m + 2.0 * own_bend * shift_m
        bend[rows, k] = own_bend
        cold_intercept[rows, k] = s.cold_intercept_um + s.cold_slope_um_per_m * shift_m
        cold_slope[rows, k] = s.cold_slope_um_per_m
        t_s[rows] = s.t_s
        cold[rows] |= s.cold
    reference_s = float(own[0].zero_t_s.mean())
    reference = _zero_degC(campaign, sensors, own[0]) if zero_degC is None else zero_degC
    track = _track(campaign, layout, own[0].zero_t_s, zero_history)
    return AxisStates(
        axis=axis,
        components=components,
        sensors=sensors,
        campaigns=(name,),
        campaign=np.full(n, index),
        t_s=t_s,
        elapsed_h=(t_s - reference_s) / 3600.0,
        cold=cold,
        p0_mm=p0_mm,
        p_min_mm=min(s.p_min_mm for s in own),
        p_max_mm=max(s.p_max_mm for s in own),
        exact_zero=zero_degC is None and all(s.exact_zero for s in own),
        rise_K=campaign.temperatures.padded(sensors).at(t_s) - reference,
        reference_degC=np.tile(reference, (n, 1)),
        reference_s=np.full(n, reference_s),
        intercept_um=intercept,
        slope_um_per_m=slope,
        bend_um_per_m2=bend,
        cold_intercept_um=cold_intercept,
        cold_slope_um_per_m=cold_slope,
        history=track.at(t_s),
        reference_history=np.tile(track.reference, (n, 1)),
        layout=layout,
        trajectory=measured_trajectory(track, index, t_s),
        samples=tuple(_samples(campaign, sensors, s, states, reference, p0_mm, track) for s in own),
    )


def _stack(parts: Sequence[AxisStates], names: tuple[str, ...]) -> AxisStates:
    """One table from the tables of single campaigns."""
    starts = np.cumsum([0, *(len(part) for part in parts)])
    columns: dict[str, Any] = {name: np.concatenate([getattr(part, name) for part in parts]) for name in _BY_ROW}
    return replace(
        parts[0],
        campaigns=names,
        p_min_mm=min(part.p_min_mm for part in parts),
        p_max_mm=max(part.p_max_mm for part in parts),
        exact_zero=all(part.exact_zero for part in parts),
        trajectory=concatenated([part.trajectory for part in parts]),
        samples=tuple(
            _stack_samples([part.samples[c] for part in parts], starts) for c in range(len(parts[0].components))
        ),
        **columns,
    )


_BY_ROW = (
    "campaign",
    "t_s",
    "elapsed_h",
    "cold",
    "rise_K",
    "reference_degC",
    "reference_s",
    "intercept_um",
    "slope_um_per_m",
    "bend_um_per_m2",
    "cold_intercept_um",
    "cold_slope_um_per_m",
    "history",
    "reference_history",
)


def _track(
    campaign: Campaign, layout: InputLayout | None, zero_t_s: Floats, zero_history: Floats | None
) -> HistoryTrack:
    """History of a campaign; with a common datum it counts from the zero of the first campaign."""
    if layout is None:
        t_s = campaign.temperatures.t_s
        return HistoryTrack(None, t_s, np.zeros((len(t_s), 0)), np.zeros(0))
    track = history_track(campaign, layout, zero_t_s)
    return track if zero_history is None else replace(track, reference=zero_history)


def _samples(
    campaign: Campaign,
    sensors: tuple[str, ...],
    s: ComponentSeparation,
    states: Ints,
    reference: Floats,
    p0_mm: float,
    track: HistoryTrack,
) -> Samples:
    if s.points is not None:
        good = ~s.points.outlier
        state, t_s = np.searchsorted(states, s.points.sweep[good]), s.points.t_s[good]
        position, value = s.points.position_mm[good], s.points.thermal_um[good]
    elif s.axis is not None:
        grid = np.linspace(s.p_min_mm, s.p_max_mm, LINE_POSITIONS)
        state = np.repeat(np.searchsorted(states, s.sweep), len(grid))
        t_s = np.repeat(s.t_s, len(grid))
        position = np.tile(grid, len(s.t_s))
        value = np.concatenate([s.line_um(k, grid) for k in range(len(s.t_s))])
    else:
        state, t_s, value = np.searchsorted(states, s.sweep), s.t_s, s.intercept_um
        position = np.full(len(t_s), p0_mm)
    if s.points is not None and s.points.drift_um is not None:
        drift = s.points.drift_um[~s.points.outlier]
    else:
        drift = np.zeros(len(value))
    known = np.isfinite(value)
    drift = drift[known]
    state, t_s, position, value = state[known], t_s[known], position[known], value[known]
    noise = s.noise_sd_um if s.points is not None else 0.0
    return Samples(
        state=state,
        lever_m=(position - p0_mm) / 1000.0,
        value_um=value,
        elapsed_h=(t_s - s.zero_t_s.mean()) / 3600.0,
        rise_K=campaign.temperatures.padded(sensors).at(t_s) - reference,
        noise_sd_um=np.full(len(t_s), noise),
        history=track.at(t_s),
        drift_um=drift,
    )


def _stack_samples(parts: Sequence[Samples], starts: Ints) -> Samples:
    return Samples(
        state=np.concatenate([part.state + start for part, start in zip(parts, starts, strict=False)]),
        lever_m=np.concatenate([part.lever_m for part in parts]),
        value_um=np.concatenate([part.value_um for part in parts]),
        elapsed_h=np.concatenate([part.elapsed_h for part in parts]),
        rise_K=np.concatenate([part.rise_K for part in parts]),
        noise_sd_um=np.concatenate([part.noise_sd_um for part in parts]),
        history=np.concatenate([part.history for part in parts]),
        drift_um=np.concatenate([part.drift_um for part in parts]),
    )

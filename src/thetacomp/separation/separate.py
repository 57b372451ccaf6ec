"""From the measurements of a campaign to the separated parameters of every component."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np
from scipy import special

from thetacomp.arrays import CARTESIAN, Floats
from thetacomp.campaign import Campaign, MachineFolder, Parameters, SweepPoints
from thetacomp.cold_block import sweep_table
from thetacomp.errors import AnalysisError
from thetacomp.machine import Axis, Machine
from thetacomp.separation.axis_shares import AxisFit
from thetacomp.separation.component import ComponentSeparation, GeometryCurve, LinearityTest, Points
from thetacomp.separation.drift_outliers import gross_note, gross_readings, least_sd
from thetacomp.separation.reference import (
    drift_window,
    reference_time_s,
    refuse_reference_in_a_sweep,
)
from thetacomp.separation.sweep_fit import ComponentData, ShapeChange, SweepFit, fit_component, shape_change
from thetacomp.standards.instrument import Instrument

GRID_POINTS = 101
# The shape test requires strong evidence: with six components and eight states it is made often.
SHAPE_TEST_LEVEL = 0.01


def separate_folder(folder: MachineFolder) -> tuple[ComponentSeparation, ...]:
    """Separate every campaign of a folder, in the order of the folder."""
    return tuple(result for campaign in folder.campaigns for result in separate_campaign(folder.machine, campaign))


def separate_campaign(
    machine: Machine, campaign: Campaign, bent: Collection[str] = ()
) -> tuple[ComponentSeparation, ...]:
    """Separate all components of one campaign: from sweeps, from separated parameters, and the drift.

    `bent` names the components whose heated sweeps are parabolas instead of lines. Raises AnalysisError where an axis
    has too few points, or where the reference lies outside the measurements.
    """
    reference_s = reference_time_s(campaign)
    refuse_reference_in_a_sweep(campaign, reference_s)
    results: list[ComponentSeparation] = []
    if campaign.sweeps is not None:
        for axis in machine.axes:
            results += [fitted.separation for fitted in separate_axis(axis, campaign, reference_s, bent=bent)]
    if campaign.parameters is not None:
        results += _from_parameters(campaign, campaign.parameters, reference_s)
    if campaign.drift is not None:
        results += _from_drift(campaign, reference_s)
    return tuple(results)


def separate_axis(
    axis: Axis,
    campaign: Campaign,
    reference_s: float,
    letters: Sequence[str] = CARTESIAN,
    bent: Collection[str] = (),
) -> list[AxisFit]:
    """Separate all components of one axis on its own: the intercept holds the drift and the tilt of the other axes.

    `letters` names the columns of `error_um`; for angles it is A, B, C and the columns are µrad. `bent` as in
    `separate_campaign`. Empty where the axis was not swept. Raises AnalysisError where a sweep has too few points.
    """
    points = campaign.sweeps
    assert points is not None
    _refuse_what_cannot_be_separated(axis, campaign, points)
    rows = np.array([name == axis.name for name in points.axis], dtype=bool)
    if not rows.any():
        return []
    table = sweep_table(points)
    own = [number for number, name in zip(table.sweep, table.axis, strict=True) if name == axis.name]
    ends = dict(zip(table.sweep, table.end_s, strict=True))
    cold = np.array([ends[number] <= reference_s + 1.0 for number in own])
    notes: list[str] = []
    if not cold.any():
        # Better than refusing: the first sweep carries little heat; a note says what it means.
        cold[0] = True
        notes.append(
            f"no sweep of axis {axis.name} ended before the reference ({reference_s:.0f} s); its first sweep serves as"
            " the cold state, so heat before that sweep is not seen"
        )
    results = []
    for index, direction in enumerate(letters):
        is_angle = direction not in CARTESIAN
        usable = rows & np.isfinite(points.error_um[:, index])
        if not usable.any():
            continue
        number = {sweep: k for k, sweep in enumerate(own)}
        counts = np.array([np.count_nonzero(usable & (points.sweep == sweep)) for sweep in own])
        if counts.min() < 3:
            raise AnalysisError(
                f"campaign {campaign.name}: sweep {own[int(counts.argmin())]} of axis {axis.name} has"
                f" {counts.min()} points with {_column(direction)}; a line needs at least 3."
                " Fix: complete the sweep or remove it."
            )
        sweep_index = np.array([number[s] for s in points.sweep[usable]])
        data = ComponentData(
            position_mm=points.position_mm[usable],
            t_s=points.t_s[usable],
            direction=points.direction[usable],
            sweep=sweep_index,
            error_um=points.error_um[usable, index],
            middle_s=np.array([points.t_s[usable & (points.sweep == sweep)].mean() for sweep in own]),
            cold=cold,
            p0_mm=float(np.mean(axis.travel_mm)),
            # An angle error of the instrument tilts a line of displacements; it does not tilt a line of angles.
            angle_sd_urad=0.0 if is_angle else (campaign.settings.instrument_u_um_per_m or 0.0) / 2.0,
            weight=None if is_angle or points.noise_um is None else _weight(points.noise_um[usable, index]),
            tie=None if is_angle or points.tie_covariance is None else points.tie_covariance[own, index],
            bent=f"E{direction}{axis.name}" in bent,
        )
        if len(np.unique(data.position_mm)) < 3:
            raise AnalysisError(
                f"campaign {campaign.name}: axis {axis.name} was measured at fewer than 3 positions."
                " Fix: sweeps need targets spread over the travel."
            )
        results.append(_component(axis, campaign, direction, data, np.array(own), reference_s, notes))
    return results


def _weight(noise_um: Floats) -> Floats:
    """Weights with the mean 1 from the standard deviations of the points."""
    weight = 1.0 / noise_um**2
    return np.asarray(weight / weight.mean())


def _column(letter: str) -> str:
    return f"d{letter}_um" if letter in CARTESIAN else f"r{letter}_urad"


def _refuse_what_cannot_be_separated(axis: Axis, campaign: Campaign, points: SweepPoints) -> None:
    """A common datum and a change of station need ties between sweeps that a single axis does not give."""
    if campaign.settings.datum == "common":
        raise AnalysisError(
            f'campaign {campaign.name}: datum = "common" cannot be kept by sweeps, which are referred to their own cold'
            ' block. Fix: set datum = "campaign", or give drift.csv or parameters.csv.'
        )
    if points.station is not None and points.tie_covariance is None:
        used = dict.fromkeys(s for s, name in zip(points.station, points.axis, strict=True) if name == axis.name)
        if len(used) > 1:
            raise AnalysisError(
                f"campaign {campaign.name}: the sweeps of axis {axis.name} come from the stations {', '.join(used)};"
                " the step between two stations would be taken for heat. Fix: bring all points into one frame through"
                " the foundation targets and leave the column `station` out, or give each station a campaign."
            )


def _component(
    axis: Axis,
    campaign: Campaign,
    direction: str,
    data: ComponentData,
    own: np.ndarray,
    reference_s: float,
    notes: list[str],
) -> AxisFit:
    fit, linearity, bends = _fit(data)
    count = len(own)
    intercept, slope = np.zeros(count), np.zeros(count)
    intercept_se, slope_se = np.zeros(count), np.zeros(count)
    bend, bend_se = np.zeros(count), np.zeros(count)
    intercept[fit.states], slope[fit.states] = fit.intercept_um, fit.slope_um_per_m
    intercept_se[fit.states], slope_se[fit.states] = fit.intercept_se_um, fit.slope_se_um_per_m
    bend[fit.states], bend_se[fit.states] = fit.bend_um_per_m2, fit.bend_se_um_per_m2
    residual = data.error_um - fit.geometry_um - fit.line_um
    good = ~fit.outlier
    rms = [
        float(np.sqrt(np.mean(residual[good & (data.sweep == k)] ** 2))) if (good & (data.sweep == k)).any() else np.nan
        for k in range(count)
    ]
    curves = _geometry_curves(data, fit)
    own_notes = [*notes, *bends]
    settings = campaign.settings
    is_angle = direction not in CARTESIAN
    stated_um = Instrument.of(settings).reading_u_um(float(np.ptp(data.position_mm)))
    if not is_angle and stated_um is not None and fit.noise_sd_um > stated_um:
        own_notes.append(
            f"points scatter by {fit.noise_sd_um:.1f} µm (one standard deviation), more than twice what the stated"
            f" uncertainty of {stated_um:.3g} µm (expanded, at the far end of the travel) allows"
        )
    own_notes += _outlier_notes(data, fit)
    points = campaign.sweeps
    tied = points is not None and points.tie_covariance is not None
    if not is_angle and settings.instrument_u_um_per_m is None and not tied:
        own_notes.append(
            "instrument_u_um_per_m is not stated: the standard errors hold the scatter of the points only,"
            " not an angle error common to a sweep"
        )
    separation = ComponentSeparation(
        campaign=campaign.name,
        component=f"E{direction}{axis.name}",
        direction=direction,
        axis=axis.name,
        p0_mm=data.p0_mm,
        p_min_mm=float(data.position_mm.min()),
        p_max_mm=float(data.position_mm.max()),
        reference_s=reference_s,
        zero_t_s=data.t_s[data.cold[data.sweep]],
        sweep=own,
        t_s=data.middle_s,
        cold=data.cold,
        intercept_um=intercept,
        intercept_se_um=intercept_se,
        slope_um_per_m=slope,
        slope_se_um_per_m=slope_se,
        rms_um=np.array(rms),
        noise_sd_um=fit.noise_sd_um,
        dof=fit.dof,
        geometry_model=fit.curve.name,
        geometry=curves,
        points=Points(
            t_s=data.t_s,
            sweep=own[data.sweep],
            position_mm=data.position_mm,
            direction=data.direction,
            error_um=data.error_um,
            geometry_um=fit.geometry_um,
            line_um=fit.line_um,
            outlier=fit.outlier,
        ),
        linearity=linearity,
        reversal_um=_reversal_um(curves),
        notes=tuple(own_notes),
        bend_um_per_m2=bend if data.bent else None,
        bend_se_um_per_m2=bend_se if data.bent else None,
    )
    return AxisFit(data, fit, separation)


def _outlier_notes(data: ComponentData, fit: SweepFit) -> list[str]:
    """Sweeps that lose several points in a row: that is no single gross reading but something that moved."""
    notes = []
    for number in np.unique(data.sweep[fit.outlier]):
        own = np.flatnonzero(data.sweep == number)
        out = fit.outlier[own]
        if np.any(out[2:] & out[1:-1] & out[:-2]):
            notes.append(
                f"sweep at {data.middle_s[number] / 3600.0:.2f} h: {out.sum()} of {len(own)} points are left out as"
                " outliers, several of them in a row, as after a jump of the machine or of the instrument"
            )
    return notes


def _fit(data: ComponentData) -> tuple[SweepFit, LinearityTest | None, tuple[str, ...]]:
    """The fit over all sweeps and its test of shape. Where that fails, the geometry is that of the cold block alone.

    Else the mean change of shape in the heated sweeps would count as geometry, and every error before and after look
    too small.
    """
    fit = fit_component(data)
    if not len(fit.states):
        return fit, None, ()
    shape = shape_change(data, fit)
    linearity = _linearity(fit, shape)
    if linearity is None or linearity.holds:
        return fit, linearity, ()
    cold = replace(
        fit,
        geometry_coefficients=shape.geometry_coefficients,
        geometry_covariance=shape.geometry_covariance,
        geometry_um=shape.geometry_um,
    )
    what = "a parabola" if data.bent else "a line"
    note = (
        f"heat bends the curve by up to {linearity.cost_um:.0f} µm, which {what} cannot follow: the geometry is that of"
        " the cold block, and the bend counts as error before and after"
    )
    return cold, linearity, (note,)


def _geometry_curves(data: ComponentData, fit: SweepFit) -> tuple[GeometryCurve, ...]:
    grid = np.linspace(data.position_mm.min(), data.position_mm.max(), GRID_POINTS)
    basis = fit.curve.basis(grid)
    curves = []
    for k, direction in enumerate(fit.directions):
        part = slice(k * fit.curve.size, (k + 1) * fit.curve.size)
        variance = np.einsum("ij,jk,ik->i", basis, fit.geometry_covariance[part, part], basis)
        curves.append(
            GeometryCurve(direction, grid, basis @ fit.geometry_coefficients[part], np.sqrt(np.maximum(variance, 0.0)))
        )
    return tuple(curves)


def _reversal_um(curves: tuple[GeometryCurve, ...]) -> float | None:
    """Mean difference between the approaches, positive minus negative (ISO 230-2 calls its size reversal B)."""
    by_direction = {curve.direction: curve for curve in curves}
    if 1 not in by_direction or -1 not in by_direction:
        return None
    return float(np.mean(by_direction[1].value_um - by_direction[-1].value_um))


def _linearity(fit: SweepFit, shape: ShapeChange) -> LinearityTest | None:
    """F-test of a change of shape in the heated sweeps against the scatter of the points."""
    freedom = fit.dof - shape.terms
    if freedom < 5:
        return None
    statistic = max((fit.rss_um2 - shape.rss_um2) / shape.terms / (shape.rss_um2 / freedom), 0.0)
    p_value = float(special.fdtrc(shape.terms, freedom, statistic))
    worst = int(np.argmax(np.abs(shape.change_um)))
    return LinearityTest(
        f_statistic=float(statistic),
        p_value=p_value,
        cost_um=float(abs(shape.change_um[worst])),
        cost_se_um=float(shape.se_um[worst]),
        holds=p_value >= SHAPE_TEST_LEVEL,
    )


def _from_parameters(campaign: Campaign, table: Parameters, reference_s: float) -> list[ComponentSeparation]:
    results = []
    moments = np.unique(table.t_s)
    for component in dict.fromkeys(table.component):
        rows = np.array([name == component for name in table.component])
        rows = np.flatnonzero(rows)[np.argsort(table.t_s[rows], kind="stable")]
        t_s = table.t_s[rows]
        cold = t_s <= reference_s + 1.0
        is_drift = component[0] == "D"
        slope = np.zeros(len(rows)) if is_drift else table.slope_um_per_m[rows]
        p0_mm = np.zeros(len(rows)) if is_drift else table.p0_mm[rows]
        # One P0 for all rows of a component: changing it changes the intercept, never the line.
        intercept = table.intercept_um[rows] + slope * (p0_mm[0] - p0_mm) / 1000.0
        cold_intercept, cold_slope = _cold_value(intercept, cold), _cold_value(slope, cold)
        if campaign.settings.datum == "common":
            # The zero belongs to all campaigns together: nothing is referred to this campaign's cold state.
            cold_intercept = cold_slope = 0.0
        notes: tuple[str, ...] = ()
        if not np.isfinite([cold_intercept, cold_slope]).all():
            cold_intercept = cold_slope = 0.0
            notes = (
                f"{component} has no complete state at or before the reference; it is not referred to the cold state",
            )
        nan = np.full(len(rows), np.nan)
        results.append(
            ComponentSeparation(
                campaign=campaign.name,
                component=component,
                direction=component[1],
                axis=None if is_drift else component[2:],
                p0_mm=float(p0_mm[0]),
                p_min_mm=0.0 if is_drift else float(np.nanmin(table.p_min_mm[rows])),
                p_max_mm=0.0 if is_drift else float(np.nanmax(table.p_max_mm[rows])),
                reference_s=reference_s,
                zero_t_s=t_s[cold] if cold.any() else t_s[:1],
                sweep=np.searchsorted(moments, t_s),
                t_s=t_s,
                cold=cold,
                intercept_um=intercept - cold_intercept,
                intercept_se_um=nan,
                slope_um_per_m=slope - cold_slope,
                slope_se_um_per_m=nan,
                rms_um=nan,
                noise_sd_um=float("nan"),
                dof=float("nan"),
                cold_intercept_um=cold_intercept,
                cold_slope_um_per_m=cold_slope,
                notes=notes,
            )
        )
    return results


def _cold_value(values: Floats, cold: np.ndarray) -> float:
    good = cold & np.isfinite(values)
    return float(values[good].mean()) if good.any() else float("nan")


def _from_drift(campaign: Campaign, reference_s: float) -> list[ComponentSeparation]:
    drift = campaign.drift
    assert drift is not None
    results = []
    gross = gross_readings(drift.t_s, drift.error_um, drift.at_mm, least_sd(campaign))
    for index, direction in enumerate(CARTESIAN):
        good = np.isfinite(drift.error_um[:, index]) & ~gross[:, index]
        if not good.any():
            continue
        t_s, error = drift.t_s[good], drift.error_um[good, index]
        cold = drift_window(t_s, reference_s)
        # With a common datum the zero belongs to all campaigns together and must not be set again.
        zero = float(error[cold].mean()) if campaign.settings.datum == "campaign" else 0.0
        nan, zeros = np.full(len(t_s), np.nan), np.zeros(len(t_s))
        results.append(
            ComponentSeparation(
                campaign=campaign.name,
                component=f"D{direction}",
                direction=direction,
                axis=None,
                p0_mm=0.0,
                p_min_mm=0.0,
                p_max_mm=0.0,
                reference_s=reference_s,
                zero_t_s=t_s[cold],
                sweep=np.flatnonzero(good),
                t_s=t_s,
                cold=cold if campaign.settings.datum == "campaign" else np.zeros(len(t_s), dtype=bool),
                intercept_um=error - zero,
                intercept_se_um=nan,
                slope_um_per_m=zeros,
                slope_se_um_per_m=zeros,
                rms_um=nan,
                noise_sd_um=float("nan"),
                dof=float("nan"),
                cold_intercept_um=zero,
                notes=(gross_note(drift.t_s[gross[:, index]], "the readings beside them"),)
                if gross[:, index].any()
                else (),
            )
        )
    return results

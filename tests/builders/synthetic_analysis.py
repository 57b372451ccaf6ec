"""Builds complete, plausible `AnalysisResult` objects without any other part of the program.

The numbers come from known temperatures, geometry, slopes and intercepts with noise from a seeded generator; the
model is plain least squares on them and the validation leaves one campaign (or one state) out. They serve to draw
and to test the report, not to check the analysis.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from small_models import Part

from thetacomp.analysis_result import AnalysisResult
from thetacomp.arrays import Floats
from thetacomp.campaign import Campaign, CampaignSettings, CorrelationTable, Drift, MachineFolder
from thetacomp.machine import Axis, HeatSource, Machine, Sensor, SensorRole
from thetacomp.model.border import Border
from thetacomp.model.document import AxisLaw, Term
from thetacomp.model.filters import InputLayout
from thetacomp.model.format_1 import from_format_1
from thetacomp.model.leverage import regression_leverage
from thetacomp.model.temperatures import Duty, Temperatures
from thetacomp.sensors.key_points import AxisKeyPoints, StrategyDecision, StrategyTable
from thetacomp.separation.component import ComponentSeparation, GeometryCurve, LinearityTest, Points
from thetacomp.temperature.rises import LayoutCheck, SensorRise
from thetacomp.validation.outcome import AcceptanceCheck, HeldOutStates, PermutationTest, ValidationRow

HOUR_S = 3600.0

SENSORS: tuple[tuple[str, str, SensorRole, str | None], ...] = (
    ("theta_1", "outside of the ram at the front spindle bearing", "structure", "W"),
    ("theta_2", "oil scraper at the W axis oil film", "guide", "W"),
    ("theta_3", "slide surface (reference temperature)", "reference", None),
    ("theta_4", "oil scraper at the Y axis oil film", "guide", "Y"),
    ("theta_5", "Z axis feed screw nut (inside the ram near the boring spindle support bearing)", "drive", "Z"),
    ("theta_6", "column at the linear scale 1 of 5", "structure", "Y"),
    ("theta_7", "column at the linear scale 2 of 5", "structure", "Y"),
    ("theta_8", "column at the linear scale 3 of 5", "structure", "Y"),
    ("theta_9", "column at the linear scale 4 of 5", "structure", "Y"),
    ("theta_10", "column at the linear scale 5 of 5", "structure", "Y"),
    ("theta_11", "Y axis feed screw nut", "drive", "Y"),
    ("theta_12", "X axis feed gear end cover", "drive", "X"),
    ("theta_13", "W axis feed screw nut", "drive", "W"),
    ("theta_14", "hydraulic oil", "fluid", None),
    ("theta_15", "X feed motor bearing end cover", "drive", "X"),
)
KEY_OF_AXIS = {"X": "theta_15", "Y": "theta_11", "W": "theta_13"}
TRAVEL_MM = {"X": (0.0, 6000.0), "Y": (0.0, 3000.0), "W": (0.0, 1000.0)}
# Slope (µm/m per K) and intercept (µm per K) of every component: of the size of the published machine.
TRUTH = {
    "EXX": (6.0, -22.0), "EYX": (0.9, 1.0), "EZX": (-1.6, -14.0),
    "EXY": (13.0, 9.0), "EYY": (7.0, 21.0), "EZY": (-4.5, -30.0),
    "EXW": (3.0, -18.0), "EYW": (-6.0, 1.0), "EZW": (-11.0, 9.0),
}  # fmt: skip


def machine(name: str = "TK6920") -> Machine:
    """A floor-type boring and milling machine with fifteen sensors."""
    axes = [
        Axis(name="X", direction="+X", travel_mm=(0.0, 6000.0), feedback="scale", sensor="theta_15"),
        Axis(name="Y", direction="+Y", travel_mm=(0.0, 3000.0), feedback="scale", sensor="theta_11"),
        Axis(name="Z", direction="+Z", travel_mm=(0.0, 800.0), feedback="screw", sensor="theta_5"),
        Axis(name="W", direction="+Z", travel_mm=(0.0, 1000.0), feedback="screw", sensor="theta_13"),
    ]
    sensors = [Sensor(id=i, location=where, role=role, axis=axis) for i, where, role, axis in SENSORS]
    sources = (HeatSource(name="X feed motor", sensor="theta_15", axis="X"), HeatSource(name="spindle bearing"))
    return Machine(name=name, axes=tuple(axes), sensors=tuple(sensors), heat_sources=sources)


def temperatures(sensor_ids: Sequence[str], hours: float, step_s: float, seed: int, start_degC: float) -> Temperatures:
    """First-order warm-up from 0.7 h on, cool-down in the last fifth, every sensor with its own size and delay."""
    rng = np.random.default_rng(seed)
    sizes = np.random.default_rng(5)  # the machine is the same in every campaign
    t_s = np.arange(0.0, hours * HOUR_S + 1.0, step_s)
    value = np.empty((len(t_s), len(sensor_ids)))
    for j in range(len(sensor_ids)):
        rise_K, tau_h = sizes.uniform(4.0, 18.0), sizes.uniform(1.5, 5.0)
        t_h = t_s / HOUR_S
        warm = rise_K * (1.0 - np.exp(-np.clip(t_h - 0.7, 0.0, None) / tau_h))
        stop_h = 0.85 * hours
        fall = np.where(t_h > stop_h, np.exp(-(t_h - stop_h) / tau_h), 1.0)
        value[:, j] = start_degC + sizes.uniform(-0.4, 0.4) + warm * fall + rng.normal(0.0, 0.05, len(t_s))
    return Temperatures(t_s, tuple(sensor_ids), value)


def _states_s(hours: float, states: int) -> Floats:
    return np.concatenate([[0.3], np.linspace(1.2, hours - 0.3, states - 1)]) * HOUR_S if states > 1 else np.r_[1080.0]


def _rise(campaign: Campaign, sensor: str, t_s: Floats, reference_s: float) -> Floats:
    j = campaign.temperatures.sensor_ids.index(sensor)
    at = campaign.temperatures.at(np.append(t_s, reference_s))[:, j]
    return np.asarray(at[:-1] - at[-1])


def separation(
    campaign: Campaign, component: str, axis: str, key: str, t_s: Floats, rng: np.random.Generator, points: bool
) -> ComponentSeparation:
    """One component of a moving axis, with measured points and geometry where `points`."""
    p_min, p_max = TRAVEL_MM[axis]
    slope_per_K, intercept_per_K = TRUTH[f"E{component[1]}{axis}" if f"E{component[1]}{axis}" in TRUTH else component]
    rise = _rise(campaign, key, t_s, float(t_s[0]))
    span_m = (p_max - p_min) / 1000.0
    slope = slope_per_K * rise + rng.normal(0.0, 3.0 / span_m, len(t_s)) * (rise != 0)
    intercept = intercept_per_K * rise + rng.normal(0.0, 5.0, len(t_s)) * (rise != 0)
    nan = np.full(len(t_s), np.nan)
    base = ComponentSeparation(
        campaign=campaign.name, component=component, direction=component[1], axis=axis, p0_mm=p_min, p_min_mm=p_min,
        p_max_mm=p_max, reference_s=float(t_s[0]), zero_t_s=t_s[:1], sweep=np.arange(len(t_s)), t_s=t_s,
        cold=np.arange(len(t_s)) == 0, intercept_um=intercept, intercept_se_um=nan, slope_um_per_m=slope,
        slope_se_um_per_m=nan, rms_um=nan, noise_sd_um=float("nan"), dof=0.0,
    )  # fmt: skip
    if not points:
        return base
    grid = np.linspace(p_min, p_max, 41)

    def geometry(p: Floats, side: int) -> Floats:
        u = (p - p_min) / (p_max - p_min)
        return np.asarray(25.0 * np.sin(2.1 * u) - 12.0 * u**2 + 2.0 * np.sin(12 * np.pi * u) + 2.5 * side)

    station = np.linspace(p_min, p_max, 13)
    rows: list[list[float]] = []
    for k in range(len(t_s)):
        for side in (1, -1):
            for m, p in enumerate(station[::side]):
                line = intercept[k] + slope[k] * (p - p_min) / 1000.0
                rows.append([t_s[k] + (m - 6) * 20.0, k, p, side, line, float(geometry(np.array(p), side))])
    table = np.array(rows)
    noise = rng.normal(0.0, 2.5, len(table))
    outlier = rng.random(len(table)) < 0.01
    measured = Points(
        t_s=table[:, 0], sweep=table[:, 1].astype(np.int64), position_mm=table[:, 2],
        direction=table[:, 3].astype(np.int64), error_um=table[:, 4] + table[:, 5] + noise + 60.0 * outlier,
        geometry_um=table[:, 5], line_um=table[:, 4], outlier=outlier,
    )  # fmt: skip
    curves = tuple(
        GeometryCurve(side, grid, geometry(grid, side), np.full(41, 1.1) + np.abs(grid - grid.mean()) / p_max)
        for side in (1, -1)
    )
    holds = component != "EZW"
    return replace(
        base, intercept_se_um=np.full(len(t_s), 1.3), slope_se_um_per_m=np.full(len(t_s), 1.9 / span_m),
        rms_um=np.abs(rng.normal(2.5, 0.2, len(t_s))), noise_sd_um=2.5, dof=float(len(table) - 2 * len(t_s) - 8),
        geometry_model="polynomial, degree 6", geometry=curves, points=measured, reversal_um=5.0,
        linearity=LinearityTest(1.1 if holds else 6.3, 0.31 if holds else 1e-4, 2.1 if holds else 9.4, 1.4, holds),
    )  # fmt: skip


def _drift_separation(campaign: Campaign, component: str, column: int) -> ComponentSeparation:
    drift = campaign.drift
    assert drift is not None
    n = len(drift.t_s)
    zero, nan = np.zeros(n), np.full(n, np.nan)
    return ComponentSeparation(
        campaign=campaign.name, component=component, direction=component[1], axis=None, p0_mm=0.0, p_min_mm=0.0,
        p_max_mm=0.0, reference_s=0.0,
        zero_t_s=drift.t_s[:1], sweep=np.arange(n), t_s=drift.t_s, cold=np.arange(n) < 31,
        intercept_um=drift.error_um[:, column], intercept_se_um=nan, slope_um_per_m=zero, slope_se_um_per_m=nan,
        rms_um=nan, noise_sd_um=float("nan"), dof=0.0,
    )  # fmt: skip


def _term(x: Floats, y: Floats) -> Part:
    design = np.column_stack([np.ones(len(x)), x])
    coefficient = np.linalg.lstsq(design, y, rcond=None)[0]
    residual = y - design @ coefficient
    variance = float(residual @ residual / max(len(y) - 2, 1))
    inverse = np.linalg.pinv(design.T @ design)
    total = float(((y - y.mean()) ** 2).sum())
    return {
        "constant": float(coefficient[0]),
        "coefficients_per_K": (float(coefficient[1]),),
        "covariance": (variance * inverse).tolist(),
        "residual_sd": variance**0.5,
        "r_squared": 1.0 - float(residual @ residual) / total if total > 0 else 0.0,
    }


@dataclass(frozen=True)
class _Fit:
    component: Part
    worst_before_um: Floats
    worst_after_um: Floats


def _fit(name: str, parts: Sequence[ComponentSeparation], folder: MachineFolder, key: str) -> _Fit:
    rise = np.concatenate([_rise(folder.campaign(s.campaign), key, s.t_s, s.reference_s) for s in parts])
    intercept = np.concatenate([s.intercept_um for s in parts])
    slope = np.concatenate([s.slope_um_per_m for s in parts])
    first = parts[0]
    length_m = (first.p_max_mm - first.p0_mm) / 1000.0
    a, b = _term(rise, intercept), _term(rise, slope)
    da = intercept - a["constant"] - a["coefficients_per_K"][0] * rise
    db = slope - b["constant"] - b["coefficients_per_K"][0] * rise
    before = np.maximum(np.abs(intercept), np.abs(intercept + slope * length_m))
    after = np.maximum(np.abs(da), np.abs(da + db * length_m))
    start = folder.campaign(first.campaign).temperatures.at(np.r_[first.reference_s])
    j = folder.campaign(first.campaign).temperatures.sensor_ids.index(key)
    moving = first.axis is not None
    body = f"{a['constant']:+.1f} {a['coefficients_per_K'][0]:+.2f} ({key} - ref)"
    lever = f"({b['constant']:+.1f} {b['coefficients_per_K'][0]:+.2f} ({key} - ref)) (p - {first.p0_mm:g}) / 1000"
    component: Part = {
        "direction": first.direction, "axis": first.axis, "p0_mm": first.p0_mm if moving else None,
        "p_min_mm": first.p_min_mm if moving else None, "p_max_mm": first.p_max_mm if moving else None,
        "reference": {"campaign": first.campaign, "t_s": first.reference_s,
                      "temperature_degC": {key: float(start[0, j])}},
        "inputs": (key,), "intercept": a, "slope": b if moving else None, "residual_correlation": -0.3,
        "dof": max(len(rise) - 2, 1), "states": len(rise),
        "residual_um": (float(np.sqrt(np.mean(after**2))), float(after.max())),
        "held_out_um": [1.25 * float(v) for v in (np.sqrt(np.mean(after**2)), np.percentile(after, 95), after.max())],
        "equation": f"{name} = {lever + ' ' if moving else ''}{body}",
    }  # fmt: skip
    return _Fit(component, before, after)


def _rows(name: str, campaign: str, split: str, before: Floats, after: Floats) -> list[ValidationRow]:
    """Plausible rows: hold-out a little worse than in-sample, the baselines worse again."""
    rows = []
    for model, factor in (
        ("default", 1.25),
        ("one_sensor", 1.5),
        ("clock", 2.6),
        ("all_sensors", 4.0),
        ("nothing", None),
    ):
        left = before if factor is None else factor * after
        coverage = {"default": 93.1}.get(model, float("nan"))
        rows.append(
            ValidationRow(
                name, campaign, model, split, len(before), float(before.max()), float(left.max()),
                float(np.percentile(before, 95)), float(np.percentile(left, 95)),
                float(np.sqrt(np.mean(before**2))), float(np.sqrt(np.mean(left**2))),
                100.0 * (1.0 - float(left.max()) / max(float(before.max()), 1e-9)), coverage,
                float(np.sqrt(np.mean((left if factor is None else after) ** 2))),
            )
        )  # fmt: skip
    return rows


def _correlation(rows: dict[str, Floats], columns: dict[str, Floats]) -> CorrelationTable:
    def r(x: Floats, y: Floats) -> float:
        return float(np.corrcoef(x, y)[0, 1]) if len(x) > 2 and x.std() > 1e-12 and y.std() > 1e-12 else float("nan")

    value = np.array([[r(x, y) for y in columns.values()] for x in rows.values()]).reshape(len(rows), len(columns))
    return CorrelationTable(tuple(rows), tuple(columns), value)


def _key_points(axis: str, key: str, sensors: Sequence[str]) -> AxisKeyPoints:
    kept = sensors[:6] if key in sensors[:6] else (*sensors[:5], key)
    first = StrategyTable(
        "main factor", axis, "largest regret (-)",
        tuple(StrategyDecision(s, s in kept, 0.04 if s in kept else 0.31, "follows the heavy parameters" if s in kept
                      else "weak relation to EYY slope") for s in sensors),
    )  # fmt: skip
    second = StrategyTable(
        "mutual irrelevance", axis, "largest |r| to a kept sensor (-)",
        tuple(StrategyDecision(s, s == key, 0.0 if s == key else 0.97,
                      "sits on the drive of the moving axis" if s == key
                      else f"has the same information as {key}") for s in kept),
    )  # fmt: skip
    third = StrategyTable(
        "fewest sensors",
        axis,
        "held-out RMS (µm)",
        (StrategyDecision(key, True, 8.3, "a second sensor lowers the held-out RMS by less than one standard error"),),
    )
    return AxisKeyPoints(
        axis, "weighted regret", tuple(kept), (tuple(kept),), (key,), 0.91, (first, second, third),
        left_out=((f"EY{axis or 'X'} intercept", "R² not above shuffled states"),),
    )  # fmt: skip


def _assemble(
    folder: MachineFolder, parts: Sequence[ComponentSeparation], keys: dict[str, str], sign: str
) -> AnalysisResult:
    """Model, validation and the tables around the given separations."""
    components: dict[str, Part] = {}
    validation: list[ValidationRow] = []
    split = "campaign" if len({s.campaign for s in parts if s.component == parts[0].component}) > 1 else "state"
    for name in dict.fromkeys(s.component for s in parts):
        mine = [s for s in parts if s.component == name]
        fit = _fit(name, mine, folder, keys[mine[0].axis or ""])
        components[name] = fit.component
        edges = np.cumsum([len(s.t_s) for s in mine])[:-1]
        for s, before, after in zip(
            mine, np.split(fit.worst_before_um, edges), np.split(fit.worst_after_um, edges), strict=True
        ):
            validation += _rows(name, s.campaign, split, before, after)
            if name in ("EXY", "EZY"):
                validation += _rows(f"column_{name[1]}", s.campaign, split, before, after)
            if s is mine[-1] and len(mine) > 1:
                validation += _rows(name, "all", split, fit.worst_before_um, fit.worst_after_um)
                if name in ("EXY", "EZY"):
                    validation += _rows(f"column_{name[1]}", "all", split, fit.worst_before_um, fit.worst_after_um)
    inputs = tuple(dict.fromkeys(keys.values()))
    model = from_format_1(
        {
            "kind": "thetacomp model", "format": 1, "version": "0.0", "created": "2026-03-02T10:00:00Z",
            "machine": folder.machine.name, "axes": folder.machine.axes, "sign": sign, "method": "linear",
            "components": components,
            "training": {
                "campaigns": tuple(c.name for c in folder.campaigns), "mode": "no cooling",
                "instrument": "Leica AT901-B", "datum": "campaign",
                "range_degC": dict.fromkeys(inputs, (19.0, 31.5)), "range_rise_K": dict.fromkeys(inputs, (0.0, 12.0)),
            },
        }
    )  # fmt: skip
    states: dict[str, Floats] = {}
    columns: dict[str, Floats] = {}
    first = folder.campaigns[0]
    if all(set(first.temperatures.sensor_ids) == set(c.temperatures.sensor_ids) for c in folder.campaigns):
        mine = [s for s in parts if s.campaign == first.name]
        for s in mine:
            states[f"{s.component} intercept"] = s.intercept_um
            if s.axis is not None:
                states[f"{s.component} slope"] = s.slope_um_per_m
        at = first.temperatures.at(mine[0].t_s)
        columns = {sensor: at[:, j] for j, sensor in enumerate(first.temperatures.sensor_ids)}
    worst = max((r for r in validation if r.model == "default"), key=lambda r: r.max_after_um)
    acceptance = (
        AcceptanceCheck("held-out reduction of the largest error (%)", worst.reduction_percent, ">=", 50.0,
                        worst.reduction_percent >= 50.0, "the model halves the largest error at least"),
        AcceptanceCheck("held-out RMS against the clock (ratio)", 0.48, "<", 1.0, True, "beats the clock"),
        AcceptanceCheck("permutation p-value", 0.005, "<=", 0.05, True, "better than shuffled states"),
        AcceptanceCheck("coverage of the 95 % band (%)", 93.1, ">=", 90.0, True, "the stated band can be believed"),
    )  # fmt: skip
    held_out = tuple(
        HeldOutStates(s.component, s.campaign, s.t_s, np.abs(s.intercept_um), 0.2 * np.abs(s.intercept_um))
        for s in parts
    )
    return AnalysisResult(
        held_out=held_out,
        folder=folder, rises=_rises(folder), layout=_layout(folder.machine), separations=tuple(parts),
        parameter_correlations=_correlation(states, columns), sensor_correlations=_correlation(columns, columns),
        key_points=tuple(_key_points(a, k, folder.machine.sensor_ids) for a, k in keys.items()),
        model=model, paper_model=model.model_copy(update={"method": "paper"}), validation=tuple(validation),
        permutations=tuple(PermutationTest(a, 0.97, 0.21, 0.55, 0.005, 199) for a in keys),
        acceptance=acceptance, notes=("EYX intercept: one state left out as an outlier.",),
    )  # fmt: skip


def _rises(folder: MachineFolder) -> tuple[SensorRise, ...]:
    rows = []
    for campaign in folder.campaigns:
        t = campaign.temperatures
        for j, sensor in enumerate(t.sensor_ids):
            top = int(np.nanargmax(t.value_degC[:, j]))
            start, peak = float(t.value_degC[0, j]), float(t.value_degC[top, j])
            lag, source = (float("nan"), "") if j else (840.0, "X feed motor")
            remark = "" if source else "no heat source named"
            rows.append(
                SensorRise(
                    campaign.name, sensor, start, peak, float(t.t_s[top]), peak - start, 3.2, lag, source, remark
                )
            )
    return tuple(rows)


def _layout(machine: Machine) -> tuple[LayoutCheck, ...]:
    n, sources = len(machine.sensors), len(machine.heat_sources)
    return (
        LayoutCheck("more sensors than heat sources", n > sources, f"{n} sensors, {sources} heat sources"),
        LayoutCheck("one sensor near every heat source", sources == 0, "no sensor is named for: spindle bearing"),
        LayoutCheck("a reference away from heat", True, "theta_3 is marked as reference"),
    )


def sweeps_analysis(name: str = "TK6920", campaigns: Sequence[str] = ("2026-03-02", "2026-03-09"),
                    states: int = 9) -> AnalysisResult:  # fmt: skip
    """Three moving axes, fifteen sensors, measured points, geometry in both directions."""
    ids = tuple(s[0] for s in SENSORS)
    measured, parts = [], []
    hours = 8.5
    for c, label in enumerate(campaigns):
        temp = temperatures(ids, hours, 120.0, seed=20 + c, start_degC=19.5 + 1.5 * c)
        spindle = np.where((temp.t_s > 0.7 * HOUR_S) & (temp.t_s < 0.85 * hours * HOUR_S), 650.0, 0.0)
        measured.append(
            Campaign(
                label, CampaignSettings(instrument="Leica AT901-B"), temp, duty=Duty(temp.t_s, {"spindle_rpm": spindle})
            )
        )
        rng = np.random.default_rng(40 + c)
        for a, axis in enumerate(("X", "Y", "W")):
            t_s = _states_s(hours, states) + a * 720.0
            parts += [
                separation(measured[-1], f"E{d}{axis}", axis, KEY_OF_AXIS[axis], t_s, rng, points=True) for d in "XYZ"
            ]
    return _assemble(MachineFolder(machine(name), tuple(measured)), parts, KEY_OF_AXIS, "stated")


def parameters_analysis() -> AnalysisResult:
    """Published parameters only: a campaign for each axis with one temperature, correlations 18 x 14 with gaps."""
    measured, parts = [], []
    for c, (axis, key) in enumerate(KEY_OF_AXIS.items()):
        temp = temperatures((key,), 7.5, 1800.0, seed=60 + c, start_degC=19.0)
        measured.append(Campaign(axis, CampaignSettings(sign="unproven"), temp))
        t_s = _states_s(7.5, 8 if axis != "W" else 10)
        rng = np.random.default_rng(70 + c)
        parts += [separation(measured[-1], f"E{d}{axis}", axis, key, t_s, rng, points=False) for d in "XYZ"]
    analysis = _assemble(MachineFolder(machine(), tuple(measured)), parts, KEY_OF_AXIS, "unproven")
    rng = np.random.default_rng(80)
    sensors = tuple(s[0] for s in SENSORS if s[0] != "theta_12")
    rows = tuple(f"{c} {kind}" for c in TRUTH for kind in ("intercept", "slope"))
    value = np.round(np.clip(rng.normal(0.85, 0.2, (18, 14)) * rng.choice([-1.0, 1.0], (18, 1)), -1.0, 1.0), 2)
    value[2, 5] = np.nan
    square = np.round(np.clip(rng.normal(0.8, 0.15, (14, 14)), -1.0, 1.0), 2)
    square = (square + square.T) / 2.0
    np.fill_diagonal(square, 1.0)
    square[9, 3] = square[3, 9] = np.nan
    return replace(
        analysis, parameter_correlations=CorrelationTable(rows, sensors, value),
        sensor_correlations=CorrelationTable(sensors, sensors, square),
    )  # fmt: skip


def drift_analysis(rows: int = 11115, campaigns: int = 6) -> AnalysisResult:
    """A long recording of the tool at a fixed position, cut into campaigns; no axes are described."""
    ids = tuple(f"t{k}" for k in range(1, 17))
    spindle = Machine(name="spindle test bench", sensors=tuple(Sensor(id=i, role="structure") for i in ids))
    step_s, measured, parts = 15.0, [], []
    for c in range(campaigns):
        n = rows // campaigns
        temp = temperatures(ids, (n - 1) * step_s / HOUR_S, step_s, seed=90 + c, start_degC=24.0)
        rise = temp.value_degC - temp.value_degC[0]
        rng = np.random.default_rng(95 + c)
        error = np.column_stack([0.4 * rise[:, 2], 2.2 * rise[:, 4], 1.1 * rise[:, 4]])
        drift = Drift(temp.t_s, error + rng.normal(0.0, 0.4, error.shape))
        measured.append(Campaign(f"campaign {c + 1}", CampaignSettings(), temp, drift=drift))
        parts += [_drift_separation(measured[-1], f"D{d}", k) for k, d in enumerate("XYZ")]
    return _assemble(MachineFolder(spindle, tuple(measured)), parts, {"": "t5"}, "stated")


def chinese_analysis() -> AnalysisResult:
    """A machine with Chinese names."""
    analysis = sweeps_analysis(name="重型落地铣镗床 TK6920", campaigns=("第一次热机",))
    sensors = tuple(
        s.model_copy(update={"location": f"立柱光栅尺 {k}"}) for k, s in enumerate(analysis.folder.machine.sensors)
    )
    renamed = analysis.folder.machine.model_copy(update={"sensors": sensors})
    return replace(analysis, folder=replace(analysis.folder, machine=renamed))


def one_state_analysis() -> AnalysisResult:
    """One campaign with one state only: nothing can be fitted, every figure must still be drawn or left out."""
    return sweeps_analysis(campaigns=("2026-03-02",), states=1)


def nasty_names_analysis() -> AnalysisResult:
    """Names that would break HTML or SVG if they were not escaped."""
    return sweeps_analysis(name='<script>alert("x")</script> & Söhne', campaigns=('A < B & "C"',), states=4)


def no_key_point_analysis() -> AnalysisResult:
    """No sensor predicts what happens while Y moves: its components have no input and predict no error at all."""
    analysis = sweeps_analysis(states=5)
    law = analysis.model.control["Y"]
    blind = Term(coefficients=(), r_squared=-0.4)
    components = {
        name: component.model_copy(
            update={"terms": (blind, blind), "band": replace(component.band, sd=(30.0, 30.0)), "leverage": None,
                    "through_zero": True, "equation": f"{name} = (0) Y/1000 + (0)   [µm; Y in mm]"}
        )
        for name, component in law.components.items()
    }  # fmt: skip
    nothing = law.model_copy(
        update={"layout": InputLayout.plain(()), "reference": law.reference.model_copy(update={"inputs": ()}),
                "leverage": law.leverage.of_inputs(()), "border": Border(), "components": components}
    )  # fmt: skip
    points = tuple(replace(p, key_points=()) if p.axis == "Y" else p for p in analysis.key_points)
    control = {**analysis.model.control, "Y": nothing}
    return replace(analysis, model=analysis.model.model_copy(update={"control": control}), key_points=points)


def _two_inputs(law: AxisLaw, folder: MachineFolder, parts: Sequence[ComponentSeparation]) -> AxisLaw:
    """The law of an axis fitted again on its own input and theta_14, through zero."""
    inputs = (*law.layout.sensors, "theta_14")
    components, shapes = {}, []
    for name, component in law.components.items():
        own = [s for s in parts if s.component == name]
        columns = [[_rise(folder.campaign(s.campaign), i, s.t_s, s.reference_s) for s in own] for i in inputs]
        rise = np.column_stack([np.concatenate(column) for column in columns])
        targets = [np.concatenate([s.intercept_um for s in own])]
        targets += [np.concatenate([s.slope_um_per_m for s in own])] * (len(component.terms) > 1)
        inverse = np.linalg.inv(rise.T @ rise)
        terms, sds = [], []
        for y in targets:
            coefficient = inverse @ rise.T @ y
            residual = y - rise @ coefficient
            sds.append(float(residual @ residual / (len(y) - 2)) ** 0.5)
            r_squared = 1.0 - float(residual @ residual) / float(((y - y.mean()) ** 2).sum())
            terms.append(Term(coefficients=tuple(coefficient.tolist()), r_squared=r_squared))
        unscaled = np.zeros((3, 3))
        unscaled[1:, 1:] = inverse
        shapes.append(regression_leverage(unscaled))
        band = replace(component.band, sd=tuple(sds))
        components[name] = component.model_copy(
            update={"terms": tuple(terms), "band": band, "leverage": shapes[-1], "through_zero": True}
        )
    start = folder.campaign(law.reference.campaign).temperatures.at(np.r_[law.reference.t_s])[0]
    sensors = folder.campaign(law.reference.campaign).temperatures.sensor_ids
    reference = law.reference.model_copy(update={"inputs": tuple(float(start[sensors.index(i)]) for i in inputs)})
    border = Border(dict.fromkeys(inputs, (19.0, 31.5)), dict.fromkeys(inputs, (0.0, 12.0)))
    return law.model_copy(
        update={"layout": InputLayout.plain(inputs), "reference": reference, "leverage": shapes[0],
                "border": border, "components": components}
    )  # fmt: skip


def two_inputs_analysis() -> AnalysisResult:
    """A model with two inputs for every component, as the choice of sensors often ends."""
    analysis = sweeps_analysis()
    control = {
        axis: _two_inputs(law, analysis.folder, analysis.separations) for axis, law in analysis.model.control.items()
    }
    return replace(analysis, model=analysis.model.model_copy(update={"control": control}))


KINDS = {
    "sweeps": sweeps_analysis,
    "parameters": parameters_analysis,
    "drift": drift_analysis,
    "chinese": chinese_analysis,
    "one_state": one_state_analysis,
    "nasty_names": nasty_names_analysis,
    "no_key_point": no_key_point_analysis,
    "two_inputs": two_inputs_analysis,
}

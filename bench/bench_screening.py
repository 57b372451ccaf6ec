"""Fault injection: every sensor in turn, every kind of fault, on the real spindle recording and on synthetic machines.

Two compensations, each fitted on healthy campaigns other than the one under test: `key sensors`, a standardised ridge
on five sensors with the faulty one among them, and `heat history`, the averaged block ridge on all sensors. The error
from the begin of the fault to the end of the campaign, after repair, is divided by the error on the healthy table over
the same time. Where the screening calls the sensor lost, the fallback without it takes over, and the difference of the
two models at the switch decays as in model/fallback.py. `offline` screens the whole record; `live` uses the
verdicts sample by sample, from the first verdict on. Also: false alarms on healthy records, per month of 720 h, where
every finding counts, a spike too.

    python bench/bench_screening.py [--recording FILE.xlsx] [--machines 2] [--each 2] [--months 1] [--model history]
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from thermal_network import network, operate  # noqa: E402

from thetacomp.arrays import Floats  # noqa: E402
from thetacomp.fitting.ridge import HistoryRidge, history_candidates, rise_since  # noqa: E402
from thetacomp.model.fallback import DECAY_S  # noqa: E402
from thetacomp.model.filters import InputLayout, history_inputs  # noqa: E402
from thetacomp.model.temperatures import Temperatures  # noqa: E402
from thetacomp.screening import (  # noqa: E402
    Detector,
    ScreeningModel,
    fit_screening,
    screen,
    with_fault,
)

RECORDING = ROOT.parent / "shared" / "data" / "caiviac_fl_thermal" / "data.xlsx"
CUTS = (0, 1951, 3871, 5791, 7711, 9631, 11115)
TARGETS = (2, 4, 6)  # ch1, ch3, ch5
ALLOWED = 1.5
MODEL_SENSORS = 5
AIR_DEGC = 20.0
KINDS: tuple[tuple[str, str, float], ...] = (
    ("jump 2 K", "jump", 2.0),
    ("jump 5 K", "jump", 5.0),
    ("jump 31 K", "jump", 31.0),
    ("stuck", "stuck", 0.0),
    ("drift 0.5 K/h", "drift", 0.5),
    ("detached 2 K", "detached", 2.0),
    ("swapped", "swapped", 0.0),
    ("drop-out 1 h", "missing", 0.0),
    ("lost for good", "missing", np.inf),
)


@dataclass(frozen=True)
class Record:
    """A campaign with what was displaced, (n, targets) in µm, and the spindle speed (n,) where it is known."""

    temperatures: Temperatures
    displacement_um: Floats
    speed_rpm: Floats | None = None


@dataclass(frozen=True)
class KeySensors:
    """A linear model on some sensors: weights (sensors, targets)."""

    sensors: list[int]
    weights: Floats

    def predict(self, record: Record, value_degC: Floats, base: Floats) -> Floats:
        """Errors (n, targets); NaN where a sensor of the model is missing."""
        return (value_degC - base)[:, self.sensors] @ self.weights


@dataclass(frozen=True)
class History:
    """The heat-history model on the sensors of its layout."""

    layout: InputLayout
    ridge: HistoryRidge

    def predict(self, record: Record, value_degC: Floats, base: Floats) -> Floats:
        """Errors (n, targets); NaN where a sensor of the model is missing."""
        value = replace(record.temperatures, value_degC=value_degC).select(self.layout.sensors).value_degC
        inputs = history_inputs(self.layout, record.temperatures.t_s, value, record.speed_rpm)
        return self.ridge.predict(rise_since(inputs, inputs[0]))


Fitted = KeySensors | History


@dataclass(frozen=True)
class Case:
    kind: str
    above_limit: bool
    detected: bool
    named: bool
    delay_s: float
    fate: str
    offline: Floats
    live: Floats
    unrepaired: Floats


def ridge(records: Sequence[Record], sensors: Sequence[int]) -> Floats:
    """Weights (sensors, targets) of rises since the start of each campaign; ridge of 1 % of every input's power."""
    x = np.vstack([rises(r.temperatures.value_degC)[:, sensors] for r in records])
    y = np.vstack([rises(r.displacement_um) for r in records])
    size = np.sqrt(np.mean(x**2, axis=0))
    gram = (x / size).T @ (x / size) / len(x) + 0.01 * np.eye(len(sensors))
    return np.asarray(np.linalg.solve(gram, (x / size).T @ y / len(x)) / size[:, None])


def rises(x: Floats) -> Floats:
    return np.asarray(x - np.mean(x[:4], axis=0))


def chosen(records: Sequence[Record], first: int | None, banned: int | None) -> list[int]:
    """Greedy choice of five sensors on the training campaigns, `first` among them, `banned` not."""
    p = records[0].temperatures.value_degC.shape[1]
    thin = [Record(thinned(r.temperatures), r.displacement_um[::20]) for r in records]
    taken = [] if first is None else [first]
    y = np.vstack([rises(r.displacement_um) for r in thin])
    x = np.vstack([rises(r.temperatures.value_degC) for r in thin])
    while len(taken) < min(MODEL_SENSORS, p - 1):
        free = [k for k in range(p) if k not in taken and k != banned]
        left = [np.sum(((y - x[:, [*taken, k]] @ ridge(thin, [*taken, k])) / y.std(axis=0)) ** 2) for k in free]
        taken.append(free[int(np.argmin(left))])
    return taken


def thinned(t: Temperatures) -> Temperatures:
    return replace(t, t_s=t.t_s[::20], value_degC=t.value_degC[::20])


def rms(x: Floats) -> Floats:
    return np.asarray(np.sqrt(np.mean(x**2, axis=0)))


def live_values(model: ScreeningModel, table: Temperatures) -> Floats:
    detector = Detector(model)
    return np.array([detector.update(float(t), v).value_degC for t, v in zip(table.t_s, table.value_degC, strict=True)])


def compensated(record: Record, value: Floats, base: Floats, main: Fitted, spare: Fitted) -> Floats:
    """Errors (n, targets) of the main model, or of the one without the faulty sensor where that one is lost.

    At the switch the output goes on from where it was; the difference decays.
    """
    out = main.predict(record, value, base)
    lost = ~np.isfinite(out).all(axis=1)
    if not lost.any():
        return out
    instead = spare.predict(record, value, base)
    at = int(np.argmax(lost))
    carried = out[at - 1] - instead[at - 1] if at else np.zeros(out.shape[1])
    t_s = record.temperatures.t_s
    left = np.exp(-np.maximum(t_s - t_s[at], 0.0) / DECAY_S)
    return np.where(lost[:, None], instead + left[:, None] * carried, out)


def key_sensor_models(records: Sequence[Record], j: int) -> tuple[Fitted, Fitted]:
    """Five sensors with the faulty one among them, and five without it."""
    with_it, without = chosen(records, j, None), chosen(records, None, j)
    return KeySensors(with_it, ridge(records, with_it)), KeySensors(without, ridge(records, without))


def history_model(records: Sequence[Record], without: int | None) -> Fitted:
    """The heat-history model, or its fallback without one sensor, on every fourth sample of the training."""
    ids = records[0].temperatures.sensor_ids
    layout = InputLayout(
        sensors=tuple(name for k, name in enumerate(ids) if k != without),
        base_degC=20.0,
        speed_powers=(1, 2) if records[0].speed_rpm is not None else (),
    )
    x, y, campaign = [], [], []
    for number, record in enumerate(records):
        table = record.temperatures
        value = table.select(layout.sensors).value_degC
        inputs = history_inputs(layout, table.t_s, value, record.speed_rpm)
        x.append(rise_since(inputs, inputs[0])[::4])
        y.append(rises(record.displacement_um)[::4])
        campaign.append(np.full(len(y[-1]), number))
    fitted = HistoryRidge(layout.blocks, history_candidates(layout, 3))
    return History(layout, fitted.fit(np.vstack(x), np.vstack(y), np.concatenate(campaign)))


def inject(record: Record, j: int, kind: str, size: float, start_s: float, sign: float) -> tuple[Temperatures, float]:
    """The faulty table, and the difference of the two levels for a swap or the final deviation of a lost contact."""
    table = record.temperatures
    p = len(table.sensor_ids)
    sensor, partner = table.sensor_ids[j], table.sensor_ids[j + 1 if j + 1 < p else j - 1]
    at = int(np.searchsorted(table.t_s, start_s))
    apart = abs(float(np.diff(table.value_degC[max(at - 10, 0) : at, [j, j + 1 if j + 1 < p else j - 1]].mean(0))[0]))
    if kind == "detached":
        apart = min(size, 0.9 * abs(float(table.value_degC[at, j]) - AIR_DEGC))
    return (
        with_fault(
            table, sensor, kind, start_s,  # type: ignore[arg-type]
            air_degC=AIR_DEGC,
            size_K=sign * size if kind == "jump" else size,
            rate_K_per_h=sign * size,
            partner=partner,
            duration_s=3600.0 if kind == "missing" and size == 0.0 else np.inf,
        ),
        apart,
    )  # fmt: skip


def is_above(
    model: ScreeningModel, table: Temperatures, j: int, kind: str, size: float, apart: float, left_s: float
) -> bool:
    """Whether the case exceeds the stated detection limit of a machine in a transient."""
    limits = {limit.sensor: limit for limit in model.limits()}
    limit = limits[table.sensor_ids[j]]
    if kind == "jump":
        return size >= limit.jump_transient_K
    if kind == "drift":
        return size >= limit.drift_K_per_h and left_s >= limit.drift_within_s
    if kind == "detached":
        return apart >= limit.detached_transient_K
    if kind == "swapped":
        other = limits[table.sensor_ids[j + 1 if j + 1 < len(table.sensor_ids) else j - 1]]
        return apart >= max(limit.jump_transient_K, other.jump_transient_K)
    return True


def run(
    records: Sequence[Record], rounds: Sequence[int], seed: int, history: bool
) -> tuple[list[Case], float, int, float]:
    """All sensors and kinds on the campaigns `rounds`; hours of healthy record, alarms in it, and seconds it took."""
    rng = np.random.default_rng(seed)
    cases: list[Case] = []
    healthy_h, alarms = 0.0, 0
    begin = time.perf_counter()
    p = len(records[0].temperatures.sensor_ids)
    for c in rounds:
        rest = [r for i, r in enumerate(records) if i != c]
        model = fit_screening([r.temperatures for r in rest])
        record = records[c]
        table = record.temperatures
        found = screen(model, table).findings
        healthy_h += (table.t_s[-1] - table.t_s[0]) / 3600.0
        alarms += len(found)
        for f in found:
            print("  on the record as it is:", f)
        base = np.mean(table.value_degC[:4], axis=0)
        truth = rises(record.displacement_um)
        whole = history_model(rest, None) if history else None
        for j in range(p):
            main, spare = (whole, history_model(rest, j)) if whole is not None else key_sensor_models(rest, j)
            healthy = compensated(record, table.value_degC, base, main, spare)
            for label, kind, size in KINDS:
                start_s = float(table.t_s[-1] * rng.uniform(0.2, 0.5))
                faulty, apart = inject(record, j, kind, size, start_s, rng.choice([-1.0, 1.0]))
                result = screen(model, faulty)
                mine = [
                    f for f in result.findings
                    if table.sensor_ids[j] in (f.sensor, f.partner) and f.detected_s >= start_s and f.window_s > 0
                ]  # fmt: skip
                after = table.t_s >= start_s
                known = table.t_s >= (mine[0].detected_s if mine else start_s)
                usual = rms((truth - healthy)[after])
                usual_known = rms((truth - healthy)[known])
                mended = compensated(record, result.repaired.value_degC, base, main, spare)
                live = compensated(record, live_values(model, faulty), base, main, spare)
                raw = compensated(record, np.nan_to_num(faulty.value_degC), base, main, main)
                expected = {"drift": ("drift", "detached"), "detached": ("drift", "detached")}.get(kind, (kind,))
                cases.append(
                    Case(
                        label,
                        is_above(model, table, j, kind, size, apart, float(table.t_s[-1]) - start_s),
                        bool(mine),
                        bool(mine) and mine[0].kind in expected,
                        mine[0].detected_s - start_s if mine else np.inf,
                        mine[0].repair if mine else "not found",
                        rms((truth - mended)[after]) / usual,
                        rms((truth - live)[known]) / usual_known,
                        rms((truth - raw)[after]) / usual,
                    )
                )
                wrong = {f.sensor for f in result.findings if f.window_s > 0} - {f.sensor for f in mine} - {""}
                if cases[-1].above_limit and (cases[-1].offline.max() > ALLOWED or wrong):
                    names = [f"{f.sensor} {f.kind} {f.size_K:+.2f} {f.repair}" for f in result.findings]
                    print(f"  campaign {c}, {table.sensor_ids[j]}, {label} at {start_s / 3600:.1f} h:"
                          f" offline {cases[-1].offline.round(2)}; {names}")  # fmt: skip
    return cases, healthy_h, alarms, time.perf_counter() - begin


def show(title: str, cases: Sequence[Case]) -> None:
    print(f"\n{title}")
    print(
        f"{'kind':15s}{'cases':>6s}{'above':>6s}{'found':>6s}{'named':>6s}{'delay':>9s}"
        f"{'<=1.5 offline':>14s}{'<=1.5 live':>11s}{'unmended':>9s}{'worst':>7s}"
        f"{'lost':>5s}{'all <=1.5':>10s}"
    )
    for label in [*dict.fromkeys(c.kind for c in cases), "all"]:
        group = [c for c in cases if label in ("all", c.kind)]
        above = [c for c in group if c.above_limit]
        if not above:
            print(f"{label:15s}{len(group):6d}{0:6d}")
            continue
        delay = np.median([c.delay_s for c in above]) / 60.0
        share = {
            name: 100.0 * float(np.mean(np.concatenate([getattr(c, name) for c in above]) <= ALLOWED))
            for name in ("offline", "live", "unrepaired")
        }
        worst = max(float(c.offline.max()) for c in above)
        every = 100.0 * float(np.mean(np.concatenate([c.offline for c in group]) <= ALLOWED))
        print(
            f"{label:15s}{len(group):6d}{len(above):6d}"
            f"{sum(c.detected for c in above):6d}{sum(c.named for c in above):6d}"
            f"{delay:7.1f}min{share['offline']:13.1f}%{share['live']:10.1f}%{share['unrepaired']:8.1f}%{worst:7.2f}"
            f"{sum(c.fate == 'lost' for c in above):5d}{every:9.1f}%"
        )


def real_records(path: Path) -> list[Record]:
    import pandas as pd

    data = pd.read_excel(path, engine="calamine").to_numpy(float)
    ids = tuple(f"t{i}" for i in range(1, 17))
    return [
        Record(Temperatures(data[a:b, 0] - data[a, 0], ids, data[a:b, 7:]), data[a:b, list(TARGETS)], data[a:b, 1])
        for a, b in pairwise(CUTS)
    ]


def synthetic_records(seed: int, campaigns: int = 6) -> list[Record]:
    rng = np.random.default_rng(1000 + seed)
    machine = network(seed)
    made = [operate(machine, 10.0, rng, season_degC=rng.uniform(16.0, 26.0)) for _ in range(campaigns)]
    return [Record(t, d[:, None]) for t, d in made]


def false_alarms(seed: int, months: float) -> tuple[float, int]:
    """Alarms on healthy months of a synthetic machine, sampled each minute, in stretches of ten days."""
    machine = network(seed)
    rng = np.random.default_rng(2000 + seed)
    model = fit_screening([r.temperatures for r in synthetic_records(seed)])
    hours, alarms = 0.0, 0
    while hours < 720.0 * months:
        table, _ = operate(machine, 240.0, rng, step_s=60.0, season_degC=rng.uniform(16.0, 26.0))
        found = screen(model, table).findings
        for f in found:
            print("  false alarm:", f)
        hours, alarms = hours + 240.0, alarms + len(found)
    return hours, alarms


def main(arguments: Sequence[str] = ()) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--recording", type=Path, default=RECORDING)
    parser.add_argument("--machines", type=int, default=1, help="synthetic machines")
    parser.add_argument("--each", type=int, default=1, help="campaigns put under test, of every machine")
    parser.add_argument("--months", type=float, default=1.0, help="healthy months of every synthetic machine")
    parser.add_argument("--model", choices=("key", "history"), default="key", help="key sensors or heat history")
    options = parser.parse_args(arguments)
    history = options.model == "history"
    if options.recording.exists():
        records = real_records(options.recording)
        cases, hours, alarms, seconds = run(records, range(min(options.each, len(records))), 1, history)
        show(f"real recording ({seconds:.0f} s)", cases)
        print(f"healthy: {alarms} alarms in {hours:.1f} h")
    pooled: list[Case] = []
    for seed in range(1, options.machines + 1):
        cases, hours, alarms, seconds = run(synthetic_records(seed), range(options.each), seed, history)
        show(f"synthetic machine {seed} ({seconds:.0f} s)", cases)
        pooled += cases
        month_h, month_alarms = false_alarms(seed, options.months)
        print(f"healthy: {alarms} alarms in {hours:.1f} h of campaigns, {month_alarms} in {month_h / 720:.1f} months")
    if pooled:
        show("synthetic machines together", pooled)


if __name__ == "__main__":
    main(sys.argv[1:])

"""The spindle recording, held out by campaign: nothing, mean, least squares, ridge, heat history, hourly probes.

Run: python bench/run.py spindle, or python bench/bench_spindle.py PATH/data.xlsx
All settings are chosen inside the training campaigns by one procedure; the datum is never set anew. The error is
zero at the first row by definition (the datum was set there); no displacement of a held-out campaign is used, except
by the probes in the last line. bench/spindle_log.md lists every configuration whose held-out score was looked at.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from thetacomp.fitting.probe import fit_between_probes, follow_probes, probe_rows
from thetacomp.fitting.ridge import BlockUse, HistoryRidge, history_candidates
from thetacomp.model.filters import InputLayout, history_inputs

# first rows of the six campaigns, as the data's README cuts them
CAMPAIGN_ROWS = (0, 1951, 3871, 5791, 7711, 9631, 11115)
CHANNELS = ("ch1", "ch2", "ch3", "ch4", "ch5")
LOG = Path(__file__).with_name("spindle_log.md")
RECORDING = Path(__file__).parents[2] / "shared" / "data" / "caiviac_fl_thermal" / "data.xlsx"


@dataclass(frozen=True)
class Spindle:
    """The recording: t_s (n,), speed_rpm (n,), displacement_um (n, 5), temperature_degC (n, 16), campaign (n,)."""

    t_s: np.ndarray
    speed_rpm: np.ndarray
    displacement_um: np.ndarray
    temperature_degC: np.ndarray
    campaign: np.ndarray


def read_spindle(path: Path) -> Spindle:
    raw = pd.read_excel(path, engine="calamine").to_numpy(dtype=np.float64)
    campaign = np.repeat(np.arange(6), np.diff(CAMPAIGN_ROWS))
    return Spindle(raw[:, 0], raw[:, 1], raw[:, 2:7], raw[:, 7:], campaign)


def history_model(spindle: Spindle) -> tuple[np.ndarray, HistoryRidge]:
    """Inputs (n, inputs) since the datum, and the unfitted procedure."""
    sensors, start_degC = tuple(f"t{k}" for k in range(1, 17)), spindle.temperature_degC[0]
    layout = InputLayout(sensors=sensors, base_degC=float(np.median(start_degC)), products=("median",))
    inputs = history_inputs(layout, spindle.t_s, spindle.temperature_degC, spindle.speed_rpm)
    return layout.since(inputs, inputs[0]), HistoryRidge(layout.blocks, history_candidates(layout, 5))


def plain_ridge(spindle: Spindle) -> tuple[np.ndarray, HistoryRidge]:
    """Standardised ridge on the 16 temperatures, strength chosen by the same inner hold-out."""
    names = tuple(f"t{k}" for k in range(1, 17))
    rise_K = spindle.temperature_degC - spindle.temperature_degC[0]
    return rise_K, HistoryRidge({"temperature": names}, ((BlockUse("temperature", 1.0, "each"),),))


def least_squares(train: np.ndarray, y: np.ndarray, test: np.ndarray) -> np.ndarray:
    coef = np.linalg.lstsq(np.column_stack([np.ones(len(train)), train]), y, rcond=None)[0]
    return np.column_stack([np.ones(len(test)), test]) @ coef


def held_out(spindle: Spindle, predict: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> np.ndarray:
    """Prediction (n, 5) of every row by `predict(training rows, held-out rows)` without its campaign."""
    out = np.empty_like(spindle.displacement_um)
    for campaign in range(6):
        test = spindle.campaign == campaign
        out[test] = predict(~test, test)
    return out


def ridge_predictor(spindle: Spindle, x: np.ndarray, model: HistoryRidge) -> Callable[..., np.ndarray]:
    def predict(train: np.ndarray, test: np.ndarray) -> np.ndarray:
        return model.fit(x[train], spindle.displacement_um[train], spindle.campaign[train]).predict(x[test])

    return predict


def with_hourly_probes(spindle: Spindle, x: np.ndarray, model: HistoryRidge) -> np.ndarray:
    """Held-out prediction (n, 5) with a probe at every full hour; each campaign starts with the offset 0."""

    def predict(train: np.ndarray, test: np.ndarray) -> np.ndarray:
        y, groups, t_s = spindle.displacement_um, spindle.campaign, spindle.t_s
        hours = probe_rows(t_s[train], groups[train], 3600.0)
        out = fit_between_probes(model, x[train], y[train], groups[train], hours).predict(x[test])
        probes = probe_rows(t_s[test], groups[test], 3600.0)
        for k in range(out.shape[1]):
            out[:, k] = follow_probes(t_s[test], out[:, k], t_s[test][probes], y[test][probes, k])
        return out

    return held_out(spindle, predict)


def rmse_um(spindle: Spindle, predicted_um: np.ndarray) -> np.ndarray:
    """RMSE (6 campaigns + all rows, 5 channels) in µm."""
    square = (predicted_um - spindle.displacement_um) ** 2
    each = [square[spindle.campaign == campaign].mean(axis=0) for campaign in range(6)]
    return np.sqrt([*each, square.mean(axis=0)])


def scored_configurations() -> int:
    """Rows of the log's table of outer scores that carry a number."""
    return sum(line.startswith("| ") and line[2].isdigit() for line in LOG.read_text(encoding="utf-8").splitlines())


def main(path: Path = RECORDING) -> None:
    if not path.exists():
        print(f"\nSpindle recording: not run, {path.name} is not there")
        return
    spindle = read_spindle(path)
    y, theta, every = spindle.displacement_um, spindle.temperature_degC, np.ones(len(spindle.t_s), dtype=bool)
    begin = time.perf_counter()
    plain, history = plain_ridge(spindle), history_model(spindle)
    open_loop = held_out(spindle, ridge_predictor(spindle, *history))
    seconds = time.perf_counter() - begin
    rows = {
        "nothing": (np.zeros_like(y), np.zeros_like(y)),
        "training mean": (
            np.broadcast_to(y.mean(axis=0), y.shape),
            held_out(spindle, lambda train, test: np.tile(y[train].mean(axis=0), (test.sum(), 1))),
        ),
        "least squares, 16 temperatures": (
            least_squares(theta, y, theta),
            held_out(spindle, lambda train, test: least_squares(theta[train], y[train], theta[test])),
        ),
        "ridge, 16 temperatures": (
            ridge_predictor(spindle, *plain)(every, every),
            held_out(spindle, ridge_predictor(spindle, *plain)),
        ),
        "heat history": (ridge_predictor(spindle, *history)(every, every), open_loop),
        "heat history, hourly probes": (None, with_hourly_probes(spindle, *history)),
    }
    print(f"{'RMSE in µm':36}" + "".join(f"{name:>14}" for name in CHANNELS))
    print(f"{'(in-sample, held out)':36}" + f"{'in':>7}{'out':>7}" * len(CHANNELS))
    for name, (inside, outside) in rows.items():
        left = [f"{v:6.2f}" for v in rmse_um(spindle, inside)[6]] if inside is not None else ["     -"] * 5
        right = rmse_um(spindle, outside)[6]
        print(f"{name:36}" + "".join(f"{a:>7}{b:7.2f}" for a, b in zip(left, right, strict=True)))
    for name in ("heat history", "heat history, hourly probes"):
        print(f"\n{name}, held out, by campaign 1 to 6")
        for channel, values in zip(CHANNELS, rmse_um(spindle, rows[name][1]).T[:, :6], strict=True):
            print(f"{channel:10}" + "".join(f"{value:7.2f}" for value in values))
    print(f"\nnested hold-out of 5 channels: {seconds:.0f} s on one core")
    print(f"configurations scored by leaving one campaign out: {scored_configurations()}")
    print("compared on the way by scores of the same rows inside training campaigns: about 360 (bench/spindle_log.md)")


if __name__ == "__main__":
    main(Path(sys.argv[1]))

"""Prediction of a hundred thousand rows from models of 30 sensors: plain temperatures, and heat history with lags.

One axis with three components, 95 % bands and the border of validity, a week of temperatures by the minute.
"""

from __future__ import annotations

import statistics
import time
from dataclasses import dataclass

import numpy as np

from thetacomp.machine import Axis
from thetacomp.model.band import Band
from thetacomp.model.border import Border, Validity
from thetacomp.model.document import AxisLaw, Component, ModelDocument, Reference, Term, Training
from thetacomp.model.filters import InputLayout
from thetacomp.model.leverage import Leverage
from thetacomp.model.prediction import predict
from thetacomp.model.temperatures import Temperatures

SENSORS, ROWS, MINUTES, DIRECTIONS_KEPT, RUNS = tuple(f"theta_{i + 1}" for i in range(30)), 100_000, 10_080, 12, 5


@dataclass(frozen=True)
class Rows:
    t_s: np.ndarray
    axis: tuple[str, ...]
    position_mm: np.ndarray


def shape(rng: np.random.Generator, k: int) -> Leverage:
    vectors = np.linalg.qr(rng.normal(size=(k, DIRECTIONS_KEPT)))[0].T
    rows = tuple(map(tuple, vectors.tolist()))
    return Leverage((0.0,) * k, (3.0,) * k, rows, tuple(rng.uniform(0.1, 3.0, DIRECTIONS_KEPT).tolist()), 0.01)


def model_of(layout: InputLayout, rng: np.random.Generator) -> ModelDocument:
    k, p = sum(map(len, layout.blocks.values())), len(SENSORS)
    fades = bool(layout.time_constants_s)
    validity = Validity(shape(rng, k + p), (0.0,) * (k + p), (15.0,) * (k + p), 3.0, 1.0, 1.5, 0.9, 9, "")
    box = Border(dict.fromkeys(SENSORS, (15.0, 35.0)), dict.fromkeys(SENSORS, (-1.0, 15.0)))

    def term() -> Term:
        beyond = tuple(rng.normal(0, 0.1, p).tolist()) if fades else None
        return Term(coefficients=tuple(rng.normal(0, 0.3, k).tolist()), beyond=beyond)

    components = {
        f"E{d}Y": Component(direction=d, terms=(term(), term()), band=Band(2.0, (3.0, 1.0)), residual_um=(2.0, 5.0))
        for d in ("X", "Y", "Z")
    }
    law = AxisLaw(
        axis="Y", p0_mm=1000.0, p_min_mm=0.0, p_max_mm=2000.0, layout=layout, leverage=shape(rng, k),
        reference=Reference(campaign="a", t_s=0.0, inputs=(20.0,) * p + (0.0,) * (k - p)),
        border=Border(distance=validity) if fades else box, components=components,
    )  # fmt: skip
    room = {"prediction": {"Y": law}} if fades else {}
    return ModelDocument(
        version="0", created="", machine="bench", axes=(Axis(name="Y", direction="+Y", travel_mm=(0.0, 2000.0)),),
        sign="stated", method="", control={} if fades else {"Y": law}, **room,
        training=Training(campaigns=("a",), mode="", instrument="", datum="campaign"),
    )  # fmt: skip


def main() -> None:
    rng = np.random.default_rng(1)
    t_s = 60.0 * np.arange(MINUTES)
    warm = 20.0 + 4.0 * np.sin(2 * np.pi * t_s[:, None] / 86400.0 + rng.uniform(0, 6, len(SENSORS)))
    heat = Temperatures(t_s, SENSORS, warm + rng.normal(0, 0.02, warm.shape))
    rows = Rows(np.sort(rng.uniform(0, t_s[-1], ROWS)), ("Y",) * ROWS, rng.uniform(0, 2000, ROWS))
    print(f"\nprediction of {ROWS} rows, {len(SENSORS)} sensors, {MINUTES} samples  ({RUNS} runs)")
    for name, layout in (
        ("plain temperatures", InputLayout.plain(SENSORS)),
        ("heat history, 7 lags", InputLayout(sensors=SENSORS, speed_powers=(), base_degC=20.0)),
    ):
        model, seconds = model_of(layout, rng), []
        for _ in range(RUNS):
            begin = time.process_time()
            predict(model, heat, rows)
            seconds.append(time.process_time() - begin)
        inputs = sum(map(len, layout.blocks.values()))
        print(f"  {name:22} {inputs:4} inputs  {statistics.median(seconds):6.2f} s (best {min(seconds):.2f} s)")


if __name__ == "__main__":
    main()

"""The spindle recording held out by campaign: the figures that stand in the documents, with a small margin.

Expected values were measured with bench/bench_spindle.py; bench/spindle_log.md counts every configuration scored.
"""

from __future__ import annotations

import importlib.util
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]
DATA = ROOT.parent / "shared" / "data" / "caiviac_fl_thermal" / "data.xlsx"
pytestmark = pytest.mark.shared_data("caiviac_fl_thermal/data.xlsx")


@pytest.fixture(scope="module")
def bench():
    spec = importlib.util.spec_from_file_location("bench_spindle", ROOT / "bench" / "bench_spindle.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["bench_spindle"] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def spindle(bench):
    return bench.read_spindle(DATA)


def rms_um(bench, spindle, predicted_um):
    return dict(zip(bench.CHANNELS, bench.rmse_um(spindle, predicted_um)[6], strict=True))


def test_least_squares_falls_apart_as_published(bench, spindle):
    theta, y = spindle.temperature_degC, spindle.displacement_um
    found = rms_um(
        bench,
        spindle,
        bench.held_out(spindle, lambda train, test: bench.least_squares(theta[train], y[train], theta[test])),
    )
    # README of the data: 6.9, 6.5, 6.3, 5.9, 6.8 µm
    assert {name: round(float(value), 1) for name, value in found.items()} == pytest.approx(
        {"ch1": 6.9, "ch2": 6.5, "ch3": 6.3, "ch4": 5.9, "ch5": 6.8}, abs=0.051
    )


def test_open_loop(bench, spindle):
    found = rms_um(
        bench, spindle, bench.held_out(spindle, bench.ridge_predictor(spindle, *bench.history_model(spindle)))
    )
    # measured: 1.52, 1.62, 3.22, 3.13, 2.32 µm
    assert found["ch1"] < 1.6
    assert found["ch2"] < 1.7
    assert found["ch3"] < 3.3
    assert found["ch4"] < 3.3
    assert found["ch5"] < 2.5


def test_hourly_probes(bench, spindle):
    found = rms_um(bench, spindle, bench.with_hourly_probes(spindle, *bench.history_model(spindle)))
    # measured: 0.77, 0.87, 1.16, 1.16, 1.69 µm
    assert found["ch1"] < 0.85
    assert found["ch2"] < 0.95
    assert found["ch3"] < 1.25
    assert found["ch4"] < 1.25
    assert found["ch5"] < 1.8


@pytest.mark.parametrize("campaign", [0, 3])
def test_poisoned_displacements_of_the_held_out_campaign_change_nothing(bench, spindle, campaign):
    x, model = bench.history_model(spindle)
    test = spindle.campaign == campaign
    clean_um = bench.ridge_predictor(spindle, x, model)(~test, test)
    poisoned = replace(spindle, displacement_um=np.where(test[:, None], 1e6, spindle.displacement_um))
    np.testing.assert_array_equal(bench.ridge_predictor(poisoned, x, model)(~test, test), clean_um)

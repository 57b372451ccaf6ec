"""Regression, axis models and the stored document."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from sklearn.base import clone
from sklearn.linear_model import LinearRegression
from sklearn.model_selection import GridSearchCV, cross_val_score
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from small_models import component, document, term

from thetacomp.errors import ModelFileError
from thetacomp.fitting.estimator import Regressor
from thetacomp.fitting.linear import ThermalRegression
from thetacomp.model.load import load_model


def _data(seed: int = 0, n: int = 30, p: int = 3, m: int = 2) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    X = rng.normal(5, 2, (n, p))
    return X, 7.0 + X @ rng.normal(0, 3, (p, m)) + rng.normal(0, 0.5, (n, m))


def test_agrees_with_scikit_learn() -> None:
    X, y = _data()
    ours, theirs = ThermalRegression().fit(X, y), LinearRegression().fit(X, y)
    assert ours.coef_ == pytest.approx(theirs.coef_)
    assert ours.intercept_ == pytest.approx(theirs.intercept_)
    assert ours.predict(X) == pytest.approx(theirs.predict(X))
    assert ours.score(X, y) == pytest.approx(theirs.score(X, y))


def test_covariance_is_the_textbook_one() -> None:
    """Closed form: sigma² (A'A)^-1 with A = [1, X]."""
    X, y = _data(m=1)
    fit = ThermalRegression().fit(X, y[:, 0])
    A = np.column_stack([np.ones(len(X)), X])
    residual = y[:, 0] - A @ np.linalg.lstsq(A, y[:, 0], rcond=None)[0]
    expected = residual @ residual / (len(X) - 4) * np.linalg.inv(A.T @ A)
    assert fit.residual_covariance_[0, 0] * fit.unscaled_covariance_ == pytest.approx(expected, rel=1e-9)
    assert fit.dof_ == 26
    assert fit.leverage(X).sum() == pytest.approx(4.0)


def test_is_a_scikit_learn_estimator() -> None:
    X, y = _data(m=1)
    fit = clone(ThermalRegression()).fit(X, y[:, 0])
    assert fit.predict(X).shape == (30,)
    with pytest.raises(ValueError, match="features"):
        fit.predict(X[:, :2])


def test_a_regression_through_zero_is_the_textbook_one() -> None:
    """No column of ones: sigma² (X'X)^-1 with one degree of freedom more, and R² still against the mean."""
    X, y = _data()
    fit = ThermalRegression(fit_intercept=False).fit(X, y)
    beta = np.linalg.lstsq(X, y, rcond=None)[0]
    residual = y - X @ beta
    assert fit.coef_ == pytest.approx(beta.T)
    assert fit.intercept_ == pytest.approx([0.0, 0.0])
    assert (fit.dof_, fit.states_) == (27, 30)
    assert fit.residual_covariance_ == pytest.approx(residual.T @ residual / 27)
    assert fit.unscaled_covariance_[1:, 1:] == pytest.approx(np.linalg.inv(X.T @ X))
    assert fit.leverage(X) == pytest.approx(np.einsum("ij,jk,ik->i", X, np.linalg.inv(X.T @ X), X))
    spread = np.sum((y - y.mean(axis=0)) ** 2, axis=0)
    assert fit.r_squared_ == pytest.approx(1.0 - np.sum(residual**2, axis=0) / spread)
    free = ThermalRegression().fit(X, y)
    assert free.r_squared_ == pytest.approx(1.0 - np.sum((y - free.predict(X)) ** 2, axis=0) / spread)


def test_a_target_that_never_moves_has_no_share_explained() -> None:
    X, _ = _data()
    still = ThermalRegression().fit(X, np.column_stack([np.full(30, 4.0), X[:, 0]]))
    assert still.r_squared_ == pytest.approx([0.0, 1.0])
    assert still.score(X, np.full((30, 2), 4.0)) < 0.0  # no spread to explain, and the second column is missed


def test_an_estimator_without_a_rule_does_not_predict() -> None:
    with pytest.raises(TypeError, match="Regressor does not predict"):
        Regressor().predict(np.ones((1, 1)))
    assert not Regressor().__sklearn_is_fitted__()


def test_too_few_states_are_refused() -> None:
    X, y = _data(n=4)
    with pytest.raises(ValueError, match="4 states cannot determine 4 unknowns"):
        ThermalRegression().fit(X, y)


def test_collinear_inputs_share_the_effect() -> None:
    X, y = _data(p=1)
    fit = ThermalRegression().fit(np.column_stack([X, X]), y)
    assert fit.coef_[:, 0] == pytest.approx(fit.coef_[:, 1])
    assert fit.dof_ == 28


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("{", "not readable as JSON"),
        ("[1]", "not a thetacomp model"),
        ('{"kind": "thetacomp model", "format": 9}', "model format 9"),
        ('{"kind": "thetacomp model", "format": 1}', "do not edit model files by hand"),
    ],
)
def test_damaged_model_files_get_one_message(tmp_path: Path, content: str, words: str) -> None:
    path = tmp_path / "model.json"
    path.write_text(content, encoding="utf-8")
    with pytest.raises(ModelFileError, match=words):
        load_model(path)


def test_missing_model_file(tmp_path: Path) -> None:
    with pytest.raises(ModelFileError, match="there is no such file"):
        load_model(tmp_path / "model.json")


def test_a_model_saved_again_by_windows_notepad_is_read_and_nonsense_is_not(tmp_path: Path) -> None:
    small = document({}, {"DX": component("DX", term(0.0, 1.0), None, {"t1": 20.0})}, {"t1": (0.0, 5.0)})
    path = tmp_path / "model.json"
    path.write_text(small.to_json(), encoding="utf-8-sig")
    assert load_model(path) == small
    raw = json.loads(small.to_json())
    raw["control"][""]["components"]["DX"]["dof"] = -3
    path.write_text(json.dumps(raw), encoding="utf-8")
    with pytest.raises(ModelFileError, match=r"control\.\.components\.DX\.dof"):
        load_model(path)


def test_unknown_keys_of_a_model_are_refused(tmp_path: Path) -> None:
    small = document({}, {"DX": component("DX", term(0.0, 1.0), None, {"t1": 20.0})}, {"t1": (0.0, 5.0)})
    raw = json.loads(small.to_json())
    path = tmp_path / "model.json"
    path.write_text(json.dumps({**raw, "surprise": 1}), encoding="utf-8")
    with pytest.raises(ModelFileError, match="surprise"):
        load_model(path)
    path.write_text(json.dumps(raw), encoding="utf-8")
    assert load_model(path) == small


def test_scikit_learn_accepts_the_estimator() -> None:
    """Model selection and pipelines of scikit-learn use it like their own; the scores are those of LinearRegression."""
    X, y = _data(n=40, m=1)
    ours = cross_val_score(make_pipeline(StandardScaler(), ThermalRegression()), X, y[:, 0], cv=4)
    theirs = cross_val_score(make_pipeline(StandardScaler(), LinearRegression()), X, y[:, 0], cv=4)
    assert ours == pytest.approx(theirs)
    search = GridSearchCV(ThermalRegression(), {"fit_intercept": [True, False]}, cv=4).fit(X, y[:, 0])
    assert search.best_params_ == {"fit_intercept": True}
    with pytest.raises(ValueError, match="has no parameter 'intercept'"):
        ThermalRegression().set_params(intercept=True)
    with pytest.raises(ValueError, match="not fitted yet"):
        ThermalRegression().predict(X)
    with pytest.raises(ValueError, match="missing or infinite"):
        ThermalRegression().fit(np.full((5, 1), np.nan), np.zeros(5))


def test_an_analysis_loads_neither_scikit_learn_nor_pandas() -> None:
    code = "import sys, thetacomp.analysis, thetacomp.reading, thetacomp.report; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert not {"sklearn", "pandas", "numba"} & set(loaded)

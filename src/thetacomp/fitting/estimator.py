"""scikit-learn's estimator interface without importing scikit-learn, whose import costs more than a whole fit."""

from __future__ import annotations

import inspect
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from thetacomp.arrays import Floats


class Regressor:
    """Parameters, score and tags of a regressor; subclasses bring `fit` and `predict`.

    `clone`, pipelines and model selection of scikit-learn accept it: they ask for `get_params`, `set_params` and
    `__sklearn_tags__` alone.
    """

    _estimator_type = "regressor"

    def get_params(self, deep: bool = True) -> dict[str, Any]:
        """Arguments of the constructor by name."""
        names = [name for name in inspect.signature(type(self).__init__).parameters if name != "self"]
        return {name: getattr(self, name) for name in names}

    def set_params(self, **params: Any) -> Self:
        """Set arguments of the constructor; ValueError for a name that it does not have."""
        for name, value in params.items():
            if name not in self.get_params():
                raise ValueError(
                    f"{type(self).__name__} has no parameter {name!r}, only {', '.join(self.get_params())}"
                )
            setattr(self, name, value)
        return self

    def predict(self, X: ArrayLike) -> Floats:
        """Predicted targets, (n,) or (n, m)."""
        raise TypeError(f"{type(self).__name__} does not predict")

    def score(self, X: ArrayLike, y: ArrayLike) -> float:
        """R² on (X, y), the mean over the targets."""
        target = np.asarray(y, dtype=float).reshape(len(np.asarray(y)), -1)
        left = np.sum((target - self.predict(X).reshape(target.shape)) ** 2, axis=0)
        spread = np.sum((target - target.mean(axis=0)) ** 2, axis=0)
        return float(np.mean(1.0 - left / np.where(spread > 0, spread, 1.0)))

    def __sklearn_is_fitted__(self) -> bool:
        """True after `fit`."""
        return hasattr(self, "coef_")

    def __sklearn_tags__(self) -> Any:
        """Capabilities that scikit-learn asks for; called by scikit-learn alone, which is loaded then."""
        from sklearn.utils import InputTags, RegressorTags, Tags, TargetTags

        return Tags(
            estimator_type="regressor",
            target_tags=TargetTags(required=True, multi_output=True),
            regressor_tags=RegressorTags(),
            input_tags=InputTags(),
        )

    def _checked_inputs(self, X: ArrayLike, features: int | None = None) -> Floats:
        """X as floats (n, features). Raises ValueError where it is not two-dimensional, empty, finite or as wide."""
        inputs = np.asarray(X, dtype=float)
        if inputs.ndim != 2 or not len(inputs):
            raise ValueError(f"X must be two-dimensional with at least one row, found shape {inputs.shape}")
        if features is not None and inputs.shape[1] != features:
            raise ValueError(f"X has {inputs.shape[1]} features, but {type(self).__name__} was fitted with {features}")
        if not np.isfinite(inputs).all():
            raise ValueError("X holds missing or infinite values")
        return inputs

    def _require_fit(self) -> None:
        if not self.__sklearn_is_fitted__():
            raise ValueError(f"this {type(self).__name__} is not fitted yet: call `fit` first")

"""Changing the model while the machine runs: the fallback for lost sensors, and a switch without a bump.

At the switch the difference of the two models is kept as an offset, so the output goes on from where it was. The
offset decays slowly, or stays until a probe measures the error anew. Time is an argument.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass

from thetacomp.model.document import Accuracy, Component, HistoryAxis, ModelDocument
from thetacomp.model.history_law import without_sensor

DECAY_S = 4 * 3600.0


@dataclass(frozen=True)
class Carried:
    """What is added to the running model since the switch at `t_s`: one value each of the outputs that were carried.

    The outputs are those that must not jump: an offset in µm, or intercept (µm) and slope (µm/m) so that no position
    jumps. `decay_s` is the time constant of the decay, None to keep the values until the next probe.
    JSON-able by `dataclasses.asdict`.
    """

    t_s: float
    values: tuple[float, ...]
    decay_s: float | None = DECAY_S

    def at(self, t_s: float) -> tuple[float, ...]:
        """The carried values at `t_s`. Raises ValueError for a time before the switch."""
        if t_s < self.t_s:
            raise ValueError(f"{t_s:g} s lies before the switch at {self.t_s:g} s")
        left = 1.0 if self.decay_s is None else math.exp((self.t_s - t_s) / self.decay_s)
        return tuple(left * value for value in self.values)


def switch(t_s: float, output: Sequence[float], model: Sequence[float], decay_s: float | None = DECAY_S) -> Carried:
    """Carry the output over to another model: `output` is what was put out last, `model` what the new model says.

    Serves every change of model alike: to a fallback, to another one, and back when the sensor returns.
    """
    return Carried(t_s, tuple(old - new for old, new in zip(output, model, strict=True)), decay_s)


@dataclass(frozen=True)
class Degraded:
    """A model for the sensors that are left, and the components that nothing is ready for.

    `replaced` names the components that changed, each with its held-out accuracy where that was measured.
    """

    model: ModelDocument
    replaced: dict[str, Accuracy | None]
    ended: tuple[str, ...]


def degraded(model: ModelDocument, lost: Collection[str]) -> Degraded:
    """The model without the lost sensors: every component that uses one comes from a fallback that uses none.

    An axis with heat history goes on with its own fallback where one sensor is lost, else with the law on key
    temperatures. Where several fallbacks could serve, the one with the smallest held-out error is taken. A component
    without any is left out and named in `ended`: its compensation ends, the others go on.
    """
    history, replaced = _without(model, lost)
    components: dict[str, Component] = {}
    ended = []
    for name, component in model.components.items():
        if not set(lost) & set(component.inputs):
            components[name] = component
            continue
        ready = [f for f in model.fallbacks if name in f.components and not set(lost) & set(f.components[name].inputs)]
        if ready:
            best = min(ready, key=lambda fallback: fallback.accuracy[name].without_rms_um)
            components[name] = best.components[name]
            if (component.axis or "") not in history:
                replaced[name] = _against_history(model, name, best.accuracy[name])
        elif (component.axis or "") in history:
            components[name] = component
        else:
            ended.append(name)
    left = {"components": components, "history": history}
    return Degraded(model.model_copy(update=left), replaced, tuple(ended))


def _against_history(model: ModelDocument, name: str, accuracy: Accuracy) -> Accuracy:
    """The accuracy against what was in use: an axis that falls back from heat history loses more than a key sensor."""
    axis = model.history.get(model.components[name].axis or "")
    told = [f.accuracy[name] for f in axis.fallbacks if name in f.accuracy] if axis else []
    return accuracy.model_copy(update={"full_rms_um": told[0].full_rms_um}) if told else accuracy


def _without(model: ModelDocument, lost: Collection[str]) -> tuple[dict[str, HistoryAxis], dict[str, Accuracy | None]]:
    """The axes that go on with heat history, and the components that changed."""
    history: dict[str, HistoryAxis] = {}
    replaced: dict[str, Accuracy | None] = {}
    for key, axis in model.history.items():
        gone = [sensor for sensor in axis.layout.sensors if sensor in lost]
        if not gone:
            history[key] = axis
            continue
        rest = without_sensor(axis, gone[0]) if len(gone) == 1 else None
        if rest is not None:
            history[key] = rest
            replaced |= next(fallback for fallback in axis.fallbacks if fallback.lost == gone[0]).accuracy
        else:
            replaced |= dict.fromkeys(axis.components)
    return history, replaced

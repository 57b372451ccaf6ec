"""Changing the law while the machine runs: the fallback for lost sensors, and a change of laws without a bump.

At the change the difference of the two laws is kept as an offset, so the output goes on from where it was. The offset
decays slowly, or stays until a probe measures the error anew. Time is an argument.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from thetacomp.model.document import Accuracy, AxisLaw, Fallback, ModelDocument

DECAY_S = 4 * 3600.0


@dataclass(frozen=True)
class BumplessTransfer:
    """What is added to the running law since the change at `t_s`: one value each of the outputs that were carried.

    The outputs are those that must not jump: an offset in µm, or intercept (µm) and slope (µm/m) so that no position
    jumps. `decay_s` is the time constant of the decay, None to keep the values until the next probe.
    JSON-able by `dataclasses.asdict`.
    """

    t_s: float
    values: tuple[float, ...]
    decay_s: float | None = DECAY_S

    def at(self, t_s: float) -> tuple[float, ...]:
        """The carried values at `t_s`. Raises ValueError for a time before the change."""
        if t_s < self.t_s:
            raise ValueError(f"{t_s:g} s lies before the change of laws at {self.t_s:g} s")
        left = 1.0 if self.decay_s is None else math.exp((self.t_s - t_s) / self.decay_s)
        return tuple(left * value for value in self.values)


def start_transfer(
    t_s: float, output: Sequence[float], law: Sequence[float], decay_s: float | None = DECAY_S
) -> BumplessTransfer:
    """Carry the output over to another law: `output` is what was put out last, `law` what the new law says.

    Serves every change of laws: to a fallback, to another one, and back when the sensor returns.
    """
    return BumplessTransfer(t_s, tuple(old - new for old, new in zip(output, law, strict=True)), decay_s)


@dataclass(frozen=True)
class Degraded:
    """A model for the sensors that are left, and the components that nothing is ready for.

    `replaced` names the components that changed, each with its held-out accuracy where that was measured.
    """

    model: ModelDocument
    replaced: dict[str, Accuracy | None]
    ended: tuple[str, ...]


def degraded(model: ModelDocument, lost: Collection[str]) -> Degraded:
    """The model without the lost sensors: every law that uses one gives way to a fallback that uses none.

    An axis with heat history goes on with its own fallback, else with the law on key temperatures. Where several
    fallbacks could serve an axis, the one with the smallest held-out error is taken. An axis without any is left out
    and its components named in `ended`: its compensation ends, the others go on. Angles without their sensors are
    left out.
    """
    prediction, replaced = {}, dict[str, Accuracy | None]()
    for name, law in model.prediction.items():
        ready = _ready(law, lost)
        if ready is law:
            prediction[name] = law
        elif isinstance(ready, Fallback):
            prediction[name] = without_sensor(law, ready)
            replaced |= ready.accuracy
        else:
            replaced |= dict.fromkeys(law.components)
    control, ended = {}, list[str]()
    for name, law in model.control.items():
        ready = _ready(law, lost)
        if isinstance(ready, Fallback):
            control[name] = without_sensor(law, ready)
            if name not in prediction:
                replaced |= {c: _against_history(model.prediction.get(name), c, a) for c, a in ready.accuracy.items()}
        elif ready is law or name in prediction:
            control[name] = law
        else:
            ended += law.components
    rotations = {name: law for name, law in model.rotations.items() if _ready(law, lost) is law}
    left = {"prediction": prediction, "control": control, "rotations": rotations}
    return Degraded(model.model_copy(update=left), replaced, tuple(ended))


def without_sensor(law: AxisLaw, fallback: Fallback) -> AxisLaw:
    """The law of an axis without one of its sensors, from its fallback."""
    names = [name for block in law.layout.blocks.values() for name in block]
    left = {name for block in fallback.layout.blocks.values() for name in block}
    kept = [j for j, name in enumerate(names) if name in left]
    border, validity = fallback.border or law.border, law.border.distance
    if fallback.border is None and validity is not None:
        absolute = [len(names) + j for j, name in enumerate(law.layout.sensors) if name != fallback.lost]
        border = replace(border, distance=validity.of_inputs(kept + absolute))
    changed = {
        "layout": fallback.layout,
        "reference": fallback.reference,
        "leverage": fallback.leverage or law.leverage.of_inputs(kept),
        "border": border,
        "components": fallback.components,
        "fallbacks": (),
    }
    return law.model_copy(update=changed)


def _ready(law: AxisLaw, lost: Collection[str]) -> AxisLaw | Fallback | None:
    """The law itself where it misses nothing, else its most accurate fallback that does, None where there is none."""
    gone = set(lost)
    if not gone & set(law.layout.sensors):
        return law
    able = [fallback for fallback in law.fallbacks if not gone & set(fallback.layout.sensors)]
    return min(able, key=_squares_um2, default=None)


def _squares_um2(fallback: Fallback) -> float:
    return float(np.sum([accuracy.without_rms_um**2 for accuracy in fallback.accuracy.values()]))


def _against_history(law: AxisLaw | None, name: str, accuracy: Accuracy) -> Accuracy:
    """The accuracy against what was in use: an axis that falls back from heat history loses more than a key sensor."""
    told = [f.accuracy[name] for f in law.fallbacks if name in f.accuracy] if law else []
    return accuracy.model_copy(update={"full_rms_um": told[0].full_rms_um}) if told else accuracy

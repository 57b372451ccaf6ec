"""Beyond the border of validity: the prediction fades towards a prior, with no jump. Numpy only.

The prior is a simple physical law (`fitting.prior`), which is plausible everywhere and precise nowhere.
"""

from __future__ import annotations

import numpy as np

from thetacomp.arrays import Floats

# Heat deforms a machine nearly in proportion: twice the range of the training is still used, though it is flagged.
FADE_START = 2.0


def model_weight(distance: Floats) -> Floats:
    """Weight of the model (n,) at distances (n,): 1 up to FADE_START, then FADE_START / distance.

    A model linear in its inputs then sees them drawn back along the ray from the reference, and the prior answers for
    the rest: what the model says stays bounded however far the inputs go.
    """
    weight: Floats = FADE_START / np.maximum(distance, FADE_START)
    return weight


def faded_um(model_um: Floats, prior_um: Floats, weight: Floats) -> Floats:
    """`weight × model + (1 - weight) × prior`, (n,), continuous in all three."""
    return weight * model_um + (1.0 - weight) * prior_um

"""The fixed list of families: the same for every machine and channel."""

from __future__ import annotations

from thetacomp.validation.families.dynamic import ARX, GREY
from thetacomp.validation.families.family import Family
from thetacomp.validation.families.learners import GAUSSIAN_PROCESS, GRADIENT_BOOSTING, NEURAL_NETWORK, SUPPORT_VECTORS
from thetacomp.validation.families.linear import BEST_SUBSET, CORRELATION, STEPWISE
from thetacomp.validation.families.shrinkage import GROUP_LASSO, LASSO, PLS

FAMILIES: tuple[Family, ...] = (
    CORRELATION,
    STEPWISE,
    BEST_SUBSET,
    LASSO,
    GROUP_LASSO,
    PLS,
    ARX,
    GREY,
    SUPPORT_VECTORS,
    GAUSSIAN_PROCESS,
    GRADIENT_BOOSTING,
    NEURAL_NETWORK,
)

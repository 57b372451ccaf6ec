"""The fixed list of families: the same for every machine and channel."""

from __future__ import annotations

from thetacomp.comparison.dynamic import ARX, GREY
from thetacomp.comparison.family import Family
from thetacomp.comparison.learners import GAUSSIAN_PROCESS, GRADIENT_BOOSTING, NEURAL_NETWORK, SUPPORT_VECTORS
from thetacomp.comparison.linear import BEST_SUBSET, CORRELATION, STEPWISE
from thetacomp.comparison.shrinkage import GROUP_LASSO, LASSO, PLS

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

"""The quantile of Student's t distribution without scipy, which the machine wing does not carry."""

from __future__ import annotations

import math
from statistics import NormalDist


def t_quantile(probability: float, dof: int) -> float:
    """Quantile of Student's t for `probability` above 0.5; infinite where `dof` is below 1.

    Closed forms for 1 and 2 degrees of freedom, else G. W. Hill, "Algorithm 396: Student's t-quantiles",
    Communications of the ACM 13 (1970), 619-620.
    """
    if not 0.5 < probability < 1.0:
        raise ValueError(f"the probability must lie between 0.5 and 1, not at {probability}")
    if dof < 1:
        return math.inf
    two_sided = 2.0 * (1.0 - probability)
    if dof == 1:
        return 1.0 / math.tan(two_sided * math.pi / 2.0)
    if dof == 2:
        return math.sqrt(2.0 / (two_sided * (2.0 - two_sided)) - 2.0)
    a = 1.0 / (dof - 0.5)
    b = 48.0 / a**2
    c = ((20700.0 * a / b - 98.0) * a - 16.0) * a + 96.36
    d = ((94.5 / (b + c) - 3.0) / b + 1.0) * math.sqrt(a * math.pi / 2.0) * dof
    y = (d * two_sided) ** (2.0 / dof)
    if y > 0.05 + a:
        x = NormalDist().inv_cdf(two_sided / 2.0)
        y = x**2
        if dof < 5:
            c += 0.3 * (dof - 4.5) * (x + 0.6)
        c = (((0.05 * d * x - 5.0) * x - 7.0) * x - 2.0) * x + b + c
        y = (((((0.4 * y + 6.3) * y + 36.0) * y + 94.5) / c - y - 3.0) / b + 1.0) * x
        y = math.expm1(a * y**2)
    else:
        y = (
            (1.0 / (((dof + 6.0) / (dof * y) - 0.089 * d - 0.822) * (dof + 2.0) * 3.0) + 0.5 / (dof + 4.0)) * y - 1.0
        ) * (dof + 1.0) / (dof + 2.0) + 1.0 / y
    return math.sqrt(dof * y)

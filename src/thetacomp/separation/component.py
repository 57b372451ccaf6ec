"""What separation gives: geometry, slope and intercept of every component at every state."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from thetacomp.arrays import Bools, Floats, Ints

Form = Literal["separate", "joint"]


@dataclass(frozen=True)
class GeometryCurve:
    """`G(p)` of one approach direction (+1, -1; 0: not known) on a grid: `value_um` and its standard error."""

    direction: int
    position_mm: Floats
    value_um: Floats
    se_um: Floats


@dataclass(frozen=True)
class Points:
    """Measured points of one component with what the separation made of them, each (n,).

    `thermal_um` is the measured error less the geometry; `line_um` the separated thermal line (with its bend, where it
    has one) at the point's own time; their difference is the residual. Outliers carry no weight in the fit and are left
    out of validation. In the joint form the other axes' share, the drift and the constant are taken off `error_um`;
    `drift_um` is that drift at the point's own time.
    """

    t_s: Floats
    sweep: Ints
    position_mm: Floats
    direction: Ints
    error_um: Floats
    geometry_um: Floats
    line_um: Floats
    outlier: Bools
    drift_um: Floats | None = None

    @property
    def thermal_um(self) -> Floats:
        """Error less geometry, (n,)."""
        return self.error_um - self.geometry_um

    @property
    def residual_um(self) -> Floats:
        """What neither geometry nor the thermal line explains, (n,)."""
        return self.thermal_um - self.line_um


def mean_square_m2(p0_mm: float, p_min_mm: float, p_max_mm: float) -> float:
    """Mean of `u²` over the travel, u = (p - P0) / 1000. P0 in the middle: C times it lifts the best line of `C u²`."""
    low_m, high_m = (p_min_mm - p0_mm) / 1000.0, (p_max_mm - p0_mm) / 1000.0
    return (low_m**2 + low_m * high_m + high_m**2) / 3.0


@dataclass(frozen=True)
class LinearityTest:
    """Test of the assumption that heat changes only slope and intercept of a component (and its bend, where it has
    one).

    `cost_um` is the largest change of shape that these cannot follow, over travel and states; `cost_se_um` is the
    standard error of that figure, so a cost below twice it is within the noise.
    """

    f_statistic: float
    p_value: float
    cost_um: float
    cost_se_um: float
    holds: bool


@dataclass(frozen=True)
class ComponentSeparation:
    """One error component in one campaign, states in order of time.

    `component` is a name of ISO 230-1 such as `EYX` (moving `axis` "X") or, at a fixed position, `DX` (`axis` None,
    slope zero). Slope and intercept are zero over the times `zero_t_s` at which the cold state was measured;
    `reference_s` ends the cold block and `cold` marks its states. Where the
    parameters came already separated, `cold_intercept_um` and `cold_slope_um_per_m` hold what they were in the cold
    state (that is geometry, and is subtracted here), the standard errors are NaN, and `points`, `geometry` and
    `linearity` are absent. A missing value is NaN.

    Where heat bends the component (`separate_all` decides), `bend_um_per_m2` holds C of
    `E = intercept + slope u + C u²`, u = (p - P0) / 1000 in metres; the intercept is then the error at P0 itself. None
    for a component that stays a line.

    `form` is "joint" where the drift was taken out of the sweeps: the intercept of an axis is then zero and the
    drift of all sweeps is one component of its own, such as `DX`, whose `cold_intercept_um` is the one constant of the
    geometry. Angles have the same shape, in µrad and µrad/m: `EAX`, `DA`, with `direction` "A", "B" or "C".
    """

    campaign: str
    component: str
    direction: str
    axis: str | None
    p0_mm: float
    p_min_mm: float
    p_max_mm: float
    reference_s: float
    zero_t_s: Floats
    sweep: Ints
    t_s: Floats
    cold: Bools
    intercept_um: Floats
    intercept_se_um: Floats
    slope_um_per_m: Floats
    slope_se_um_per_m: Floats
    rms_um: Floats
    noise_sd_um: float
    dof: float
    cold_intercept_um: float = 0.0
    cold_slope_um_per_m: float = 0.0
    geometry_model: str = ""
    geometry: tuple[GeometryCurve, ...] = ()
    points: Points | None = None
    linearity: LinearityTest | None = None
    reversal_um: float | None = None
    notes: tuple[str, ...] = ()
    form: Form = "separate"
    bend_um_per_m2: Floats | None = None
    bend_se_um_per_m2: Floats | None = None

    @property
    def exact_zero(self) -> bool:
        """True where slope and intercept are zero in the cold state by definition, not by measurement."""
        return self.points is not None or self.form == "joint"

    @property
    def line_intercept_um(self) -> Floats:
        """Intercepts of the best lines over the travel, for a law without bends; those of the joint form stay zero."""
        if self.bend_um_per_m2 is None or self.form == "joint":
            return self.intercept_um
        return self.intercept_um + self.bend_um_per_m2 * mean_square_m2(self.p0_mm, self.p_min_mm, self.p_max_mm)

    def line_um(self, state: int, position_mm: Floats) -> Floats:
        """The separated thermal line of one state at `position_mm`, with its bend where it has one."""
        lever_m = (position_mm - self.p0_mm) / 1000.0
        bend = 0.0 if self.bend_um_per_m2 is None else self.bend_um_per_m2[state]
        return np.asarray(self.intercept_um[state] + self.slope_um_per_m[state] * lever_m + bend * lever_m**2)

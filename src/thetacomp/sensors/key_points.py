"""What the sensor strategies give: for every sensor a figure, whether it stays, and why."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class StrategyDecision:
    """One sensor under one strategy. `figure` is the number that decided; `reason` says it in words."""

    sensor: str
    stays: bool
    figure: float
    reason: str


@dataclass(frozen=True)
class StrategyTable:
    """One strategy applied to the sensors of one axis. `figure_name` names the figure with its unit."""

    strategy: str
    axis: str
    figure_name: str
    decisions: tuple[StrategyDecision, ...]

    @property
    def kept(self) -> tuple[str, ...]:
        """The sensors that stay."""
        return tuple(v.sensor for v in self.decisions if v.stays)


@dataclass(frozen=True)
class AxisKeyPoints:
    """Key points of one moving axis ("" for drift at a fixed position), with every table that led there.

    `left_out` lists the parameters that did not vote (such as `S_wy`), each with the reason.
    `smallest_correlation` is the smallest |r| inside the main-factor set, NaN where it has one member.
    """

    axis: str
    method: str
    main_factors: tuple[str, ...]
    groups: tuple[tuple[str, ...], ...]
    key_points: tuple[str, ...]
    smallest_correlation: float
    tables: tuple[StrategyTable, ...]
    left_out: tuple[tuple[str, str], ...] = ()

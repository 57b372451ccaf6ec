"""A jump inside a sweep: the machine, a clamp or the instrument moved while the axis went from point to point."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from thetacomp.arrays import Floats
from thetacomp.campaign import Campaign
from thetacomp.instrument import jump_that_stays, step_scatter
from thetacomp.reading.components import MeasuredComponent, measured_components
from thetacomp.reading.problems import ProblemList

FEWEST_SWEEPS = 3  # fewer do not show what the sweeps have in common


def check_sweep_jumps(campaigns: Sequence[Campaign], recorded: bool, problems: ProblemList) -> None:
    """Note every sweep in which an error jumps and stays, against the median of all sweeps at each place."""
    for campaign in campaigns:
        for component in measured_components(campaign):
            if component.lever.any() and len(np.unique(component.sweep)) >= FEWEST_SWEEPS:
                _check(component, "recording.toml" if recorded else f"campaigns/{campaign.name}", problems)


def _check(component: MeasuredComponent, file: str, problems: ProblemList) -> None:
    left_um = _without_geometry(component)
    rows = [np.flatnonzero(component.sweep == number) for number in np.unique(component.sweep)]
    scatter_um = step_scatter([left_um[own] for own in rows])
    for own in rows:
        jump = jump_that_stays(left_um[own], scatter_um)
        if jump is not None:
            i = own[jump[0]]
            problems.warning(
                "error-jump",
                file,
                f"{component.name}: the error jumps by {jump[1]:+.0f} µm inside the sweep that starts at"
                f" t_s = {component.t_s[own[0]]:g}, at t_s = {component.t_s[i]:g}, and stays there.",
                "find out what moved: the machine, a clamp, the instrument or its foot; if not the machine, leave"
                " the rest of the sweep out.",
            )


def _without_geometry(component: MeasuredComponent) -> Floats:
    """Errors (n,) less their median over the sweeps at each place."""
    place = np.unique(component.place, axis=0, return_inverse=True)[1].ravel()
    left_um = component.error_um.copy()
    for number in range(int(place.max(initial=-1)) + 1):
        own = (place == number) & np.isfinite(left_um)
        if own.any():
            left_um[own] -= np.median(left_um[own])
    return left_um

"""Which form a set of campaigns has, and the separation of all of them in that form."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from thetacomp.campaign import Campaign
from thetacomp.machine import Machine
from thetacomp.separation.component import ComponentSeparation, Form, LinearityTest
from thetacomp.separation.joint_form import separate_joint, why_not_joint
from thetacomp.separation.separate import separate_campaign

# A bend that rests on fewer positions cannot be distinguished from two bad points.
MIN_POSITIONS = 5


@dataclass(frozen=True)
class Separated:
    """All components of all campaigns in one form, the angles (µrad, µrad/m) in the joint form, and notes."""

    form: Form
    components: tuple[ComponentSeparation, ...]
    angles: tuple[ComponentSeparation, ...] = ()
    notes: tuple[str, ...] = ()


def separate_all(machine: Machine, campaigns: Sequence[Campaign]) -> Separated:
    """Separate campaigns in the joint form where every one of them carries it, else all of them axis by axis.

    The two forms are never mixed: an intercept means another thing in each. Where heat bends a component, all its
    heated sweeps become parabolas instead of lines, in every campaign. Raises AnalysisError where a campaign
    cannot be separated.
    """
    straight = _separate_as(machine, campaigns, ())
    bent = bent_components(straight.components)
    if not bent:
        return straight
    found = _separate_as(machine, campaigns, bent)
    return replace(found, notes=(*found.notes, *_bend_notes(found.components, bent)))


def bent_components(straight: Sequence[ComponentSeparation]) -> tuple[str, ...]:
    """Components whose test of shape, separated as lines, fails in more than half of the campaigns that made it."""
    tests: dict[str, list[LinearityTest]] = {}
    for s in straight:
        if s.linearity is not None and s.points is not None and len(np.unique(s.points.position_mm)) >= MIN_POSITIONS:
            tests.setdefault(s.component, []).append(s.linearity)
    return tuple(name for name, own in tests.items() if 2 * sum(not test.holds for test in own) > len(own))


def _bend_notes(components: Sequence[ComponentSeparation], bent: Sequence[str]) -> tuple[str, ...]:
    notes = []
    for name in bent:
        size_um = max(_bend_rms_um(s) for s in components if s.component == name)
        notes.append(
            f"{name}: heat bends the line, by {size_um:.0f} µm at the ends of the travel (RMS over heated sweeps): they"
            " are separated as parabolas. Heat history follows the bend; the law on key points, which a control can"
            " carry, is a line and leaves it"
        )
    return tuple(notes)


def _bend_rms_um(s: ComponentSeparation) -> float:
    """Size of a bend at the farther end of the travel, over the heated sweeps of a campaign."""
    if s.bend_um_per_m2 is None or s.cold.all():
        return 0.0
    end_m = max(s.p_max_mm - s.p0_mm, s.p0_mm - s.p_min_mm) / 1000.0
    return float(np.sqrt(np.mean(s.bend_um_per_m2[~s.cold] ** 2))) * end_m**2


def _separate_as(machine: Machine, campaigns: Sequence[Campaign], bent: Sequence[str]) -> Separated:
    reasons = {campaign.name: why_not_joint(machine, campaign) for campaign in campaigns}
    lengths = {campaign.name: campaign.settings.tool_length_mm for campaign in campaigns}
    if campaigns and len(set(lengths.values())) > 1:
        listed = ", ".join(f"{name}: {length:g} mm" for name, length in lengths.items())
        reasons = {name: reason or f"the tool lengths differ ({listed})" for name, reason in reasons.items()}
    if any(reasons.values()) or not campaigns:
        components = [s for campaign in campaigns for s in separate_campaign(machine, campaign, bent)]
        return Separated("separate", tuple(components), notes=_refusals(campaigns, reasons))
    joint = [separate_joint(machine, campaign, bent) for campaign in campaigns]
    angles = tuple(s for one in joint for s in one.angles)
    notes = [_chain_note(machine, bool(angles)), *(note for one in joint for note in one.notes)]
    return Separated("joint", tuple(s for one in joint for s in one.components), angles, tuple(notes))


def _chain_note(machine: Machine, with_angles: bool) -> str:
    turning = (
        "measured angles act over the arms of the axes behind them and of the tool"
        if with_angles
        else "no angles were measured (rA_urad, rB_urad, rC_urad at every point): tilts that stay the same along an"
        " axis are in the slopes, rotation of an axis along its own travel is left out"
    )
    return (
        "joint form: drift is counted once for each direction; the axes are taken in the order of machine.toml,"
        f" {', '.join(axis.name for axis in machine.axes)}, as the order from the workpiece to the tool; {turning}"
    )


def _refusals(campaigns: Sequence[Campaign], reasons: dict[str, str | None]) -> tuple[str, ...]:
    """Positions of the other axes that were measured and cannot be used, with the reason."""
    carrying = [c.name for c in campaigns if c.sweeps is not None and c.sweeps.at_mm]
    if not carrying:
        return ()
    why = "; ".join(f"{name}: {reason}" for name, reason in reasons.items() if reason)
    return (
        f"positions of other axes ({', '.join(carrying)}) are not used, every axis is modelled alone ({why}): an"
        " intercept includes the tilt of the other axes there, and a volumetric prediction is not possible",
    )

"""Which form a set of campaigns has, and the separation of all of them in that form."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from thetacomp.campaign import Campaign
from thetacomp.machine import Machine
from thetacomp.separation.joint_form import separate_joint, why_not_joint
from thetacomp.separation.result import ComponentSeparation, Form
from thetacomp.separation.separate import separate_campaign


@dataclass(frozen=True)
class Separated:
    """All components of all campaigns in one form, the angles (µrad, µrad/m) in the joint form, and notes."""

    form: Form
    components: tuple[ComponentSeparation, ...]
    angles: tuple[ComponentSeparation, ...] = ()
    notes: tuple[str, ...] = ()


def separate_all(machine: Machine, campaigns: Sequence[Campaign]) -> Separated:
    """Separate campaigns in the joint form where every one of them carries it, else all of them axis by axis.

    The two forms are never mixed: an intercept means another thing in each. Raises AnalysisError where a campaign
    cannot be separated.
    """
    reasons = {campaign.name: why_not_joint(machine, campaign) for campaign in campaigns}
    lengths = {campaign.name: campaign.settings.tool_length_mm for campaign in campaigns}
    if campaigns and len(set(lengths.values())) > 1:
        listed = ", ".join(f"{name}: {length:g} mm" for name, length in lengths.items())
        reasons = {name: reason or f"the tool lengths differ ({listed})" for name, reason in reasons.items()}
    if any(reasons.values()) or not campaigns:
        components = [s for campaign in campaigns for s in separate_campaign(machine, campaign)]
        return Separated("separate", tuple(components), notes=_refusals(campaigns, reasons))
    joint = [separate_joint(machine, campaign) for campaign in campaigns]
    angles = tuple(s for one in joint for s in one.angles)
    notes = [_chain_note(machine, bool(angles)), *(note for one in joint for note in one.notes)]
    return Separated("joint", tuple(s for one in joint for s in one.components), angles, tuple(notes))


def _chain_note(machine: Machine, with_angles: bool) -> str:
    turning = (
        "measured angles act over the arms of the axes behind them and of the tool"
        if with_angles
        else "no angles were measured (rA_urad, rB_urad, rC_urad at every point): tilts that stay the same along an"
        " axis are in the slopes, what an axis turns along its own travel is left out"
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
        f"positions of other axes ({', '.join(carrying)}) are not used, every axis is modelled on its own ({why}): an"
        " intercept holds the tilt of the other axes at those positions, and a volumetric prediction is not possible",
    )

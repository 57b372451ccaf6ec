"""Under which conditions campaigns were measured, what a model has to say of them, and which may share a model."""

from __future__ import annotations

from collections.abc import Sequence

from thetacomp.campaign import Campaign
from thetacomp.errors import AnalysisError

TEMPERATURE_TABLE = "temperature"


def refuse_mixtures(campaigns: Sequence[Campaign], mix: bool = False) -> tuple[str, ...]:
    """Campaigns of different operating modes or active tables are not mixed unless requested.

    With `mix` they are, and the notes that come back say so. Raises AnalysisError for a mixture, and in any case where
    temperature compensation was active: a model of it would be a model of the remainder.
    """
    active = [c.name for c in campaigns if c.settings.compensation == "on"]
    if active:
        raise AnalysisError(
            f"compensation was on in campaign {', '.join(active)}: a model of it would be a model of the remainder."
            " Fix: leave it out with --train; use it in `thetacomp verify`."
        )
    hidden = [c.name for c in campaigns if TEMPERATURE_TABLE in c.settings.active_tables]
    if hidden:
        raise AnalysisError(
            f"the control applied its temperature compensation in campaign {', '.join(hidden)} (active_tables in"
            " campaign.toml), though compensation is 'off' there: a model of it would be a model of the remainder."
            " Fix: leave it out with --train, or correct campaign.toml."
        )
    notes = []
    for what, key, found in (
        ("operating modes", "mode", {c.name: f"'{c.settings.mode}'" for c in campaigns}),
        ("active tables", "active_tables", {c.name: _tables(c) for c in campaigns}),
    ):
        if len(set(found.values())) < 2:
            continue
        listed = ", ".join(f"{name}: {value}" for name, value in found.items())
        if not mix:
            raise AnalysisError(
                f"the campaigns were measured with different {what} ({listed}); a model of the mixture may fit neither."
                f" Fix: choose campaigns of one kind with --train and --test, correct `{key}` in campaign.toml,"
                " or ask for the mixture with --mix."
            )
        notes.append(f"campaigns with different {what} ({listed}) were mixed as asked: the model may fit neither")
    return tuple(notes)


def condition_notes(campaigns: Sequence[Campaign]) -> tuple[str, ...]:
    """What the settings and the tracker of campaigns say that a user of their model has to know."""
    notes = [
        f"sign unproven: campaign {campaign.name} does not state its sign convention; a wrong sign doubles the error"
        for campaign in campaigns
        if campaign.settings.sign == "unproven"
    ]
    notes += [f"origin of campaign {c.name}: {c.settings.origin.strip()}" for c in campaigns if c.settings.origin]
    notes += [
        f"campaign {c.name} was measured while the control applied {', '.join(c.settings.active_tables)} compensation;"
        " these tables must be active whenever the model is used"
        for c in campaigns
        if c.settings.active_tables
    ]
    ties = [(c.name, c.tracker) for c in campaigns if c.tracker is not None]
    notes += [f"campaign {name}, tracker: {note}" for name, tie in ties for note in (*tie.notes, *tie.doubts)]
    return tuple(notes)


def _tables(campaign: Campaign) -> str:
    return " and ".join(sorted(set(campaign.settings.active_tables))) or "none"

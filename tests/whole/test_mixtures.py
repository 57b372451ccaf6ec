"""Campaigns of different modes, active tables or compensation are recognised and never mixed unasked."""

from __future__ import annotations

import numpy as np
import pytest

from thetacomp.campaign import Campaign, CampaignSettings
from thetacomp.campaign_conditions import refuse_mixtures
from thetacomp.errors import AnalysisError
from thetacomp.model.temperatures import Temperatures


def campaign(name: str, **settings: object) -> Campaign:
    return Campaign(name, CampaignSettings.model_validate(settings), Temperatures(np.zeros(1), ("a",), np.ones((1, 1))))


def test_like_campaigns_pass_in_silence() -> None:
    alike = [
        campaign("a", mode="cooling", active_tables=["pitch", "sag"]),
        campaign("b", mode="cooling", active_tables=["sag", "pitch"]),
    ]
    assert refuse_mixtures(alike) == ()


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        ({"mode": "no cooling"}, "different operating modes (a: '', b: 'no cooling')"),
        ({"active_tables": ["pitch"]}, "different active tables (a: none, b: pitch)"),
    ],
)
def test_a_mixture_is_refused_unless_asked_for(settings: dict[str, object], told: str) -> None:
    mixture = [campaign("a"), campaign("b", **settings)]
    with pytest.raises(AnalysisError) as refused:
        refuse_mixtures(mixture)
    assert told in str(refused.value)
    assert "--mix" in str(refused.value)
    (note,) = refuse_mixtures(mixture, mix=True)
    assert told in note
    assert "mixed as asked" in note


@pytest.mark.parametrize("mix", [False, True])
def test_a_compensated_campaign_never_trains(mix: bool) -> None:
    with pytest.raises(AnalysisError, match="compensation was on in campaign b"):
        refuse_mixtures([campaign("a"), campaign("b", compensation="on")], mix)
    with pytest.raises(AnalysisError, match="applied its temperature compensation in campaign b"):
        refuse_mixtures([campaign("a"), campaign("b", active_tables=["temperature"])], mix)

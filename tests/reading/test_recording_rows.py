"""Which rows of a recording belong to a campaign, and what of it is the heat that the campaign starts with."""

from __future__ import annotations

from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from machine_folders import MACHINE_TOML, csv_text, write_files

from thetacomp.campaign import Campaign, MachineFolder
from thetacomp.reading import check_folder

ROWS = 14
TOML = """\
format = 1
[recording]
file = "log.csv"
time = "t"
time_unit = "{unit}"
[recording.temperatures]
theta_1 = "a"
theta_2 = "b"
[recording.drift]
dX_um = "x"
{duty}
[[recording.campaigns]]
name = "later"
first_row = 7
last_row = 12
[[recording.campaigns]]
name = "early"
first_row = 1
last_row = 5
"""
DUTY = '[recording.duty]\nspindle_rpm = "n"'


def time_cell(row: int, unit: str) -> object:
    """A row each 10 min, or each 10 min and 1.5 s of the clock."""
    match unit:
        case "iso":
            return (datetime(2026, 3, 2, 8) + row * timedelta(seconds=601.5)).isoformat()
        case "min":
            return 10 * row
        case "h":
            return row / 6
        case _:
            return 600 * row


def recording(tmp_path: Path, unit: str, duty: str = DUTY) -> MachineFolder:
    body = [[time_cell(i, unit), 20 + i / 2, 21 - i / 4, i * 1.5, 100 * i] for i in range(ROWS)]
    files = {
        "machine.toml": MACHINE_TOML,
        "recording.toml": TOML.format(unit=unit, duty=duty),
        "log.csv": csv_text([["t", "a", "b", "x", "n"], *body]),
    }
    folder, problems = check_folder(write_files(tmp_path, files))
    assert folder is not None, problems
    return folder


def rows_of(campaign: Campaign) -> tuple[list[float], list[float], list[float]]:
    """Row numbers as temperatures, drift and speed tell them."""
    assert campaign.drift is not None
    assert campaign.duty is not None
    heat = 2 * (campaign.temperatures.value_degC[:, 0] - 20)
    return (
        heat.tolist(),
        (campaign.drift.error_um[:, 0] / 1.5).tolist(),
        (campaign.duty.columns["spindle_rpm"] / 100).tolist(),
    )


@pytest.mark.parametrize(("unit", "step_s"), [("s", 600.0), ("min", 600.0), ("h", 600.0), ("iso", 601.5)])
def test_a_campaign_holds_its_rows_ends_included_and_its_lead_in_all_rows_before(
    tmp_path: Path, unit: str, step_s: float
) -> None:
    """Rows are counted by hand in `TOML`; each row's values are its own number, scaled."""
    campaigns = {campaign.name: campaign for campaign in recording(tmp_path, unit).campaigns}
    for name, first, last in (("early", 1, 5), ("later", 7, 12)):
        campaign = campaigns[name]
        mine = [float(row) for row in range(first, last + 1)]
        for told in rows_of(campaign):
            assert told == pytest.approx(mine)
        np.testing.assert_allclose(campaign.temperatures.t_s, step_s * np.arange(len(mine)), atol=1e-6)
        before = campaign.before
        assert before is not None
        assert before.duty is not None
        np.testing.assert_allclose(before.temperatures.t_s, step_s * np.arange(-first, 0), atol=1e-6)
        np.testing.assert_allclose(before.duty.t_s, before.temperatures.t_s)
        assert before.temperatures.value_degC[:, 1].tolist() == [21 - row / 4 for row in range(first)]
        assert before.duty.columns["spindle_rpm"].tolist() == [100.0 * row for row in range(first)]


def test_without_duty_the_lead_in_has_none_and_a_campaign_from_the_first_row_has_no_lead_in(tmp_path: Path) -> None:
    early, later = sorted(recording(tmp_path / "a", "s", "").campaigns, key=lambda c: c.name)
    assert later.before is not None
    assert later.before.duty is None
    assert early.duty is None
    toml = TOML.format(unit="s", duty="").replace("first_row = 1", "first_row = 0")
    root = tmp_path / "a"
    (root / "recording.toml").write_text(toml, encoding="utf-8")
    folder, _ = check_folder(root)
    assert folder is not None
    assert folder.campaign("early").before is None


def test_the_last_row_of_the_file_is_the_last_that_a_campaign_may_have(tmp_path: Path) -> None:
    recording(tmp_path, "s")
    toml = TOML.format(unit="s", duty=DUTY)
    for last, code in ((13, None), (14, "campaign-rows")):
        (tmp_path / "recording.toml").write_text(toml.replace("last_row = 12", f"last_row = {last}"), encoding="utf-8")
        folder, problems = check_folder(tmp_path)
        assert [p.code for p in problems if p.severity == "error"] == ([code] if code else [])
        if folder is not None:
            assert len(folder.campaign("later").temperatures.t_s) == 7
        else:
            assert "ends at row 14, but the last data row of log.csv is 13" in problems[0].message


def test_a_campaign_of_empty_lines_is_refused(tmp_path: Path) -> None:
    recording(tmp_path, "s")
    path = tmp_path / "log.csv"
    lines = path.read_text(encoding="utf-8").split("\n")
    path.write_text("\n".join("" if 2 <= i <= 6 else line for i, line in enumerate(lines)), encoding="utf-8")
    assert {p.code for p in check_folder(tmp_path)[1] if p.severity == "error"} == {"campaign-rows"}


def test_neighbouring_campaigns_may_touch_and_neither_share_a_row_nor_a_name(tmp_path: Path) -> None:
    recording(tmp_path, "s")
    toml = TOML.format(unit="s", duty=DUTY)
    for old, new, message in (
        ("last_row = 5", "last_row = 6", ""),
        ("last_row = 5", "last_row = 7", "the campaigns 'early' and 'later' share rows"),
        ('name = "early"', 'name = "later"', "two campaigns have the same name"),
        ("last_row = 5", "last_row = 2", ""),
        ("last_row = 5", "last_row = 1", "last_row 1 is not above first_row 1"),
    ):
        (tmp_path / "recording.toml").write_text(toml.replace(old, new), encoding="utf-8")
        found = [p.message for p in check_folder(tmp_path)[1] if p.code == "campaign-rows"]
        assert bool(found) == bool(message)
        assert not message or message in found[0]

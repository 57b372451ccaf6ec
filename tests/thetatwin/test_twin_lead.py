"""How a campaign is measured: rounds of the cold block, and loggers that run before it begins."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from thetacomp.errors import InputError
from thetacomp.model.filters import InputLayout
from thetacomp.reading import check_folder, read_folder, summarize
from thetacomp.temperature.history_track import history_track
from thetatwin import picture
from thetatwin.campaigns import DAYS_BEFORE, Record, Twin, plan_campaigns, run_campaign
from thetatwin.conditions import LONGEST_LEAD_H, load_conditions
from thetatwin.duty import MINUTES_A_DAY
from thetatwin.picture import campaign_figure, figure_content
from thetatwin.writer import truth_folder, write_twin

DAY_S = 86400.0
NIGHT_S = 7 * 3600.0  # campaigns begin at 7 o'clock, and the machine is off since midnight


def measured_with(twin: Twin, **settings: float) -> Twin:
    work = twin.conditions.work.model_copy(update=settings)
    return replace(twin, conditions=twin.conditions.model_copy(update={"work": work}))


@pytest.fixture(scope="module")
def early(twin: Twin) -> Twin:
    return measured_with(twin, lead_h=24.0)


@pytest.fixture(scope="module")
def records(twin: Twin, early: Twin) -> tuple[Record, Record]:
    """The same campaign without and with a day of logging before it, the one of the first eight that follows work."""
    plans = plan_campaigns(twin, 8)
    for plan in plans:
        record = run_campaign(early, plan)
        if record.work.rpm[:MINUTES_A_DAY].any():
            return run_campaign(twin, plan), record
    raise AssertionError("no day of work before any campaign")


def test_the_campaign_is_the_same_with_and_without_the_day_before(records: tuple[Record, Record]) -> None:
    plain, early = records
    own = early.temperature_t_s >= 0
    assert np.array_equal(early.temperature_t_s[own], plain.temperature_t_s)
    assert np.array_equal(early.temperature_degC[own], plain.temperature_degC, equal_nan=True)
    assert np.array_equal(early.measured_um, plain.measured_um, equal_nan=True)
    assert early.reference_s == plain.reference_s
    minutes = early.work_t_s >= 0
    assert np.array_equal(early.work.rpm[minutes], plain.work.rpm)
    assert np.array_equal(early.work_t_s[minutes], plain.work_t_s)
    assert (plain.lead_s, plain.work_t_s[0], plain.temperature_t_s[0]) == (0.0, 0.0, 0.0)


def test_the_day_before_is_what_the_machine_lived_through(records: tuple[Record, Record]) -> None:
    _, early = records
    earlier = early.temperature_t_s < 0
    assert early.lead_s == DAY_S
    assert np.array_equal(early.temperature_t_s[earlier], np.arange(-DAY_S, 0.0, 60.0))
    assert early.work_t_s[0] == -DAY_S
    assert not early.work.on[(early.work_t_s >= -NIGHT_S) & (early.work_t_s < 0)].any()
    assert early.work.rpm[early.work_t_s < -NIGHT_S].any()
    # Truth under the sensors: offset 0.08 K (one standard deviation) and a lag of up to 90 s stand between.
    rows = np.searchsorted(early.history.t_s, early.begin_s + early.temperature_t_s[earlier])
    apart = early.temperature_degC[earlier] - early.history.sensors_degC[rows]
    assert np.nanmax(np.abs(np.nanmedian(apart, axis=0))) < 0.4
    # The spindle bearing cools from the work of the day before; the lags of a model need that heat.
    bearing = early.temperature_degC[earlier, 0]
    assert np.nanmax(bearing) - bearing[-1] > 1.0


def test_the_folder_holds_the_day_before_apart_from_the_campaign(
    records: tuple[Record, Record], twin: Twin, early: Twin, tmp_path: Path
) -> None:
    plans = [records[0].plan]
    write_twin(tmp_path / "plain", twin, plans)
    (record,) = write_twin(tmp_path / "early", early, plans)
    assert check_folder(tmp_path / "early")[1] == ()
    (plain,), (read,) = (read_folder(tmp_path / name).campaigns for name in ("plain", "early"))
    assert np.array_equal(read.temperatures.t_s, plain.temperatures.t_s)
    assert np.array_equal(read.temperatures.value_degC, plain.temperatures.value_degC, equal_nan=True)
    assert read.duty is not None
    assert plain.duty is not None
    assert np.array_equal(read.duty.t_s, plain.duty.t_s)
    assert plain.before is None
    assert read.before is not None
    assert read.before.duty is not None
    assert np.array_equal(read.before.temperatures.t_s, record.temperature_t_s[record.temperature_t_s < 0])
    assert np.array_equal(read.before.duty.columns["spindle_rpm"], np.round(record.work.rpm[record.work_t_s < 0]))
    assert summarize(read_folder(tmp_path / "early")).campaigns[0].lead_s == DAY_S
    first = (truth_folder(tmp_path / "early") / "campaigns" / read.name / "drift.csv").read_text().splitlines()[1]
    assert first.startswith("-86400,")
    # Filters rest on the first row of the day before: at the begin they know the heat that is in the machine.
    layout = InputLayout(sensors=("theta_1",), time_constants_s=(14400.0,), base_degC=20.0)
    rested, warm = (history_track(c, layout, np.array([1800.0])).absolute(np.array([0.0]))[0] for c in (plain, read))
    assert rested[1] == 0.0
    assert abs(warm[1]) > 0.05


def test_the_picture_shows_the_end_of_the_campaigns_own_work(
    records: tuple[Record, Record], twin: Twin, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(picture, "_PIXELS", 160)
    plain, early = (figure_content(campaign_figure(twin.machine, r, 150.0), "machine.png") for r in records)
    assert plain == early


def test_more_cold_rounds_make_a_longer_cold_block(twin: Twin) -> None:
    plan = plan_campaigns(twin, 1)[0]
    two, four = (run_campaign(measured_with(twin, cold_rounds=n), plan) for n in (2, 4))
    cold = [np.unique(r.truth.sweep[(r.truth.t_s <= r.reference_s) & (r.truth.axis >= 0)]) for r in (two, four)]
    assert [len(sweeps) for sweeps in cold] == [6, 12]  # rounds of three axes
    assert four.reference_s == pytest.approx(2 * two.reference_s, rel=0.02)
    assert len(np.unique(four.truth.sweep)) == len(np.unique(two.truth.sweep)) + 12  # each with its drift point
    assert four.temperature_t_s[-1] - two.temperature_t_s[-1] == pytest.approx(two.reference_s, abs=120.0)


def test_defaults_are_two_rounds_and_no_lead(twin: Twin) -> None:
    assert (twin.conditions.work.cold_rounds, twin.conditions.work.lead_h) == (2, 0.0)


def test_the_lead_is_bounded_by_the_past_that_is_lived(twin: Twin, tmp_path: Path) -> None:
    assert LONGEST_LEAD_H <= 24.0 * DAYS_BEFORE
    record = run_campaign(measured_with(twin, lead_h=LONGEST_LEAD_H), plan_campaigns(twin, 1)[0])
    assert record.temperature_t_s[0] == record.work_t_s[0] == -3600.0 * LONGEST_LEAD_H
    text = Path(load_conditions.__code__.co_filename).with_name("presets").joinpath("standard.toml").read_text("utf-8")
    for name, value in (("lead_h", 72.5), ("lead_h", -1), ("cold_rounds", 0)):
        path = tmp_path / "own.toml"
        path.write_text(text.replace("rpm_max = 900.0", f"rpm_max = 900.0\n{name} = {value}"), encoding="utf-8")
        with pytest.raises(InputError, match=rf"work\.{name}: Input should be"):
            load_conditions(path)

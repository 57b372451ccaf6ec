"""Screening inside the analysis: what is repaired, what is left out, what is told, and what the held-out errors become.

The machine is the thermal network with drawn parameters; the faults are put in, so the healthy values are known.
"""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
from screening_folder import HOUR_S, column, cut, folder, unbroken, with_temperatures, write_folder
from typer.testing import CliRunner

from thetacomp.analysis import analyze_folder
from thetacomp.analysis_result import AnalysisResult
from thetacomp.campaign import MachineFolder
from thetacomp.cli.main import app
from thetacomp.examples import TK6920
from thetacomp.files import write_files
from thetacomp.model.temperatures import Temperatures
from thetacomp.reading import read_folder
from thetacomp.report.analysis_files import table_files
from thetacomp.report.analysis_page import render_page
from thetacomp.report.figures_screening import screened_channels
from thetacomp.report.figures_temperature import temperatures_over_time
from thetacomp.report.rendering import Drawings, draw
from thetacomp.screening import with_fault
from thetacomp.screening.campaigns import ScreenedFolder, screened
from thetacomp.screening.faults import InjectedKind

NAMES = ("c0", "c1", "c2", "c3")
FAULTY = "c2"
SENSOR = "theta_11"
START_S = 5.0 * HOUR_S


def healthy() -> Temperatures:
    return folder().campaign(FAULTY).temperatures


def faulty_folder(kind: InjectedKind, **fault: float | str) -> MachineFolder:
    table = with_fault(healthy(), SENSOR, kind, START_S, **fault)  # type: ignore[arg-type]
    return with_temperatures(folder(), FAULTY, table)


@lru_cache
def jumped(repair: bool = True) -> ScreenedFolder:
    return screened(faulty_folder("jump", size_K=31.0), NAMES, (), repair)


@lru_cache
def analysis(kind: str, repair: bool = True) -> AnalysisResult:
    if kind == "healthy":
        return analyze_folder(folder())
    return analyze_folder(faulty_folder("jump", size_K=31.0), repair=repair)


def held_out_rms_um(result: AnalysisResult, model: str = "default") -> float:
    (row,) = (r for r in result.validation if (r.campaign, r.model, r.split) == (FAULTY, model, "campaign"))
    return row.rms_after_um


def test_a_jump_of_a_key_sensor_hardly_changes_the_held_out_error() -> None:
    """The campaign with the jump is held out; the model that judges it uses the sensor that jumped."""
    well, mended, spoilt = analysis("healthy"), analysis("jump"), analysis("jump", repair=False)
    for model in ("default", "key_points", "one_sensor", "all_sensors"):
        assert held_out_rms_um(mended, model) == pytest.approx(held_out_rms_um(well, model), rel=0.05)
    assert held_out_rms_um(spoilt) > 20.0 * held_out_rms_um(well)
    assert held_out_rms_um(spoilt, "key_points") > held_out_rms_um(well, "nothing")


def test_training_with_the_faulty_campaign_gives_the_healthy_model() -> None:
    well, mended = analysis("healthy").model, analysis("jump").model
    assert mended.control[""].layout.sensors == well.control[""].layout.sensors
    assert SENSOR in well.control[""].layout.sensors
    np.testing.assert_allclose(
        mended.components["DX"].terms[0].coefficients, well.components["DX"].terms[0].coefficients, rtol=0.02
    )
    spoilt = analysis("jump", repair=False).model
    assert spoilt.control[""].layout.sensors != well.control[""].layout.sensors


def test_the_evidence_is_in_the_notes_of_analysis_and_model() -> None:
    (note,) = (n for n in analysis("jump").model.notes if SENSOR in n and "jump" in n)
    assert note in analysis("jump").notes
    assert note.startswith(f"campaign {FAULTY}, sensor {SENSOR}: jump of +3")
    for told in (
        "from 5.00 h on",
        "sharper than any sensor of its kind changes",
        "limit",
        "Used after subtracting the jump (u = 0.0",
    ):
        assert told in note
    (note,) = (n for n in analysis("jump", repair=False).notes if SENSOR in n and "jump" in n)
    assert note.endswith("Used as read, because repair is switched off")


def test_only_the_faulty_stretch_is_changed_and_the_input_never() -> None:
    spoilt = faulty_folder("jump", size_K=31.0)
    before = [c.temperatures.value_degC.copy() for c in spoilt.campaigns]
    out = screened(spoilt, NAMES).folder
    for old, campaign in zip(before, spoilt.campaigns, strict=True):
        np.testing.assert_array_equal(campaign.temperatures.value_degC, old)
    changed = out.campaign(FAULTY).temperatures.value_degC != spoilt.campaign(FAULTY).temperatures.value_degC
    assert {healthy().sensor_ids[j] for j in np.flatnonzero(changed.any(axis=0))} == {SENSOR}
    assert healthy().t_s[changed.any(axis=1)].min() >= START_S - 120.0
    for name in ("c0", "c1", "c3"):
        assert out.campaign(name) is spoilt.campaign(name)
    off = screened(spoilt, NAMES, (), repair=False)
    assert off.folder.campaign(FAULTY) is spoilt.campaign(FAULTY)
    assert [f.kind for _, f in off.findings] == ["jump"]


@pytest.mark.parametrize(
    ("kind", "fault", "allowed_K"),
    [
        ("jump", {"size_K": 31.0}, 0.1),
        ("jump", {"size_K": -2.0}, 0.1),
        ("stuck", {}, 0.3),
        ("drift", {"rate_K_per_h": 1.0}, 0.3),
        ("detached", {"size_K": 3.0, "air_degC": 5.0}, 0.3),
        ("swapped", {"partner": "theta_12"}, 0.3),
        ("missing", {"duration_s": HOUR_S}, 0.3),
    ],
)
def test_every_kind_is_repaired_to_what_a_healthy_sensor_would_have_read(
    kind: InjectedKind, fault: dict[str, float | str], allowed_K: float
) -> None:
    """Allowed is what the sensor's noise (0.02 K) and the stated uncertainty of the repair make plausible."""
    out = screened(faulty_folder(kind, **fault), NAMES)
    error_K = column(out.folder.campaign(FAULTY).temperatures, SENSOR) - column(healthy(), SENSOR)
    assert np.sqrt(np.mean(error_K**2)) < allowed_K
    channel = next(c for c in out.channels if c.sensor == SENSOR)
    assert {f.kind for f in channel.findings} == {"drift" if kind == "detached" else kind}
    assert not channel.left_out
    if kind in ("stuck", "drift", "detached", "missing"):
        late = channel.u_K > 0.0
        assert 0.3 < np.sqrt(np.mean((error_K / np.where(late, channel.u_K, np.inf))[late] ** 2)) < 3.0


def test_the_uncertainty_of_a_rebuilt_value_grows_with_the_time_since_its_last_good_one() -> None:
    out = screened(faulty_folder("stuck"), NAMES)
    (channel,) = out.channels
    assert np.all(channel.u_K[channel.t_s < START_S - 120.0] == 0.0)
    rebuilt = channel.u_K[channel.t_s > START_S + 600.0]
    assert rebuilt[-1] > rebuilt[0] > 0.0
    assert rebuilt[-1] == pytest.approx(channel.findings[0].repair_u_K, rel=0.05)


def test_the_held_out_campaign_teaches_nothing() -> None:
    """Poisoned readings of the campaign under test change neither the repair of it nor that of the training."""
    spoilt = faulty_folder("jump", size_K=31.0)
    train = tuple(name for name in NAMES if name != "c3")
    wild = replace(spoilt.campaign("c3").temperatures, value_degC=spoilt.campaign("c3").temperatures.value_degC[::-1])
    other = screened(with_temperatures(spoilt, "c3", wild), train, ("c3",))
    usual = screened(spoilt, train, ("c3",))
    for name in train:
        np.testing.assert_array_equal(
            other.folder.campaign(name).temperatures.value_degC, usual.folder.campaign(name).temperatures.value_degC
        )
    # Nor does one tested campaign teach another.
    pair = [screened(f, ("c0", "c1"), (FAULTY, "c3")) for f in (spoilt, with_temperatures(spoilt, "c3", wild))]
    np.testing.assert_array_equal(*(out.folder.campaign(FAULTY).temperatures.value_degC for out in pair))
    # The faulty campaign under test: its own healthy part does not enter the model that judges it.
    alone = screened(spoilt, [n for n in NAMES if n != FAULTY], (FAULTY,))
    together = screened(spoilt, NAMES)
    np.testing.assert_array_equal(
        alone.folder.campaign(FAULTY).temperatures.value_degC, together.folder.campaign(FAULTY).temperatures.value_degC
    )


def loose_folder() -> MachineFolder:
    """One sensor more that nothing else can predict, and that gives no reading in half of one campaign."""
    rng = np.random.default_rng(3)
    out = folder()
    for campaign in out.campaigns:
        table = campaign.temperatures
        walk = np.cumsum(rng.normal(0.0, 0.1, (len(table.t_s), 1)), axis=0)
        wide = Temperatures(table.t_s, (*table.sensor_ids, "coolant"), np.hstack([table.value_degC, 20.0 + walk]))
        if campaign.name == FAULTY:
            wide = with_fault(wide, "coolant", "missing", START_S)
        out = with_temperatures(out, campaign.name, wide)
    sensors = (*out.machine.sensors, out.machine.sensors[0].model_copy(update={"id": "coolant"}))
    return replace(out, machine=out.machine.model_copy(update={"sensors": sensors}))


def test_a_sensor_that_cannot_be_rebuilt_is_left_out_of_its_campaign_and_said_so() -> None:
    loose = loose_folder()
    out = screened(loose, NAMES)
    assert "coolant" not in out.folder.campaign(FAULTY).temperatures.sensor_ids
    assert "coolant" in out.folder.campaign("c1").temperatures.sensor_ids
    (channel,) = out.channels
    assert channel.left_out
    assert np.isnan(channel.used_degC).all()
    assert any("coolant" in n and "cannot be rebuilt" in n for n in out.notes)


def test_a_campaign_without_a_sensor_is_judged_whole_by_a_model_without_it() -> None:
    """The displacement follows `coolant`, which the held-out campaign lost: no state may drop out of the judgement."""
    loose = loose_folder()
    campaigns = []
    for campaign in loose.campaigns:
        assert campaign.drift is not None
        error_um = campaign.drift.error_um.copy()
        walk = column(campaign.temperatures, "coolant")[::5]
        error_um[:, 0] += 30.0 * (np.nan_to_num(walk, nan=20.0) - walk[0])
        campaigns.append(replace(campaign, drift=replace(campaign.drift, error_um=error_um)))
    result = analyze_folder(replace(loose, campaigns=tuple(campaigns)))
    (row,) = (r for r in result.validation if (r.campaign, r.model, r.split) == (FAULTY, "default", "campaign"))
    assert row.n == len(campaigns[2].drift.t_s)  # type: ignore[union-attr]


def test_what_could_not_be_screened_is_named_with_the_reason() -> None:
    """Alone a campaign shows steps and dead channels; what only a comparison shows is said to be open."""
    spoilt = faulty_folder("jump", size_K=31.0)
    out = screened(spoilt, (FAULTY,))
    assert [(f.sensor, f.kind) for _, f in out.findings] == [(SENSOR, "jump")]
    (note,) = (n for n in out.notes if "were not screened" in n)
    assert note.startswith(f"temperatures of campaign {FAULTY} were not screened for all faults")
    assert "no other training campaign" in note
    short = with_temperatures(folder(), "c0", folder().campaign("c0").temperatures.take(slice(0, 29)))
    assert ("c0", "fewer than 30 samples") in screened(short, NAMES).unscreened


def test_two_campaigns_judge_each_other() -> None:
    """A wrong pair is put right so that both agree; which of two is the wrong one only a third could tell."""
    both = ("c0", FAULTY)
    assert screened(folder(), both).findings == ()
    table = with_fault(healthy(), SENSOR, "swapped", -1.0, partner="theta_14")
    ((name, found),) = screened(with_temperatures(folder(), FAULTY, table), both).findings
    assert name in both
    assert (found.kind, {found.sensor, found.partner}) == ("swapped", {SENSOR, "theta_14"})


def test_the_published_tables_give_the_same_results_with_and_without_repair() -> None:
    with_repair, without = (analyze_folder(read_folder(TK6920), repair=repair) for repair in (True, False))
    assert with_repair.model.components == without.model.components
    assert repr(with_repair.validation) == repr(without.validation)
    assert with_repair.screening is not None
    assert with_repair.screening.held == ()
    assert {name for name, _ in with_repair.screening.unscreened} == {"W", "X", "Y"}


def test_sensors_in_another_order_are_the_same_sensors() -> None:
    spoilt = faulty_folder("jump", size_K=31.0)
    table = spoilt.campaign("c1").temperatures
    turned = Temperatures(table.t_s, table.sensor_ids[::-1], table.value_degC[:, ::-1])
    out = screened(with_temperatures(spoilt, "c1", turned), NAMES)
    assert out.unscreened == ()
    np.testing.assert_array_equal(
        out.folder.campaign(FAULTY).temperatures.value_degC,
        jumped().folder.campaign(FAULTY).temperatures.value_degC,
    )


def test_a_fault_that_began_before_the_campaign_is_repaired_in_an_unbroken_recording() -> None:
    """The sensor jumps in the third campaign and stays: the fourth, taken alone, shows no change at all."""
    well, start_s = unbroken(), 25.0 * HOUR_S
    out = screened(cut(with_fault(well, SENSOR, "jump", start_s, size_K=31.0)), NAMES)
    truth = cut(well)
    for name in (FAULTY, "c3"):
        error_K = column(out.folder.campaign(name).temperatures, SENSOR)
        error_K = error_K - column(truth.campaign(name).temperatures, SENSOR)
        assert np.max(np.abs(error_K)) < 0.2
    before, known = out.folder.campaign("c3").before, truth.campaign("c3").before
    assert before is not None
    assert known is not None
    assert np.max(np.abs(column(before.temperatures, SENSOR) - column(known.temperatures, SENSOR))) < 0.2
    assert any(n.startswith(f"campaign c3, sensor {SENSOR}") and "since before the campaign on" in n for n in out.notes)


def test_the_table_and_the_page_hold_the_evidence(tmp_path: Path) -> None:
    write_files(tmp_path, table_files(analysis("jump")))
    with (tmp_path / "screening.csv").open(encoding="utf-8", newline="") as file:
        (row,) = [row for row in csv.DictReader(file) if row["fault"] == "jump"]
    assert (row["campaign"], row["sensor"], row["done"], row["end_s"]) == (FAULTY, SENSOR, "shifted back", "")
    assert float(row["size_K"]) == pytest.approx(31.0, abs=0.1)
    assert float(row["start_s"]) <= START_S <= float(row["detected_s"]) <= START_S + 300.0
    assert float(row["statistic"]) > float(row["threshold"])
    assert 0.0 < float(row["u_K"]) < 0.1
    assert SENSOR not in row["repaired_from"].split()
    write_files(tmp_path, table_files(analysis("jump", repair=False)))
    with (tmp_path / "screening.csv").open(encoding="utf-8", newline="") as file:
        assert {row["done"] for row in csv.DictReader(file)} == {"none"}
    pages = {
        repair: render_page(result, draw(figures))
        for repair, result, figures in (
            (repair, result, screened_channels(result))
            for repair, result in ((True, analysis("jump")), (False, analysis("jump", repair=False)))
        )
    }
    (note,) = (n for n in analysis("jump").notes if SENSOR in n and "jump" in n)
    assert pages[True].count(note) == 1
    assert "used the repaired values" in pages[True]
    assert "Repair was switched off" in pages[False]
    assert f'id="screening_{FAULTY}_{SENSOR}"' in pages[True]
    healthy_page = render_page(analysis("healthy"), Drawings())
    assert "Faulty readings" not in healthy_page


def test_the_picture_shows_what_was_read_what_was_used_and_the_difference() -> None:
    (figure,) = (f for f in screened_channels(analysis("jump")) if SENSOR in f.name)
    above, below = figure.figure.axes
    read, used = (line.get_ydata() for line in above.get_lines()[:2])
    assert np.max(np.asarray(read)) - np.max(np.asarray(used)) > 25.0
    difference_K = np.asarray(below.get_lines()[1].get_ydata())
    assert difference_K[0] == 0.0
    assert difference_K[-1] == pytest.approx(31.0, abs=0.1)
    assert "repaired values" in figure.caption
    drawn = {f.name: f.caption for f in temperatures_over_time(analysis("jump"))}
    assert f"repaired or left out: {SENSOR}" in drawn[f"temperatures_{FAULTY}"]
    assert "repaired" not in drawn["temperatures_c0"]


def test_the_command_repairs_unless_told_otherwise(tmp_path: Path) -> None:
    """The same folder on disk, both ways; the files of the campaigns stay as they are."""
    root = write_folder(faulty_folder("jump", size_K=31.0), tmp_path / "machine")
    kept = {path: path.read_bytes() for path in root.rglob("*.csv")}
    told = {}
    for option in ((), ("--no-repair",)):
        result = CliRunner().invoke(app, ["analyze", str(root), "--out", str(tmp_path / "out"), "--json", *option])
        assert result.exit_code in (0, 3), result.output
        told[option] = json.loads(result.stdout)
    assert {path: path.read_bytes() for path in root.rglob("*.csv")} == kept
    for data in told.values():
        (found,) = data["screening"]
        assert (found["campaign"], found["sensor"], found["kind"]) == (FAULTY, SENSOR, "jump")
    rms_um = [
        next(
            row["rms_after_um"]
            for row in data["validation"]
            if (row["campaign"], row["model"], row["split"]) == (FAULTY, "default", "campaign")
        )
        for data in told.values()
    ]
    assert rms_um[1] > 20.0 * rms_um[0]


def test_a_faulty_campaign_is_cleaned_before_it_teaches() -> None:
    """A campaign with a jump would teach that this sensor jumps, and hide the drift in another."""
    spoilt = faulty_folder("jump", size_K=31.0)
    drifting = with_fault(folder().campaign("c3").temperatures, SENSOR, "drift", START_S, rate_K_per_h=0.5)
    found = screened(with_temperatures(spoilt, "c3", drifting), NAMES).findings
    assert {(name, f.sensor, f.kind) for name, f in found} == {(FAULTY, SENSOR, "jump"), ("c3", SENSOR, "drift")}

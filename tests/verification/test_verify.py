"""Verification: runs of known truth, with every way in which a compensation goes wrong on a machine."""

from __future__ import annotations

import csv
import json
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner
from verification_runs import LAW, Run, true_model, write_folder

import thetacomp
from thetacomp.api import Verification
from thetacomp.arrays import Floats
from thetacomp.cli.main import app
from thetacomp.cli.verify import summary
from thetacomp.errors import AnalysisError
from thetacomp.reading import read_folder
from thetacomp.report.figures_verification import over_time
from thetacomp.verification import VerificationResult, verify_folder
from thetacomp.verification.straightness import END_POINTS, LEAST_SQUARES, straightness_um


def cooled(name: str, t_h: Floats) -> Floats:
    """Another law between temperatures and error: cooling takes part of the heat away, and the rest comes late."""
    return 0.25 + 0.2 * t_h * (-0.6 if name[1] == "Y" else 1.0)


RUNS = {
    "good": Run("good", "on", 0.9, share=1.0, tables=("pitch", "temperature")),
    "reversed": Run("reversed", "on", 0.9, share=-1.0),
    "doubled": Run("doubled", "on", 0.9, share=2.0),
    "never": Run("never", "on", 0.9, share=0.0),
    "partly": Run("partly", "on", 0.9, share=0.4),
    "axis": Run("axis", "on", 0.9, share=1.0, shares={"EXX": -1.0, "EYX": -1.0, "EZX": -1.0}),
    "one": Run("one", "on", 0.9, share=1.0, shares={"EZY": -1.0}),
    "mode": Run("mode", "on", 0.9, share=1.0, mode="oil cooling", law=cooled),
    "hidden": Run("hidden", "on", 0.9, share=1.0, law=cooled),
    "little": Run("little", "on", 0.3, share=1.0),
    "hot": Run("hot", "on", 1.4, share=1.0),
    "tables": Run("tables", "on", 0.9, share=1.0, tables=()),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_folder(tmp_path_factory.mktemp("verify") / "machine", [Run("off"), *RUNS.values()])


@pytest.fixture(scope="module")
def verified(folder: Path) -> dict[str, VerificationResult]:
    """Every run against the same run off; a fit to it says what to expect."""
    read = read_folder(folder)
    return {name: verify_folder(read, ["off"], [name]) for name in RUNS}


# --- go or no-go, and the cause by name -------------------------------------------------------------------------------


def test_a_good_compensation_is_a_go(verified: dict[str, VerificationResult]) -> None:
    result = verified["good"]
    assert result.go
    assert result.causes == ()
    assert all(share.kind == "applied" for share in result.shares if share.part == "all")


@pytest.mark.parametrize(
    ("name", "kind", "words"),
    [
        ("reversed", "reversed", "all 9 components that can be judged: the compensation works with the wrong sign"),
        ("doubled", "doubled", "all 9 components that can be judged: the compensation is applied twice"),
        ("never", "not active", "all 9 components that can be judged: the compensation was not active"),
        ("partly", "partly", "only a part of the correction arrives"),
        ("axis", "reversed", "axis X (EXX, EYX, EZX): the compensation works with the wrong sign"),
        ("one", "reversed", "EZY: the compensation works with the wrong sign"),
        ("mode", "mode", "another operating mode: 'no cooling' with compensation off, 'oil cooling' with"),
        ("hidden", "relation", "the relation between temperatures and error is not that of the run with compensation"),
        ("little", "heat", "the two runs are not comparable: on 30 % of off"),
        ("tables", "tables", "different tables were active in the control: pitch active only with compensation off"),
    ],
)
def test_a_no_go_names_its_cause_and_no_other(
    verified: dict[str, VerificationResult], name: str, kind: str, words: str
) -> None:
    result = verified[name]
    assert not result.go
    assert [cause.kind for cause in result.causes] == [kind]
    assert words in result.causes[0].text


def test_shares_come_back_inside_their_intervals(verified: dict[str, VerificationResult]) -> None:
    for name, truth in (("good", 1.0), ("reversed", -1.0), ("doubled", 2.0), ("never", 0.0), ("partly", 0.4)):
        shares = [share for share in verified[name].shares if share.part == "all"]
        assert len(shares) == len(LAW)
        assert sum(share.low <= truth <= share.high for share in shares) >= 7
        assert np.median([share.value for share in shares]) == pytest.approx(truth, abs=0.07)


def test_the_model_that_was_compensated_with_tells_the_same(folder: Path) -> None:
    read, model = read_folder(folder), true_model()
    for name, kinds in (("good", []), ("axis", ["reversed"])):
        result = verify_folder(read, ["off"], [name], model)
        assert [cause.kind for cause in result.causes] == kinds
    # A component that the model does not predict is no fault of the control.
    result = verify_folder(read, ["off"], ["good"], true_model(("EYX",)))
    assert "EYX" not in {share.component for share in result.shares}
    assert any("EYX: the model does not predict it" in note for note in result.notes)


def test_a_model_trained_in_another_mode_is_named(folder: Path) -> None:
    result = verify_folder(read_folder(folder), ["off"], ["good"], true_model(mode="oil cooling"))
    assert [cause.kind for cause in result.causes] == ["mode"]
    assert "'oil cooling' in the training of the model" in result.causes[0].text


def test_one_reversed_register_of_a_component_is_found(tmp_path: Path) -> None:
    """The slope of EXY goes through a sag table, its intercept through K0: either sign can be wrong alone."""
    path = write_folder(tmp_path / "m", [Run("off"), Run("on", "on", share=1.0)])
    sweeps = path / "campaigns" / "on" / "sweeps.csv"
    from verification_runs import rises_K

    head, *rows = sweeps.read_text(encoding="utf-8").splitlines()
    out = [head]
    for row in rows:
        t_s, axis, position, dx, dy, dz = row.split(",")
        if axis == "Y":
            # What the right slope takes away comes back twice.
            rise = rises_K(np.array([float(t_s)]), 1.0)["ty"][0]
            dx = f"{float(dx) + 2 * LAW['EXY'][1] * rise * (float(position) - 1500.0) / 1000.0:.2f}"
        out.append(",".join([t_s, axis, position, dx, dy, dz]))
    sweeps.write_text("\n".join(out) + "\n", encoding="utf-8")
    result = verify_folder(read_folder(path), ["off"], ["on"])
    assert [cause.kind for cause in result.causes] == ["reversed"]
    assert result.causes[0].components == ("slope of EXY",)


def test_a_correction_that_nothing_explains_is_the_model(tmp_path: Path) -> None:
    """Large errors of single sweeps, unrelated to temperature: no fault of the control can be told."""
    runs = [Run("off"), Run("on", "on", share=1.0, rest_um=45.0)]
    result = verify_folder(read_folder(write_folder(tmp_path / "m", runs)), ["off"], ["on"], true_model())
    assert not result.go
    assert not {"reversed", "doubled", "not active"} & {cause.kind for cause in result.causes}


def test_two_heated_sweeps_prove_nothing(tmp_path: Path) -> None:
    runs = [Run("off", rounds=3), Run("on", "on", share=1.0, rounds=3)]
    result = verify_folder(read_folder(write_folder(tmp_path / "m", runs)), ["off"], ["on"], true_model())
    assert all(share.kind == "unclear" for share in result.shares)
    assert all(np.isnan(s.low_percent) for row in result.rows for s in row.statistics)


# --- before and after -------------------------------------------------------------------------------------------------


def test_before_and_after_of_the_column_in_closed_form(verified: dict[str, VerificationResult]) -> None:
    result = verified["never"]
    row = next(r for r in result.rows if r.component == "column_X")
    # 11 µm/K and 12 µm/m/K over 1.5 m, 6.05 K at the end of the warm-up; the sweep at 6 h sees 97 % of it.
    rise_K = 7.0 * (1 - np.exp(-5.5 / 3.0))
    assert row.of("max").before_um == pytest.approx((11 + 12 * 1.5) * rise_K, rel=0.08)
    # 0.9 of the heat, nothing compensated: nothing is gained at like heat, ten per cent as measured.
    assert row.of("rms").like_reduction_percent == pytest.approx(0.0, abs=8.0)
    assert row.of("rms").reduction_percent == pytest.approx(10.0, abs=8.0)
    assert result.heat_ratio == pytest.approx(0.9, abs=0.01)


def test_the_published_column_deviation_and_a_run_of_known_remainder(tmp_path: Path) -> None:
    """Table 2 of the paper holds 0.45 mm in X (its before); a run that keeps 30 % of every parameter is 70 % better."""
    path = tmp_path / "tk6920"
    shutil.copytree(Path(thetacomp.__file__).parent / "examples" / "tk6920", path)
    shutil.copytree(path / "campaigns" / "Y", path / "campaigns" / "on")
    settings = path / "campaigns" / "on" / "campaign.toml"
    text = settings.read_text(encoding="utf-8").replace('compensation = "off"', 'compensation = "on"')
    settings.write_text(text, encoding="utf-8")
    table = path / "campaigns" / "on" / "parameters.csv"
    with table.open(encoding="utf-8", newline="") as file:
        rows = list(csv.reader(file))
    for row in rows[1:]:
        for k, name in enumerate(rows[0]):
            if row[k] and name in ("intercept_um", "slope_um_per_m"):
                row[k] = repr(0.3 * float(row[k]))
    with table.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file).writerows(rows)
    result = verify_folder(read_folder(path), ["Y"], ["on"])
    column = next(r for r in result.rows if r.component == "column_X").of("max")
    assert column.before_um == pytest.approx(450.0, abs=5.0)
    assert column.reduction_percent == pytest.approx(70.0)
    assert column.low_percent < 70.0 < column.high_percent
    assert [share.value for share in result.shares if share.part == "all"] == pytest.approx([0.7] * 3)
    assert result.go
    assert any("only a part of the correction arrives" in note for note in result.notes)


def test_a_hotter_run_is_compared_at_like_heat(verified: dict[str, VerificationResult]) -> None:
    result = verified["hot"]
    assert result.go
    row = next(r for r in result.rows if r.component == "column_X").of("max")
    assert row.like_before_um == pytest.approx(1.4 * row.before_um, rel=0.05)
    assert row.like_reduction_percent > row.reduction_percent


def test_bounds_enclose_the_percentages_and_are_wider_for_noisy_runs(tmp_path: Path) -> None:
    widths = []
    for k, rest_um in enumerate((2.0, 12.0)):
        runs = [Run("off", rest_um=rest_um), Run("on", "on", share=1.0, rest_um=rest_um)]
        result = verify_folder(read_folder(write_folder(tmp_path / str(k), runs)), ["off"], ["on"])
        one = next(r for r in result.rows if r.component == "column_X").of("max")
        assert one.low_percent < one.like_reduction_percent < one.high_percent
        widths.append(one.high_percent - one.low_percent)
    assert widths[1] > 2.0 * widths[0]


def test_harm_is_found_where_it_was_made(verified: dict[str, VerificationResult]) -> None:
    worst = max(verified["one"].harm, key=lambda one: one.largest_um)
    assert worst.component == "EZY"
    # -9 and -8 µm/m/K: the error is largest at the top of the column, at the end of the warm-up.
    assert worst.largest_at_mm == pytest.approx(3000.0)
    assert 4.0 < worst.largest_at_s / 3600 < 7.5
    assert worst.largest_um == pytest.approx(0.9 * (9 + 8 * 1.5) * 7 * (1 - np.exp(-5.5 / 3)), rel=0.25)
    assert all(one.largest_um <= one.limit_um for one in verified["good"].harm)


# --- straightness and squareness --------------------------------------------------------------------------------------


def test_straightness_has_no_tilt_and_knows_both_reference_lines() -> None:
    p = np.linspace(0.0, 3000.0, 31)
    assert straightness_um(p, 0.099 * p + 7.0, LEAST_SQUARES) == pytest.approx(0.0, abs=1e-9)
    # A parabola of 12 µm sag: from the chord 12 µm; the least-squares line is parallel to it, the range the same.
    sag = 12.0 * (1 - (2 * p / 3000.0 - 1) ** 2)
    assert straightness_um(p, sag, END_POINTS) == pytest.approx(12.0)
    assert straightness_um(p, sag + 0.05 * p, LEAST_SQUARES) == pytest.approx(12.0)
    # p³ on -1 … 1 from its end-point line p: extremes ±2/(3√3); from the least-squares line 3p/5: ±0.4 at the ends.
    x = np.linspace(-1.0, 1.0, 2001)
    assert straightness_um(x, x**3, END_POINTS) == pytest.approx(4 / (3 * np.sqrt(3)), rel=1e-5)
    # The line through n points differs from the one through all of them by 2/n.
    assert straightness_um(x, x**3, LEAST_SQUARES) == pytest.approx(0.8, rel=2e-3)


def test_tilt_is_squareness_and_not_straightness(verified: dict[str, VerificationResult]) -> None:
    result = verified["never"]
    tilt = next(s for s in result.squareness if s.name == "EXY")
    rise_K = 7.0 * (1 - np.exp(-5.5 / 3.0))
    assert tilt.off_urad == pytest.approx(12 * rise_K, rel=0.08)
    assert tilt.on_urad == pytest.approx(0.9 * 12 * rise_K, rel=0.1)
    bend = next(s for s in result.straightness if s.component == "EXY" and s.line == LEAST_SQUARES)
    # The machine bends by its geometry alone, cold and warm; noise of ± 3 µm comes on top.
    assert bend.off_um == pytest.approx(bend.cold_off_um, abs=8.0)
    angle = next(s for s in result.squareness if s.name == "X-Y")
    # EXY and EYX both turn the right angle the same way: 12 and 2 µrad/K.
    warmest_K = 8.0 * (1 - np.exp(-5.2 / 2.0))
    assert angle.off_urad == pytest.approx(12 * rise_K + 2 * warmest_K, rel=0.1)
    assert {s.component for s in result.straightness}.isdisjoint({"EXX", "EYY", "EZW"})


# --- contradictions and hard cases ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("off", "on", "words"),
    [
        (["good"], ["reversed"], 'campaign good is named with --off, but its campaign.toml says compensation = "on"'),
        (["off"], ["off"], "campaign off is named twice"),
        (["off"], ["none"], "there is no campaign none"),
        (["off"], ["good", "mode"], "have different operating modes"),
        (["off"], ["good", "tables"], "have different active tables"),
    ],
)
def test_contradictions_are_refused(folder: Path, off: list[str], on: list[str], words: str) -> None:
    with pytest.raises(AnalysisError, match=re.escape(words)):
        verify_folder(read_folder(folder), off, on)


def test_a_baseline_that_was_compensated_is_no_baseline(tmp_path: Path) -> None:
    runs = [Run("off", tables=("temperature",)), Run("on", "on", share=1.0, tables=("temperature",))]
    result = verify_folder(read_folder(write_folder(tmp_path / "m", runs)), ["off"], ["on"])
    assert [cause.kind for cause in result.causes] == ["tables"]
    assert "was active in the run that is named as the uncompensated one" in result.causes[0].text


def test_several_campaigns_of_one_run_are_taken_together(tmp_path: Path) -> None:
    runs = [Run("a"), Run("b", heat=0.8), Run("c", "on", share=1.0), Run("d", "on", heat=1.1, share=1.0)]
    result = verify_folder(read_folder(write_folder(tmp_path / "m", runs)), ["a", "b"], ["c", "d"])
    assert result.go
    assert next(r for r in result.rows if r.component == "EXY").states_on == 16


def test_without_a_law_only_like_heat_is_compared(folder: Path, verified: dict[str, VerificationResult]) -> None:
    model = true_model()
    nothing = model.model_copy(update={"control": {}})
    like = verify_folder(read_folder(folder), ["off"], ["good"], nothing)
    assert like.go
    assert np.isnan(like.heat_ratio)
    assert all(np.isnan(r.of("max").low_percent) for r in like.rows)
    unlike = verify_folder(read_folder(folder), ["off"], ["hot"], nothing)
    assert [cause.kind for cause in unlike.causes] == ["heat"]


# --- the command and its page -----------------------------------------------------------------------------------------


def run_command(folder: Path, on: str, out: Path, *more: str) -> tuple[int, str]:
    arguments = ["verify", str(folder), "--off", "off", "--on", on, "--out", str(out), *more]
    result = CliRunner().invoke(app, arguments)
    return result.exit_code, result.stdout


def test_the_command_ends_with_three_for_a_no_go(folder: Path, tmp_path: Path) -> None:
    code, text = run_command(folder, "reversed", tmp_path / "out")
    assert code == 3
    assert text.splitlines()[0].startswith("NO-GO: known mill, off off, on reversed")
    assert "cause: all 9 components that can be judged: the compensation works with the wrong sign" in text
    page = (tmp_path / "out" / "verification.html").read_text(encoding="utf-8")
    assert "NO-GO" in page
    assert "wrong sign" in page
    assert "http" not in page.replace("http-equiv", "").replace("http://www.w3.org", "").replace("http://purl.org", "")


def test_a_go_counts_its_notes(verified: dict[str, VerificationResult]) -> None:
    good = verified["good"]
    for notes, verdict in (((), "GO"), (("a",), "GO WITH 1 NOTE"), (("a", "b"), "GO WITH 2 NOTES")):
        result = replace(good, notes=notes)
        lines = summary(result, (Path("verification.html"),)).text.splitlines()
        assert lines[0].startswith(f"{verdict}: known mill")
        assert sum(line.startswith("note: ") for line in lines) == len(notes)
        assert repr(Verification(result)).startswith(f"Verification of known mill: {verdict}, off off")
    assert replace(verified["reversed"], notes=("a",)).verdict == "NO-GO"


def test_the_command_ends_with_zero_for_a_go_and_writes_tables(folder: Path, tmp_path: Path) -> None:
    true_model().save(tmp_path / "model.json")
    code, text = run_command(folder, "good", tmp_path / "out", "--json", "--model", str(tmp_path / "model.json"))
    assert code == 0
    data = json.loads(text)
    assert data["go"] is True
    assert data["causes"] == []
    with (tmp_path / "out" / "verification.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert {row["component"] for row in rows} == {*LAW, "column_X", "column_Z"}
    assert {row["statistic"] for row in rows} == {"max", "p95", "rms"}
    column = next(row for row in rows if (row["component"], row["statistic"]) == ("column_X", "max"))
    percent = 100 * (1 - float(column["after_um"]) / float(column["like_before_um"]))
    assert float(column["like_reduction_percent"]) == pytest.approx(percent, abs=0.01)
    for name in data["files"]:
        assert Path(name).stat().st_size > 0
    names = {Path(name).name for name in data["files"]}
    assert {
        "verification.html",
        "verification_over_time.png",
        "verification_share.svg",
        "verification_harm.png",
    } <= names


@pytest.mark.needs("chromium")
def test_the_figure_over_time_shows_every_point_of_both_columns(verified: dict[str, VerificationResult]) -> None:
    good = verified["good"]
    for larger in ("column_X", "column_Z"):
        lines = [
            replace(line, largest_um=10.0 * line.largest_um) if line.component == larger else line
            for line in good.states_off
        ]
        for axes in over_time(replace(good, states_off=tuple(lines))).figure.axes:
            drawn_um = np.concatenate([np.asarray(line.get_ydata(), dtype=float) for line in axes.lines])
            assert axes.get_ylim()[1] >= np.nanmax(drawn_um)


def test_the_page_is_one_sheet_of_paper(folder: Path, tmp_path: Path) -> None:
    run_command(folder, "hidden", tmp_path)  # the run with the longest words
    sheet = tmp_path / "page.pdf"
    subprocess.run(
        ["chromium", "--headless", "--no-sandbox", "--disable-gpu", "--no-pdf-header-footer",
         f"--user-data-dir={tmp_path / 'profile'}", f"--print-to-pdf={sheet}",
         (tmp_path / "verification.html").as_uri()],
        capture_output=True, timeout=60, check=True,
    )  # fmt: skip
    assert re.findall(rb"/Count (\d+)", sheet.read_bytes()) == [b"1"]


def test_a_name_with_markup_cannot_break_the_page(tmp_path: Path) -> None:
    runs = [Run("off", mode="<b>dry</b>"), Run("on", "on", share=1.0, mode="<b>dry</b>", rounds=6)]
    folder = write_folder(tmp_path / "m", [replace(run, rounds=6) for run in runs])
    code, _ = run_command(folder, "on", tmp_path / "out")
    assert code == 0
    page = (tmp_path / "out" / "verification.html").read_text(encoding="utf-8")
    assert "<b>dry</b>" not in page
    assert re.search(r"GO WITH \d NOTES?.*as far as the notes at the foot of the page say", page, re.DOTALL)


def test_a_faulty_sensor_is_mended_before_anything_is_expected_of_it(tmp_path: Path) -> None:
    """The drive sensor of Y jumps by 25 K in the run with compensation on: unscreened, the wrong error is expected."""
    names = ["off_1", "off_2", "off_3"]
    path = write_folder(tmp_path / "m", [*(Run(name) for name in names), Run("on", "on", share=1.0)])
    healthy = verify_folder(read_folder(path), names, ["on"])
    table = path / "campaigns" / "on" / "temperatures.csv"
    head, *rows = [line.split(",") for line in table.read_text(encoding="utf-8").splitlines()]
    for row in rows[len(rows) // 2 :]:
        row[head.index("ty")] = f"{float(row[head.index('ty')]) + 25.0:.3f}"
    table.write_text("\n".join(",".join(row) for row in [head, *rows]) + "\n", encoding="utf-8")
    result = verify_folder(read_folder(path), names, ["on"])
    assert result.go
    assert any("campaign on, sensor ty: jump of +25.0" in note for note in result.notes)
    for name in ("EXY", "EYY", "EZY"):
        mended, known = (
            next(s.value for s in one.shares if s.component == name and s.part == "all") for one in (result, healthy)
        )
        assert mended == pytest.approx(known, abs=0.02)

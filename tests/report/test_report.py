"""The report: all files are written, the page stands alone, names are escaped, no warning escapes."""

from __future__ import annotations

import re
import warnings
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import pytest
from synthetic_analysis import (
    KINDS,
    drift_analysis,
    nasty_names_analysis,
    no_key_point_analysis,
    parameters_analysis,
    sweeps_analysis,
)

from thetacomp.analysis_result import AnalysisResult
from thetacomp.files import write_files
from thetacomp.report import style, tables
from thetacomp.report.analysis_page import render_page, report_files
from thetacomp.report.rendering import Drawings, inline_svg, missing_note, render

VOID = {"meta", "br", "link", "img", "input", "hr"}


class Outline(HTMLParser):
    """Checks that tags are closed in order and collects ids, attributes and text."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.ids: list[str] = []
        self.tags: set[str] = set()
        self.references: list[str] = []
        self.text = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        self.ids += [value for name, value in attrs if name == "id" and value]
        self.references += [value for name, value in attrs if name in ("src", "href", "xlink:href") and value]
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open, f"</{tag}> without a start"
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data


def outline(html: str) -> Outline:
    parsed = Outline()
    parsed.feed(html)
    parsed.close()
    return parsed


def page_of(analysis: AnalysisResult) -> str:
    """The page without its figures: fast, for tests of tables and words."""
    return render_page(analysis, Drawings())


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> tuple[tuple[Path, ...], str]:
    out = tmp_path_factory.mktemp("report")
    paths = write_files(out, report_files(nasty_names_analysis()))
    return paths, paths[0].read_text(encoding="utf-8")


def test_all_files_are_written_and_returned(written: tuple[tuple[Path, ...], str]) -> None:
    paths, _ = written
    assert paths[0].name == "report.html"
    assert all(path.stat().st_size > 500 for path in paths)
    assert {path.suffix for path in paths[1:]} == {".svg", ".png"}
    on_disk = sorted((paths[0].parent / "figures").iterdir())
    assert on_disk == sorted(paths[1:])
    names = {path.stem for path in paths[1:]}
    expected = {"machine_sketch", "error_over_position", "geometry", "fit_X", "before_after_state", "error_over_time"}
    assert expected <= names
    assert len(paths) == 1 + 2 * len(names)


def test_page_needs_no_network_and_no_script(written: tuple[tuple[Path, ...], str]) -> None:
    _, html = written
    parsed = outline(html)
    assert parsed.open == []
    assert all(reference.startswith(("#", "data:image/png;base64,")) for reference in parsed.references)
    assert not {"script", "link", "img", "iframe"} & parsed.tags
    bare = re.sub(r'xmlns(:\w+)?="[^"]*"', "", html)
    assert not re.findall(r"https?://", bare)
    assert not re.findall(r"url\((?!#)", bare)
    assert "default-src 'none'" in html


def test_ids_of_inline_figures_do_not_collide(written: tuple[tuple[Path, ...], str]) -> None:
    _, html = written
    ids = outline(html).ids
    assert len(ids) == len(set(ids))
    for target in re.findall(r'(?:url\(#|href="#)([^")]+)', html):
        assert target in ids


def test_user_names_are_escaped(written: tuple[tuple[Path, ...], str]) -> None:
    _, html = written
    assert "<script" not in html
    assert "&lt;script&gt;alert(" in html
    assert 'A < B & "C"' in outline(html).text


def test_svg_files_are_deterministic_and_without_time() -> None:
    first, second = (render(style_figures(sweeps_analysis())).svg for _ in range(2))
    assert first == second
    assert "dc:date" not in first
    assert "<metadata" not in first
    assert "<text" in first  # text is kept as text


def style_figures(analysis: AnalysisResult) -> style.NamedFigure:
    from thetacomp.report.sketch import machine_sketch

    return machine_sketch(analysis)[0]


def test_svg_names_fallback_fonts_and_never_only_dejavu() -> None:
    svg = render(style_figures(sweeps_analysis())).svg
    families = set(re.findall(r"font(?:-family)?: ?[^;\"]*'DejaVu Sans'[^;\"]*", svg))
    assert families
    assert all("Verdana" in family and family.rstrip().endswith("sans-serif") for family in families)


def test_letters_without_a_font_give_one_clear_note(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    # U+E7C3 is in the private use area: no text font draws it, on any computer.
    monkeypatch.setattr(style, "font_families", lambda: ("DejaVu Sans",))
    analysis = drift_analysis(rows=300, campaigns=2)
    sensor = analysis.folder.machine.sensors[0].model_copy(update={"location": "bed \ue7c3"})
    machine = analysis.folder.machine.model_copy(update={"sensors": (sensor, *analysis.folder.machine.sensors[1:])})
    analysis = replace(analysis, folder=replace(analysis.folder, machine=machine))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        paths = write_files(tmp_path, report_files(analysis))
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.count("note:") == 1
    assert "bed \ue7c3" in said.err
    assert "Fix: install" in said.err
    assert "bed \ue7c3" in paths[0].read_text(encoding="utf-8")


def test_note_for_chinese_names_the_font() -> None:
    assert "fonts-noto-cjk" in missing_note(["立柱"])
    assert "and 2 more" in missing_note(["a", "b", "c", "d", "e"])


def test_inline_svg_prefixes_every_reference() -> None:
    svg = (
        '<?xml version="1.0"?><!DOCTYPE svg><svg width="324pt" height="10pt" viewBox="0 0 1 1">'
        '<g id="a"><use xlink:href="#a" clip-path="url(#a)"/></g></svg>'
    )
    text = inline_svg(svg, "fig", "a &amp; b")
    assert text.startswith("<svg ")
    assert 'id="fig-a"' in text
    assert 'href="#fig-a"' in text
    assert "url(#fig-a)" in text
    assert "width: 50%" in text  # 324 pt of the 648 pt of a full picture
    assert "DOCTYPE" not in text


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_page_of_every_kind_is_well_formed(kind: str) -> None:
    html = page_of(KINDS[kind]())
    parsed = outline(html)
    assert parsed.open == []
    for heading in ("1 Temperature field", "2 Error separation", "3 Key points", "4 Model", "5 Validation"):
        assert heading in parsed.text
    assert "nan" not in re.sub(r"<[^>]+>", " ", html).lower().split()


def test_unproven_sign_is_a_banner_and_never_plainly_fit() -> None:
    text = outline(page_of(parameters_analysis())).text
    assert "Sign unproven: do not send this model to a controller." in text
    assert "Fit for use only after its sign is proven" in text
    assert "Sign unproven" not in outline(page_of(drift_analysis(rows=300, campaigns=2))).text


def test_failed_check_makes_the_verdict_and_stands_first() -> None:
    analysis = drift_analysis(rows=300, campaigns=2)
    broken = replace(analysis.acceptance[-1], passed=False, name="coverage too small")
    analysis = replace(analysis, acceptance=(*analysis.acceptance[:-1], broken))
    verdict = tables.verdict(analysis)
    assert (verdict.level, verdict.text) == ("bad", "Not fit for use")
    assert "coverage too small" in verdict.detail
    text = outline(page_of(analysis)).text
    rows = text[text.index("acceptance check") :]
    assert rows.index("coverage too small") < rows.index(analysis.acceptance[1].name)
    assert tables.verdict(replace(analysis, acceptance=())).level == "open"


def test_before_and_after_with_baselines_stand_together() -> None:
    analysis = sweeps_analysis()
    table, *folded = tables.validation_tables(analysis)
    assert not table.folded
    assert [t.folded for t in folded] == [True, True]  # one for each campaign
    group = next(g for g in table.groups if g.component == "column deviation X")
    assert group.campaign == "all campaigns"
    assert [line.name for line in group.lines] == [
        "model",
        "clock alone",
        "one key sensor",
        "all sensors",
        "uncompensated",
    ]
    row = next(r for r in analysis.validation if r.component == "column_X" and r.model == "default")
    html = page_of(analysis)
    for value in (row.max_before_um, row.max_after_um, row.p95_after_um, row.rms_after_um, row.rms_in_sample_um):
        assert f">{value:.1f}<" in html


def test_states_and_measured_points_are_counted_apart() -> None:
    """Nine states of 2 x 13 points in each of two campaigns; published lines have eight states and no points."""
    measured = tables.validation_tables(sweeps_analysis())[0].groups[0].lines[0]
    assert measured.states == 2 * 9
    assert measured.points == measured.row.n
    analysis = parameters_analysis()
    on_grid = tuple(replace(r, n=8 * 31) if r.component == "EXX" else r for r in analysis.validation)
    lines = tables.validation_tables(replace(analysis, validation=on_grid))[0].groups[0].lines[0]
    assert (lines.states, lines.points) == (8, None)
    assert "248" not in page_of(replace(analysis, validation=on_grid))


def test_a_baseline_that_is_the_default_is_told_once() -> None:
    analysis = parameters_analysis()
    default = next(r for r in analysis.validation if r.component == "EXX" and r.model == "default")
    rows = tuple(
        replace(default, model=r.model) if r.component == "EXX" and r.model in ("one_sensor", "all_sensors") else r
        for r in analysis.validation
    )
    group = tables.validation_tables(replace(analysis, validation=rows))[0].groups[0]
    assert [line.name for line in group.lines] == [
        "model",
        "one key sensor, all sensors",
        "clock alone",
        "uncompensated",
    ]
    assert group.lines[1].remark == "same as default: only one sensor has readings"
    assert group.lines[1].remark in page_of(replace(analysis, validation=rows))


def test_the_only_sensor_with_readings_was_not_chosen() -> None:
    text = outline(page_of(parameters_analysis())).text
    assert "Only sensor with readings: nothing was chosen." in text
    assert "sensors stay" not in text
    assert "nothing was chosen" not in outline(page_of(sweeps_analysis())).text


def test_residuals_are_named_held_out_and_in_sample() -> None:
    analysis = sweeps_analysis()
    html = page_of(analysis)
    part = analysis.model.components["EXX"]
    assert part.held_out_um is not None
    row = html[html.index(part.equation.split(" ")[0] + " = ") :]
    figures = [f">{value:.1f}<" for value in (*part.held_out_um, *part.residual_um)]
    assert sorted(row.index(figure) for figure in figures) == [row.index(figure) for figure in figures]
    assert html.index("residual, held-out") < html.index("residual, in-sample") < html.index("R² in-sample")


def test_a_component_without_a_sensor_is_told_beside_its_equation() -> None:
    analysis = no_key_point_analysis()
    text = outline(page_of(analysis)).text
    assert "EXY: no sensor predicts this component; nothing is compensated." in text
    assert "-0.40" not in text  # a negative R² is no figure to show
    assert "EXX: no sensor" not in text


def test_sections_are_numbered_without_a_gap() -> None:
    for analysis in (sweeps_analysis(), parameters_analysis()):
        numbers = [tuple(map(int, n)) for n in re.findall(r"<h3>(\d+)\.(\d+) ", page_of(analysis))]
        assert numbers == sorted(set(numbers))
        for chapter in {a for a, _ in numbers}:
            own = [b for a, b in numbers if a == chapter]
            assert own == list(range(1, len(own) + 1))
        assert "<h3>" not in re.sub(r"<h3>\d+\.\d+ ", "", page_of(analysis))


def test_one_axis_is_singular() -> None:
    analysis = sweeps_analysis(campaigns=("a",))
    machine = analysis.folder.machine.model_copy(update={"axes": analysis.folder.machine.axes[:1]})
    text = outline(page_of(replace(analysis, folder=replace(analysis.folder, machine=machine)))).text
    assert "15 sensors, 1 axis, 1 campaign: a" in text


def test_headlines_are_the_column_deviations_with_the_clock() -> None:
    lines = tables.headlines(sweeps_analysis())
    assert {line.name for line in lines} == {"column deviation X", "column deviation Z"}
    assert all(line.clock_max_um > line.row.max_after_um for line in lines)
    assert [line.name for line in tables.headlines(drift_analysis(rows=300, campaigns=2))] == ["DY", "DZ", "DX"]


def test_a_larger_error_is_called_more() -> None:
    analysis = parameters_analysis()
    worse = tuple(replace(r, reduction_percent=-84.2) for r in analysis.validation)
    html = page_of(replace(analysis, validation=worse))
    assert "(84.2 % more)" in html
    assert "% less" not in html


def test_long_records_are_thinned_in_the_tables() -> None:
    table = tables.state_tables(drift_analysis(rows=3000, campaigns=1))[0]
    assert len(table.states) == 24
    assert table.skipped == 3000 - 24
    assert (table.states[0], table.states[-1]) == (0, 2999)


@pytest.mark.parametrize(
    ("value", "digits", "text"),
    [(1.25, 1, "1.2"), (-0.04, 1, "0.0"), (float("nan"), 1, "–"), (None, 2, "–"), (-3.456, 2, "-3.46")],
)
def test_number(value: float | None, digits: int, text: str) -> None:
    assert tables.number(value, digits) == text


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "0"), (0.00012, "1.20e-04"), (0.05, "0.05"), (1.6872, "1.687"), (90.55, "90.55"), (451.62, "451.6")],
)
def test_significant(value: float, text: str) -> None:
    assert tables.significant(value) == text


def test_date_words() -> None:
    assert tables.date_words("2026-03-02T10:00:00Z") == "2026-03-02 10:00 UTC"
    assert tables.date_words("some day") == "some day"

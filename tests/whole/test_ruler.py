"""The ruler of bench/: it must see what differs, and only that."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "bench"))

from ruler.difference import Report, compare, told
from ruler.tables import Table, from_csv, from_json, from_page


def full(**columns: list[object]) -> Table:
    return Table("full", columns, ("component",))


def differing(stored: Table, found: Table, intended: list[tuple[str, str]] | None = None) -> Report:
    return compare({"a/table": stored}, {"a/table": found}, intended or [])


@pytest.mark.parametrize(
    ("found", "same"),
    [(250.0, True), (250.0 * (1 + 9e-10), True), (250.0 * (1 + 2e-9), False), (None, False), (True, False)],
)
def test_numbers_with_all_digits_may_differ_by_a_billionth(found: object, same: bool) -> None:
    report = differing(full(component=["EXX"], rms_um=[250.0]), full(component=["EXX"], rms_um=[found]))
    assert bool(report.failing()) is not same


def test_small_numbers_are_compared_with_the_typical_size_of_their_unit() -> None:
    stored = full(component=["EXX"], rms_um=[1e-9])
    assert not differing(stored, full(component=["EXX"], rms_um=[9e-8])).failing()
    assert differing(stored, full(component=["EXX"], rms_um=[2e-7])).failing()


@pytest.mark.parametrize(("found", "same"), [("95.70", True), ("95.74", True), ("95.76", False), ("", False)])
def test_printed_numbers_may_differ_by_half_a_unit_of_the_last_digit(found: str, same: bool) -> None:
    stored = Table("printed", {"dX_um": ["95.7", "1234.5"]})
    assert bool(differing(stored, Table("printed", {"dX_um": [found, "1234.5"]})).failing()) is not same


def test_rows_are_matched_by_what_they_are_about() -> None:
    stored = full(component=["EXX", "EYX"], rms_um=[1.0, 2.0])
    assert not differing(stored, full(component=["EYX", "EXX"], rms_um=[2.0, 1.0])).failing()
    assert differing(stored, full(component=["EXX"], rms_um=[1.0])).failing()
    assert differing(stored, full(component=["EXX", "EYX", "EZX"], rms_um=[1.0, 2.0, 3.0])).failing()


def test_what_is_gone_fails_and_what_is_new_is_only_told() -> None:
    stored = full(component=["EXX"], rms_um=[1.0])
    assert compare({"a/table": stored}, {}, []).failing()
    assert differing(stored, full(component=["EXX"])).failing()
    report = differing(stored, full(component=["EXX"], rms_um=[1.0], p95_um=[2.0]))
    assert not report.failing()
    assert report.added == ["a/table:p95_um"]


def test_intended_differences_stand_apart_with_their_reason() -> None:
    stored, found = full(component=["EXX"], rms_um=[1.0]), full(component=["EXX"], rms_um=[2.0])
    report = differing(stored, found, [("a/*:rms_um", "the RMS is now taken twice")])
    assert not report.failing()
    assert "the RMS is now taken twice" in told(report)
    assert "EQUAL: 2 values compared, 0 differ, 1 differ as intended." in told(report)


def test_json_becomes_tables_with_the_lists_apart() -> None:
    tables = from_json(
        "a", {"exit_code": 0, "axes": [{"axis": "X", "groups": [["t1", "t2"], ["t3"]], "r": {"s": 0.5}}]}
    )
    assert tables["a"].columns == {"exit_code": [0]}
    assert tables["a/axes"].columns == {"axis": ["X"], "r.s": [0.5], "of": ["0"]}
    assert tables["a/axes/groups/value"].columns["value"] == ["t1", "t2", "t3"]


def test_moments_and_versions_are_no_difference(tmp_path: Path) -> None:
    page = from_page("<p>2026-11-30 11:15 UTC · thetacomp 0.1.0</p><style>p {}</style><b>12.5</b>")
    assert page.columns["line"] == ["<moment> · thetacomp <version>", "12.5"]
    path = tmp_path / "a.csv"
    path.write_text("campaign,created\n2026-03-02,2026-11-30T11:15:44+00:00\n", encoding="utf-8")
    assert from_csv(path).columns == {"campaign": ["2026-03-02"], "created": ["<moment>"]}

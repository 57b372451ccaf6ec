"""Tables as files: the same rows as CSV and as .xlsx, and no cell that is a formula."""

from __future__ import annotations

import io
import math

import pytest
from openpyxl import load_workbook
from python_calamine import CalamineWorkbook

from thetacomp.errors import OutputError
from thetacomp.table_file import Number, csv_text, digits, fixed, plain, unit_of, write_table, xlsx_bytes

COLUMNS = ("campaign", "direction", "t_s", "intercept_um", "slope_um_per_m", "stays")
ROWS = (
    ("2026-03-02", "+", Number("3600"), digits(-12.34567891), fixed(0.5, 3), 1),
    ("day, \"two\" <&>", "-", 7200.5, digits(math.nan), None, 0),
)  # fmt: skip


def test_csv_keeps_the_digits_and_leaves_empty_what_is_missing() -> None:
    text = csv_text(COLUMNS, ROWS)
    assert text == (
        "campaign,direction,t_s,intercept_um,slope_um_per_m,stays\n"
        "2026-03-02,+,3600,-12.3457,0.500,1\n"
        '"day, ""two"" <&>",-,7200.5,,,0\n'
    )
    assert csv_text(COLUMNS, ROWS, "\r\n") == text.replace("\n", "\r\n")


def test_an_xlsx_has_numbers_as_numbers_and_a_row_of_units(tmp_path) -> None:
    write_table(tmp_path / "table.xlsx", COLUMNS, ROWS)
    sheet = load_workbook(tmp_path / "table.xlsx").active
    found = [[cell.value for cell in row] for row in sheet.iter_rows()]
    assert found == [
        list(COLUMNS),
        [None, None, "s", "µm", "µm/m", None],
        ["2026-03-02", "+", 3600, -12.3457, 0.5, 1],
        ['day, "two" <&>', "-", 7200.5, None, None, 0],
    ]
    assert [cell.data_type for cell in sheet[3]] == ["s", "s", "n", "n", "n", "n"]
    assert all(cell.font.b for row in sheet["A1:F1"] for cell in row)
    assert sheet.freeze_panes == "A3"
    read = CalamineWorkbook.from_filelike(io.BytesIO(xlsx_bytes(COLUMNS, ROWS))).get_sheet_by_index(0).to_python()
    assert read[2] == ["2026-03-02", "+", 3600.0, -12.3457, 0.5, 1.0]
    assert xlsx_bytes(COLUMNS, ROWS) == xlsx_bytes(COLUMNS, ROWS)


def test_many_columns_keep_their_letters() -> None:
    names = [f"c{k}_um" for k in range(730)]
    sheet = load_workbook(io.BytesIO(xlsx_bytes(names, [range(730)]))).active
    assert [cell.value for cell in sheet[1]] == names
    assert [cell.value for cell in sheet[3]] == list(range(730))


def test_units_stand_at_the_end_of_a_name() -> None:
    names = {"dX_um": "µm", "slope_se_um_per_m": "µm/m", "rise_K": "K", "feed_X_mm_min": "mm/min", "theta_1_degC": "°C",
             "bend_um_per_m2": "µm/m²", "share_percent": "%", "axis": "", "passed": ""}  # fmt: skip
    assert {name: unit_of(name) for name in names} == names


@pytest.mark.parametrize("text", ["=1+1", "+cmd|' /C calc'!A0", "-2+3", "@SUM(A1)", "\t=1", "＝1", "a\rb", " =1"])
@pytest.mark.parametrize("make", [csv_text, xlsx_bytes])
def test_a_formula_is_no_cell(make, text: str) -> None:
    with pytest.raises(OutputError, match="cannot be a cell"):
        make(("name",), [(text,)])
    with pytest.raises(OutputError):
        csv_text((text,), [])


def test_our_own_signs_and_numbers_are_no_formulas() -> None:
    rows = [
        ("+",),
        ("-X",),
        ("-X+Y",),
        ("-500 mm, approach +",),
        ("-500 to 1e+03 mm",),
        (Number("-1.5"),),
        (-1.5,),
        (-3,),
    ]
    assert len(csv_text(("name",), rows).splitlines()) == 9


def test_values_of_a_result_become_cells() -> None:
    assert [plain(value) for value in (True, 2, 0.1 + 0.2, math.inf, None, "text")] == [1, 2, "0.3", "", "", "text"]

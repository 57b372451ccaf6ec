"""Random bytes and random tables: a clear error or a right result, nothing else."""

from __future__ import annotations

import io
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np
import openpyxl
import pandas as pd
from hypothesis import given, settings
from hypothesis import strategies as st
from machine_folders import (
    MACHINE_TOML,
    SENSORS,
    campaign_of_frames,
    csv_text,
    small_machine,
    temperature_rows,
    valid_files,
    write_files,
)

from thetacomp.campaign import MachineFolder
from thetacomp.errors import InputError, Problem
from thetacomp.model.temperatures import Temperatures
from thetacomp.reading import (
    check_folder,
    read_correlations,
    read_positions,
    read_temperatures,
)

C = "campaigns/c"
FILES = (
    *("machine.toml", "recording.toml", "sensor_correlations.csv", f"{C}/campaign.toml", f"{C}/temperatures.csv"),
    *(f"{C}/sweeps.csv", f"{C}/parameters.csv", f"{C}/duty.csv", f"{C}/log.xlsx", f"{C}/drift.parquet"),
)
STARTS = (b"", b"\xef\xbb\xbf", b"\xff\xfe", b"\xfe\xff", b"PK\x03\x04", b"PAR1", b"t_s,theta_1\n", b"format = 1\n")
BOUNDED = settings(max_examples=200, derandomize=True, deadline=None, database=None)


def checked(files: dict[str, str | bytes]) -> tuple[MachineFolder | None, tuple[Problem, ...]]:
    """Either a folder without errors, or errors that say what, where and how; never an exception."""
    with tempfile.TemporaryDirectory() as root:
        folder, problems = check_folder(write_files(Path(root), files))
    errors = [problem for problem in problems if problem.severity == "error"]
    assert (folder is None) == bool(errors)
    for problem in problems:
        assert problem.message
        assert problem.fix
        assert len(str(problem)) < 2000
    return folder, problems


@BOUNDED
@given(st.sampled_from(FILES), st.sampled_from(STARTS), st.binary(max_size=300))
def test_random_bytes_as_any_file(name: str, start: bytes, data: bytes) -> None:
    checked(valid_files(("c",)) | {name: start + data})


Read = TypeVar("Read")


def attempt(read: Callable[[Path], Read], path: Path) -> tuple[Read | None, tuple[Problem, ...]]:
    try:
        return read(path), ()
    except InputError as exc:
        return None, exc.problems


def workbook_bytes() -> bytes:
    book = openpyxl.Workbook()
    sheet = book.worksheets[0]
    sheet.title = "temperatures"
    for row in temperature_rows():
        sheet.append(row)
    stream = io.BytesIO()
    book.save(stream)
    return stream.getvalue()


def parquet_bytes() -> bytes:
    rows = temperature_rows()
    return bytes(pd.DataFrame(rows[1:], columns=[str(name) for name in rows[0]]).to_parquet())


WHOLE = {"log.xlsx": workbook_bytes(), "temperatures.parquet": parquet_bytes()}


@BOUNDED
@given(st.sampled_from(sorted(WHOLE)), st.data())
def test_damaged_workbooks_and_parquet(name: str, draw: st.DataObject) -> None:
    """One byte changed, or the file cut off."""
    data = bytearray(WHOLE[name])
    place = draw.draw(st.integers(0, len(data) - 1))
    if draw.draw(st.booleans()):
        data[place] = draw.draw(st.integers(0, 255))
    else:
        del data[place:]
    checked({"machine.toml": MACHINE_TOML, f"{C}/{name}": bytes(data)})


@BOUNDED
@given(st.sampled_from(list(valid_files(("c",)))), st.data())
def test_one_spoilt_character_in_any_file(name: str, draw: st.DataObject) -> None:
    files: dict[str, str | bytes] = dict(valid_files(("c",)))
    text = str(files[name])
    place = draw.draw(st.integers(0, len(text) - 1))
    char = draw.draw(st.sampled_from(list('0159.,;-"\t\n #µ中')))
    checked(files | {name: text[:place] + char + text[place + 1 :]})


CELLS = st.one_of(
    st.sampled_from(["", "0", "1.5", "1,5", "1.234", "1.234,5", "-3", "nan", "inf", "#N/A", "X", "+", "2026-03-04"]),
    st.text(max_size=6),
    st.floats(allow_nan=False).map(repr),
)
HEADERS = st.one_of(
    st.sampled_from(["t_s", "t_h", "time", "axis", "position_mm", "dX_um", "dX_mm", "X_mm", "component", *SENSORS]),
    st.text(max_size=8),
)


@BOUNDED
@given(
    st.integers(1, 5).flatmap(
        lambda width: st.tuples(
            st.lists(HEADERS, min_size=width, max_size=width),
            st.lists(st.lists(CELLS, min_size=width, max_size=width), max_size=6),
        )
    ),
    st.sampled_from([",", ";", "\t"]),
    st.sampled_from(["utf-8", "utf-8-sig", "utf-16", "gb18030", "cp1252"]),
)
def test_random_tables(table: tuple[list[str], list[list[str]]], delimiter: str, encoding: str) -> None:
    header, rows = table
    lines = [delimiter.join(row) for row in (header, *rows)]
    data = "\n".join(lines).encode(encoding, errors="replace")
    names = ("temperatures", "sweeps", "drift", "parameters")
    for name in names:
        checked({"machine.toml": MACHINE_TOML, f"{C}/{name}.csv": data})
    with tempfile.TemporaryDirectory() as root:
        path = Path(root) / "lone.csv"
        path.write_bytes(data)
        readers: tuple[Callable[[Path], object], ...] = (read_temperatures, read_positions, read_correlations)
        for read in readers:
            data, problems = attempt(read, path)
            assert (data is None) == bool(problems)


# Right tables: the same numbers must come back from every form, or a question where the text is ambiguous.

VALUES = st.one_of(
    st.floats(-60, 250, allow_nan=False).map(lambda value: round(value, 4)),
    st.integers(-60, 250).map(float),
    st.just(float("nan")),
)
TABLES = st.integers(2, 12).flatmap(
    lambda n: st.tuples(
        st.lists(st.integers(0, 30_000), min_size=n, max_size=n, unique=True).map(sorted),
        st.lists(st.tuples(VALUES, VALUES, VALUES), min_size=n, max_size=n),
    )
)


def rows_of(times: list[int], values: list[tuple[float, ...]]) -> list[list[object]]:
    body = [[t, *(None if v != v else v for v in row)] for t, row in zip(times, values, strict=True)]
    return [["t_s", *SENSORS], *body]


def expect(data: Temperatures, times: list[int], values: list[tuple[float, ...]]) -> None:
    wanted = np.array(values)
    kept = [i for i in range(3) if np.isfinite(wanted[:, i]).any()]
    assert data.sensor_ids == tuple(SENSORS[i] for i in kept)
    np.testing.assert_array_equal(data.t_s, times)
    np.testing.assert_array_equal(data.value_degC, wanted[:, kept])


@BOUNDED
@given(TABLES, st.sampled_from([(",", "."), (";", "."), (";", ","), ("\t", "."), ("\t", ",")]),
       st.sampled_from(["utf-8", "utf-8-sig", "utf-16", "gb18030", "cp1252"]), st.booleans())  # fmt: skip
def test_text_round_trip(
    table: tuple[list[int], list[tuple[float, ...]]], signs: tuple[str, str], encoding: str, quoted: bool
) -> None:
    times, values = table
    text = csv_text(rows_of(times, values), *signs)
    if quoted:
        lines = [signs[0].join(f'"{cell}"' for cell in line.split(signs[0])) for line in text.splitlines()]
        text = "\r\n".join(lines)
    with tempfile.TemporaryDirectory() as root:
        path = Path(root) / "t.csv"
        path.write_bytes(text.encode(encoding))
        data, problems = attempt(read_temperatures, path)
    if data is not None:
        expect(data, times, values)
    elif np.isfinite(np.array(values)).any():
        assert [problem.code for problem in problems] == ["thousands"]


@settings(BOUNDED, max_examples=40)
@given(TABLES)
def test_workbook_parquet_and_pandas_round_trip(table: tuple[list[int], list[tuple[float, ...]]]) -> None:
    times, values = table
    rows = rows_of(times, values)
    frame = pd.DataFrame(rows[1:], columns=[str(name) for name in rows[0]])
    if not np.isfinite(np.array(values)).any():
        return
    with tempfile.TemporaryDirectory() as root:
        frame.to_parquet(Path(root) / "t.parquet")
        book = openpyxl.Workbook()
        for row in rows:
            book.worksheets[0].append(row)
        book.save(Path(root) / "t.xlsx")
        for name in ("t.parquet", "t.xlsx"):
            expect(read_temperatures(Path(root) / name), times, values)
    expect(campaign_of_frames(small_machine(), "c", temperatures=frame).temperatures, times, values)

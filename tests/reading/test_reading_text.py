"""Bytes to numbers: encodings, delimiters, decimal signs. Doubt must end in a question, never in a number."""

from __future__ import annotations

import numpy as np
import pytest

from thetacomp.reading.problems import UnreadableError
from thetacomp.reading.text import decimal_sign, decode, split, to_floats


@pytest.mark.parametrize(
    ("text", "encoding"),
    [
        ("t_s,θ_1\n0,20.5\n", "utf-8"),
        ("t_s,θ_1\n0,20.5\n", "utf-8-sig"),
        ("t_s,θ_1\n0,20.5\n", "utf-16"),
        ("时间,温度,主轴\n0,20.5,21\n", "gb18030"),
        ("时间,温度,位移(µm)\n0,20.5,21\n", "gb18030"),  # µ is a four-byte code
        ("温度(℃)\n20.5\n", "gbk"),
        ("t1(℃)\n20.5\n", "gb2312"),
        ("工作表1;時間\n1;2\n", "gb18030"),  # traditional letters are rarer pairs
        ("Temperatur in °C;Verschiebung in µm\n", "cp1252"),
        ("Öl;Kühlmittel;Gehäuse;Straße\n", "cp1252"),
        ("Größe;1\n", "cp1252"),  # öß is also a Chinese letter, but none of everyday use
        ("Température;pièce;côté\n", "cp1252"),
    ],
)
def test_encodings_are_told_apart(text: str, encoding: str) -> None:
    assert decode(text.encode(encoding)) == text


@pytest.mark.parametrize(
    ("data", "code"),
    [
        ("t_s;a°±\n".encode("cp1252"), "encoding"),  # °± is also one everyday Chinese letter
        ("温度".encode("shift-jis"), "encoding"),
        ("температура".encode("cp1251"), "encoding"),
        ("зимнему".encode("cp1251") + b"\xf3", "encoding"),  # an even number of bytes
        (b"\xef\xbb\xbft_s,\xff", "encoding"),
        ("t_s,a".encode("utf-16-le"), "binary-file"),
        (b"\x00\x00\x00", "empty-file"),
        (b" \r\n\t", "empty-file"),
        (b"%PDF-1.4 ...", "binary-file"),
    ],
)
def test_doubtful_bytes_are_asked_about(data: bytes, code: str) -> None:
    with pytest.raises(UnreadableError) as caught:
        decode(data)
    assert caught.value.code == code
    assert caught.value.fix


def test_delimiters() -> None:
    assert split("a;b\n1,5;2\n") == (";", [["a", "b"], ["1,5", "2"]])
    assert split('"a,b";c\n1;2\n')[0] == ";"  # a comma inside quotes parts nothing
    assert split("a,x;b\n1;2\n")[0] == ";"  # only the semicolon gives every row as many cells
    assert split("a\n1\n")[1] == [["a"], ["1"]]
    assert split("a,b\r1,2\r")[1] == [["a", "b"], ["1", "2"]]  # old line ends
    with pytest.raises(UnreadableError, match="several of comma, semicolon and tab"):
        split("a;b,c\n1;2,3\n")


def sign(cells: list[str], delimiter: str) -> str:
    return decimal_sign({"x": cells}, np.arange(2, len(cells) + 2), delimiter)


@pytest.mark.parametrize(
    ("cells", "delimiter", "expected"),
    [
        (["20,5", "21"], ";", ","),
        (["1,234", "21,5"], "\t", ","),  # 21,5 cannot be thousands
        (["0,123"], ";", ","),
        (["1234,567"], ";", ","),
        (["1,234", "1000"], ";", ","),  # who parts thousands would have parted 1000
        (["1.234"], ",", "."),
        (["1.234", "0.5"], ";", "."),
        (["1.5e-3"], ";", "."),
        (["1", "2", ""], ";", "."),
    ],
)
def test_decimal_sign_where_it_is_sure(cells: list[str], delimiter: str, expected: str) -> None:
    assert sign(cells, delimiter) == expected


@pytest.mark.parametrize(
    ("cells", "delimiter", "code"),
    [
        (["1,234"], ";", "thousands"),
        (["1.234", "999"], ";", "thousands"),
        (["1.234.567", "5"], "\t", "thousands"),
        (["1,5", "1.5"], ";", "decimal-mixed"),
        (["1.234,5"], ";", "decimal-mixed"),
        (["1,234.5"], ",", "decimal-mixed"),
        (["20,5"], ",", "decimal-comma"),
    ],
)
def test_decimal_sign_where_it_is_not(cells: list[str], delimiter: str, code: str) -> None:
    with pytest.raises(UnreadableError) as caught:
        sign(cells, delimiter)
    assert caught.value.code == code
    assert (caught.value.rows, caught.value.column) == ((2,), "x")


def test_only_plain_decimal_numbers_are_numbers() -> None:
    cells = ["1", "-2.5", "+.5", "1e3", "", "NaN", "1_000", "inf", "0x1F", "1e999", "１２", "2,5", "--", "1 2"]
    values, bad = to_floats(cells, ".")
    assert values[:4].tolist() == [1, -2.5, 0.5, 1000]
    assert np.isnan(values[4:]).all()
    assert bad == list(range(6, len(cells)))
    values, bad = to_floats(["1,5", "-,25", "1.5", ""], ",")
    assert (values[:2].tolist(), bad) == ([1.5, -0.25], [2])

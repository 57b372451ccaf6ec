"""Which names may enter: a cell of a table must never be a formula, and no text may hold a control character."""

from __future__ import annotations

import unicodedata

# Spreadsheets take a cell that begins so for a formula; the full-width forms in some languages.
_FORMULA = "=+-@＝＋－＠"


def name_fault(text: str) -> str:
    """What is wrong with a name or a text that can reach a table, in words; empty where nothing is."""
    found = next((letter for letter in text if unicodedata.category(letter) in ("Cc", "Zl", "Zp")), None)
    if found is not None:
        return f"it holds the control character U+{ord(found):04X}"
    if text.lstrip()[:1] and text.lstrip()[0] in _FORMULA:
        return f"it begins with '{text.lstrip()[0]}', which a spreadsheet takes for a formula"
    return ""


def checked_name(text: str) -> str:
    """The text as it is. Raises ValueError where it has a fault."""
    fault = name_fault(text)
    if fault:
        raise ValueError(f"{text!r} cannot be used here: {fault}")
    return text

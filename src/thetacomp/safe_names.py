"""Which names may enter: a cell of a table must never be a formula, and no text may hold what cannot be seen."""

from __future__ import annotations

import unicodedata

# Spreadsheets take a cell that begins so for a formula; the full-width forms in some languages.
_FORMULA = "=+-@＝＋－＠"
# Control characters, breaks of line and paragraph, halves of letters; marks that hide or turn what stands beside them.
_UNSEEN = {"Cc": "control", "Zl": "control", "Zp": "control", "Cs": "control", "Cf": "invisible"}


def text_fault(text: str) -> str:
    """What is wrong with a free text, in words; empty where nothing is."""
    kinds = ((letter, _UNSEEN.get(unicodedata.category(letter))) for letter in text)
    found = next(((letter, kind) for letter, kind in kinds if kind), None)
    return f"it holds the {found[1]} character U+{ord(found[0]):04X}" if found else ""


def name_fault(text: str) -> str:
    """What is wrong with a name, which can reach a table, in words; empty where nothing is."""
    fault = text_fault(text)
    if fault or not is_formula(text):
        return fault
    return f"it begins with '{text.lstrip()[0]}', which a spreadsheet takes for a formula"


def is_formula(text: str) -> bool:
    """Whether a spreadsheet takes a cell with this text for a formula."""
    return text.lstrip()[:1] in tuple(_FORMULA)


def checked_text(text: str) -> str:
    """A free text as it is. Raises ValueError where it has a fault."""
    return _checked(text, text_fault(text))


def checked_name(text: str) -> str:
    """A name as it is. Raises ValueError where it has a fault."""
    return _checked(text, name_fault(text))


def _checked(text: str, fault: str) -> str:
    if fault:
        raise ValueError(f"{text!r} cannot be used here: {fault}")
    return text

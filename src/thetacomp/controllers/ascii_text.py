"""Names and sentences in plain ASCII, for files that a control reads."""

from __future__ import annotations

import unicodedata
from collections.abc import Iterable

_SPELLED = {
    **{"ä": "ae", "ö": "oe", "ü": "ue", "Ä": "Ae", "Ö": "Oe", "Ü": "Ue", "ß": "ss", "æ": "ae", "ø": "oe", "ł": "l"},
    **{"µ": "u", "°": "deg", "±": "+/-", "×": "x", "·": "*", "−": "-", "–": "-", "—": "-", "…": "...", "Δ": "d"},
    **{"≤": "<=", "≥": ">=", "“": '"', "”": '"', "„": '"', "‘": "'", "’": "'"},
}


def ascii_text(text: str) -> str:
    """The text with every letter spelled in ASCII (`ä` -> `ae`, `θ` -> `theta`); what has no spelling is left out."""
    return "".join(_spelled(letter) for letter in unicodedata.normalize("NFC", text))


def ascii_names(names: Iterable[str], otherwise: str) -> dict[str, str]:
    """A name in ASCII for each name, all different; `<otherwise>_<place>` where one cannot be spelled in full."""
    wanted = tuple(names)
    out: dict[str, str] = {}
    # Names that are ASCII already keep their spelling, whatever comes before them.
    taken = {name for name in wanted if name.isascii()}
    for place, name in enumerate(wanted, start=1):
        spelled = name if name.isascii() else ascii_text(name)
        whole = all(_spelled(letter) for letter in unicodedata.normalize("NFC", name))
        if not name.isascii() and (not whole or spelled in taken):
            spelled = f"{otherwise}_{place}"
            while spelled in taken:
                spelled += "_"
        taken.add(spelled)
        out[name] = spelled
    return out


def _spelled(letter: str) -> str:
    if letter.isascii():
        return letter
    if letter in _SPELLED:
        return _SPELLED[letter]
    words = unicodedata.name(letter, "").split()
    if words[:1] == ["GREEK"] and "LETTER" in words:
        name = words[words.index("LETTER") + 1].lower()
        return name.capitalize() if "CAPITAL" in words else name
    return unicodedata.normalize("NFKD", letter).encode("ascii", "ignore").decode("ascii")

"""Figures to files: SVG with text kept as text, PNG, and SVG made fit to stand inside a page."""

from __future__ import annotations

import io
import re
import sys
import unicodedata
import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import matplotlib
from markupsafe import Markup, escape
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.text import Text

from thetacomp.report import style

FIGURE_FOLDER = "figures"
PNG_DPI = 160
_NO_METADATA = {"Date": None, "Creator": None, "Format": None, "Type": None}
_MISSING = re.compile(r"Glyph (\d+) ")


@dataclass(frozen=True)
class Rendered:
    """Text of the SVG, bytes of the PNG and what went wrong, in words ("" where nothing did)."""

    svg: str
    png: bytes
    missing: tuple[str, ...]
    remarks: tuple[str, ...]


def render(named: style.NamedFigure) -> Rendered:
    """Draw one figure. Warnings of matplotlib become `missing` texts (no glyph) or remarks; none escapes."""
    figure = named.figure
    svg, png = io.StringIO(), io.BytesIO()
    with warnings.catch_warnings(record=True) as caught, matplotlib.rc_context(style.settings()):  # type: ignore[arg-type]
        warnings.simplefilter("always")
        # Straight to the canvases: figure.savefig draws everything twice.
        FigureCanvasSVG(figure).print_svg(svg, metadata=_NO_METADATA)  # type: ignore[no-untyped-call]
        figure.set_layout_engine("none")  # the layout found for the SVG holds for the PNG
        figure.set_dpi(PNG_DPI)
        FigureCanvasAgg(figure).print_png(png, pil_kwargs={"compress_level": 4})  # type: ignore[no-untyped-call]
    letters: set[str] = set()
    remarks: dict[str, None] = {}
    for warning in caught:
        match = _MISSING.search(str(warning.message))
        if match:
            letters.add(chr(int(match.group(1))))
        else:
            remarks[f"figure {named.name}: {warning.message}"] = None
    texts = dict.fromkeys(t.get_text() for t in figure.findobj(Text) if letters.intersection(t.get_text()))
    return Rendered(_with_fallback_fonts(svg.getvalue()), png.getvalue(), tuple(texts), tuple(remarks))


@dataclass(frozen=True)
class Drawings:
    """Figures with what was drawn of them, in order: for files and for the inside of a page."""

    figures: tuple[style.NamedFigure, ...] = ()
    rendered: tuple[Rendered, ...] = ()

    def files(self, folder: str = FIGURE_FOLDER) -> dict[str, str | bytes]:
        """Every figure as SVG and PNG, by file name."""
        found: dict[str, str | bytes] = {}
        for figure, drawn in zip(self.figures, self.rendered, strict=True):
            found[f"{folder}/{figure.name}.svg"] = drawn.svg
            found[f"{folder}/{figure.name}.png"] = drawn.png
        return found

    def inline(self) -> dict[str, tuple[style.NamedFigure, Markup]]:
        """Figure and its SVG for a page, by name. The drawing is our own, its texts are escaped."""
        return {
            figure.name: (figure, Markup(inline_svg(drawn.svg, figure.name, str(escape(figure.title)))))
            for figure, drawn in zip(self.figures, self.rendered, strict=True)
        }

    def remarks(self) -> list[str]:
        """What went wrong in drawing, as sentences; letters without a font in one of them."""
        missing = dict.fromkeys(text for drawn in self.rendered for text in drawn.missing)
        remarks = dict.fromkeys(remark for drawn in self.rendered for remark in drawn.remarks)
        return ([missing_note(list(missing))] if missing else []) + list(remarks)


def draw(figures: Sequence[style.NamedFigure]) -> Drawings:
    """Draw all figures of a page. Errors are reported on stderr, once."""
    drawings = Drawings(tuple(figures), tuple(render(figure) for figure in figures))
    for remark in drawings.remarks():
        print(f"note: {remark}", file=sys.stderr)
    return drawings


def missing_note(texts: Sequence[str]) -> str:
    """One clear note about letters that the PNG files show as empty boxes."""
    shown = ", ".join(f"'{' '.join(text.split())}'" for text in texts[:3])
    more = f" and {len(texts) - 3} more" if len(texts) > 3 else ""
    chinese = any("CJK" in unicodedata.name(letter, "") for text in texts for letter in text)
    fix = (
        "install a Chinese font such as Noto Sans CJK (Debian, Ubuntu: apt-get install fonts-noto-cjk)"
        if chinese
        else "install a font that has these letters"
    )
    return (
        f"No installed font has all letters of {shown}{more}: the PNG figures show empty boxes there."
        f" report.html and the SVG figures are right wherever the reader's computer has the font."
        f" Fix: {fix} and run again."
    )


def _with_fallback_fonts(svg: str) -> str:
    """Name fonts of about the same width for computers without DejaVu Sans, so that labels keep their places."""
    families = "'DejaVu Sans', Verdana, 'Noto Sans CJK SC', 'Microsoft YaHei', 'PingFang SC', sans-serif"
    return re.sub(r"(font(?:-family)?:[^;\"]*?)'DejaVu Sans'[^;\"]*", lambda m: m.group(1) + families, svg)


def inline_svg(svg: str, name: str, label: str) -> str:
    """An SVG for the inside of a page: no prolog, its own ids, no wider than its place, with a spoken label."""
    body = svg[svg.index("<svg") :]
    # Two figures in one page must not share ids: a clip path of a folded figure would hide parts of another.
    body = re.sub(r'\bid="([^"]+)"', rf'id="{name}-\1"', body)
    body = re.sub(r"url\(#([^)]+)\)", rf"url(#{name}-\1)", body)
    body = re.sub(r'href="#([^"]+)"', rf'href="#{name}-\1"', body)
    width_pt = float(re.search(r'width="([0-9.]+)pt"', body)[1])  # type: ignore[index]
    share = min(100.0, 100.0 * width_pt / (72.0 * style.WIDTH_IN))
    body = re.sub(r'<svg ([^>]*?)width="[^"]*" height="[^"]*"', r"<svg \1", body, count=1)
    opening = f'<svg class="figure" style="width: {share:.0f}%" role="img" aria-label="{label}" '
    return body.replace("<svg ", opening, 1)

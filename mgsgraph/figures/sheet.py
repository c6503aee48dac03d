"""The paper that figures are drawn on: size, title, legend band, caption, colours; and how a sheet becomes files.

No pyplot, and the user's matplotlib settings are neither used nor changed.
"""

import math
import textwrap
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from numpy.typing import NDArray

from mgsgraph.network import PointClass

MOST_SHEETS = 4
"""Sheets of one kind that are drawn; the tables have the rest."""
MOST_MARKS = 2000
"""Marks of one kind in a panel; more make an SVG slow and a panel black."""

BEFORE, AFTER, INK, SOFT = "#E69F00", "#0072B2", "#222222", "#8A8A8A"
CLASS_COLOUR = {PointClass.TIE: "#0072B2", PointClass.LASER: "#D55E00", PointClass.CONTROL: "#009E73"}
"""Okabe & Ito's palette, which colour-blind readers can tell apart; each class has a marker of its own as well."""
CLASS_MARKER = {PointClass.TIE: "o", PointClass.LASER: "^", PointClass.CONTROL: "s"}
CLASS_NAME = {PointClass.TIE: "tie points", PointClass.LASER: "laser points", PointClass.CONTROL: "control points"}

_STYLE: dict[Any, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 8.5,
    "axes.titlesize": 9.0,
    "axes.labelsize": 8.5,
    "axes.edgecolor": "#555555",
    "axes.linewidth": 0.7,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.formatter.useoffset": False,
    "axes.formatter.limits": (-4, 6),
    "grid.color": "#E4E4E4",
    "grid.linewidth": 0.6,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "legend.handletextpad": 0.5,
    "legend.columnspacing": 1.6,
    "lines.linewidth": 1.4,
    "text.color": INK,
    "axes.labelcolor": INK,
    "xtick.color": "#444444",
    "ytick.color": "#444444",
    "svg.fonttype": "path",
    "svg.hashsalt": "mgsgraph",
}
_DPI = 150
_MARGIN, _TITLE, _BAND, _CAPTION_LINE = 0.12, 0.33, 0.27, 0.165
"""inch: white border, heights of the title, the legend band and a line of the caption."""
_LEFT, _RIGHT, _UNDER, _OVER = 0.86, 0.2, 0.45, 0.25
"""inch: room beside the panels for their labels, numbers and titles."""
_INCH_PER_LETTER = 0.0672
"""inch, width of a letter of the caption on the average, on the safe side."""


@contextmanager
def plain_style() -> Iterator[None]:
    """Matplotlib's own defaults with this package's style on top; the user's settings come back afterwards."""
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(_STYLE)
        yield


@dataclass(frozen=True, slots=True, eq=False)
class Sheet:
    """One drawn figure and its words."""

    name: str
    """File name without suffix."""
    title: str
    """Title, which goes into the file's metadata too."""
    caption: str
    """The sentence under it."""
    figure: Figure
    """What is drawn."""
    below: float
    """inch, height of the caption with its borders."""
    above: float
    """inch, height of title and legend band with their borders."""


def new_sheet(name: str, width: float, height: float, title: str, caption: str, band: float = _BAND) -> Sheet:
    """A sheet with title, caption and a legend band (inch), and `height` inches for panels with their labels."""
    lines = textwrap.wrap(caption, int((width - 2.0 * _MARGIN) / _INCH_PER_LETTER)) or [""]
    below = 2.0 * _MARGIN + _CAPTION_LINE * len(lines)
    above = _MARGIN + _TITLE + band
    total = height + below + above
    figure = Figure(figsize=(width, total), dpi=_DPI)
    inset = _MARGIN / width
    figure.text(inset, 1.0 - _MARGIN / total, title, va="top", size=12.0, weight="bold", parse_math=False)
    figure.text(
        inset, _MARGIN / total, "\n".join(lines), va="bottom", size=8.5, color="#333333", linespacing=1.35,
        parse_math=False,
    )
    return Sheet(name, title, caption, figure, below, above)


def panels(
    sheet: Sheet,
    rows: int = 1,
    columns: int = 1,
    left: float = _LEFT,
    across: float = 0.55,
    down: float = 0.14,
    heights: Sequence[float] | None = None,
    widths: Sequence[float] | None = None,
) -> NDArray[np.object_]:
    """Axes (rows, columns) that fill the sheet, with gaps `across` and `down` (inch) and relative heights and widths.

    All borders are fixed: matplotlib's layout engines draw everything once more to measure it, which takes as long as
    the figure itself.
    """
    width, height = (float(size) for size in sheet.figure.get_size_inches())
    bottom, top = sheet.below + _UNDER, height - sheet.above - _OVER
    inner_width, inner_height = width - left - _RIGHT - across * (columns - 1), top - bottom - down * (rows - 1)
    return sheet.figure.subplots(
        rows, columns, squeeze=False, height_ratios=heights, width_ratios=widths,
        gridspec_kw={
            "left": left / width, "right": 1.0 - _RIGHT / width, "bottom": bottom / height, "top": top / height,
            "wspace": across * columns / inner_width, "hspace": down * rows / inner_height,
        },
    )


def words(panel: Axes, x: str = "", y: str = "", title: str = "") -> None:
    """Axis labels and title at fixed distances, so that labels are in line and nothing needs to be measured."""
    assert isinstance(panel.figure, Figure)
    box, (width, height) = panel.get_position(), panel.figure.get_size_inches()
    lines = 1 + y.count("\n")
    panel.set_xlabel(x)
    panel.set_ylabel(y)
    panel.xaxis.set_label_coords(0.5, -0.27 / (box.height * height))
    panel.yaxis.set_label_coords((-0.57 + 0.05 * (lines - 1)) / (box.width * width), 0.5)
    panel.set_title(title, y=1.0, pad=4.0, parse_math=False)


def band_height(figure: Figure) -> float:
    """Middle of the legend band as a share of the figure's height."""
    return 1.0 - (_MARGIN + _TITLE + 0.42 * _BAND) / float(figure.get_figheight())


def legend(figure: Figure, handles: Sequence[Artist]) -> None:
    """A legend in one row, in the band under the title."""
    figure.legend(
        handles=list(handles),
        loc="center left",
        bbox_to_anchor=(_MARGIN / float(figure.get_figwidth()), band_height(figure)),
        ncols=max(len(handles), 1),
        borderaxespad=0.0,
        borderpad=0.0,
    )


def save(sheet: Sheet, folder: Path) -> list[str]:
    """Write PNG and SVG; the names of the files. The same sheet gives the same bytes."""
    figure = sheet.figure
    png, svg = f"{sheet.name}.png", f"{sheet.name}.svg"
    about = {"Title": sheet.title, "Description": sheet.caption}
    agg: Any = FigureCanvasAgg(figure)  # savefig would draw twice
    agg.print_png(folder / png, metadata=about, pil_kwargs={"compress_level": 1})
    vector: Any = FigureCanvasSVG(figure)
    vector.print_svg(folder / svg, metadata={"Date": None, "Creator": "mgsgraph", **about})
    return [png, svg]


def sheet_name(kind: str, number: int, sheets: int) -> str:
    """File name of one of several sheets of a kind, counted from 1; a lone one has no number."""
    return kind if sheets == 1 else f"{kind}_{number}"


def in_sheets(images: Sequence[int], per_sheet: int) -> list[list[int]]:
    """Images by sheet."""
    return [list(images[k : k + per_sheet]) for k in range(0, len(images), per_sheet)]


def left_out(images: int, shown: int, which: str, what: str = "images") -> str:
    """Words for a caption when not all images (or strips) are drawn; `which` says which ones are."""
    return "" if shown >= images else f"; of {images} {what} the {which} are drawn, the tables have all"


def number(value: float, digits: int = 3) -> str:
    """Three significant digits for a caption or label; an en dash for what is not known."""
    if not math.isfinite(value):
        return "–"
    text = f"{value:.{digits}g}"
    return (f"{value:.0f}" if "e+" in text else text).replace("-", "\N{MINUS SIGN}")


def round_figure(value: float) -> float:
    """1, 2 or 5 times a power of ten, the largest that `value` reaches; 1 for zero or NaN."""
    if not (math.isfinite(value) and value > 0.0):
        return 1.0
    power = 10.0 ** math.floor(math.log10(value))
    return float(next(step for step in (5.0, 2.0, 1.0, 0.5) if step * power <= value * (1.0 + 1e-9)) * power)


def short(name: str, letters: int = 40) -> str:
    """A name that fits, with its middle left out where it is too long."""
    if len(name) <= letters:
        return name
    half = (letters - 1) // 2
    return f"{name[:half]}…{name[-half:]}"

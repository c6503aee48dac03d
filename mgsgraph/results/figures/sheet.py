"""What every figure needs: style, size, title, caption, legend, and how a sheet becomes files.

A function that draws a sheet is decorated by `plain_style()`, makes its panels by `Sheet.panels`, and leaves where they
stand to matplotlib's constrained layout. No pyplot, and the user's matplotlib settings are neither used nor changed.
"""

import math
import textwrap
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_pdf import FigureCanvasPdf
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.ticker import Locator
from numpy.typing import NDArray
from PIL import Image

from mgsgraph.analysis.statistics import SHARE
from mgsgraph.geometry.records import Array, Index
from mgsgraph.network import PointClass
from mgsgraph.record import Record

MOST_SHEETS = 4
"""Sheets of one kind that are drawn; the tables have the rest."""
MOST_MARKS = 2000
"""Marks of one kind in a panel; more make an SVG slow and a panel black."""

FLAT = 1.1
"""Largest over smallest value up to which a map says that they are nearly the same everywhere."""

BEFORE, AFTER, INK, SOFT = "#E69F00", "#0072B2", "#222222", "#8A8A8A"
LIGHT = "#56B4E9"
"""In place of AFTER on images, where that dark blue can't be seen."""
CLASS_COLOUR = {PointClass.TIE: "#0072B2", PointClass.LASER: "#D55E00", PointClass.CONTROL: "#009E73",
                PointClass.POST: "#CC79A7"}  # fmt: skip
"""Okabe & Ito's palette, which color-blind readers distinguish; each class has a marker of its own as well."""
CLASS_MARKER = {PointClass.TIE: "o", PointClass.LASER: "^", PointClass.CONTROL: "s", PointClass.POST: "D"}
CLASS_NAME = {PointClass.TIE: "tie points", PointClass.LASER: "laser points", PointClass.CONTROL: "control points",
              PointClass.POST: "posts of terrain models"}  # fmt: skip

_STYLE: dict[Any, Any] = {
    "font.family": "DejaVu Sans", "font.size": 8.5,
    "text.parse_math": False,  # names of users may hold dollar signs
    "axes.titlesize": 9.0, "axes.titlepad": 4.0, "axes.labelsize": 8.5, "axes.edgecolor": "#555555",
    "axes.linewidth": 0.7, "axes.grid": True, "axes.axisbelow": True, "axes.formatter.useoffset": False,
    "axes.formatter.limits": (-4, 6), "grid.color": "#E4E4E4", "grid.linewidth": 0.6, "legend.frameon": False,
    "legend.fontsize": 8.5, "legend.handletextpad": 0.5, "legend.columnspacing": 1.6, "lines.linewidth": 1.4,
    "text.color": INK, "axes.labelcolor": INK, "xtick.color": "#444444", "ytick.color": "#444444",
    "svg.fonttype": "path", "svg.hashsalt": "mgsgraph",
}
_DPI = 150
_MARGIN, _TITLE, _BAND, _CAPTION_LINE = 0.12, 0.33, 0.27, 0.165
"""inch: white border, heights of the title, the legend band and a line of the caption."""
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
class Sheet(Record):
    """One drawn figure with its title and caption."""

    name: str
    """File name without suffix."""
    title: str
    """Title, which goes into the file's metadata too."""
    caption: str
    """The sentence under it."""
    figure: Figure
    """What is drawn."""
    above: float = 0.0
    """inch, height of the title."""
    below: float = 0.0
    """inch, height of the caption."""

    def panels(
        self, rows: int = 1, columns: int = 1, heights: Sequence[float] | None = None,
        widths: Sequence[float] | None = None, **shared: Any,
    ) -> NDArray[np.object_]:
        """Axes (rows, columns) that fill the sheet, of relative heights and widths; `shared`: sharex, sharey."""
        axes: NDArray[np.object_] = self.figure.subplots(
            rows, columns, squeeze=False, height_ratios=heights, width_ratios=widths, **shared
        )
        return axes

    def legend(self, handles: Sequence[Artist]) -> None:
        """A legend in one row, in the middle of the band under the title."""
        width, height = self.figure.get_size_inches().tolist()
        self.figure.legend(
            handles=list(handles), loc="center left", ncols=max(len(handles), 1), borderaxespad=0.0, borderpad=0.0,
            bbox_to_anchor=(_MARGIN / width, 1.0 - (_MARGIN + _TITLE + 0.42 * _BAND) / height),
        )

    def colour_bar(
        self, mappable: ScalarMappable, above: Axes | list[Axes], label: str, ticks: Locator, extend: str = "neither"
    ) -> None:
        """A horizontal colour bar above one panel or several."""
        bar = self.figure.colorbar(
            mappable, ax=above, location="top", fraction=0.04, aspect=40, pad=0.02, ticks=ticks, extend=extend,
        )
        bar.minorticks_off()
        bar.set_label(label)


def new_sheet(
    name: str, width: float, height: float, title: str, caption: str, band: float = _BAND, gap: float = 0.04
) -> Sheet:
    """A sheet with title, caption and a legend band (inch), and `height` inches for panels with their labels, `gap`
    inches above and below each.
    """
    lines = textwrap.wrap(caption, int((width - 2.0 * _MARGIN) / _INCH_PER_LETTER)) or [""]
    below = 2.0 * _MARGIN + _CAPTION_LINE * len(lines)
    total = height + below + _MARGIN + _TITLE + band
    figure = Figure(figsize=(width, total), dpi=_DPI, layout="constrained")
    engine: Any = figure.get_layout_engine()
    left = _MARGIN / width
    inside = 0.5 * left, below / total, 1.0 - left, height / total
    engine.set(rect=inside, w_pad=0.06, h_pad=gap, hspace=0.5 * gap)
    figure.text(left, 1.0 - _MARGIN / total, title, va="top", size=12.0, weight="bold")
    figure.text(left, _MARGIN / total, "\n".join(lines), va="bottom", size=8.5, color="#333333", linespacing=1.35)
    return Sheet(name, title, caption, figure, _MARGIN + _TITLE, below - _MARGIN)


@plain_style()
def encoded(sheet: Sheet, kind: str, with_text: bool = True, **options: Any) -> bytes:
    """A sheet as png, jpg, svg or pdf; the same sheet gives the same bytes. Without `words`, for a page that says title
    and caption itself, these are cut off a png or jpg.
    """
    file = BytesIO()
    drawn_by = {"svg": FigureCanvasSVG, "pdf": FigureCanvasPdf}.get(kind, FigureCanvasAgg)
    canvas: Any = drawn_by(sheet.figure)  # savefig would draw twice
    _fix_layout(sheet.figure)
    if with_text:
        getattr(canvas, f"print_{kind}")(file, **options)
        return file.getvalue()
    canvas.draw()
    picture = Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")
    rows = round(sheet.above * _DPI), picture.height - round(sheet.below * _DPI)
    picture.crop((0, rows[0], picture.width, rows[1])).save(file, "jpeg" if kind == "jpg" else kind, **options)
    return file.getvalue()


def _fix_layout(figure: Figure) -> None:
    """Align labels, and put panels where constrained layout wants them, once; to a millionth of the sheet, for the last
    digits of its solver differ from run to run.
    """
    figure.align_xlabels([axes for axes in figure.axes if axes.get_xlabel()])
    figure.align_ylabels([axes for axes in figure.axes if axes.get_ylabel()])
    engine = figure.get_layout_engine()
    if isinstance(engine, ConstrainedLayoutEngine):
        engine.execute(figure)
        figure.set_layout_engine("none")
        for axes in figure.axes:
            axes.set_position(np.round(axes.get_position(original=True).bounds, 6).tolist())


def save(sheets: Iterable[Sheet], folder: Path) -> list[str]:
    """Write each sheet as PNG; returns the names of the files. The folder is made where it does not exist."""
    folder.mkdir(parents=True, exist_ok=True)
    names = []
    for sheet in sheets:
        about = {"Title": sheet.title, "Description": sheet.caption}
        data = encoded(sheet, "png", metadata=about, pil_kwargs={"compress_level": 1})
        (folder / f"{sheet.name}.png").write_bytes(data)
        names.append(f"{sheet.name}.png")
    return names


def sheet_name(kind: str, number: int, sheets: int) -> str:
    """File name of one of several sheets of a kind, counted from 1; a lone one has no number."""
    return kind if sheets == 1 else f"{kind}_{number}"


def number(value: float, digits: int = 3) -> str:
    """Three significant digits for a caption or label; an en dash for what is not known."""
    if not math.isfinite(value):
        return "–"
    text = f"{value:.{digits}g}"
    return (f"{float(text):.0f}" if "e+" in text else text).replace("-", "\N{MINUS SIGN}")


def round_figure(value: float) -> float:
    """1, 2 or 5 times a power of ten, the largest that `value` reaches; 1 for zero or NaN."""
    if not (math.isfinite(value) and value > 0.0):
        return 1.0
    power = 10.0 ** math.floor(math.log10(value))
    return float(next(step for step in (5.0, 2.0, 1.0, 0.5) if step * power <= value * (1.0 + 1e-9)) * power)


MOST_ROWS = 500
"""Rows of a picture; a block of more images has several in a row."""


def means(values: Array, groups: Index, number: int) -> Array:
    """(number,) mean of the finite values (n,) of each group (n,), counted from 0; NaN where there are none."""
    finite = np.isfinite(values)
    values, groups = values[finite], groups[finite]
    group_sizes = np.bincount(groups, minlength=number)
    total = np.bincount(groups, weights=values, minlength=number)
    return np.where(group_sizes > 0, total / np.maximum(group_sizes, 1), np.nan)


def cell_numbers(places: Array, size: Array | tuple[float, float], cells: tuple[int, int]) -> Index:
    """(n,) number of the cell, row by row, in which each place (n, 2) of a rectangle from zero to `size` lies; places
    outside belong to the nearest.
    """
    along, across = np.clip(places * (np.array(cells) / size), 0.0, np.array(cells) - 1.0).astype(np.int64).T
    return np.asarray(along * cells[1] + across)


def limit(values: Array) -> float:
    """Half the width of a colour scale about zero that covers 98 % of the values; 1 where nothing is finite."""
    finite = np.abs(values[np.isfinite(values)])
    return (float(np.quantile(finite, SHARE)) if finite.size else 0.0) or 1.0


def image_rows(images: int, max_rows: int = MOST_ROWS) -> Index:
    """(images,) row of each of so many images in a picture of at most `most` rows, from 0, none of them empty."""
    return np.arange(images) * min(images, max_rows) // max(images, 1)

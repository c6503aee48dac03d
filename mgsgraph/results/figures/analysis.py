"""What an analysis draws: normal quantiles of residuals, residuals of named effects, spectra of residuals, and sigmas
of new points over the overlap of images.
"""

from collections.abc import Iterator, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator, NullFormatter

from mgsgraph.analysis.places import SigmaGrid
from mgsgraph.analysis.residual_spectrum import FALSE_ALARMS, TURNS, ImageSpectrum, ResidualVibrations
from mgsgraph.analysis.residual_tests import ResidualStatistics
from mgsgraph.analysis.systematic import EffectKind
from mgsgraph.analysis.unexplained import Pattern, Unexplained
from mgsgraph.geometry.records import Array
from mgsgraph.results.figures.sheet import AFTER, BEFORE, FLAT, INK, SOFT, Sheet, new_sheet, number, plain_style
from mgsgraph.text import many, short
from mgsgraph.units import DEG

_PANELS_IN_ROW = 4
"""Panels in a row."""
_SIDE = 2.75
"""inch, of a panel with its labels."""


@plain_style()
def quantile_sheet(statistics: Sequence[ResidualStatistics], name: str) -> Sheet:
    """A panel for each group that has residuals which other rows control."""
    shown = [group for group in statistics if group.values.size]
    across = min(max(len(shown), 1), _PANELS_IN_ROW)
    down = -(-max(len(shown), 1) // across)
    title = f"Normalized residuals against the normal distribution: {short(name)}"
    sheet = new_sheet("quantiles", max(6.0, _SIDE * across + 0.6), _SIDE * down, title, _quantile_caption(shown))
    panels = sheet.panels(down, across).ravel().tolist()
    for k, (panel, group) in enumerate(zip(panels, shown, strict=False)):
        _draw_quantiles(panel, group)
        panel.set_title(short(group.name, 38))
        panel.set_xlabel("expected if normal (sigmas)" if k + across >= len(shown) else "")
        panel.set_ylabel("found (sigmas)" if k % across == 0 else "")
    for panel in panels[len(shown) :]:
        panel.set_axis_off()
    sheet.legend([
        Line2D([], [], ls="", marker="o", ms=3.5, mew=0.0, color=AFTER, label="normalized residuals"),
        Line2D([], [], color=INK, lw=1.0, label="consistent sigmas, normal errors"),
        Patch(color=SOFT, alpha=0.3, lw=0.0, label="pointwise 95% band"),
    ])  # fmt: skip
    return sheet


def _draw_quantiles(panel: Axes, group: ResidualStatistics) -> None:
    quantiles = group.quantiles()
    ends = np.array([min(-2.5, quantiles.expected[0]), max(2.5, quantiles.expected[-1])])
    panel.fill_between(quantiles.expected, quantiles.low, quantiles.high, color=SOFT, alpha=0.3, lw=0.0)
    panel.plot(ends, ends, color=INK, lw=1.0)
    panel.plot(quantiles.expected, quantiles.found, ls="", marker="o", ms=2.6, mew=0.0, color=AFTER)
    panel.locator_params(nbins=6)
    panel.text(
        0.05, 0.95, f"rms {number(group.rms)}\n{group.values.size} residuals\n{number(group.effective)} independent",
        transform=panel.transAxes, va="top", size=7.5, linespacing=1.35,
    )  # fmt: skip


def _quantile_caption(shown: Sequence[ResidualStatistics]) -> str:
    """Caption with the main numbers."""
    if not shown:
        return "No residual is controlled by other rows."
    inconsistent = [group.name for group in shown if group.consistent is False]
    return (
        f"Inconsistent with the stated sigmas (1% tests): {', '.join(inconsistent) or 'no group'}. Residuals over "
        "their own sigmas should lie on the line: steeper means sigmas that are too small, flatter too large ones, "
        "bent ends long tails. Correlated residuals count as fewer independent ones."
    )



_MOST_IMAGES = 4
"""Images that are drawn, those with the clearest vibrations first."""
_MARK_FACTOR = 1.3
"""Height of a vibration's mark, in units of its amplitude."""


@plain_style()
def vibrations_sheet(tested: ResidualVibrations, name: str) -> Sheet:
    """A row of panels per image, a column per turn."""
    with_vibrations = [vibration.image for vibration in tested.vibrations]
    images = list(dict.fromkeys([*with_vibrations, *(spectrum.image for spectrum in tested.spectra)]))
    shown = images[:_MOST_IMAGES]
    sheet = new_sheet(
        "vibrations", 9.6, 1.4 + 1.9 * len(shown), f"Vibrations in residuals: {short(name, 50)}",
        _vibration_caption(tested, len(images) - len(shown)),
    )  # fmt: skip
    grid = sheet.panels(len(shown), len(TURNS), sharex="col")
    for row, image in enumerate(shown):
        for column, turn in enumerate(TURNS):
            panel: Axes = grid[row, column]
            spectrum = next(candidate for candidate in tested.spectra
                            if (candidate.image, candidate.turn) == (image, turn))
            _draw_spectrum(panel, spectrum)
            if row == 0:
                panel.set_title(turn)
            panel.set(
                xlabel="frequency (Hz)" if row == len(shown) - 1 else "",
                ylabel=f"{short(image, 18)} (px)" if column == 0 else "",
            )
    sheet.legend([
        Line2D([], [], color=AFTER, label="amplitude"),
        Patch(color=SOFT, alpha=0.45, lw=0.0, label="noise floor (rms)"),
        Line2D([], [], color=INK, ls="--", lw=1.0, label=f"{100.0 - 100.0 * FALSE_ALARMS:g} % level, all frequencies"),
        Line2D([], [], color=BEFORE, marker="v", ls="", ms=6.0, label="vibration"),
    ])  # fmt: skip
    return sheet


def _draw_spectrum(panel: Axes, spectrum: ImageSpectrum) -> None:
    panel.set_xscale("log")
    panel.set_xlim(spectrum.frequencies[0], spectrum.frequencies[-1])
    panel.xaxis.set_major_formatter("{x:g}")
    panel.xaxis.set_minor_formatter(NullFormatter())
    if spectrum.blind:
        panel.set_yticks([])
        panel.text(
            0.5, 0.5, f"not seen: residuals show\n{_percent(spectrum.share)} of it", transform=panel.transAxes,
            ha="center", va="center", color=INK,
        )  # fmt: skip
        return
    bottom = 0.1 * float(np.median(spectrum.floor))
    panel.fill_between(spectrum.frequencies, bottom, spectrum.floor, color=SOFT, alpha=0.45, lw=0.0)
    panel.plot(spectrum.frequencies, spectrum.level, color=INK, ls="--", lw=0.7)
    panel.plot(spectrum.frequencies, np.maximum(spectrum.amplitudes, bottom), color=AFTER, lw=0.8)
    panel.set_yscale("log")
    panel.yaxis.set_major_formatter("{x:g}")
    panel.yaxis.set_minor_formatter(NullFormatter())
    top = max(float(spectrum.amplitudes.max()), float(np.quantile(spectrum.level, 0.9)))
    for peak in spectrum.peaks:
        height = _MARK_FACTOR * peak.amplitude
        panel.plot([peak.frequency], [height], color=BEFORE, marker="v", ms=6.0)
        panel.annotate(f"   {number(peak.frequency)} Hz, {number(peak.amplitude, 2)} px", (peak.frequency, height),
                       va="center", size=8.0)  # fmt: skip
        top = max(top, height)
    panel.set_ylim(bottom, 3.0 * top)


def _percent(share: float) -> str:
    return f"{100.0 * share:.1g} %" if share > 1e-4 else "less than 0.01 %"


def _vibration_caption(tested: ResidualVibrations, left_out: int) -> str:
    return (
        f"{many(len(tested.vibrations), 'vibration')} above the dashed level, which noise alone crosses somewhere in "
        f"{100.0 * FALSE_ALARMS:g} % of such panels. Panels without a curve: residuals don't show such rotations, "
        "which heights of points absorb." + f" {many(left_out, 'more image')} not drawn." * bool(left_out)
    )



_MOST_PANELS = 4
"""Named effects that are drawn."""
_BINS = 24
_FEWEST_IN_BIN = 5
_WIDTH = 3.1
"""inch, of a panel with its labels."""


def unexplained_sheets(tested: Unexplained, name: str) -> Iterator[Sheet]:
    """Up to four panels of named effects; no sheet if no effect is named."""
    if tested.patterns:
        yield _pattern_sheet(tested, name)


@plain_style()
def _pattern_sheet(tested: Unexplained, name: str) -> Sheet:
    shown = tested.patterns[:_MOST_PANELS]
    title = f"What the adjustment cannot explain: {short(name)}"
    sheet = new_sheet("unexplained", 1.0 + _WIDTH * max(len(shown), 2), 3.4, title,
                      _pattern_caption(tested, len(shown)))
    for panel, pattern in zip(sheet.panels(1, len(shown))[0], shown, strict=True):
        _draw_pattern(panel, pattern)
    sheet.legend([
        Line2D([], [], ls="", marker="o", ms=4, mew=0.0, color=AFTER, label="residuals, medians"),
        Patch(color=AFTER, alpha=0.2, lw=0.0, label="middle half of them"),
        Line2D([], [], color=INK, lw=1.2, label="as the effect has it"),
    ])  # fmt: skip
    return sheet


def _draw_pattern(panel: Axes, pattern: Pattern) -> None:
    effect = pattern.effect
    unit = "m" if effect.kind is not EffectKind.CORRELATION and effect.unit != "px" else effect.unit
    panel.axhline(0.0, color=SOFT, lw=0.8)
    if effect.kind is EffectKind.CORRELATION:
        panel.errorbar(pattern.along, pattern.residuals, 2.0 * pattern.shown, color=AFTER, ls="", marker="o", ms=4,
                       capsize=2)
        panel.set(xlabel=f"points within ({unit})", ylabel="correlation and 2 sigma")
    else:
        middles, quartiles, shown = binned(pattern)
        panel.fill_between(middles, quartiles[:, 0], quartiles[:, 2], color=AFTER, alpha=0.2, lw=0.0)
        panel.plot(middles, quartiles[:, 1], ls="", marker="o", ms=4, mew=0.0, color=AFTER)
        panel.plot(middles, shown, color=INK, lw=1.2)
        timed = effect.kind in (EffectKind.JITTER, EffectKind.TREND)
        phase = f"time within {number(effect.period, 2)} s (s)" if np.isfinite(effect.period) else "time (s)"
        panel.set(xlabel=phase if timed else f"effect ({unit})", ylabel=f"residual ({unit})")
    panel.set_title(f"{effect.kind}: {short(effect.where, 30)}")


def binned(pattern: Pattern) -> tuple[Array, Array, Array]:
    """(b,) medians of what residuals vary with, (b, 3) their quartiles, and (b,) means of the effect, in bins of equal
    numbers.
    """
    order = np.argsort(pattern.along, kind="stable")
    bins = np.array_split(order, max(1, min(_BINS, order.size // _FEWEST_IN_BIN)))
    quartiles = np.array([np.quantile(pattern.residuals[rows], [0.25, 0.5, 0.75]) for rows in bins])
    middles, shown = (np.array([function(values[rows]) for rows in bins])
                      for function, values in ((np.median, pattern.along), (np.mean, pattern.shown)))  # fmt: skip
    return middles, quartiles, shown


def _pattern_caption(tested: Unexplained, drawn_count: int) -> str:
    """Caption with the main numbers."""
    return (
        f"{len(tested.effects)} effects are named by {tested.tests} tests, {drawn_count} are drawn; clearest: "
        f"{tested.effects[0].sentence}. Residuals show of an effect what the adjustment did not absorb."
    )





_TOP_FACTOR = 5.0
"""Times the median sigma where colors end: cells at the rim of the overlap may have any."""


@plain_style()
def raster_sheet(grid: SigmaGrid, name: str) -> Sheet:
    """Maps of the sigmas that new points would have."""
    _, rows, columns = grid.values.shape
    ratio = rows / columns  # cells are square on the ground
    height = float(np.clip(2.4 * ratio, 1.6, 6.0)) + 1.2
    statement = grid.sentence[0].upper() + grid.sentence[1:]
    bands = grid.values[:3]
    low, middle, high = (statistic(bands, axis=(1, 2)) for statistic in (np.nanmin, np.nanmedian, np.nanmax))
    title = "Sigmas of new points over the overlap" + ": nearly the same everywhere" * bool(np.all(high < FLAT * low))
    sheet = new_sheet(name, 9.4, height, title, f"{statement}.", band=0.0)
    west, north = grid.west / DEG, grid.north / DEG
    extent = (west, west + columns * grid.steps[0] / DEG, north - rows * grid.steps[1] / DEG, north)
    panels, tops = sheet.panels(1, 3)[0], np.minimum(high, _TOP_FACTOR * middle).tolist()
    for panel, band, top, direction in zip(panels, bands, tops, ("east", "north", "up"), strict=True):
        shown = panel.imshow(band, extent=extent, aspect="auto", vmin=0.0, vmax=top, interpolation="nearest")
        sheet.colour_bar(shown, panel, f"sigma {direction} (m)", MaxNLocator(4), "max")
        panel.grid(visible=False)
        panel.locator_params(axis="both", nbins=4)
        panel.set_xlabel("east longitude (deg)")
    panels[0].set_ylabel("latitude (deg)")
    return sheet

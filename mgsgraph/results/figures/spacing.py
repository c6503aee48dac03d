"""Orientation images drawn: how well each spacing predicts rays held out, what vibrates, corrections over time."""

from collections.abc import Iterator

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FixedLocator, NullFormatter, NullLocator

from mgsgraph.adjustment.frames import FLIGHT_NAMES
from mgsgraph.analysis.spacing.choice import Choice
from mgsgraph.analysis.spacing.corrections import CorrectionSeries
from mgsgraph.analysis.spacing.spectrum import FALSE_ALARMS, Spectrum
from mgsgraph.analysis.spacing.study import NodeStudy, StripSpectra
from mgsgraph.results.figures.sheet import (
    AFTER,
    BEFORE,
    INK,
    MOST_SHEETS,
    SOFT,
    Sheet,
    new_sheet,
    number,
    plain_style,
    sheet_name,
    short,
)
from mgsgraph.units import ARCSEC, MGON

_GREEN = "#009E73"


def node_sheets(study: NodeStudy) -> Iterator[Sheet]:
    """Misfit by spacing; spectrum and corrections over time of each of the first strips."""
    yield spacing_sheet(study.choice, study.name)
    shown = study.strips[:MOST_SHEETS]
    for k, one in enumerate(shown):
        yield spectrum_sheet(one, sheet_name("spectrum", k + 1, len(shown)))
    courses = study.corrections[:MOST_SHEETS]
    for k, series in enumerate(courses):
        yield corrections_sheet(series, study.choice.spacing, sheet_name("course", k + 1, len(courses)))


@plain_style()
def spacing_sheet(choice: Choice, name: str) -> Sheet:
    """Left: misfit of rays held out over the spacing; right: how much worse than the best one."""
    good = [k for k, one in enumerate(choice.candidates) if not one.refused]
    chosen, best = choice.candidates[choice.chosen], choice.candidates[choice.best]
    refused = [f"{one.spacing:g} s" for one in choice.candidates if one.refused]
    caption = (
        f"{chosen.squares.size} rays held out, predicted with nodes at each spacing: misfit in sigmas that it has when "
        f"orientation is known; noise alone, as rays scatter, is {number(choice.scatter.factor, 3)}. Best: "
        f"{best.spacing:g} s (rms {number(best.rms, 4)}). Chosen: {chosen.spacing:g} s (rms {number(chosen.rms, 4)}), "
        "the coarsest not worse by more than one standard error; "
        "bars are standard errors, on the right of differences ray by ray"
        + (f"; refused, as rays don't support them: {', '.join(refused)}." if refused else ".")
    )
    sheet = new_sheet("spacings", 8.6, 3.6, f"Spacing of orientation images: {short(name, 50)}", caption)
    left, right = sheet.panels(1, 2)[0]
    spacings = np.array([choice.candidates[k].spacing for k in good])
    rms, median = (np.array([getattr(choice.candidates[k], what) for k in good]) for what in ("rms", "median"))
    spread = np.array([choice.candidates[k].median_error for k in good])
    left.errorbar(spacings, rms, choice.rms_errors[good], color=AFTER, marker="o", ms=4.0, capsize=2.5)
    left.errorbar(spacings * 1.04, median, spread, color=BEFORE, marker="s", ms=3.5, capsize=2.5, ls="--", lw=1.0)
    left.axhline(choice.scatter.factor, color=SOFT, lw=0.9)
    left.set(xlabel="spacing (s)", ylabel="misfit held out (sigma)")
    shown = np.maximum(choice.worse[good], 0.0)
    right.errorbar(spacings, shown, choice.worse_errors[good], color=AFTER, marker="o", ms=4.0, capsize=2.5)
    right.axhline(0.0, color=SOFT, lw=0.9)
    positive = shown[shown > 0.0]
    if positive.size and positive.max() > 30.0 * positive.min():
        linear = max(float(np.median(choice.worse_errors[good])), 1e-4)
        right.set_yscale("symlog", linthresh=linear)
        right.yaxis.set_major_formatter("{x:g}")
        right.set_ylim(bottom=-0.5 * linear)
    right.set(xlabel="spacing (s)", ylabel="mean square less the best one's")
    for panel in (left, right):
        panel.set_xscale("log")
        panel.xaxis.set_major_locator(FixedLocator(spacings.tolist()))
        panel.xaxis.set_minor_locator(NullLocator())
        panel.xaxis.set_major_formatter("{x:g}")
        panel.axvline(chosen.spacing, color=_GREEN, lw=5.0, alpha=0.3, zorder=0)
    sheet.legend([
        Line2D([], [], color=AFTER, marker="o", ms=4.0, label="rms"),
        Line2D([], [], color=BEFORE, marker="s", ms=3.5, ls="--", label="from the median"),
        Line2D([], [], color=SOFT, label="noise alone"),
        Patch(color=_GREEN, alpha=0.3, lw=0.0, label="chosen"),
    ])  # fmt: skip
    return sheet


@plain_style()
def spectrum_sheet(found: StripSpectra, name: str) -> Sheet:
    """Amplitudes of the six axes over frequency, with the noise floor."""
    first = found.spectra[0]
    sheet = new_sheet(name, 9.2, 6.9, f"Vibrations of strip {short(first.strip, 50)}", _said(found))
    grid = sheet.panels(3, 2, sharex="col")
    for k, spectrum in enumerate(found.spectra):
        row, column = k % 3, k // 3
        panel: Axes = grid[row, column]
        scale, unit = (1.0, "m") if spectrum.unit == "m" else (MGON, "mgon")
        _draw(panel, spectrum, scale)
        panel.set(xlabel="frequency (Hz)" if row == 2 else "", ylabel=f"{FLIGHT_NAMES[k]} ({unit})")
    sheet.legend([
        Line2D([], [], color=AFTER, label="amplitude"),
        Patch(color=SOFT, alpha=0.45, lw=0.0, label="noise floor (rms)"),
        Line2D([], [], color=INK, ls="--", lw=1.0, label=f"{100.0 - 100.0 * FALSE_ALARMS:g} % level, all frequencies"),
        Line2D([], [], color=BEFORE, ls=":", label="with the prior's departures"),
        Line2D([], [], color="#D55E00", marker="v", ls="", ms=6.0, label="vibration"),
        Line2D([], [], color=_GREEN, lw=1.2, label="Nyquist"),
    ])  # fmt: skip
    return sheet


def _draw(panel: Axes, spectrum: Spectrum, scale: float) -> None:
    frequencies = spectrum.frequencies
    floor, level = spectrum.floor / scale, spectrum.level / scale
    amplitudes = spectrum.amplitudes / scale
    bottom = 0.2 * float(np.median(floor))
    panel.fill_between(frequencies, bottom, floor, color=SOFT, alpha=0.45, lw=0.0)
    panel.plot(frequencies, level, color=INK, ls="--", lw=0.9)
    if np.all(np.isfinite(spectrum.wander)):
        panel.plot(frequencies, spectrum.wander / scale, color=BEFORE, ls=":", lw=1.3)
    panel.plot(frequencies, np.maximum(amplitudes, bottom), color=AFTER)
    panel.axvline(spectrum.nyquist, color=_GREEN, lw=1.2)
    panel.set_yscale("log")
    panel.yaxis.set_major_formatter("{x:g}")
    panel.yaxis.set_minor_formatter(NullFormatter())
    top = max(float(amplitudes.max()), float(np.quantile(level, 0.9)))
    for peak in spectrum.vibrations:
        panel.plot([peak.frequency], [1.35 * peak.amplitude / scale], color="#D55E00", marker="v", ms=6.0)
        panel.annotate(
            f"   {number(peak.frequency)} Hz", (peak.frequency, 1.35 * peak.amplitude / scale), va="center", size=8.0
        )
        top = max(top, 1.35 * peak.amplitude / scale)
    panel.set_ylim(bottom, 2.0 * top)
    panel.set_xlim(0.0, 1.02 * spectrum.nyquist)


def _said(found: StripSpectra) -> str:
    """What one sees, with figures."""
    first = found.spectra[0]
    named = [
        f"{spectrum.axis} {number(peak.amplitude / (1.0 if spectrum.unit == 'm' else MGON))} "
        f"{'m' if spectrum.unit == 'm' else f'mgon ({number(peak.amplitude / ARCSEC)} arcsec)'} at "
        f"{number(peak.frequency)} Hz"
        for spectrum in found.spectra
        for peak in spectrum.vibrations
    ]
    floors = [float(np.median(spectrum.floor)) / MGON for spectrum in found.spectra[3:]]
    what = f"Vibrations: {'; '.join(named[:4])}" if named else "No vibration stands out of noise and the prior"
    more = f" and {len(named) - 4} more" if len(named) > 4 else ""
    return (
        f"{what}{more}. Noise alone shows {', '.join(number(one) for one in floors)} mgon rms in roll, pitch and yaw "
        f"(medians over frequency), and crosses the dashed level somewhere in {100.0 * FALSE_ALARMS:g} % of such "
        f"panels. {found.corrections.times.size} orientation images tell frequencies up to {number(first.nyquist)} Hz; "
        "what is above the level but no vibration is explained by the departures that the prior expects, surer in "
        "another axis, or may be the trace of a stronger one."
    )


@plain_style()
def corrections_sheet(series: CorrectionSeries, spacing: float, name: str) -> Sheet:
    """Corrections of a strip over time, with their sigmas and the nodes."""
    since = series.times - series.times[0]
    sigmas = series.sigmas
    largest = np.abs(series.values).max(axis=0)
    caption = (
        f"Corrections of strip {short(series.strip, 40)} at {series.times.size} orientation images (dots, every "
        f"{spacing:g} s at the most): up to {number(float(largest[:3].max()))} m (sigma up to "
        f"{number(float(sigmas[:, :3].max()))} m) and {number(float(largest[3:].max()) / MGON)} mgon (sigma up to "
        f"{number(float(sigmas[:, 3:].max()) / MGON)} mgon). Lower edge: sigmas for sigma0 = 1."
    )
    sheet = new_sheet(name, 9.6, 7.6, f"Corrections over time: strip {short(series.strip, 50)}", caption)
    grid = sheet.panels(6, 2, heights=[2.0, 1.0] * 3, sharex="col")
    for k in range(6):
        row, column = 2 * (k % 3), k // 3
        scale, unit = (1.0, "m") if k < 3 else (MGON, "mgon")
        value, sigma = series.values[:, k] / scale, sigmas[:, k] / scale
        above, below = grid[row, column], grid[row + 1, column]
        above.axhline(0.0, color=SOFT, lw=0.8, zorder=1)
        above.fill_between(since, value - sigma, value + sigma, color=AFTER, alpha=0.22, lw=0.0)
        above.plot(since, value, color=AFTER, marker="o", ms=2.2, lw=1.0)
        below.plot(since, sigma, color=BEFORE, lw=1.2)
        below.set_ylim(0.0, 1.25 * float(sigma.max()))
        for panel in (above, below):
            panel.set_xlim(since[0], since[-1])
            panel.locator_params(axis="y", nbins=3 if panel is below else 5)
        above.set_ylabel(f"{FLIGHT_NAMES[k]} ({unit})")
        below.set(xlabel="time since the first one (s)" if row == 4 else "", ylabel="sigma")
    sheet.legend([
        Line2D([], [], color=AFTER, marker="o", ms=3.0, label="adjusted minus nominal, at orientation images"),
        Patch(color=AFTER, alpha=0.22, lw=0.0, label="± 1 sigma"),
        Line2D([], [], color=BEFORE, label="sigma"),
    ])  # fmt: skip
    return sheet

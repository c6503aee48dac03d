"""By how much two images contradict each other about footprints, along the second image, before and after."""

from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from mgsgraph.network.footprints import Misregistration
from mgsgraph.registration.case import CaseRegistration
from mgsgraph.results.figures.content import mean, rms
from mgsgraph.results.figures.overlay import MARKERS, STATE_WORDS
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

_COLOURS = {"nominal": BEFORE, "adjusted": AFTER}
_WAYS = ("along the flight", "across the flight")


def discrepancy_sheets(registration: CaseRegistration) -> Iterator[Sheet]:
    """One sheet for each pair of images with footprints in common."""
    pairs = list(dict.fromkeys(
        (one.against, one.image) for profile in registration.before for one in profile.discrepancies if one.shots.size
    ))
    shown = pairs[:MOST_SHEETS]
    omitted = f"; of {len(pairs)} pairs the first {len(shown)} are drawn" if pairs[MOST_SHEETS:] else ""
    for n, pair in enumerate(shown):
        yield _sheet(registration, pair, sheet_name("discrepancy", n + 1, len(shown)), omitted)


@plain_style()
def _sheet(registration: CaseRegistration, pair: tuple[str, str], name: str, omitted: str) -> Sheet:
    found = [
        (state, p, profile.name, one)
        for state, profiles in registration.states()
        for p, profile in enumerate(profiles)
        for one in profile.discrepancies
        if (one.against, one.image) == pair and one.shots.size
    ]
    first, second = (short(one, 30) for one in pair)
    caption = _caption(found, pair) + omitted + "."
    sheet = new_sheet(name, 9.6, 5.6, f"Discrepancy between {first} and {second} at the footprints", caption)
    grid = sheet.panels(2, 1, sharex="col")[:, 0]
    for k, panel in enumerate(grid):
        panel.axhline(0.0, color=SOFT, lw=0.8, zorder=1)
        for state, p, _, one in found:
            _draw(panel, one, k, state, MARKERS[p % len(MARKERS)])
        panel.set_ylabel(f"{_WAYS[k]} (m)")
        panel.margins(y=0.1)
        _spacings(panel, found[0][3].spacing)
    grid[0].set_title(f"{second}: projected place minus the one that {first} and the tie points give")
    grid[1].set_xlabel(f"line of {second} (px)")
    profiles = {name_: p for _, p, name_, _ in found}
    states = dict.fromkeys(state for state, *_ in found)
    sheet.legend([
        *(Line2D([], [], color=_COLOURS[s], marker="o", ms=4, lw=0.9, label=STATE_WORDS[s]) for s in states),
        *(
            Line2D([], [], ls="", marker=MARKERS[p % len(MARKERS)], ms=5, mec=INK, mfc="none",
                   label=f"profile {short(name_, 20)}")
            for name_, p in profiles.items()
        ),
    ])
    return sheet


def _draw(panel: Axes, one: Misregistration, k: int, state: str, marker: str) -> None:
    order = np.argsort(one.lines, kind="stable")
    lines, values, sigmas = one.lines[order], one.metres[order, k], one.metre_sigmas[order, k]
    colour = _COLOURS[state]
    panel.plot(lines, values, color=colour, lw=0.8, marker=marker, ms=2.8, mew=0.7, mfc="white", zorder=3)
    if np.all(np.isfinite(sigmas)):
        panel.fill_between(lines, values - sigmas, values + sigmas, color=colour, alpha=0.18, lw=0.0, zorder=2)


def _spacings(panel: Axes, spacing: float) -> None:
    """The same axis in distances between footprints, on the right."""
    if not np.isfinite(spacing):
        return
    scales = partial(np.multiply, 1.0 / spacing), partial(np.multiply, spacing)
    right = panel.secondary_yaxis("right", functions=scales)
    right.tick_params(labelsize=7.5)
    right.set_ylabel("MOLA spacings", size=8.0, labelpad=2.0)


def _caption(found: Sequence[tuple[str, int, str, Misregistration]], pair: tuple[str, str]) -> str:
    """What one sees, with figures."""
    parts = []
    for state in dict.fromkeys(state for state, *_ in found):
        mine = [one for other, _, _, one in found if other == state]
        along, across = (np.concatenate([one.metres[:, k] for one in mine]) for k in range(2))
        parts.append(
            f"{'before' if state == 'nominal' else 'after'} the adjustment {number(mean(along))} m (rms "
            f"{number(rms(along))}) along the flight and {number(mean(across))} m (rms {number(rms(across))}) across it"
        )
    return (
        f"The places of footprints in {short(pair[1], 30)} are off from where {short(pair[0], 30)} has them, on the "
        f"average {' and '.join(parts)}; bands are one standard deviation of this comparison, which rests on the tie "
        "points; a MOLA spacing is the distance between footprints"
    )

"""Laser shots in an image as the studio shows them."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from mgsgraph.geometry.records import Array
from mgsgraph.results.figures.sheet import AFTER, BEFORE, SOFT, Sheet, new_sheet, plain_style, short


def known(values: Any) -> Array:
    """Numbers, of any shape, in which None stands for what is not known; NaN for these."""
    return np.array(values, dtype=object).astype(np.float64)


@plain_style()
def footprints_sheet(record: Mapping[str, Any]) -> Sheet:
    """Laser shots in an image before and after the adjustment; the image lies on its side."""
    caption = f"{record['sentence']} The image lies on its side, lines to the right."
    sheet = new_sheet("footprints", 9.4, 2.9, f"Laser shots in {short(record['image'], 60)}", caption)
    panel: Axes = sheet.panels()[0, 0]
    for profile in record["profiles"]:
        pairs = zip(profile["before"], profile["after"], strict=True)
        ends = np.array([[one or (np.nan, np.nan) for one in pair] for pair in pairs], dtype=np.float64)
        panel.plot(ends[:, :, 0].T, ends[:, :, 1].T, color=SOFT, lw=0.6, zorder=2)
        panel.plot(ends[:, 0, 0], ends[:, 0, 1], ls="", marker="o", ms=4.0, mfc="none", mec=BEFORE, mew=0.9, zorder=3)
        panel.plot(ends[:, 1, 0], ends[:, 1, 1], ls="", marker="o", ms=2.8, mew=0.0, color=AFTER, zorder=4)
    panel.set(xlim=(0, record["lines"]), ylim=(0, record["samples"]), xlabel="line (px)", ylabel="sample (px)")
    sheet.legend([
        Line2D([], [], ls="", marker="o", ms=5, mfc="none", mec=BEFORE, label="before: archived, nominal orientation"),
        Line2D([], [], ls="", marker="o", ms=4, color=AFTER, label="after: both adjusted"),
    ])  # fmt: skip
    return sheet

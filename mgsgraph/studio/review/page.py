"""The page on which a person reviews tie points: one HTML file without any outside address, pictures as data URIs."""

import base64
import io
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mgsgraph.files.output.page import page_of, write_page
from mgsgraph.files.tie_points import PointKind
from mgsgraph.files.writing import require_free
from mgsgraph.geometry.records import Array
from mgsgraph.matching.chips import REACH, SIDE
from mgsgraph.studio.review.selection import MatchReview
from mgsgraph.studio.review.verdicts import Verdict, Verdicts
from mgsgraph.units import ISIS_OFFSET

_MARKED = 0.75
"""Chip pixels, shift from which on the best match is marked."""
_TEMPLATE = "studio/review/templates/review.html"


def require_page(path: Path) -> None:
    """Raise InputError unless a review may be written there: nothing is there, or an earlier one."""
    require_free(path, page_of(_TEMPLATE), remedy="choose another --out")


def write_review(review: MatchReview, path: Path, verdicts: Verdicts | None = None) -> None:
    """Write the page to an HTML file; an earlier review is replaced. InputError if it can't be written.

    The page begins with earlier verdicts; of points that it doesn't show they are kept in what it saves.
    """
    known = {} if verdicts is None else verdicts.of
    notes = {} if verdicts is None else verdicts.notes
    here = set(review.ties.ids)
    write_page(_TEMPLATE, {
        "review": review,
        "store": _store(review, verdicts),
        "points": _points(review, known, notes),
        "others": [(one, known[one].value, notes.get(one, "")) for one in known if one not in here],
        "sorts": [order[:2] for order in _orders(review)],
        "side": SIDE,
        "reach": REACH,
    }, path)  # fmt: skip


def _store(review: MatchReview, verdicts: Verdicts | None) -> str:
    """Name under which a browser keeps verdicts: those that the page begins with aren't overruled by earlier ones."""
    if verdicts is None:
        return review.digest
    begun = repr((sorted(verdicts.of.items()), sorted(verdicts.notes.items())))
    return f"{review.digest} {zlib.crc32(begun.encode()):08x}"


def _orders(review: MatchReview) -> list[tuple[str, str, Array]]:
    """Key and name of each order in which points may be shown, and figures (n,), the lowest of which comes first."""
    wanted: list[tuple[str, str, Array]] = [
        ("correlation", "correlation, lowest first", review.correlations),
        ("misfit", "misfit of rays, largest first", -review.misfits),
        ("offset", "better match, furthest first", -review.offsets),
        ("residual", "residual, largest first", -review.largest_residuals),
        ("sigma", "sigma, largest first", -review.sigmas),
    ]
    return [order for order in wanted if np.any(np.isfinite(order[2]))]


def _points(review: MatchReview, of: Mapping[str, Verdict], notes: Mapping[str, str]) -> Iterator[dict[str, Any]]:
    """What the page says of each point, one after the other: pictures of thousands need not be there at once."""
    ties = review.ties
    order = np.argsort(ties.measure_point, kind="stable")
    rows = np.split(order, np.cumsum(np.bincount(ties.measure_point, minlength=len(ties.ids)))[:-1])
    orders, correlations = _orders(review), review.correlations
    for i, name in enumerate(ties.ids):
        yield {
            "id": name,
            "kind": PointKind(ties.kinds[i]).name.lower(),
            "verdict": of.get(name, Verdict.UNDECIDED).value,
            "note": notes.get(name, ""),
            "sorts": {key: float(values[i]) for key, _, values in orders if np.isfinite(values[i])},
            "facts": _facts(review, i, float(correlations[i])),
            "measures": [_measure(review, k, first=k == rows[i][0]) for k in rows[i].tolist()],
        }


def _facts(review: MatchReview, i: int, correlation: float) -> list[tuple[str, str]]:
    """Figures of a point, in words."""
    skew, spacing, odd = review.skew[i], review.spacing[i], review.oddness[i]
    misfit = f"{skew:.3g} m = {skew / spacing:.2f} px" if np.isfinite(skew) else "none: one ray"
    return [
        ("correlation", f"{correlation:.3f}" if np.isfinite(correlation) else "none"),
        ("misfit of rays", misfit),
        *([("beside neighbours", f"{odd:+.2f} px")] if np.isfinite(odd) else []),
        ("chip pixel", f"{spacing:.3g} m" if np.isfinite(spacing) else "unknown"),
    ]


def _measure(review: MatchReview, k: int, first: bool) -> dict[str, Any]:
    """What the page says of a measure: `rows` are figures of line and sample."""
    ties, alike, residual = review.ties, review.alike, review.residuals[k]
    line, sample = ties.measures[k].tolist()
    rows = [
        ("ISIS", f"{line + ISIS_OFFSET:.2f}", f"{sample + ISIS_OFFSET:.2f}"),
        ("ours", f"{line:.2f}", f"{sample:.2f}"),
        ("sigma", *(f"{value:.2f}" if np.isfinite(value) else "none" for value in ties.measure_sigmas[k])),
    ]
    if np.all(np.isfinite(residual)):
        rows.append(("residual", f"{residual[0]:+.2f}", f"{residual[1]:+.2f}"))
    shift = alike.shift[k]
    known = bool(np.isfinite(shift[0]))
    if known:
        offset = review.step[k] @ shift
        rows.append(("best at", f"{offset[0]:+.2f}", f"{offset[1]:+.2f}"))
    return {
        "image": ties.measure_image[k],
        "png": base64.b64encode(png(review.chips[k])).decode() if np.isfinite(review.step[k, 0, 0]) else "",
        "rows": rows,
        "remark": _remark(review, k, first),
        "ring": (0.5 * SIDE + shift[1], 0.5 * SIDE + shift[0]) if known and np.hypot(*shift) > _MARKED else None,
    }


def _remark(review: MatchReview, k: int, first: bool) -> str:
    alike = review.alike
    blunder = "; rejected by the adjustment" if review.rejected[k] else ""
    if first:
        return f"reference{blunder}"
    if not np.isfinite(alike.correlation[k]):
        found = f"; {alike.best[k]:.3f} elsewhere" if np.isfinite(alike.best[k]) else ""
        return f"no correlation{found}{blunder}"
    edge = f", or further than {REACH} px" if alike.at_edge[k] else ""
    return f"correlation {alike.correlation[k]:.3f}, best {alike.best[k]:.3f}{edge}{blunder}"


def png(grey: NDArray[np.uint8]) -> bytes:
    """An 8-bit grey picture (rows, columns) as PNG."""
    from PIL import Image  # takes 0.1 s

    file = io.BytesIO()
    Image.fromarray(grey).save(file, "PNG", optimize=True)
    return file.getvalue()

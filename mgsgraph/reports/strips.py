"""Strips in reports: how their trajectories were corrected along time, and how well that is known.

Corrections are those of the orientation images alone, in the terms of the flight (`datum.frames`): along, across and
radial; roll, pitch and yaw. What unknowns that images share do to them on top stands in `shared.csv`.
"""

from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np

from mgsgraph.adjustment.analysis.strip_corrections import StripReport, strip_reports
from mgsgraph.adjustment.datum.frames import FLIGHT_NAMES
from mgsgraph.adjustment.solution import Solution
from mgsgraph.geometry.orientation import COMPONENTS as AXES
from mgsgraph.network import JointNodePrior, Network, NodePrior
from mgsgraph.network.support import support
from mgsgraph.output.csv_json import columns, quoted, whole, write_csv
from mgsgraph.units import ARCSEC, KM, MGON
from mgsgraph.wording import cells, many, short, some, span, three

POSITION, ROTATION = FLIGHT_NAMES[:3], FLIGHT_NAMES[3:]
"""Components of corrections along a strip: m, and rad."""
_SHORT = ("along", "acr.", "rad.")
_J2000 = datetime(2000, 1, 1, 12, tzinfo=UTC)
_ROWS = 24
"""Strips that are listed."""
_NAME = 22
"""Characters of a strip's name in the table."""


# --- tables


def strips_json(solution: Solution) -> list[dict[str, Any]]:
    """For solution.json; units in the keys."""
    return [
        {
            "name": one.name, "basis": one.basis, "images": list(one.images), "nodes": one.nodes,
            "spacing_s": one.spacing, "spacing_lines": one.lines, "spacing_km": one.ground / KM,
            "largest_correction_m": one.largest[:3], "largest_roll_pitch_yaw_mgon": one.largest[3:] / MGON,
            "mean_sigma_m": one.mean_sigmas[:3], "mean_sigma_roll_pitch_yaw_mgon": one.mean_sigmas[3:] / MGON,
            "trend": [_trend_json(*part) for part in one.trend],
        }
        for one in strip_reports(solution)
    ]  # fmt: skip


def _trend_json(part: str, component: str, value: float, sigma: float) -> dict[str, Any]:
    unit, scale = ("mgon", MGON) if component in AXES[3:] else ("m", 1.0)
    return {"part": part, "component": component, f"value_{unit}": value / scale, f"sigma_{unit}": sigma / scale}


def strips_csv(solution: Solution, path: Path) -> None:
    """Write one row per node within a strip: its time, and corrections with sigmas in m, mgon and arcsec."""
    found = strip_reports(solution)
    times = np.concatenate([one.course.times for one in found])
    values, sigmas = (np.concatenate([getattr(one.course, part) for one in found]) for part in ("values", "sigmas"))
    count = [one.course.times.size for one in found]
    text = {
        "strip": [quoted(one.name) for one, n in zip(found, count, strict=True) for _ in range(n)],
        "node": whole(np.concatenate([np.arange(1, n + 1) for n in count])),
        "time_tdb": [calendar(time) for time in times.tolist()],
    }
    since = [one.course.times - one.course.times[0] for one in found]
    numbers = {"time_et_s": times, "time_in_strip_s": np.concatenate(since)}
    for part, of in (("correction", values), ("sigma", sigmas)):
        numbers |= columns([f"{part}_{name}_m" for name in POSITION], of[:, :3])
        for unit, scale in (("mgon", MGON), ("arcsec", ARCSEC)):
            numbers |= columns([f"{part}_{name}_{unit}" for name in ROTATION], of[:, 3:] / scale)
    write_csv(path, text, numbers)


def calendar(time: float) -> str:
    """Calendar date of s TDB past J2000, in TDB: UTC is the leap seconds (64 to 69) behind."""
    return (_J2000 + timedelta(seconds=round(time, 3))).strftime("%Y-%m-%dT%H:%M:%S.%f")[:-3]


# --- words


def strips_statements(solution: Solution) -> list[str]:
    """A sentence or two about each strip."""
    found = strip_reports(solution)
    more = [f"{many(len(found) - _ROWS, 'more strip')}: see solution.json."] if len(found) > _ROWS else []
    return [_words(one) for one in found[:_ROWS]] + more


def _words(one: StripReport) -> str:
    return (
        f"Strip {one.name} ({many(len(one.images), 'image')}): {one.nodes} orientation images ({one.basis}), one every "
        f"{one.spacing:.3g} s, {one.lines:.0f} lines or {one.ground / KM:.3g} km on the ground. They correct the "
        f"trajectory by up to {three(one.largest[:3])} m along, across and radially and by up to "
        f"{three(one.largest[3:] / MGON)} mgon in roll, pitch and yaw, with mean sigmas of "
        f"{three(one.mean_sigmas[:3])} m and {three(one.mean_sigmas[3:] / MGON)} mgon."
    )


def strips_table(solution: Solution) -> str:
    """Aligned text for the terminal; empty without strips."""
    found = strip_reports(solution)
    if not found:
        return ""
    lines = [
        f"{'Strips':<{_NAME + 2}} {'nodes':>5} {'every s':>8} {'lines':>7} {'km':>6}   "
        f"{'mean sigma [m]':>17}  {'mean sigma [mgon]':>23}",
        " " * (_NAME + 36) + " ".join(f"{name:>5}" for name in _SHORT)
        + "  " + " ".join(f"{name:>7}" for name in ROTATION),
    ]  # fmt: skip
    for one in found[:_ROWS]:
        sigmas = one.mean_sigmas
        lines.append(
            f"  {short(one.name, _NAME):<{_NAME}} {one.nodes:>5} {one.spacing:>8.2f} {one.lines:>7.0f} "
            f"{one.ground / KM:>6.1f}   {cells(sigmas[:3], 5)}  {cells(sigmas[3:] / MGON, 7)}"
        )
    if len(found) > _ROWS:
        lines.append(f"  and {many(len(found) - _ROWS, 'more strip')}: see solution.json")
    return "\n".join([*lines, "  (sigmas for sigma0 = 1; every node: strips.csv)"])


def strips_inventory(network: Network) -> str:
    """Strips of a network, with what is known of their trajectories beforehand."""
    lines = ["Strips"]
    for one in network.strips:
        start, stop = one.nodes.coverage
        names = [network.images[j].name for j in one.images.tolist()]
        lines += [
            f"  {one.name}: {some(names, len(names))}",
            f"    {len(one.nodes)} orientation images ({one.nodes.basis}), one every {one.nodes.spacing:.4g} s of "
            f"{stop - start:.4g} s from {calendar(start + one.nodes.epoch)} TDB on",
            f"    a-priori sigmas: {_prior_words(one.prior)}",
        ]
    return "\n".join(lines)


def _prior_words(prior: NodePrior | JointNodePrior) -> str:
    if isinstance(prior, JointNodePrior):
        return "of all nodes jointly"
    parts = [
        f"{name} {span(sigmas[:3])} m and {span(sigmas[3:] / MGON)} mgon"
        for name, sigmas in (("bias", prior.bias), ("drift", prior.drift), ("departures", prior.sigmas))
    ]
    after = f", correlated over {prior.correlation_time:g} s" if prior.correlation_time else ", each by itself"
    return f"{', '.join(parts)}{after}"


def bare_nodes(network: Network) -> list[str]:
    """Sentences about strips with nodes near which hardly anything was measured."""
    found = []
    for k, strip in enumerate(network.strips):
        near = support(network, k)
        if near.gaps.size:
            found.append(
                f"strip {strip.name}: fewer than {near.least} rays near {near.gaps.size} of its {len(strip.nodes)} "
                "nodes, between others that have them: closer than the data supports, and refused by adjust"
            )
        if outer := int(np.count_nonzero(near.unfelt)) - near.gaps.size:
            found.append(
                f"strip {strip.name}: no rays near {many(outer, 'node')} at its ends: there it follows its prior"
            )
    return found

"""Passes in reports (strips are such): how their trajectories were corrected along time, and how well that is known.

Corrections are those of the orientation images alone, in the terms of the flight (`datum.frames`): along, across and
radial; roll, pitch and yaw. What unknowns that images share do to them on top stands in `shared.csv`.
"""

from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np

from mgsgraph.adjustment.frames import FLIGHT_NAMES
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.flight import strip_reports
from mgsgraph.files.output.table import Column, Table, numbers
from mgsgraph.geometry.orientation import COMPONENTS as AXES
from mgsgraph.geometry.records import Array
from mgsgraph.network import (
    Network,
    NodePrior,
    Pass,
    PassPrior,
    PolynomialPrior,
    Process,
    ProcessPrior,
    SharedKind,
)
from mgsgraph.network.joining import mounting_angles
from mgsgraph.network.support import support
from mgsgraph.results.section import Section
from mgsgraph.text import many, some, span
from mgsgraph.units import DEG, MGON, MRAD

POSITION, ROTATION = FLIGHT_NAMES[:3], FLIGHT_NAMES[3:]
"""Components of corrections along a pass: m, and rad."""
_J2000 = datetime(2000, 1, 1, 12, tzinfo=UTC)


# --- tables


def passes_table(solution: Solution) -> Table:
    """One row per pass."""
    found = strip_reports(solution)
    largest, sigmas = numbers(found, "largest").reshape(-1, 6), numbers(found, "mean_sigmas").reshape(-1, 6)
    (m, mgon), heads = ((("along", "acr.", "rad."), ROTATION), (POSITION, ROTATION))
    of_largest, of_sigmas = (
        [tuple(f"{what} {name}" for name in some) for some in heads] for what in ("largest Δ", "σ")
    )
    return Table("passes", "Passes (sigmas for sigma0 = 1)", (
        Column("name", [one.name for one in found], head="pass", page="s", text="<22"),
        Column("basis", [one.basis for one in found], page="s"),
        Column("images", [one.images for one in found]),
        Column("number", np.array([len(one.images) for one in found]), head="images", page="s", files=False),
        Column("nodes", np.array([one.nodes for one in found]), page="s", text=">5"),
        Column("spacing", numbers(found, "spacing"), "s", "on the average", page=".3f", label="every", text=">8.2f"),
        Column("spacing_lines", numbers(found, "lines"), label="lines", text=">7.0f"),
        Column("spacing", numbers(found, "ground"), "km", "over ground", label="", text=">6.1f"),
        Column("largest_correction", largest[:, :3], "m", "at a node", m, of_largest[0], ".2f"),
        Column("largest_roll_pitch_yaw", largest[:, 3:], "mgon", "at a node", mgon, of_largest[1], ".2f"),
        Column("mean_sigma", sigmas[:, :3], "m", "of the nodes", m, of_sigmas[0], ".2f", "mean sigma [m]", ">5", 3),
        Column("mean_sigma_roll_pitch_yaw", sigmas[:, 3:], "mgon", "of the nodes", mgon, of_sigmas[1], ".2f",
               "mean sigma [mgon]", ">7", 2),
        Column("trend", [[_trend_json(*part) for part in one.trend] for one in found]),
    ), "Corrections at the orientation images: the largest, and the mean sigma.")  # fmt: skip


def _trend_json(part: str, component: str, value: float, sigma: float) -> dict[str, Any]:
    unit, scale = ("mgon", MGON) if component in AXES[3:] else ("m", 1.0)
    return {"part": part, "component": component, f"value_{unit}": value / scale, f"sigma_{unit}": sigma / scale}


def nodes_table(solution: Solution) -> Table:
    """One row per node within a pass: its time, and corrections with sigmas in m, mgon and arcsec."""
    found = [(one.name, one.corrections) for one in strip_reports(solution)]
    times = np.concatenate([series.times for _, series in found])

    def amounts(part: str, of: Array) -> list[Column]:
        what = "of the nominal trajectory, in terms of the flight" if part == "correction" else "for sigma0 = 1"
        turns = [Column(f"{part}_{{}}", of[:, 3:], unit, what, ROTATION) for unit in ("mgon", "arcsec")]
        return [Column(f"{part}_{{}}", of[:, :3], "m", what, POSITION), *turns]

    return Table("passes", "Orientation images", (
        Column("pass", [name for name, series in found for _ in range(series.times.size)], meaning="its name"),
        Column("node", np.concatenate([np.arange(1, series.times.size + 1) for _, series in found]), meaning="from 1"),
        Column("time_tdb", [calendar(time) for time in times.tolist()], meaning="calendar date"),
        Column("time_et", times, "s", "TDB past J2000"),
        Column("time_in_pass", np.concatenate([series.times - series.times[0] for _, series in found]), "s",
               "since the first node"),
        *amounts("correction", np.concatenate([series.values for _, series in found])),
        *amounts("sigma", np.concatenate([series.sigmas for _, series in found])),
    ))  # fmt: skip


def calendar(time: float) -> str:
    """Calendar date of s TDB past J2000, in TDB: UTC is the leap seconds (64 to 69) behind."""
    return (_J2000 + timedelta(seconds=round(time, 3))).strftime("%Y-%m-%dT%H:%M:%S.%f")[:-3]


# --- words


def passes_section(solution: Solution) -> Section:
    """How trajectories were corrected."""
    table = passes_table(solution)
    csv = [nodes_table(solution)] if len(table) else []
    return Section("passes", tables=[table], csv=csv, numbers=table.records())


def passes_inventory(network: Network) -> Section:
    """Passes of a network: images, mountings, nodes, and what is known of their trajectories beforehand."""
    said = []
    for one in network.passes:
        start, stop = one.nodes.coverage
        names = [network.images[j].name for j in one.images.tolist()]
        said += [
            f"{one.name} ({some(names, len(names))}): {len(one.nodes)} orientation images ({one.nodes.basis}), one "
            f"every {one.nodes.spacing:.4g} s of {stop - start:.4g} s from {calendar(start + one.nodes.epoch)} TDB on",
            f"{one.name}: a-priori sigmas {_prior_words(one.prior)}",
            *_mounting_words(network, one),
        ]
    return Section("", "Passes" if said else "", said)


def _mounting_words(network: Network, one: Pass) -> list[str]:
    """How cameras stand against that of the first image, a line for each camera."""
    if one.axes is None:
        return []
    cameras = list[tuple[Array, list[str]]]()
    for j, axes in zip(one.images.tolist(), one.axes, strict=True):
        known = [names for other, names in cameras if np.allclose(other, axes, atol=1e-6)]
        if known:
            known[0].append(network.images[j].name)
        else:
            cameras.append((axes, [network.images[j].name]))
    first, *others = cameras
    reference = network.images[int(one.images[0])].name
    lines = [f"mounted as {reference}: {some(first[1], len(first[1]))}"] if len(first[1]) > 1 else []
    for axes, names in others:
        x, y, z = (mounting_angles(axes[None])[0] / DEG).tolist()
        apart = float(np.arccos(np.clip(axes[2, 2], -1.0, 1.0))) / DEG
        turned = f"{x:+.4f}, {y:+.4f}, {z:+.4f} deg (nominal rotation vector, about the axes x, y, z of {reference}; "
        turned += f"optical axes {apart:.4f} deg apart)"
        lines.append(f"mounted at {turned}: {some(names, len(names))}")
    return lines


def mounting_warnings(network: Network) -> list[str]:
    """Sentences about passes all of whose cameras have an unknown boresight, or lever arm: what these have in common is
    not told from the pass's own attitude, or position.
    """
    found = []
    estimated = [one for one in network.shared if one.name not in network.considered]
    for kind, what, own in (
        (SharedKind.CAMERA_BORESIGHT, "boresights", "attitude"), (SharedKind.CAMERA_LEVER_ARM, "lever arms", "position")
    ):  # fmt: skip
        known = {j for one in estimated if one.kind is kind for j in one.images.tolist()}
        bare = [one.name for one in network.passes if known.issuperset(one.images.tolist())]
        if bare:
            found.append(
                f"{what} of all cameras of {some(bare, len(bare))} are unknown beside the pass's own {own}: what they "
                "have in common is told from it by the a-priori sigmas alone; leave one camera out as the reference"
            )
    return found


def _prior_words(prior: PassPrior) -> str:
    if isinstance(prior, PolynomialPrior):
        terms = [
            f"{name} {', '.join(span(row / unit) for row in sigmas)} {word}"
            for name, sigmas, unit, word in (
                ("position", prior.position_sigmas, 1.0, "m"), ("attitude", prior.attitude_sigmas, MRAD, "mrad")
            )
        ]  # fmt: skip
        return f"of the terms 1, s, s^2, s^3 of polynomials (s = -1 .. 1): {'; '.join(terms)}"
    if isinstance(prior, ProcessPrior):
        parts = [_process_words(one, "m") for one in prior.position]
        parts += [_process_words(one, "mrad") for one in prior.attitude]
        return f"{', '.join([*_trend_words(prior), *parts])}"
    departures = f"departures {span(prior.sigmas[:3])} m and {span(prior.sigmas[3:] / MGON)} mgon"
    parts = [*_trend_words(prior), departures]
    after = f", correlated over {prior.correlation_time:g} s" if prior.correlation_time else ", each by itself"
    return f"{', '.join(parts)}{after}"


def _trend_words(prior: NodePrior | ProcessPrior) -> list[str]:
    return [
        f"{name} {span(sigmas[:3])} m and {span(sigmas[3:] / MGON)} mgon"
        for name, sigmas in (("bias", prior.bias), ("drift", prior.drift))
    ]


def _process_words(one: Process, unit: str) -> str:
    times = f" over {one.correlation_time:g} s" if one.correlation_time else ""
    times += f" at {one.frequency:g} Hz ({one.bandwidth:g} Hz wide)" if one.frequency else ""
    begin = "to be estimated, from " if one.estimated else ""
    unit_of = f"{unit}/s^1.5" if not one.stationary else unit
    return f"{one.kind}{times} {begin}{span(one.sigmas / (MRAD if unit == 'mrad' else 1.0))} {unit_of}"


def bare_nodes(network: Network) -> list[str]:
    """Sentences about passes with nodes near which hardly anything was measured."""
    found = []
    for k, one in enumerate(network.passes):
        near = support(network, k)
        if near.gaps.size:
            found.append(
                f"pass {one.name}: fewer than {near.least} rays near {near.gaps.size} of its {len(one.nodes)} "
                "nodes, between others that have them: closer than the data supports, and refused by adjust"
            )
        if outer := int(np.count_nonzero(near.unobserved)) - near.gaps.size:
            found.append(
                f"pass {one.name}: no rays near {many(outer, 'node')} at its ends: there it follows its prior"
            )
    return found

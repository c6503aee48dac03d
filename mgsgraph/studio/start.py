"""What is wrong with what is open, and what can be done next: the verdict with its reasons, the worst measurements,
points, images and profiles, and why something can't be done.
"""

from contextlib import suppress
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from mgsgraph.analysis.verdict import Cause, Reason, verdict
from mgsgraph.errors import InputError
from mgsgraph.files.output.table import plain, vector
from mgsgraph.geometry.records import Array
from mgsgraph.matching.patches import has_opencv
from mgsgraph.network import PointClass
from mgsgraph.project.project import open_project
from mgsgraph.project.reading import case_with_results
from mgsgraph.results.verdict import reason_sentences, tested_sentences
from mgsgraph.studio.map_points import map_points, ray_residuals
from mgsgraph.studio.marks import laser_profiles
from mgsgraph.studio.opened import Opened
from mgsgraph.studio.point_sheet import MOST_PLANNED

_WORST, _MOST_REASONS, _MOST_NAMES = 5, 30, 20
"""Of each kind that are listed; reasons of a verdict that are sent; names of points that a search finds."""
_OF_MANY = (Cause.GROUP, Cause.OBSERVATION, Cause.SIGMA0, Cause.LEFT_OUT)
"""Causes that are about many measurements: the worst ones are to be looked at."""


def verdict_record(opened: Opened) -> dict[str, Any]:
    """The verdict on the last batch solution, its reasons with the points, images and profiles concerned, and what was
    tested, as JSON; it takes seconds.
    """
    solution = opened.now.solution
    if solution is None:
        state = "not tested" if opened.block().adjusted else "not adjusted"
        return {"state": state, "reasons": [], "sentences": [opened.warning]}
    found = verdict(solution)
    reasons = [
        {"cause": reason.cause.value, "sentence": reason_sentences([reason])[0], "links": _links(opened, reason)}
        for reason in found.reasons[:_MOST_REASONS]
    ]
    return {"state": found.state.value, "reasons": reasons, "sentences": tested_sentences(found, solution, 2)}


def _links(opened: Opened, reason: Reason) -> list[dict[str, str]]:
    """Images, profiles and points that a reason names, or those of the worst measurements."""
    network, words = opened.block().network, [reason.what, *reason.what.replace(",", " ").split()]
    points = [word for word, number in zip(words, network.points.ids.find(words).tolist(), strict=True) if number >= 0]
    points += [row["point"] for row in _worst_measurements(opened)] if reason.cause in _OF_MANY else []
    kinds = {"image": [image.name for image in network.images], "profile": network.shift_names}
    named = [(kind, name) for kind, names in kinds.items() for name in names if name in reason.what]
    named += [("point", name) for name in dict.fromkeys(points)]
    return [{"kind": kind, "name": name} for kind, name in named]


def worst_record(opened: Opened) -> dict[str, Any]:
    """The worst of each kind, names for examples, and what can't be done and why, as JSON."""
    block, points = opened.block(), map_points(opened)
    ids, size = block.network.points.ids, np.linalg.norm(ray_residuals(opened), axis=1)
    sigma = np.where(points.value("rays") > 0.0, points.value("sigma"), np.nan)
    known = np.flatnonzero(block.used & np.isfinite(size))
    image, count = block.network.rays.image[known], len(block.images)
    with np.errstate(invalid="ignore"):
        rms = np.sqrt(np.bincount(image, size[known] ** 2, count) / np.bincount(image, minlength=count))
    ties = np.flatnonzero(np.isfinite(sigma) & (points.classes == PointClass.TIE))
    return {
        "measurements": _worst_measurements(opened),
        "points": [{"point": ids[k], "sigma_m": float(sigma[k])} for k in _largest(sigma)],
        "images": [{"image": block.images[j].name, "rms_px": float(rms[j])} for j in _largest(rms)],
        "profiles": _worst_profiles(opened),
        "examples": [ids[k] for k in ties[[0, -1]].tolist()] if ties.size > 1 else [],
        **_possible(opened),
    }


def _worst_measurements(opened: Opened) -> list[dict[str, Any]]:
    """Those with the largest residuals in their stated sigmas."""
    block, residuals, rays = opened.block(), ray_residuals(opened), opened.block().network.rays
    in_sigmas = np.where(block.used, np.abs(residuals / block.network.ray_sigmas).max(axis=1), np.nan)
    return [
        {"point": block.network.points.ids[int(rays.point[k])], "image": block.images[int(rays.image[k])].name,
         "residual_px": vector(residuals[k]), "sigmas": float(in_sigmas[k])}
        for k in _largest(in_sigmas)
    ]  # fmt: skip


def _worst_profiles(opened: Opened) -> list[dict[str, Any]]:
    """Laser profiles by their horizontal shift over its prior sigma, each with its middle shot."""
    block, shifts = opened.block(), opened.block().network.shifts
    if shifts is None or block.values is None:
        return []
    middles = {name: block.network.points.ids[int(shots[len(shots) // 2])] for name, shots in laser_profiles(block)}
    moved = np.array([block.values[len(block.images) + k][:2] for k in range(len(shifts.names))])
    in_sigmas = np.linalg.norm(moved, axis=1) / shifts.sigmas
    rows = [(shifts.names[k], plain(moved[k]), float(in_sigmas[k])) for k in _largest(in_sigmas)]
    return [{"profile": name, "point": middles.get(name, ""), "shift_m": shift, "sigmas": s} for name, shift, s in rows]


def _largest(values: Array) -> list[int]:
    """Numbers of the largest finite values."""
    ranked = np.where(np.isfinite(values), values, -np.inf)
    return [k for k in np.argsort(-ranked, kind="stable")[:_WORST].tolist() if np.isfinite(ranked[k])]


def _possible(opened: Opened) -> dict[str, Any]:
    """Why each kind of work is impossible (empty where it is possible), the command that makes a project of what is
    open, and what is to be done first.
    """
    block, case = opened.block(), Path("CASE")
    reasons = {"plan": "" if block.adjusted else "Nothing is adjusted yet."}
    if len(block.images) > MOST_PLANNED:
        reasons["plan"] = f"{len(block.images)} images; up to {MOST_PLANNED} here. See mgsgraph plan."
    if opened.kind != "project":
        with suppress(InputError):
            case = case_with_results(opened.path).case
        reasons |= dict.fromkeys(("solve", "match", "align", "add"), "Only a project can be changed.")
        return {"reasons": reasons, "command": f"mgsgraph project init PROJECT --case {case}", "next": ""}
    with open_project(opened.path) as project:
        has_case, waits = project.case is not None, not project.store.members()
    pixels = "" if has_opencv() else "It needs OpenCV: pip install 'mgsgraph[match]'"
    if not has_case or sum(picture is not None for picture in opened.pictures.values()) < 2:
        pixels = "It needs a project made of a case that names the pixels of two images."
    missing = "There are no measurements: match first." if waits else ""
    profiles = "" if block.network.shifts is not None else "There is no laser profile with an unknown shift."
    reasons |= {"solve": missing, "match": pixels, "align": missing or profiles or pixels, "add": ""}
    return {"reasons": reasons, "command": "", "next": "match" if waits else "" if opened.now.solution else "solve"}


def names_with(opened: Opened, part: str) -> list[str]:
    """The first names of points that contain a text, in any case of its letters."""
    found = (name for name in opened.block().network.points.ids if part.lower() in name.lower())
    return list(islice(found, _MOST_NAMES))

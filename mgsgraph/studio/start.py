"""What is wrong with what is open, and what can be done next: the verdict with its reasons, the worst measurements,
points, images and profiles, and why something can't be done.
"""

from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from mgsgraph.analysis.verdict import Cause, Reason, verdict
from mgsgraph.errors import InputError, command_line
from mgsgraph.matching.patches import has_opencv
from mgsgraph.network import PointClass
from mgsgraph.project.project import open_project
from mgsgraph.project.reading import case_with_results
from mgsgraph.results.verdict import reason_sentences, tested_sentences
from mgsgraph.studio.lists import compute, rows_of, table
from mgsgraph.studio.map_points import map_points
from mgsgraph.studio.opened import Opened
from mgsgraph.studio.point_sheet import MOST_PLANNED

_WORST, _MOST_REASONS = 5, 30
"""Of each list that are shown; reasons of a verdict that are sent."""
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
    kinds = {"image": network.image_names, "profile": network.shift_names}
    named = [(kind, name) for kind, names in kinds.items() for name in names if name in reason.what]
    named += [("point", name) for name in dict.fromkeys(points)]
    return [{"kind": kind, "name": name} for kind, name in named]


def worst_record(opened: Opened) -> dict[str, Any]:
    """The worst of each list, names for examples, and what can't be done and why, as JSON."""
    if opened.block().adjusted:
        compute(opened, "residuals")
    points, ids = map_points(opened), opened.block().network.points.ids
    ties = np.flatnonzero(np.isfinite(points.value("sigma")) & (points.classes == PointClass.TIE))
    return {
        "measurements": _worst_measurements(opened),
        "points": _worst(opened, "points", "sigma", {"images": "> 0"}),
        "images": _worst(opened, "images", "rms"),
        "profiles": _worst(opened, "profiles", "shift_sigmas"),
        "examples": [ids[k] for k in ties[[0, -1]].tolist()] if ties.size > 1 else [],
        **_possible(opened),
    }


def _worst_measurements(opened: Opened) -> list[dict[str, Any]]:
    return _worst(opened, "measurements", "residual_sigmas", {"state": "=used"})


def _worst(opened: Opened, name: str, by: str, conditions: Mapping[str, str] | None = None) -> list[dict[str, Any]]:
    """Rows of a list with the largest values of a column, as records."""
    shown = table(opened, name)
    rows = rows_of(opened, shown, {"sort": f"-{by}", **(conditions or {})})[:_WORST]
    return [row for row in shown.take(rows).records() if any(row[key] is not None for key in row if key.startswith(by))]


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
        return {"reasons": reasons, "command": command_line("project", "init", "PROJECT", "--case", case), "next": ""}
    with open_project(opened.path) as project:
        has_case, waits = project.case is not None, not project.store.members()
    pixels = "" if has_opencv() else "It needs OpenCV: pip install 'mgsgraph[match]'"
    if not has_case or sum(picture is not None for picture in opened.pictures.values()) < 2:
        pixels = "It needs a project made of a case that names the pixels of two images."
    missing = "There are no measurements: match first." if waits else ""
    profiles = "" if block.network.shifts is not None else "There is no laser profile with an unknown shift."
    reasons |= {"solve": missing, "match": pixels, "align": missing or profiles or pixels, "add": ""}
    return {"reasons": reasons, "command": "", "next": "match" if waits else "" if opened.now.solution else "solve"}

"""Changes that a browser asks for: each is stored in the project, adjusted by iSAM2, and answered with its effect.

One browser at a time changes a project: the first that asks. Other browsers read it, and are told so.
"""

from collections.abc import Callable, Mapping
from datetime import datetime
from functools import lru_cache
from typing import Any

import numpy as np

from mgsgraph.adjustment.incremental.impact import Impact
from mgsgraph.errors import InputError, require
from mgsgraph.files.output.table import vector
from mgsgraph.geometry.body import east_north_up, from_geodetic
from mgsgraph.geometry.records import Array
from mgsgraph.project import edits, history
from mgsgraph.project.changes import Changed
from mgsgraph.project.decisions import Measure
from mgsgraph.project.project import Project, open_project
from mgsgraph.studio.inputs import number_of, place_of, text_of
from mgsgraph.studio.opened import Opened
from mgsgraph.units import DEG

_MOST_MOVED = 500
"""Most points whose motion is sent to the page."""


class EditLock:
    """Which browser changes the project."""

    def __init__(self) -> None:
        self._holder, self._since = "", ""

    def refusal(self, browser: str) -> str:
        """Why a browser may not change the project now; empty where it may."""
        if self._holder in ("", browser):
            return ""
        return f"Another browser has been changing this project since {self._since}; here it can be read only."

    def require(self, browser: str) -> bool:
        """Give a browser the lock; True where it held it before. InputError where another browser holds it."""
        if refusal := self.refusal(browser):
            raise InputError("studio", refusal.rstrip("."), remedy="Take over, if it is yours")
        if held := self._holder == browser:
            return held
        self.take(browser)
        return False

    def release(self, browser: str) -> None:
        """Release the lock, if this browser holds it."""
        if self._holder == browser:
            self._holder = ""

    def take(self, browser: str) -> None:
        """Give a browser the lock, whoever holds it."""
        self._holder, self._since = browser, datetime.now().strftime("%H:%M:%S")


def change(opened: Opened, content: Mapping[str, Any]) -> dict[str, Any]:
    """Carry out a change; its effect, as JSON.

    Parameters
    ----------
    opened : Opened
        A project.
    content : mapping
        kind (as of `project.edits`), point; image, line, sample; rows, many of them; measures of a new point; place of
        a held one.

    Raises
    ------
    InputError
        No project; another process changes it; the change is refused. Nothing has changed then.
    """
    kind = text_of(content, "kind")
    require(kind in _KINDS, "change, kind", repr(kind)[:60], f"one of {', '.join(_KINDS)}")

    def act(project: Project) -> tuple[Changed, list[dict[str, Any]]]:
        edited = _KINDS[kind](project, content)
        return edited, [] if edited.impact is None else _moved(opened, project, edited.impact)

    edited, moved = opened.change(act)
    return {
        "kind": edited.kind, "point": edited.point, "revision": opened.revision, "moved": moved,
        "sentences": [edited.sentence, *(edited.impact.sentences if edited.impact else ())], "warning": opened.warning,
    }  # fmt: skip


def _measure(project: Project, content: Mapping[str, Any]) -> Changed:
    rows = content.get("measures")
    if not isinstance(rows, list):
        raise InputError("change, measures", repr(rows)[:60], "a list of {image, line, sample}")
    measures = [Measure(*place_of(row), *_sigmas(row)) for row in rows]
    return edits.measure(project, text_of(content, "point"), measures)


def _sigmas(row: Mapping[str, Any]) -> tuple[float, float]:
    sigma = number_of(row, "sigma_px", 0.0)
    return sigma, sigma


def _move(project: Project, content: Mapping[str, Any]) -> Changed:
    sigmas = _sigmas(content) if "sigma_px" in content else None
    return edits.move(project, text_of(content, "point"), *place_of(content), sigmas)


def _measures(content: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Points and images of measurements: one, or many in `rows`, there with an empty image for all of a point."""
    if "rows" not in content:
        image = text_of(content, "image")
        require(image, "change, image", "no image", "that of the measurement")
        return [(text_of(content, "point"), image)]
    rows = content["rows"]
    good = isinstance(rows, list) and all(isinstance(row, list) and list(map(type, row)) == [str, str] for row in rows)
    require(good, "change, rows", repr(rows)[:60], "a list of [point, image]")
    return [(point, image) for point, image in rows]


def _hold(project: Project, content: Mapping[str, Any]) -> Changed:
    """At a place in degrees (geodetic, that is planetographic latitude) and m above the ellipsoid, with sigmas in m."""
    point = text_of(content, "point")
    names = project.store.image_names()
    body = project.store.image(names[0]).image.body
    place = np.array([number_of(content, "longitude_deg") * DEG, number_of(content, "geodetic_latitude_deg") * DEG,
                      number_of(content, "height_m")])  # fmt: skip
    require(abs(place[1]) <= 0.5 * np.pi, "change, geodetic_latitude_deg", f"{place[1] / DEG:g}", "-90 to 90")
    sigmas = np.array([number_of(content, f"sigma_{axis}_m") for axis in ("east", "north", "up")])
    return edits.hold(project, point, from_geodetic(place[None], body)[0], sigmas)


_KINDS: dict[str, Callable[[Project, Mapping[str, Any]], Changed]] = {
    "measure": _measure,
    "move": _move,
    "reject": lambda project, content: edits.reject_all(project, _measures(content)),
    "accept": lambda project, content: edits.accept_all(project, _measures(content)),
    "hold": _hold,
    "release": lambda project, content: edits.release(project, text_of(content, "point")),
    "remove": lambda project, content: edits.remove_point(project, text_of(content, "point")),
    "undo": lambda project, content: history.undo(project),
    "redo": lambda project, content: history.redo(project),
}


@lru_cache(4)
def reversible(opened: Opened, _revision: int) -> dict[str, bool]:
    """Whether there is a change to undo, and one to redo, as JSON."""
    if opened.kind != "project":
        return {"undo": False, "redo": False}
    with open_project(opened.path) as project:
        return {"undo": bool(project.standing_changes()), "redo": project.last_undo() is not None}


def _moved(opened: Opened, project: Project, impact: Impact) -> list[dict[str, Any]]:
    """Points that moved, at their new places: new points first, then by motion in sigmas."""
    moved = impact.points
    order = np.argsort(-np.nan_to_num(moved.in_sigmas, nan=np.inf), kind="stable")[:_MOST_MOVED]
    names, position_of = [moved.ids[k] for k in order.tolist()], dict[str, Array]()
    for members in dict.fromkeys(project.store.bundles_of(names).values()):
        bundle = project.store.bundle(members)
        position_of |= zip(bundle.network.points.ids, bundle.places, strict=True)
    places = np.array([position_of.get(name, np.full(3, np.nan)) for name in names]).reshape(-1, 3)
    vectors = np.einsum("nij,nj->ni", east_north_up(np.where(np.isfinite(places), places, 1.0)), moved.moves[order])
    plane = opened.map_places(places)
    return [
        {"name": name, "map_m": vector(plane[k]), "vector_m": vector(vectors[k]),
         "sigmas": None if is_new else float(moved.in_sigmas[order[k]])}
        for k, (name, is_new) in enumerate(zip(names, moved.new[order].tolist(), strict=True))
    ]  # fmt: skip

"""Changes that a browser asks for: each is stored in the project, adjusted by iSAM2, and answered with what it did.

One browser at a time may change a project: the first one that does. Another one reads, and hears who has it.
"""

from collections.abc import Callable, Mapping
from datetime import datetime
from typing import Any

import numpy as np

from mgsgraph.adjustment.incremental.impact import Impact
from mgsgraph.errors import InputError
from mgsgraph.files.output.table import vector
from mgsgraph.geometry.body import east_north_up, from_geodetic
from mgsgraph.geometry.records import Array
from mgsgraph.project import edits
from mgsgraph.project.edits import Edited
from mgsgraph.project.project import Measure, Project
from mgsgraph.studio.opened import Opened
from mgsgraph.units import DEG

_MOST_MOVED = 500
"""Points that moved, of which the page is told; the rest is counted."""


class EditLock:
    """Which browser changes the project."""

    def __init__(self) -> None:
        self._holder, self._since = "", ""

    def words(self, browser: str) -> str:
        """Why a browser may not change the project now; empty where it may."""
        if self._holder in ("", browser):
            return ""
        return f"Another browser has been changing this project since {self._since}; here it can be read only."

    def require(self, browser: str) -> bool:
        """Give a browser the lock, where no other one has it; whether it had it before. InputError where one has."""
        if words := self.words(browser):
            raise InputError("studio", words.rstrip("."), remedy="Take over, if it is yours")
        if held := self._holder == browser:
            return held
        self.take(browser)
        return False

    def release(self, browser: str) -> None:
        """Take it from a browser."""
        if self._holder == browser:
            self._holder = ""

    def take(self, browser: str) -> None:
        """Give it the lock, whoever had it."""
        self._holder, self._since = browser, datetime.now().strftime("%H:%M:%S")


def change(opened: Opened, asked: Mapping[str, Any]) -> dict[str, Any]:
    """Carry out a change; what it did, as JSON.

    Parameters
    ----------
    opened : Opened
        A project.
    asked : mapping
        kind (as of `project.edits`), point; image, line, sample; measures of a new point; place of a held one.

    Raises
    ------
    InputError
        No project; another process changes it; what the change itself refuses: nothing has changed then.
    """
    kind = _text(asked, "kind")
    if kind not in _KINDS:
        raise InputError("change, kind", repr(kind)[:60], f"one of {', '.join(_KINDS)}")

    def act(project: Project) -> tuple[Edited, list[dict[str, Any]]]:
        edited = _KINDS[kind](project, asked)
        return edited, [] if edited.impact is None else _moved(opened, project, edited.impact)

    edited, moved = opened.change(act)
    return {
        "kind": edited.kind, "point": edited.point, "revision": opened.revision, "moved": moved,
        "sentences": [edited.sentence, *(edited.impact.sentences if edited.impact else ())], "warning": opened.warning,
    }  # fmt: skip


def _measure(project: Project, asked: Mapping[str, Any]) -> Edited:
    wanted = asked.get("measures")
    if not isinstance(wanted, list) or not all(isinstance(one, dict) for one in wanted):
        raise InputError("change, measures", repr(wanted)[:60], "a list of {image, line, sample}")
    measures = [
        Measure(_text(one, "image"), _number(one, "line"), _number(one, "sample"), *_sigmas(one)) for one in wanted
    ]
    return edits.measure(project, _text(asked, "point"), measures)


def _sigmas(one: Mapping[str, Any]) -> tuple[float, float]:
    sigma = _number(one, "sigma_px") if "sigma_px" in one else 0.0
    return sigma, sigma


def _move(project: Project, asked: Mapping[str, Any]) -> Edited:
    at = _number(asked, "line"), _number(asked, "sample")
    return edits.move(project, _text(asked, "point"), _text(asked, "image"), *at)


def _hold(project: Project, asked: Mapping[str, Any]) -> Edited:
    """At a place in degrees (geodetic, that is planetographic latitude) and m above the ellipsoid, with sigmas in m."""
    point = _text(asked, "point")
    names = project.store.image_names()
    body = project.store.image(names[0]).image.body
    place = np.array([_number(asked, "longitude_deg") * DEG, _number(asked, "geodetic_latitude_deg") * DEG,
                      _number(asked, "height_m")])  # fmt: skip
    if abs(place[1]) > 0.5 * np.pi:
        raise InputError("change, geodetic_latitude_deg", f"{place[1] / DEG:g}", "-90 to 90")
    sigmas = np.array([_number(asked, f"sigma_{axis}_m") for axis in ("east", "north", "up")])
    return edits.hold(project, point, from_geodetic(place[None], body)[0], sigmas)


_KINDS: dict[str, Callable[[Project, Mapping[str, Any]], Edited]] = {
    "measure": _measure,
    "move": _move,
    "reject": lambda project, asked: edits.reject(project, _text(asked, "point"), _text(asked, "image")),
    "accept": lambda project, asked: edits.accept(project, _text(asked, "point"), _text(asked, "image")),
    "hold": _hold,
    "release": lambda project, asked: edits.release(project, _text(asked, "point")),
    "remove": lambda project, asked: edits.remove_point(project, _text(asked, "point")),
    "undo": lambda project, asked: edits.undo(project),
}


def _moved(opened: Opened, project: Project, impact: Impact) -> list[dict[str, Any]]:
    """Points that moved, as the project has them now: new ones before those that moved by most of their sigmas."""
    moved = impact.points
    order = np.argsort(-np.nan_to_num(moved.in_sigmas, nan=np.inf), kind="stable")[:_MOST_MOVED]
    names, place = [moved.ids[k] for k in order.tolist()], dict[str, Array]()
    for members in dict.fromkeys(project.store.bundles_of(names).values()):
        bundle = project.store.bundle(members)
        place |= zip(bundle.network.points.ids, bundle.places, strict=True)
    places = np.array([place.get(name, np.full(3, np.nan)) for name in names]).reshape(-1, 3)
    vectors = np.einsum("nij,nj->ni", east_north_up(np.where(np.isfinite(places), places, 1.0)), moved.moves[order])
    plane = opened.map_places(places)
    return [
        {"name": name, "map_m": vector(plane[k]), "vector_m": vector(vectors[k]),
         "sigmas": None if new else float(moved.in_sigmas[order[k]])}
        for k, (name, new) in enumerate(zip(names, moved.new[order].tolist(), strict=True))
    ]  # fmt: skip


def _text(asked: Mapping[str, Any], key: str) -> str:
    value = asked.get(key, "" if key in ("point", "image") else None)
    if not isinstance(value, str):
        raise InputError(f"change, {key}", repr(value)[:60], "a text")
    return value


def _number(asked: Mapping[str, Any], key: str) -> float:
    value = asked.get(key)
    if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
        raise InputError(f"change, {key}", repr(value)[:60], "a finite number")
    return float(value)

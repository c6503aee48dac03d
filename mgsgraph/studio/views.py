"""Pictures and linked images of a scene, made anew after each change of it: what several addresses share."""

from collections.abc import Mapping
from pathlib import Path
from threading import Lock
from typing import Any, Protocol

import numpy as np

from mgsgraph.adjustment.solution import Solution
from mgsgraph.errors import InputError
from mgsgraph.geometry.records import Array
from mgsgraph.studio.block import Block
from mgsgraph.studio.linked import LinkedImages
from mgsgraph.studio.marks import shots_of, ties_of
from mgsgraph.studio.tiles import Tiles


class Pictured(Protocol):
    """What these addresses need to know of a scene."""

    @property
    def revision(self) -> int:
        """Changes since it was opened."""
        ...

    @property
    def pictures(self) -> Mapping[str, Path | None]:
        """File of each image's pixels, by its name."""
        ...

    @property
    def folder(self) -> Path | None:
        """Folder of its results, in which tables of a registration may lie."""
        ...

    @property
    def solution(self) -> Solution | None:
        """Last batch solution; None before any."""
        ...

    def block(self) -> Block:
        """Images and points as they are now."""
        ...

    def map_places(self, points: Array) -> Array:
        """(n, 2) m on the map, of points (n, 3) in m, body-fixed."""
        ...


class Views:
    """Tiles and linked images of a scene; anew after each change.

    Parameters
    ----------
    scene : Pictured
    """

    def __init__(self, scene: Pictured) -> None:
        self.scene = scene
        self.tiles = _tiles(scene)
        self._linked: tuple[int, LinkedImages] | None = None
        self._lock = Lock()

    @property
    def linked(self) -> LinkedImages:
        """Images linked by geometry, as the block is now."""
        with self._lock:
            if self._linked is None or self._linked[0] != self.scene.revision:
                self._linked = self.scene.revision, LinkedImages(self.scene.block())
                if not all(map(self.tiles.knows, (one.name for one in self.scene.block().images))):
                    self.tiles = _tiles(self.scene)  # another process has added images
            return self._linked[1]

    def image_record(self, name: str) -> dict[str, Any]:
        """Size, picture, ties and shots of an image; in place of a picture that can't be read, the sentence why."""
        block = self.linked.block
        number = block.network.image_number(name)
        picture: dict[str, Any] | None = None
        sentence = ""
        try:
            picture = self.tiles.record(name)
        except InputError as error:
            sentence = str(error)
        image = block.images[number]
        return {
            "name": name, "lines": image.lines, "samples": image.samples, "picture": picture, "sentence": sentence,
            "revision": self.scene.revision, "adjusted": block.adjusted,
            "ties": ties_of(block, number), "shots": shots_of(block, number),
        }  # fmt: skip


def _tiles(scene: Pictured) -> Tiles:
    images, pictures = scene.block().images, scene.pictures
    return Tiles({one.name: (pictures.get(one.name), one.lines, one.samples) for one in images})


def number_of(asked: Mapping[str, str], key: str, default: float | None = None) -> float:
    """A finite number among what an address asks; InputError where it is none or missing."""
    text = asked.get(key)
    if text is None and default is not None:
        return default
    try:
        value = float(text or "")
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise InputError(f"request, {key}", repr(text)[:60], "a finite number")
    return value

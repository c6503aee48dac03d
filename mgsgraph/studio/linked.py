"""Images linked by geometry: the ground under a place of one image, and where every other image shows the same ground.

A place p of image i shows the ground X(p); image j shows that at q = g_j(X(p)), and moves by the Jacobian

    dq/dp = (dg_j/dX) (dX/dp),

of 2 x 2 elements, line and sample by line and sample. What is not known of both orientations, and of the height h of
the ground, makes an error ellipse of q about its true place: with A_i = dg_i/d(orientation of i),

    dq = A_j do_j - (dq/dp) A_i do_i + (dg_j/dX) (dX/dh) dh,

for p is held, so that X moves with the orientation of i. The joint covariance of both orientations goes in: what they
have in common cancels.
"""

from collections.abc import Collection
from functools import cached_property
from typing import NamedTuple

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.geometry.body import PROBABILITY, error_ellipses, planetocentric
from mgsgraph.geometry.orientation import Angles, OrientationCorrection
from mgsgraph.geometry.records import Array
from mgsgraph.network.corrections import designs
from mgsgraph.studio.block import Block
from mgsgraph.studio.ground import Ground, GroundModel
from mgsgraph.units import DEG


class Ellipse(NamedTuple):
    """An error ellipse in an image."""

    covariance: Array
    """(2, 2) px^2 of line and sample, for sigma0 = 1."""
    semi_axes: Array
    """(2,) px, the larger first, within which the place lies with a probability of 95 %."""
    angle: float
    """rad, of the larger one, from the direction of samples towards that of lines."""

    @classmethod
    def of(cls, covariance: Array) -> "Ellipse":
        """That of a covariance (2, 2) of line and sample."""
        semi_axes, ways = error_ellipses(covariance)
        return cls(covariance, semi_axes[::-1], float(np.arctan2(ways[0, 1], ways[1, 1])))


class Prediction(NamedTuple):
    """Where another image shows the same ground."""

    image: int
    """Which."""
    place: Array
    """(2,) line and sample; may lie outside the image."""
    jacobian: Array
    """(2, 2) px per px, by line and sample of the first image."""
    inside: bool
    """Whether the image has that place."""
    ellipse: Ellipse | None
    """None where nothing is known of the orientations."""


class LinkedImages:
    """Images of a block over one ground; answers within milliseconds, for a page that follows the cursor.

    Parameters
    ----------
    block : Block
        In one state; of another one another record is made.
    """

    def __init__(self, block: Block) -> None:
        self.block = block
        self.ground = GroundModel(block)

    def under(
        self, image: str, line: float, sample: float, wanted: Collection[str] = ()
    ) -> tuple[Ground, list[Prediction]]:
        """The ground at a place of an image, and where others show it.

        Parameters
        ----------
        image : str
            Its name.
        line, sample : float
            px, first pixel's centre at 0.5; up to half the image's size outside it.
        wanted : collection of str
            Images that are answered for even if the place lies outside them.

        Raises
        ------
        InputError
            No such image; a place far outside it.
        NoGround
            A ray that goes by the body.
        """
        number = self.block.network.image_number(image)
        picture = self.block.images[number]
        size = np.array([picture.lines, picture.samples])
        place = np.array([line, sample])
        if not (np.all(np.isfinite(place)) and np.all(np.abs(place / size - 0.5) <= 1.0)):
            inside = f"a place in its {picture.lines} x {picture.samples} pixels"
            raise InputError(f"image {image}", f"line {line:g}, sample {sample:g}", inside)
        ground = self.ground.under(number, line, sample)
        kept = {self.block.network.image_number(name) for name in wanted} - {number}
        others = [j for j in self._about(ground.point) if j != number]
        found = (self._prediction(number, place, ground, j) for j in sorted({*others, *kept}))
        return ground, [one for one in found if one is not None and (one.inside or one.image in kept)]

    def _prediction(self, first: int, place: Array, ground: Ground, other: int) -> Prediction | None:
        picture, correction = self.block.images[other], self.block.corrections[other]
        places, by_point = picture.ground_to_image(ground.point[None], correction)
        if not np.all(np.isfinite(places)):
            return None
        origin, _ = picture.sightlines(places[:, 0], places[:, 1], correction)
        if (ground.point - origin[0]) @ ground.point >= 0.0:
            return None  # behind the body
        jacobian = by_point[0] @ ground.slopes
        inside = bool(np.all((places[0] >= 0.0) & (places[0] <= [picture.lines, picture.samples])))
        by_height = by_point[0] @ ground.by_height
        ellipse = self._ellipse((first, other), (place, places[0]), ground, jacobian, by_height) if inside else None
        return Prediction(other, places[0], jacobian, inside, ellipse)

    def _ellipse(
        self, pair: tuple[int, int], places: tuple[Array, Array], ground: Ground, jacobian: Array, by_height: Array
    ) -> Ellipse | None:
        joint = self.block.joint
        if joint is None:
            return None
        parts = dict[int, Array]()
        for number, place, factor in zip(pair, places, (-jacobian, np.eye(2)), strict=True):
            picture, correction = self.block.images[number], self.block.corrections[number] or self._nominal
            by_pose = picture.by_correction(ground.point[None], place[None], correction)[0, :, :6]
            for v, part in designs(self.block.network, number, self._angles, place[:1])[0].items():
                parts[v] = parts.get(v, np.zeros((2, part.shape[1]))) + factor @ by_pose @ part
        covariance = np.zeros((2, 2))
        if parts:
            design = np.concatenate(list(parts.values()), axis=1)
            covariance = design @ joint.of(list(parts)) @ design.T
        if np.isfinite(ground.height_sigma):
            covariance = covariance + ground.height_sigma**2 * np.outer(by_height, by_height)
        return Ellipse.of(covariance)

    def _about(self, point: Array) -> list[int]:
        """Images that may show a point (3,), by their caps on the sphere."""
        middles, reaches = self.block.caps
        away = np.arccos(np.clip(middles @ (point / np.linalg.norm(point)), -1.0, 1.0))
        return np.flatnonzero(away <= reaches).tolist()

    @property
    def _angles(self) -> Angles:
        return self.block.settings.angles

    @cached_property
    def _nominal(self) -> OrientationCorrection:
        return OrientationCorrection(np.zeros((1, 6)), self.block.settings.angles)


def ground_record(found: Ground, others: list[Prediction], block: Block) -> dict[str, object]:
    """What the page is told, as JSON: degrees and pixels."""
    longitude, latitude, radius = planetocentric(found.point).tolist()
    return {
        "longitude_deg": longitude / DEG % 360.0, "latitude_deg": latitude / DEG, "radius_m": radius,
        "height_m": found.height, "height_sigma_m": found.height_sigma if np.isfinite(found.height_sigma) else None,
        "surface": found.surface, "point_m": found.point.tolist(),
        "spacing_m": np.linalg.norm(found.slopes, axis=0).tolist(),
        "others": {block.images[one.image].name: _prediction_record(one) for one in others},
        "sigmas": "posterior" if block.adjusted else "a-priori", "probability": PROBABILITY,
    }  # fmt: skip


def _prediction_record(one: Prediction) -> dict[str, object]:
    ellipse = None if one.ellipse is None else {
        "semi_axes_px": one.ellipse.semi_axes.tolist(), "angle_deg": one.ellipse.angle / DEG,
        "covariance_px2": one.ellipse.covariance.tolist(),
    }  # fmt: skip
    return {
        "line": float(one.place[0]), "sample": float(one.place[1]), "inside": one.inside,
        "jacobian": one.jacobian.tolist(), "ellipse_px": ellipse,
    }  # fmt: skip

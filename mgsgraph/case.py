"""A case file (TOML) names the inputs of an adjustment and what is known of them beforehand; here it becomes a network.

Units stand in the keys' names. Unknown keys are refused with their path; paths are relative to the case file.
"""

import math
import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.batch import Iteration
from mgsgraph.adjustment.settings import Angles, Form, Line, Loss, SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.errors import InputError
from mgsgraph.geometry.altimetry import LaserProfile
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import OrientationPrior
from mgsgraph.geometry.records import Array, Index, Mask
from mgsgraph.io.control_net import read_control_network
from mgsgraph.io.gcp import read_ground_control
from mgsgraph.io.isd import Aberration, Observer, read_isd
from mgsgraph.io.lidar import read_lidar
from mgsgraph.io.text import read_text
from mgsgraph.network import GroundPoints, ImageRays, Network, PointClass, Ranges
from mgsgraph.ties import PointKind, TiePoints
from mgsgraph.units import MRAD

Positive = Annotated[float, msgspec.Meta(gt=0.0)]
FORMAT = 1


class OrientationInput(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """A-priori knowledge of an image's orientation corrections."""

    degree: Annotated[int, msgspec.Meta(ge=0, le=8)] = 2
    """Degree of the polynomials of the line."""
    position_sigma_m: float | list[float] = 100.0
    """Sigma of the constant term along the body-fixed axes; inf for unknown."""
    angle_sigma_mrad: float | list[float] = 0.29
    """Sigma of the constant term about the camera axes (1 arcmin by default); inf for unknown."""
    trend: Annotated[tuple[Positive, ...], msgspec.Meta(min_length=1)] = (1.0, 0.1, 0.01)
    """Factor of the constant term's sigma for each power of u, at u = 1; its last value serves higher powers."""

    def prior(self, where: str) -> OrientationPrior:
        """The sigmas, (degree + 1, 6), in m and rad; `where` names this table in errors."""
        position = _three_sigmas(self.position_sigma_m, f"{where}, position_sigma_m")
        angle = _three_sigmas(self.angle_sigma_mrad, f"{where}, angle_sigma_mrad") * MRAD
        factors = [self.trend[min(k, len(self.trend) - 1)] for k in range(self.degree + 1)]
        return OrientationPrior(np.outer(factors, np.concatenate([position, angle])))


def _three_sigmas(value: float | list[float], where: str) -> Array:
    """One sigma for all three directions, or three. (A union with a fixed-length tuple crashes msgspec 0.22.)"""
    sigmas = np.atleast_1d(np.asarray(value, dtype=np.float64))
    if sigmas.size not in (1, 3) or not np.all(sigmas > 0.0):
        raise InputError(where, f"{value}", "one positive number or three (inf for unknown)")
    return np.broadcast_to(sigmas, 3)


class ImageInput(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """One image."""

    name: Annotated[str, msgspec.Meta(min_length=1)]
    """By which networks and shots refer to it (ISIS serial number)."""
    isd: str
    """CSM image support data, JSON."""
    held: bool = False
    """Keep its orientation as it is."""
    aberration: Literal["NONE", "LT+S"] | None = None
    """What its position table holds, where the support data don't say."""
    observer: Observer = "body"
    """Who observed whom when that table was made."""
    orientation: OrientationInput | None = None
    """Sigmas of this image alone."""


class TiesInput(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """Tie points: a control network."""

    network: str
    """ISIS control network, PVL."""
    sigma_px: Positive = 1.0
    """Sigma of line and sample where the network doesn't say."""


class ControlInput(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """Ground control points with sigmas."""

    file: str
    """ASP .gcp text."""


class LaserInput(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """Laser shots."""

    file: str
    """ISIS lidar JSON."""
    image_sigma_px: Positive = 30.0
    """Sigma of the shots' image coordinates."""
    range_sigma_m: Positive | None = None
    """Sigma of the ranges; the file's own when absent."""
    ground_sigma_m: Positive | None = None
    """Sigma of the footprints in each direction; the file's covariances when absent."""
    ranges: bool = True
    """Use the ranges."""


class SolverInput(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """Choices of the solver; see SolverSettings."""

    form: Form = "bundle"
    line: Line = "predicted"
    angles: Angles = "camera"
    loss: Loss = "none"
    loss_width: Positive | None = None
    reject: float = 0.0
    max_iterations: Annotated[int, msgspec.Meta(ge=1)] = 50


class CaseInput(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """A case file."""

    format: int
    """Version of this layout."""
    name: str
    """What to call the case in reports."""
    images: Annotated[tuple[ImageInput, ...], msgspec.Meta(min_length=1)]
    """All images."""
    orientation: OrientationInput = OrientationInput()
    """For images without sigmas of their own."""
    ties: TiesInput | None = None
    """Tie points."""
    ground_control: ControlInput | None = None
    """Ground control points."""
    laser: LaserInput | bool = False
    """Laser shots; false leaves them out."""
    solver: SolverInput = SolverInput()
    """Choices of the solver."""


@dataclass(frozen=True, slots=True, eq=False)
class Case:
    """Everything that an adjustment starts from."""

    name: str
    """What it is called."""
    path: Path
    """Where it was read."""
    network: Network
    """Who sees what, with what sigma."""
    settings: SolverSettings
    """How to solve it."""

    def __repr__(self) -> str:
        return f"Case({self.name!r}: {self.network!r})"


def read_case(path: str | Path, laser: bool = True) -> Case:
    """Read a case file and everything that it names.

    Parameters
    ----------
    path : path
        TOML file.
    laser : bool
        False leaves the laser rows out whatever the file says.

    Raises
    ------
    InputError
        With the place, the finding and the remedy.
    """
    path = Path(path)
    wanted = _decode(path)
    folder = path.parent
    images = tuple(_read_image(image, folder) for image in wanted.images)
    priors = tuple(
        image.orientation.prior(f"{path}, images[{j}].orientation")
        if image.orientation
        else wanted.orientation.prior(f"{path}, orientation")
        for j, image in enumerate(wanted.images)
    )
    ties = read_control_network(folder / wanted.ties.network) if wanted.ties else None
    control_file = wanted.ground_control.file if wanted.ground_control else None
    control = read_ground_control(folder / control_file, images[0].body) if control_file else None
    if wanted.laser is True:
        raise InputError(f"{path}, laser", "true", "false, or a table with the shots' file")
    shots = wanted.laser if laser and isinstance(wanted.laser, LaserInput) else None
    profile = read_lidar(folder / shots.file) if shots else None
    parts = _Parts(images)
    if ties and wanted.ties:
        parts.add_points(ties, PointClass.TIE, wanted.ties.sigma_px)
    if control:
        parts.add_points(control, PointClass.CONTROL, 1.0)
    if profile and shots:
        parts.add_profile(profile, shots)
    if not parts.ids:
        raise InputError(str(path), "neither ties nor ground control nor laser", "at least one of them")
    settings = SolverSettings(**{name: getattr(wanted.solver, name) for name in wanted.solver.__struct_fields__})
    held = np.array([image.held for image in wanted.images])
    return Case(wanted.name, path, parts.network(priors, held), settings)


def _decode(path: Path) -> CaseInput:
    try:
        table = tomllib.loads(read_text(path))
    except tomllib.TOMLDecodeError as error:
        raise InputError(str(path), f"malformed TOML ({error})", remedy="mend that line") from None
    version = table.get("format")
    if version != FORMAT:
        found = "no key 'format'" if version is None else f"format {version!r}"
        raise InputError(str(path), found, f"format = {FORMAT}", "write it at the head of the case file")
    try:
        case = msgspec.convert(table, CaseInput, strict=False)
    except msgspec.ValidationError as error:
        what, _, place = str(error).partition(" - at `$.")
        where = f"{path}, {place.rstrip('`')}" if place else str(path)
        raise InputError(where, what[0].lower() + what[1:], remedy="see the case files in scripts/cases") from None
    _refuse_nan(table, str(path))
    return case


def _refuse_nan(value: object, where: str) -> None:
    """TOML has nan; nothing here may be it."""
    if isinstance(value, float) and math.isnan(value):
        raise InputError(where, "nan", "a number")
    if isinstance(value, dict):
        for key, item in value.items():
            _refuse_nan(item, f"{where}, {key}")
    if isinstance(value, list):
        for k, item in enumerate(value):
            _refuse_nan(item, f"{where}[{k}]")


def _read_image(image: ImageInput, folder: Path) -> PushbroomImage:
    stated = Aberration(image.aberration, image.observer) if image.aberration else None
    return read_isd(folder / image.isd, image.name, stated)


class _Parts:
    """Points, rays and ranges as they are gathered from several files; becomes one network."""

    def __init__(self, images: tuple[PushbroomImage, ...]) -> None:
        self._images = images
        self._index = {image.name: j for j, image in enumerate(images)}
        self.ids: list[str] = []
        self._sources: dict[str, str] = {}
        self._points: list[tuple[NDArray[Any], ...]] = []
        self._rays: list[tuple[NDArray[Any], ...]] = []
        self._ranges: list[tuple[NDArray[Any], ...]] = []

    def add_points(self, points: TiePoints, point_class: PointClass, sigma: float) -> None:
        """Points and measures of a control network or ground control file; `sigma` (px) where the file has none."""
        first, n = self._claim(points.ids, points.source), len(points.ids)
        self._points.append((np.full(n, int(point_class)), points.kinds, points.places, points.covariances))
        sigmas = np.where(np.isnan(points.measure_sigmas), sigma, points.measure_sigmas)
        self._add_rays(first, points.measure_point, points.measure_image, points.measures, sigmas, points.source)

    def add_profile(self, profile: LaserProfile, wanted: LaserInput) -> None:
        """Shots of a laser profile: constrained points, with rays where they are measured and ranges."""
        first, n = self._claim(profile.ids, profile.source), len(profile.ids)
        covariances = profile.covariances
        if wanted.ground_sigma_m is not None:
            covariances = np.broadcast_to(np.eye(3) * wanted.ground_sigma_m**2, (n, 3, 3))
        kinds = np.full(n, int(PointKind.CONSTRAINED))
        self._points.append((np.full(n, int(PointClass.LASER)), kinds, profile.footprints, covariances))
        sigmas = np.full((profile.measure_shot.size, 2), wanted.image_sigma_px)
        self._add_rays(first, profile.measure_shot, profile.measure_image, profile.measures, sigmas, profile.source)
        if wanted.ranges:
            pairs = [
                (i, self._image(name, f"{profile.source}, shot {profile.ids[i]}"))
                for i, names in enumerate(profile.simultaneous)
                for name in names
            ]
            shot, image = np.array(pairs, dtype=np.int64).reshape(-1, 2).T
            own = profile.range_sigmas if wanted.range_sigma_m is None else np.full(n, wanted.range_sigma_m)
            self._ranges.append((shot + first, image, profile.times[shot], profile.ranges[shot], own[shot]))

    def network(self, priors: tuple[OrientationPrior, ...], held: Mask) -> Network:
        """All of it as one network."""
        points = GroundPoints(tuple(self.ids), *(np.concatenate(part) for part in zip(*self._points, strict=True)))
        rays = ImageRays(*(np.concatenate(part) for part in zip(*self._rays, strict=True)))
        empty: tuple[NDArray[Any], ...] = tuple(np.zeros(0, dtype=kind) for kind in (int, int, float, float, float))
        ranges = Ranges(*(np.concatenate(part) for part in zip(empty, *self._ranges, strict=True)))
        return Network(self._images, priors, held, points, rays, ranges)

    def _claim(self, ids: tuple[str, ...], source: str) -> int:
        """Take the ids in; the index of the first."""
        for name in ids:
            if name in self._sources:
                raise InputError(source, f"the id {name!r}, which {self._sources[name]} has too", "each id once")
            self._sources[name] = source
        first = len(self.ids)
        self.ids += ids
        return first

    def _image(self, name: str, where: str) -> int:
        if name not in self._index:
            known = ", ".join(list(self._index)[:4])
            raise InputError(
                where,
                f"the image {name!r}",
                f"one of the case's images ({known})",
                "add it to the case or take its measures out",
            )
        return self._index[name]

    def _add_rays(
        self, first: int, point: Index, names: tuple[str, ...], places: Array, sigmas: Array, source: str
    ) -> None:
        where = {name: k for k, name in reversed(list(enumerate(names)))}
        index = {
            name: self._image(name, f"{source}, point {self.ids[first + int(point[k])]}") for name, k in where.items()
        }
        image = np.array([index[name] for name in names], dtype=np.int64)
        self._require_inside(image, places, point + first, source)
        self._rays.append((point + first, image, places, sigmas))

    def _require_inside(self, image: Index, places: Array, point: Index, source: str) -> None:
        """Measures lie on their image."""
        size = np.array([(im.lines, im.samples) for im in self._images], dtype=np.float64)[image]
        for k in np.flatnonzero(np.any((places < 0.0) | (places > size), axis=1))[:1]:
            raise InputError(
                f"{source}, point {self.ids[int(point[k])]}, image {self._images[image[k]].name}",
                f"line {places[k, 0] + 0.5:g}, sample {places[k, 1] + 0.5:g} (counted from 1)",
                f"a place inside {size[k, 0]:g} lines x {size[k, 1]:g} samples",
            )


def adjust(case: Case, progress: Callable[[Iteration], None] = lambda _: None) -> Solution:
    """Adjust a case; see `mgsgraph.adjustment.adjust.adjust_network`."""
    return adjust_network(case.network, case.settings, case.name, progress)

"""What a case file may say: tables and keys, units in their names. Unknown keys are refused with their path."""

from collections.abc import Sequence
from typing import Annotated, Literal

import msgspec
import numpy as np

from mgsgraph.adjustment.settings import Angles, Device, Line, Loss, SolverSettings
from mgsgraph.case.motion import Factor, Positive, Sigma, three
from mgsgraph.case.passes import MountingInput, PassInput, require_image
from mgsgraph.errors import InputError, errors_from, require
from mgsgraph.files.labels.aberration import Observer
from mgsgraph.files.labels.accuracy import accuracy_of
from mgsgraph.geometry.altimetry import Altimeter
from mgsgraph.geometry.image import PushbroomImage, fit_attitude, fit_polynomials
from mgsgraph.geometry.orientation import OrientationPrior
from mgsgraph.geometry.records import Array
from mgsgraph.network import SharedKind, SharedUnknown
from mgsgraph.text import listed
from mgsgraph.units import MRAD


class LaserInput(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """Laser shots in a file of ISIS, and the sigmas that they get."""

    file: str
    """ISIS lidar JSON."""
    image_sigma_px: Sigma = 30.0
    """Sigma of the shots' image coordinates. Heights of tie points may follow it in proportion: state your own."""
    range_sigma_m: Sigma | None = None
    """Sigma of the ranges; the file's own when absent."""
    ground_sigma_m: Sigma | None = None
    """Sigma of the footprints in each direction; the file's covariances when absent."""
    ranges: bool = True
    """Use the ranges."""


class ShotsInput(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """A laser profile of an altimeter."""

    file: str
    """Shots as their archive has them: MOLA PEDR (binary, PEDR2TAB table, CSV of the Orbital Data Explorer), LOLA RDR
    (binary or CSV), MLA RDR (CSV), a PDS3 label of a table of shots, or a selection of `mgsgraph footprints`."""
    image: str | None = None
    """Image taken along with it, whose orientation carries the ranges; found by time when absent."""
    range_sigma_m: Sigma | None = None
    """Sigma of the ranges; that of the altimeter when absent: MOLA 10, LOLA 1, LALT 5, MLA 1."""
    pulse_share: Annotated[float, msgspec.Meta(ge=0.0, le=1.0)] = 0.1
    """What ranges and footprints err more, as a share of the echo's standard deviation, which a binary PEDR has; 0:
    none."""
    ground_sigma_m: Sigma | None = None
    """Sigma of each footprint in each direction; that of the altimeter when absent: MOLA 10, LOLA 20, LALT 50; of MLA
    none is published."""
    height_sigma_m: Sigma | None = None
    """Sigma of each footprint's height, where it is another one than `ground_sigma_m`."""
    shift_sigma_m: Sigma | None = None
    """Sigma of the common horizontal error of each profile in the file, which becomes an unknown; absent: none."""
    drift_sigma_m: Sigma | None = None
    """Sigma of how much that error grows from the middle of the profile's shots to their end, an unknown east and
    north; absent: none."""
    beam_sigma_mrad: Annotated[float, msgspec.Meta(ge=0.0, le=1e3)] | None = None
    """Sigma of what its beam points elsewhere in common, about each axis of the camera flown with it: an unknown; 0:
    none; absent: 0.25 where the shots have ranges and lie more than 2 degrees off nadir, else none."""
    image_rows: Literal["none", "back-projected"] = "none"
    """Image coordinates of the footprints: none, or their projections with the nominal orientation (the papers')."""
    image_sigma_px: Sigma = 30.0
    """Sigma of these."""
    ranges: bool = True
    """Use the ranges."""
    check_every: Annotated[int, msgspec.Meta(ge=2)] | None = None
    """Keep every so many-th shot that could be used out of the adjustment, as a checkpoint (`mgsgraph dem`)."""
    version: str | None = None
    """PEDR version letter, where the file's name doesn't say."""
    clock_bias_s: float = 0.0
    """Added to the shots' times."""

    def with_sigmas_of(self, altimeter: Altimeter, source: str) -> "ShotsInput":
        """The same with the altimeter's sigmas where none are stated; InputError names `source` where it has none."""
        stated = {key: getattr(self, key) for key in ("range_sigma_m", "ground_sigma_m")}
        usual = {"range_sigma_m": altimeter.range_sigma, "ground_sigma_m": altimeter.ground_sigma}
        sigmas = {key: usual[key] if value is None else value for key, value in stated.items()}
        for key in [key for key, value in sigmas.items() if np.isnan(value)][:1]:
            found = f"no {key}, and none published for {altimeter.name}"
            raise InputError(source, found, f"{key} in [[shots]], shot_{key} in a project's [measures]")
        return msgspec.structs.replace(self, **sigmas)


class AltimetryInput(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """Laser altimetry as control for the relief that the images show: ground returns in profiles, without an image."""

    file: str
    """Shots as in [[shots]], or a CSV whose header names columns and units: longitude_deg, latitude_deg
    (planetocentric) with radius_m, radius_km or height_m; or x_m, y_m, z_m; optional id, profile or orbit, time_s or
    utc."""
    sigma_m: tuple[Sigma, Sigma] = (10.0, 1.0)
    """Sigma of each shot, horizontal in each direction and vertical, without what its profile has in common."""
    shift_sigma_m: tuple[Sigma, Sigma, Sigma] = (100.0, 100.0, 10.0)
    """Sigma of each profile's common error east, north and up, which becomes an unknown."""
    drift_sigma_m: Sigma | None = None
    """Sigma of each profile's drift: the height at its ends, linear along the track; absent: none."""
    footprint_m: Positive | None = None
    """Diameter of the laser's spot on the ground; when absent 168 for MOLA, 5 for LOLA, 40 for LALT, and for MLA
    what its ranges say."""
    margin_px: Annotated[float, msgspec.Meta(ge=0.0, le=1e6)] = 500.0
    """Shots are taken that lie in an image or so many pixels beside it."""
    version: str | None = None
    """PEDR version letter, where the file's name doesn't say."""


_DEFAULTS = SolverSettings()


class OrientationInput(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """A-priori knowledge of an image's orientation corrections, and the nominal orientation that they correct."""

    nominal: Literal["trajectory", "polynomial", "attitude polynomial"] = "trajectory"
    """The trajectory as read; or polynomials of the line fitted to 31 samples of it (Yoon & Shan 2005, Eq. 2); or
    positions as read and polynomials of time fitted to the records of the attitude (jigsaw's CKDEGREE)."""
    nominal_order: Annotated[int, msgspec.Meta(ge=0, le=12)] = 2
    """Order of these polynomials."""
    degree: Annotated[int, msgspec.Meta(ge=0, le=8)] = 2
    """Degree of the polynomials of the line."""
    position_sigma_m: float | list[float] | None = None
    """Sigma of the constant term along the body-fixed axes; inf for unknown; when absent what is published of the
    image's mission, or 100 m (docs/case_file.md)."""
    angle_sigma_mrad: float | list[float] | None = None
    """Sigma of the constant term about the camera axes; inf for unknown; when absent what is published of the image's
    mission, or 0.29 mrad (1 arcmin; docs/case_file.md)."""
    trend: Annotated[tuple[Positive, ...], msgspec.Meta(min_length=1)] | None = None
    """Factor of the constant term's sigma for each power of u, at u = 1; 1, 0.1, then 0.01 when absent."""

    def nominal_of(self, image: PushbroomImage) -> PushbroomImage:
        """An image with the nominal orientation of this table."""
        if self.nominal == "trajectory":
            return image
        return (fit_polynomials if self.nominal == "polynomial" else fit_attitude)(image, self.nominal_order)

    def prior(self, where: str, mission: str = "") -> OrientationPrior:
        """The sigmas, (degree + 1, 6), in m and rad, of an image of a mission; `where` names this table in errors."""
        usual = accuracy_of(mission)
        metres = usual.orbit if self.position_sigma_m is None else self.position_sigma_m
        mrad = list(usual.pointing) if self.angle_sigma_mrad is None else self.angle_sigma_mrad
        position = three(metres, f"{where}, position_sigma_m", infinite=True)
        angle = three(mrad, f"{where}, angle_sigma_mrad", infinite=True) * MRAD
        factors = self.trend or (1.0, 0.1) + (0.01,) * self.degree
        expected = f"{self.degree + 1}, one for each power from 0 to degree = {self.degree}"
        require(len(factors) > self.degree, f"{where}, trend", f"{len(factors)} factors", expected)
        with errors_from(where):
            return OrientationPrior(np.outer(factors[: self.degree + 1], np.concatenate([position, angle])))


RESECTED = {"position_sigma_m": 5000.0, "angle_sigma_mrad": 10.0}
"""Of a resected start, by convention. A camera 400 km up that looks 5 mrad (0.3 degrees) off the nadir is 2 km beside
its start over the same ground. Attitude and position err together; as independent errors they need larger sigmas."""


_Turn = Annotated[float, msgspec.Meta(ge=-360.0, le=360.0)]


class ResectionInput(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """Where an image was taken from of which no kernels are at hand: by its label's time, and a circular orbit that
    passes over its middle, in the plane of another image's orbit turned about the pole.
    """

    longitude_deg: _Turn | None = None
    """East longitude of the image's middle; when absent, by the tie points that it shares with other images."""
    latitude_deg: Annotated[float, msgspec.Meta(gt=-90.0, lt=90.0)] | None = None
    """Planetocentric latitude of it; together with the longitude."""
    altitude_km: Annotated[float, msgspec.Meta(gt=0.0, le=1e6)] | None = None
    """Altitude above the ellipsoid; that of `like` when absent."""
    emission_deg: Annotated[float, msgspec.Meta(gt=-80.0, lt=80.0)] = 0.0
    """Emission angle at its middle: positive where the camera looks to the right of the flight, negative to the
    left."""
    north_azimuth_deg: _Turn | None = None
    """Angle from the direction of increasing samples clockwise to north, as archives have it; when absent the camera
    is turned against the flight as that of `like`."""
    like: str = ""
    """Name of the image whose orbit it resembles, which says inclination and altitude; when absent the first one with
    an orbit."""


class ImageInput(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """One image of the case: its geometry, its pixels, and what is known of its orientation."""

    name: str = ""
    """By which networks and shots refer to it; when absent, ISIS's serial number (of a cube or label), or what support
    data call it (`image_identifier`), or the file's name without its ending."""
    image: str | None = None
    """The image, by a file of any of the kinds below; its content tells the kind."""
    list: str | None = None
    """Several images: an ISIS list, one file in every line, relative to the list; what stands beside is for each."""
    isd: str | None = None
    """CSM image support data, JSON, of ALE or ISIS."""
    state: str | None = None
    """Line-scanner model state of usgscsm (*.adjusted_state.json of Ames Stereo Pipeline)."""
    cube: str | None = None
    """ISIS cube that spiceinit has been run on, or its label with the cube's tables beside it as JSON; no kernels."""
    label: str | None = None
    """PDS3 image or its label, or ISIS cube, with kernels; its instrument is the label's."""
    kernels: tuple[str, ...] = ()
    """SPICE kernels or meta-kernels of this image; those of [spice] when absent."""
    pixels: str | None = None
    """Its pixels, for `match` and figures: GeoTIFF, ISIS cube, PDS image, VICAR, PNG, JPEG or MOC's
    formats; those that belong to its label when absent."""
    constants: Literal["iak", "ik"] = "iak"
    """Camera constants of the ISIS addendum, or of NAIF's instrument kernel alone (MOC-NA, HRSC, Kaguya TC)."""
    focal_length_m: Positive | None = None
    """Focal length; the kernels' when absent."""
    attitude_bias_s: float | None = None
    """Attitude of time t is the CK's of t + this; for MOC -1.15 when absent (ISIS), else 0."""
    position_bias_s: float = 0.0
    """Position of time t is the SPK's of t + this."""
    line_times: Annotated[str, msgspec.Meta(min_length=1)] | None = None
    """HRSC without its line prefixes: a text file with the times of its lines, or "mean" (files.cameras.label)."""
    resection: ResectionInput | None = None
    """Start of an image of which no kernels are at hand, with wide a-priori sigmas (docs/own_files.md)."""
    held: bool = False
    """Keep its orientation as it is."""
    aberration: Literal["NONE", "LT+S"] | None = None
    """What its position table holds; what the file says, or its sensor is known for, when absent."""
    observer: Observer = "body"
    """Who observed whom when that table was made."""
    orientation: OrientationInput | None = None
    """Sigmas of this image alone."""
    measure_sigma_px: Sigma | None = None
    """Sigma of tie points' line and sample in this image where the network doesn't say; the group's when absent."""


class TiesInput(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """Tie points: a control network."""

    network: str
    """ISIS control network (.pvl, .net) or table (.csv, .parquet); measures in images that the case doesn't hold are
    left out."""
    sigma_px: Sigma = 1.0
    """Sigma of line and sample where neither the network nor the image ([[images]], measure_sigma_px) says."""
    sigma_factor: Factor = 1.0
    """Multiplies the sigmas of all measures of the group, those that the network itself states among them."""
    window_px: Annotated[float, msgspec.Meta(ge=0.0, le=1e6)] | None = None
    """Side of the windows that were matched: measures of an image whose windows overlap have errors in common, as far
    as they overlap; that of the match.json beside the network when absent, else 0: none."""
    common_share: Annotated[float, msgspec.Meta(gt=0.0, le=1.0)] = 1.0
    """Share of the variance that such measures have in common where their windows coincide: 1 for errors of pixels,
    less where most errors are each measure's own."""


class TerrainInput(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """A terrain model: control for the tie points, and where their heights above the areoid come from."""

    radius: str | tuple[str, ...] = ()
    """MEGDR grid of radii (.img, .lbl) or GeoTIFF in any map projection; several: tiles of one grid."""
    topography: str | None = None
    """MEGDR grid of topography with the same posts: radius minus topography is the areoid."""
    areoid: str | None = None
    """MEGDR grid of the areoid's radius (MEGA...) or GeoTIFF, where the values of `radius` are heights above it."""
    counts: str | tuple[str, ...] | bool | None = None
    """MEGDR grid of the number of shots of each post (MEGC...): between the tracks its posts are interpolated, which
    adds to their sigma; that beside `radius` when absent, false: none."""
    control: bool = True
    """Tie points lie on it."""
    reference_radius_m: Positive | None = None
    """Sphere above which a GeoTIFF's heights are."""
    reference_ellipsoid_m: tuple[Positive, Positive] | None = None
    """Ellipsoid above which they are, along its normal: equatorial and polar radius."""
    vertical_sigma_m: Sigma = 10.0
    """Sigma of its heights."""
    planimetric_sigma_m: Sigma = 200.0
    """Sigma of its horizontal place as a whole, which becomes an unknown."""
    shift: bool = True
    """That unknown is estimated; false: it is considered, held at zero while its sigma enters all others."""
    height_sigma_m: Sigma | None = None
    """Sigma of its height as a whole, which becomes an unknown; absent: none."""
    tilt_sigma_mrad: Sigma | None = None
    """Sigma of its tilts about east and north through the points' middle, which become unknowns; absent: none."""
    name: str = ""
    """What reports call it; the first file's name without its ending when absent."""

    @property
    def grids(self) -> tuple[str, ...]:
        """Files of the grid."""
        return (self.radius,) if isinstance(self.radius, str) else self.radius

    @property
    def cells(self) -> bool:
        """Whether its posts can lie on the surface that images show: measured by themselves, with a common horizontal
        place that is an unknown, and without tilts.
        """
        return self.control and self.shift and self.tilt_sigma_mrad is None


class ControlInput(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """Ground control points with sigmas."""

    file: str
    """ASP .gcp text; with `orthoimage` a table (.csv, .parquet) of positions in it and image measurements."""
    datum: Literal["D_MARS", "MOLA", "D_MOON"] | tuple[Positive, Positive] | None = None
    """What its latitudes and heights refer to: a sphere by its name in the Ames Stereo Pipeline (3396190, 3396000,
    1737400 m), or an ellipsoid by its equatorial and polar radius in m; by the file's header (# WKT:) when absent, else
    the images' ellipsoid."""
    orthoimage: str | None = None
    """GeoTIFF in any map projection in which the table's positions were read: map_line and map_sample (the first
    pixel's centre is at 0.5), map_x and map_y, or longitude_deg and latitude_deg as its system has them."""
    terrain: TerrainInput | None = None
    """Terrain model with the heights of these positions, a table with the keys of [terrain] for files and
    `vertical_sigma_m`."""
    map_sigma_px: Sigma = 0.5
    """Sigma of these positions, pixels of the orthoimage."""
    map_sigma_m: Sigma | None = None
    """Sigma of the orthoimage itself, east and north, independent at each point; absent: none."""


class SharedInput(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """An unknown that several images share, with its a-priori sigma about zero in the unit that fits its kind."""

    kind: Literal[
        "attitude-time bias", "position-time bias", "camera boresight", "altimeter boresight", "range bias",
        "focal length", "principal point", "radial distortion k1", "radial distortion k2", "radial distortion k3",
        "orbit position", "line rate", "camera lever arm", "altimeter lever arm",
    ]  # fmt: skip
    """What it is."""
    images: tuple[str, ...] = ()
    """Names of the images that share it; all when absent."""
    name: str = ""
    """What to call it in reports; its kind when absent."""
    sigma_s: Sigma | None = None
    """Of a time bias."""
    sigma_mrad: float | list[float] | None = None
    """Of a boresight: one for the camera's axes x, y and z, or three numbers."""
    sigma_m: float | list[float] | None = None
    """Of a range bias or a focal length; of a radial distortion at the pixel farthest from the principal point; of a
    principal point along the camera's x and y alike, or two numbers; of an orbit's position radially, along and across
    the flight alike, or of a lever arm along the camera's axes x, y, z alike, or three numbers."""
    sigma_ppm: Sigma | None = None
    """Of a line rate."""

    def unknown(self, names: Sequence[str], where: str) -> SharedUnknown:
        """The record; `names` are those of all images, and `where` names this table in errors."""
        kind = SharedKind(self.kind)
        scale, unit = (MRAD, "mrad") if kind.unit == "rad" else kind.reported
        sigma_key = f"sigma_{unit}"
        given = {key: value for key in _SHARED_SIGMAS if (value := getattr(self, key)) is not None}
        if set(given) != {sigma_key}:
            raise InputError(where, listed(list(given)) if given else "no sigma", f"{sigma_key} for {self.kind}")
        for name in self.images:
            require_image(name, names, f"{where}, images")
            require(self.images.count(name) <= 1, f"{where}, images", f"{name!r} twice", "each image once")
        members = [list(names).index(name) for name in self.images or names]
        sigmas = _sigmas(given[sigma_key], kind.width, f"{where}, {sigma_key}", self.kind) * scale
        with errors_from(where):
            return SharedUnknown(self.name or self.kind, kind, np.array(members), sigmas)


def _sigmas(value: float | list[float], width: int, where: str, kind: str) -> Array:
    """(width,) sigmas of a shared unknown: one number for all its components, or one for each."""
    if isinstance(value, list) and (len(value) != width or width == 1):
        counts = {1: "one number", 2: "one number, or two"}.get(width, "one number from 1e-9 to 1e9, or three")
        raise InputError(where, f"{value}", f"{counts} for {kind}")
    padded = [*value, *value[-1:] * (3 - width)] if isinstance(value, list) else value
    return three(padded, where, infinite=True)[:width]


_SHARED_SIGMAS = ("sigma_s", "sigma_mrad", "sigma_m", "sigma_ppm")
"""Keys of a shared unknown's sigma, by its unit in reports."""


class SpiceInput(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """SPICE kernels for all images that name none of their own."""

    kernels: tuple[str, ...]
    """Kernels or meta-kernels."""
    sampling_s: Positive = 0.1
    """Interval of the trajectory's nodes."""


class SolverInput(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """Choices of the solver; see SolverSettings, which has their meaning and their defaults."""

    line: Line = _DEFAULTS.line
    angles: Angles = _DEFAULTS.angles
    loss: Loss = _DEFAULTS.loss
    loss_width: Positive | None = _DEFAULTS.loss_width
    reject: float = _DEFAULTS.reject
    starts: Annotated[int, msgspec.Meta(ge=0)] | None = _DEFAULTS.starts
    max_iterations: Annotated[int, msgspec.Meta(ge=1)] = _DEFAULTS.max_iterations
    memory_gb: Positive | None = _DEFAULTS.memory_gb
    device: Device = _DEFAULTS.device
    deterministic: bool = _DEFAULTS.deterministic

    @property
    def settings(self) -> SolverSettings:
        """The same as the adjustment takes them."""
        return SolverSettings(**msgspec.structs.asdict(self))


class CaseInput(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """A case file."""

    format: int
    """Version of this layout."""
    name: str
    """What to call the case in reports."""
    images: Annotated[tuple[ImageInput, ...], msgspec.Meta(min_length=1)]
    """All images."""
    files_from: str = ""
    """How to get its files, said where that of an image is missing."""
    orientation: OrientationInput = OrientationInput()
    """For images without sigmas of their own."""
    ties: TiesInput | tuple[TiesInput, ...] = ()
    """Tie points: one table, [ties], or several, [[ties]], each a group with its own sigma."""
    ground_control: ControlInput | None = None
    """Ground control points."""
    checkpoints: tuple[str, ...] = ()
    """Ids of Constrained or Fixed points of [ties] or [ground_control] whose known coordinates take no part in the
    adjustment, but check it; their image measurements take part as those of tie points."""
    laser: LaserInput | tuple[LaserInput, ...] | bool = False
    """Laser shots: one table, [laser], or several, [[laser]], each a group with its own sigmas; false: none."""
    shots: tuple[ShotsInput, ...] = ()
    """Laser profiles of an altimeter."""
    altimetry: tuple[AltimetryInput, ...] = ()
    """Laser altimetry that lies on the relief."""
    terrain: TerrainInput | tuple[TerrainInput, ...] = ()
    """Terrain models: one table, [terrain], or several, [[terrain]]; tie points lie on the first, and the others are
    control by relief alone."""
    shared: tuple[SharedInput, ...] = ()
    """Unknowns that several images share."""
    considered: tuple[str, ...] = ()
    """Names of profiles' shifts and shared unknowns, as reports have them, that are not estimated but held at zero,
    while their sigmas enter those of all else (Schmidt 1966)."""
    passes: tuple[PassInput, ...] = ()
    """Images on one trajectory, adjusted through its corrections in time."""
    mountings: tuple[MountingInput, ...] = ()
    """How cameras and the laser stand against the trajectories that carry them."""
    spice: SpiceInput | None = None
    """SPICE kernels."""
    solver: SolverInput = SolverInput()
    """Choices of the solver."""

    @property
    def orientations(self) -> list[OrientationInput]:
        """[orientation] of each image: its own, or that of the case; of a resected one with the sigmas of its start."""
        resected = msgspec.structs.replace(self.orientation, **RESECTED)
        return [image.orientation or (resected if image.resection else self.orientation) for image in self.images]

    def priors(self, where: str, images: Sequence[PushbroomImage]) -> tuple[OrientationPrior, ...]:
        """Priors of the corrections of all images, which have been read; `where` names the file in errors."""
        return tuple(
            orientation.prior(
                f"{where}, images[{j}].orientation" if self.images[j].orientation else f"{where}, orientation",
                image.mission,
            )
            for j, (orientation, image) in enumerate(zip(self.orientations, images, strict=True))
        )

    @property
    def tie_groups(self) -> tuple[TiesInput, ...]:
        """Tables of control networks, one or several."""
        return (self.ties,) if isinstance(self.ties, TiesInput) else self.ties

    @property
    def terrain_models(self) -> tuple[TerrainInput, ...]:
        """Tables of terrain models, none, one or several."""
        return (self.terrain,) if isinstance(self.terrain, TerrainInput) else self.terrain

    @property
    def measured(self) -> bool:
        """Whether it names points measured in images; else tie points are still to be found."""
        back_projected = any(profile.image_rows != "none" for profile in self.shots)
        return bool(self.tie_groups or self.ground_control or self.laser_groups or back_projected)

    @property
    def laser_groups(self) -> tuple[LaserInput, ...]:
        """Files of laser shots."""
        if isinstance(self.laser, LaserInput):
            return (self.laser,)
        return self.laser if isinstance(self.laser, tuple) else ()

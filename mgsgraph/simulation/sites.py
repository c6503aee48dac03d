"""The three study sites as published, and errors of their kernels: drawn from the sigmas that their
cases state, or of the sizes that the papers found, for the reproduction of their tables alone.

Numbers: Yoon & Shan, PE&RS 2005 and ISPRS 2004, Table 1; site and height of Eos from the exterior orientation of Shan,
Yoon et al. (ISPRS 2002), whose right start position (Y) holds a misprint: with -2436.1 km the radius, the ground track
and the speed (3.39 km/s) come out right. At Eos Table 1's own numbers disagree: 17.97 deg of emission, a base-to-height
ratio of 0.41 and that orientation, which both want 22.0 deg. Table 1's emission is simulated; an option changes it.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from mgsgraph.errors import require
from mgsgraph.files.decoding import toml_table
from mgsgraph.files.opening import read_text
from mgsgraph.geometry.orientation import OrientationPrior
from mgsgraph.geometry.records import Array, assign, frozen
from mgsgraph.record import Record
from mgsgraph.units import ARCMIN, ARCSEC, DEG

SiteName = Literal["eos", "gusev", "isidis"]
SITE_NAMES: tuple[SiteName, ...] = get_args(SiteName)
"""What `mgsgraph simulate` knows."""
ARCHIVE_ATTITUDE_BIAS = -1.15
"""s: attitude(t) := CK(t - 1.15 s) for the archive's MGS kernels (ISIS; NAIF's comments in mgs_sc_ext26.bc)."""
POSITION_SIGMA, SHIFT_SIGMA = 100.0, 100.0
"""m, a-priori sigmas of a nadir image's position along each axis (Yoon & Shan 2005), and of a profile's common error
east and north (Kirk et al. 2002)."""
_HELD = 2.0
"""Sigmas of a held image, in those of a nadir one (Yoon & Shan: 100 and 200 m, and the angles that match)."""


@dataclass(frozen=True, slots=True, eq=False)
class KernelErrors(Record):
    """Errors of the kernels of one image; nominal = true (+) these."""

    position: Array
    """(terms, 3) m, of the SPK, row k times u^k of the normalised line u in [-1, 1]: radial, along the flight, across
    it (to the left, the orbit's normal)."""
    rotation: Array
    """(terms, 3) rad, of the CK, likewise: roll to the right of the flight (away from the orbit's normal), pitch
    forward, yaw about the optical axis."""
    attitude_time_bias: float = 0.0
    """s: the CK says at t what was true at t + bias, beside the archive's own time tags."""
    noise: float = 0.0
    """rad rms about each camera axis, of each record of the CK, one per second; without what a polynomial of the line
    would take of it, which is drawn with `rotation`."""

    def __post_init__(self) -> None:
        position = frozen(self.position, "kernel errors, position", (None, 3))
        assign(self, position=position, rotation=frozen(self.rotation, "kernel errors, rotation", (None, 3)))


@dataclass(frozen=True, slots=True, eq=False)
class ImageSettings(Record):
    """One image as published, its simultaneous profile, and the errors of its kernels."""

    name: str
    """Product, as the papers write it."""
    emission: float
    """rad, angle between the ray of the image's middle and the ellipsoid's normal, across track."""
    held: bool
    """Inertially held (the off-nadir images), or turning with the orbit."""
    start: str
    """UTC of the first line, ISO."""
    exposure: float
    """s, LINE_EXPOSURE_DURATION: a line takes this times the downtrack summing."""
    downtrack_summing: int
    """lines."""
    crosstrack_summing: int
    """detector pixels per sample."""
    lines: int
    """Number of lines."""
    samples: int
    """Number of samples."""
    edit_mode: int
    """detector pixels before the image's first (EDIT_MODE_ID)."""
    profile: str
    """MOLA PEDR product of the day."""
    shots: int
    """Number of ground shots inside the image."""
    spacing: float
    """m, between these on the ground; sets the orbit's speed."""
    orbit: int
    """MGS mapping orbit; MOLA counts 10,000 more."""
    phase: str
    """Which SPK and CK cover it."""
    errors: KernelErrors
    """What the papers found wrong with these kernels."""

    @property
    def period(self) -> float:
        """Time per line, s; the papers' exposure time."""
        return self.exposure * self.downtrack_summing

    @property
    def duration(self) -> float:
        """s, of the whole image."""
        return self.period * self.lines


@dataclass(frozen=True, slots=True)
class SiteSettings(Record):
    """A study site: where it is, its two images, and how many tie points they share."""

    name: SiteName
    """Name on the command line."""
    title: str
    """Name in the papers."""
    longitude: float
    """rad east, of the middle of both images."""
    latitude: float
    """rad, planetocentric."""
    altitude: float
    """m, of the spacecraft above the ellipsoid's radius at the site."""
    images: tuple[ImageSettings, ImageSettings]
    """Left and right as in PE&RS."""
    ties: int
    """Number of tie points."""
    angle_sigmas: tuple[float, float, float] = (ARCMIN, ARCMIN, ARCMIN)
    """rad, a-priori sigmas of a nadir image's rotation about the camera's axes (roll, pitch, yaw)."""
    trend: tuple[float, ...] = (1.0, 0.1, 0.01)
    """Factors of the constant terms' sigmas for each power of u."""

    @property
    def nadir(self) -> ImageSettings:
        """The image that tracks nadir."""
        return self.images[0] if not self.images[0].held else self.images[1]

    def prior(self, image: ImageSettings) -> OrientationPrior:
        """Prior of an image's orientation, and what the errors of its kernels are drawn from."""
        constant = np.array([*(POSITION_SIGMA,) * 3, *self.angle_sigmas])
        return OrientationPrior((_HELD if image.held else 1.0) * np.array(self.trend)[:, None] * constant)


def site_settings(name: str) -> SiteSettings:
    """The published settings of one of the three sites.

    Raises
    ------
    InputError
        If there is no such site.
    """
    require(name in _SITES, "site", repr(name), " or ".join(SITE_NAMES))
    return _SITES[name]


def drawn_errors(prior: OrientationPrior, noise: float, rng: np.random.Generator) -> KernelErrors:
    """Errors of an image's kernels, each coefficient from its a-priori sigma, with attitude noise in rad."""
    coefficients = prior.sigmas * rng.standard_normal(prior.sigmas.shape)
    return KernelErrors(coefficients[:, :3], coefficients[:, 3:], noise=noise)


def template(name: str) -> str:
    """A text that comes with this package: a table of settings, or a label or kernel with places for values."""
    return read_text(Path(__file__).with_name("data") / name)


def _of_table(site: dict[str, Any]) -> SiteSettings:
    """A site as sites.toml has it; the units are said there."""
    angles = {"longitude": site["longitude"] * DEG, "latitude": site["latitude"] * DEG}
    more = {name: tuple(site[name]) for name in ("trend",) if name in site}
    if "angle_sigmas" in site:
        more["angle_sigmas"] = tuple(sigma * ARCMIN for sigma in site["angle_sigmas"])
    return SiteSettings(**site | angles | more | {"images": tuple(_image_of_table(entry) for entry in site["images"])})


def _image_of_table(image: dict[str, Any]) -> ImageSettings:
    errors = image["errors"]
    turned = np.array([errors.get(axis, (0.0, 0.0)) for axis in ("roll", "pitch", "yaw")]).T * ARCMIN
    bias, noise = errors.get("attitude_time_bias", 0.0), errors["noise"] * ARCSEC
    kernel_errors = KernelErrors(np.array([errors["position"]]), turned, bias, noise)
    return ImageSettings(**image | {"emission": image["emission"] * DEG, "errors": kernel_errors})


_SITES = {site["name"]: _of_table(site) for site in toml_table(template("sites.toml"), "sites.toml")["sites"]}

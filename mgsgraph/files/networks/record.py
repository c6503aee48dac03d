"""A control network with everything that ISIS keeps in one, as its files say it: for exchange, not for computing.

Field by field that of ISIS ControlPointFileEntryV0002 (ControlNetVersioner), in ISIS's own units and counts: the first
pixel's centre is (1, 1); m and m^2, body-fixed. What is not set is None or empty. `networks.tie_points` makes TiePoints
of it.
"""

from collections.abc import Callable
from enum import IntEnum, StrEnum

import msgspec
import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.files.opening import name_of
from mgsgraph.geometry.records import LONGEST_NAME
from mgsgraph.names import Names

Where = Callable[[int, int | None, str], str]
"""Where something is in a file, in words: by index of the point, index of the measure or None, and keyword."""


def of_mars(target: str) -> str:
    """The body's name, which some old networks of MRO give as MRO/...: so does ISIS."""
    return "Mars" if target.startswith("MRO/") else target


class PointType(IntEnum):
    """How a point enters jigsaw; numbers as in the file."""

    FREE = 2
    CONSTRAINED = 3
    FIXED = 4


class MeasureType(IntEnum):
    """How a measure was made; numbers as in the file."""

    CANDIDATE = 0
    MANUAL = 1
    REGISTERED_PIXEL = 2
    REGISTERED_SUBPIXEL = 3


class AprioriSource(IntEnum):
    """Where an a-priori place or radius comes from; numbers as in the file."""

    NONE = 0
    USER = 1
    AVERAGE_OF_MEASURES = 2
    REFERENCE = 3
    ELLIPSOID = 4
    DEM = 5
    BASEMAP = 6
    BUNDLE_SOLUTION = 7


class Duplicates(StrEnum):
    """Treatment of a point that several files have (`networks.editing.united`)."""

    REFUSE = "refuse"
    """It is an error."""
    FIRST = "first"
    """United; the first file counts where they contradict each other."""
    LAST = "last"
    """United; the last file counts where they contradict each other."""


class ControlMeasure(msgspec.Struct, frozen=True, gc=False):
    """One measure of a point in an image."""

    serial_number: str
    """Of the image."""
    type: MeasureType
    sample: float | None = None
    """First pixel's centre at 1."""
    line: float | None = None
    sample_residual: float | None = None
    """pixels."""
    line_residual: float | None = None
    chooser_name: str = ""
    """Who or what measured it."""
    date_time: str = ""
    edit_lock: bool = False
    ignore: bool = False
    jigsaw_rejected: bool = False
    diameter: float | None = None
    """pixels, of a crater."""
    apriori_sample: float | None = None
    apriori_line: float | None = None
    sample_sigma: float | None = None
    """pixels."""
    line_sigma: float | None = None
    log: tuple[tuple[int, float], ...] = ()
    """Figures of merit: ISIS's number of the kind (ControlMeasureLogData) and the value."""


class ControlPoint(msgspec.Struct, frozen=True, gc=False):
    """A ground point and its measures."""

    id: str
    type: PointType
    measures: tuple[ControlMeasure, ...] = ()
    chooser_name: str = ""
    date_time: str = ""
    edit_lock: bool = False
    ignore: bool = False
    jigsaw_rejected: bool = False
    reference: int | None = None
    """Index (from 0) of the reference measure, where one is chosen."""
    apriori_source: AprioriSource = AprioriSource.NONE
    apriori_source_file: str = ""
    apriori_radius_source: AprioriSource = AprioriSource.NONE
    apriori_radius_source_file: str = ""
    latitude_constrained: bool = False
    longitude_constrained: bool = False
    radius_constrained: bool = False
    apriori: tuple[float, float, float] | None = None
    """m, body-fixed."""
    apriori_covariance: tuple[float, ...] = ()
    """m^2: xx, xy, xz, yy, yz, zz; or empty."""
    adjusted: tuple[float, float, float] | None = None
    """m, body-fixed."""
    adjusted_covariance: tuple[float, ...] = ()
    """m^2: xx, xy, xz, yy, yz, zz; or empty."""


class ControlNetwork(msgspec.Struct, frozen=True):
    """A network: its head and its points, each id once.

    Raises
    ------
    InputError
        An empty id or one that stands twice, or a reference that is none of the point's measures.
    """

    network_id: str
    target_name: str
    points: tuple[ControlPoint, ...]
    user_name: str = ""
    created: str = ""
    last_modified: str = ""
    description: str = ""
    source: str = ""
    """File it comes from, for messages."""
    target_radii: tuple[float, ...] = ()
    """m, two equatorial and the polar one; or empty."""

    def __post_init__(self) -> None:
        indices: dict[str, int] = {}
        for index, point in enumerate(self.points):
            if not point.id:
                raise InputError(self.where(index), "no PointId", "one for each point")
            if (first := indices.setdefault(point.id, index)) != index:
                raise InputError(self.where(index), f"the id twice, first at point {first + 1}", "each id once")
            if point.reference is not None and not 0 <= point.reference < len(point.measures):
                found = f"measure {point.reference} (counted from 0) as reference"
                raise InputError(self.where(index), found, f"one of its {len(point.measures)} measures")

    def where(self, point: int, measure: int | None = None, key: str = "") -> str:
        """Where something stands: file, number of the point and id, image, keyword."""
        record = self.points[point]
        name = record.id[:60].replace("\n", " ")
        image = "" if measure is None else f"image {record.measures[measure].serial_number}"
        return ", ".join(filter(None, (self.source, f"point {point + 1} ({name})", image, key)))


def with_names(network: ControlNetwork) -> ControlNetwork:
    """A network that was read, whose body, points and images have names that can be shown; InputError for others."""
    if network.target_name:
        name_of(network.target_name, ", ".join(filter(None, (network.source, "TargetName"))))
    require_shown(Names.of([point.id for point in network.points]), network.where, "an id")
    images = dict[str, tuple[int, int]]()
    for index, point in enumerate(network.points):
        for k, measure in enumerate(point.measures):
            images.setdefault(measure.serial_number, (index, k))
    places = list(images.values())
    require_shown(Names.of(list(images)), lambda j: network.where(*places[j]))
    return network


def require_shown(names: Names, where: Callable[[int], str], what: str = "an image's name") -> None:
    """Raise InputError for a name (n) that is empty, overlong or can't be printed; `where` is the k-th."""
    sizes = np.diff(names.offsets)
    if not names.text.isprintable() or sizes.min(initial=1) < 1 or sizes.max(initial=0) > LONGEST_NAME:
        for k, name in enumerate(names):
            name_of(name, where(k), what)

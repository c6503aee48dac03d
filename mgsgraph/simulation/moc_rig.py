"""MOC's narrow angle, its red wide angle and MOLA in one pass: three sensors on one trajectory, two mounted wrongly.

The nominal images are real ones: M04/02852 by its label and kernels, and the wide angle of the same moment by a label
that names its own times (`wide_angle_label`), so that optics, mounting and orbit are those of ISIS's camera models and
NAIF's kernels. MOLA's beam looks along the narrow angle's axis. What is simulated is what they see: the pass's error,
the boresights of the wide angle and of the beam (by default 325 m along the track, the discrepancy of the papers), tie
points of both cameras on heights of MOLA's grid, control points of MOLA's map in the wide angle, and laser shots with a
range, found in both images.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.geometry import rotation
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import OrientationPrior
from mgsgraph.geometry.records import Array
from mgsgraph.network import ImageRays, Network, PointClass, Ranges
from mgsgraph.network.shared import SharedKind, SharedUnknown
from mgsgraph.simulation.camera import InstrumentErrors, displaced_footprints
from mgsgraph.simulation.observations import Visible
from mgsgraph.simulation.rig import PassErrors, SimulatedRig, TrueRig, given_points, joined, measured, seen_twice

WIDE, BEAM = "boresight of MOC-WA", "boresight of MOLA"

_HEIGHT, _RELIEF = 4000.0, 300.0
"""m, mean height of the ground above the ellipsoid at 87 degrees south, about, and its sigma."""
_PERIOD, _SIDE, _FIRST = 80.0, 480, 1489
"""ms per line, lines and samples, and first detector sample of the wide angle's image."""
_CHANGES = {
    "InstrumentId          = MOC-NA": "InstrumentId          = MOC-WA",
    "FilterName   = BROAD_BAND": "FilterName   = RED",
    "M04/02852": "M04/02852W",
    "NaifFrameCode = -94031": "NaifFrameCode = -94032",
    "CrosstrackSumming     = 8": "CrosstrackSumming     = 1",
    "DowntrackSumming      = 8": "DowntrackSumming      = 1",
    "LineExposureDuration  = 0.482100": f"LineExposureDuration  = {_PERIOD}",
    "Samples = 256": f"Samples = {_SIDE}",
    "Lines   = 1536": f"Lines   = {_SIDE}",
    "FirstLineSample       = 1": f"FirstLineSample       = {_FIRST}",
    "619971158:28": "619971142:28",
    "14:12:13.64": "14:11:57.64",
    "14:12:19.56": "14:12:36.04",
}


def wide_angle_label(narrow: str) -> str:
    """Label of a red wide angle, 480 x 480 pixels of 240 m, taken about M04/02852, from the latter's ISIS label.

    Raises
    ------
    InputError
        For another label.
    """
    for before, after in _CHANGES.items():
        if before not in narrow:
            raise InputError("label of M04/02852", f"no {before!r}", "m0402852_isis.lbl of shared/data")
        narrow = narrow.replace(before, after)
    return narrow


@dataclass(frozen=True, slots=True)
class MocSettings:
    """What to simulate."""

    ties: int = 40
    """Tie points in the narrow angle, measured in both images."""
    control: int = 60
    """Control points over the wide angle; 0 for none."""
    shots: int = 128
    """Laser shots over the time of the wide angle; 0 for none."""
    wide: bool = True
    """Whether the wide angle is measured at all."""
    tie_sigmas: tuple[float, float] = (0.5, 0.3)
    """px, in the narrow and the wide angle."""
    shot_sigmas: tuple[float, float] = (5.0, 1.0)
    """px, of a footprint in the narrow and the wide angle."""
    control_sigmas: tuple[float, float] = (150.0, 20.0)
    """m, horizontal and vertical."""
    grid_sigmas: tuple[float, float] = (5000.0, 30.0)
    """m, of a tie point on MOLA's grid: horizontally as good as unknown, and its height."""
    footprint_sigmas: tuple[float, float] = (30.0, 10.0)
    """m, horizontal and vertical, of a footprint's own place."""
    range_sigma: float = 1.0
    """m."""
    discrepancy: float = 325.0
    """m along the track by which footprints lie elsewhere than MOLA's beam truly met the ground."""
    wide_sigmas: tuple[float, float, float] = (2e-3, 2e-3, 2e-3)
    """rad, of the wide angle's boresight about its axes."""
    beam_sigmas: tuple[float, float, float] = (2.5e-4, 9e-4, 2.5e-4)
    """rad, of the beam's about the wide angle's axes: x across the beam's roll, y its pitch (along the track)."""
    errors: PassErrors = field(default_factory=lambda: PassErrors((100.0, 20.0), (3e-4, 1e-4, 3e-5, 1e-5)))
    """Of the pass's trajectory."""


def simulate_moc_rig(
    images: Sequence[PushbroomImage], settings: MocSettings | None = None, seed: int = 1
) -> SimulatedRig:
    """Simulate what the two images and the laser see; the same settings and seed give the same.

    Parameters
    ----------
    images : sequence of PushbroomImage
        Nominal: the narrow angle, and the wide angle, within whose time the narrow one lies.
    settings : MocSettings, optional
        The default ones when absent.
    seed : int
        zero or positive. Truth, points, shots and noise have streams of their own, so that what is left out changes
        nothing else.
    """
    settings = settings or MocSettings()
    of_truth, of_ties, of_control, of_shots, of_noise, of_places = np.random.default_rng([seed, 24]).spawn(6)
    narrow, wide = images
    one = joined("M04/02852", images, 0, settings.errors)
    turned, beam = _drawn_boresights(settings, wide, of_truth)
    truth = TrueRig.drawn(images, [one], settings.errors, np.stack([np.zeros(3), turned]), of_truth)
    ties, control = _tie_places(truth, settings, of_ties), _control_places(truth, settings, of_control)
    mounted = one.axes_of(1)
    assert mounted is not None
    beam_axis = rotation.exponential(-turned) @ (rotation.exponential(beam) @ mounted)[:, 2]
    heights = _HEIGHT + _RELIEF * of_shots.standard_normal(settings.shots)
    shots, times, ranges = truth.shots(1, np.linspace(0.1, 0.9, settings.shots), beam_axis, heights)
    points = np.concatenate([ties, control, shots])
    kinds = np.repeat([0, 1, 2], [len(ties), len(control), len(shots)])
    given = points.copy()
    given[kinds == 2] = displaced_footprints(
        wide, times - wide.trajectory.epoch, shots, InstrumentErrors(altimeter_boresight=beam)
    )
    sigmas = np.array([
        [flat, flat, height]
        for flat, height in (settings.grid_sigmas, settings.control_sigmas, settings.footprint_sigmas)
    ])[kinds]  # fmt: skip
    network = Network(
        images=(narrow, wide),
        priors=(OrientationPrior(settings.errors.sigmas),) * 2,
        held=np.zeros(2, dtype=bool),
        points=given_points(
            [f"{'TCS'[kind]}{i:04d}" for i, kind in enumerate(kinds.tolist())],
            np.array([PointClass.TIE, PointClass.CONTROL, PointClass.LASER], dtype=np.int64)[kinds],
            np.ones(len(kinds), dtype=bool), given, sigmas, sigmas * of_places.standard_normal(points.shape),
        ),
        rays=_rays(truth, points, kinds, settings, of_noise),
        ranges=Ranges(
            np.flatnonzero(kinds == 2), np.ones(len(shots), dtype=np.int64), times,
            ranges + settings.range_sigma * of_shots.standard_normal(ranges.size),
            np.full(ranges.size, settings.range_sigma),
        ),
        shared=_unknowns(settings),
        passes=(one,),
    )  # fmt: skip
    true = {WIDE: turned, BEAM: beam}
    return SimulatedRig(network, truth, points, tuple(true[unknown.name] for unknown in network.shared))


def _unknowns(settings: MocSettings) -> tuple[SharedUnknown, ...]:
    """Those that something measured depends on."""
    camera = SharedUnknown(WIDE, SharedKind.CAMERA_BORESIGHT, np.array([1]), np.array(settings.wide_sigmas))
    beam = SharedUnknown(BEAM, SharedKind.ALTIMETER_BORESIGHT, np.array([1]), np.array(settings.beam_sigmas))
    return tuple(one for one, there in ((camera, settings.wide), (beam, settings.shots)) if there)


def _drawn_boresights(
    settings: MocSettings, wide: PushbroomImage, rng: np.random.Generator
) -> tuple[Array, Array]:
    """(3,) and (3,) rad: of the wide angle, drawn; of the beam, with the stated discrepancy along the track, either
    forward or back.
    """
    camera = np.array(settings.wide_sigmas) * rng.standard_normal(3)
    beam = np.array(settings.beam_sigmas) * rng.standard_normal(3)
    middle = np.array([0.5 * wide.lines]), np.array([0.5 * wide.samples])
    away = np.linalg.norm(wide.image_to_ground(*middle, _HEIGHT)[0][0] - wide.pose(middle[0]).position[0])
    beam[1] = np.sign(beam[1]) * settings.discrepancy / away
    return camera, beam


def _tie_places(truth: TrueRig, settings: MocSettings, rng: np.random.Generator) -> Array:
    """(n, 3) m, over the narrow angle, in the wide one as well."""
    size, count = np.array([truth.images[0].lines, truth.images[0].samples]), 2 * settings.ties
    places = truth.ground(0, size * rng.random((count, 2)), _HEIGHT + _RELIEF * rng.standard_normal(count))
    return places[seen_twice(truth.seen(places), count)][: settings.ties]


def _control_places(truth: TrueRig, settings: MocSettings, rng: np.random.Generator) -> Array:
    """(n, 3) m, over the wide angle."""
    size = np.array([truth.images[1].lines, truth.images[1].samples])
    pixels = size * rng.uniform(0.1, 0.9, (settings.control, 2))
    return truth.ground(1, pixels, _HEIGHT + _RELIEF * rng.standard_normal(settings.control))


def _rays(
    truth: TrueRig, points: Array, kinds: Array, settings: MocSettings, rng: np.random.Generator
) -> ImageRays:
    """Ties and footprints in both images, control in the wide one alone: the narrow one is too small for the map."""
    visible, wanted = truth.seen(points), Visible()
    for point, image, pixels in zip(visible.point, visible.image, visible.pixels, strict=True):
        keep = (image == 1) & settings.wide | (image == 0) & (kinds[point] != 1)
        wanted.add(point[keep], image[keep], pixels[keep])
    of_kind = np.array([settings.tie_sigmas, settings.tie_sigmas, settings.shot_sigmas])
    return measured(wanted, of_kind[kinds], rng)

"""Eos, Gusev and Isidis as one campaign, held together by one bridge image that shows ground of all three.

The sites lie 5,000 to 8,000 km apart, so no narrow image and no single revolution of a polar orbit passes all of them.
The bridge is what MOC's red wide-angle camera did for its global maps, carried to an extreme: one uninterrupted nadir
swath of 1024 samples of 240 m over eight revolutions (15.8 hours), while Mars turns each site under the orbit on a
northbound flight: Eos first, Gusev five revolutions later, Isidis three after that. The positions of the sites and the
orbit are true to life. An image of 710,000 lines, half of them at night, is not, nor that one polynomial orientation
describes all of it. Its nominal orientation differs from truth by a correction drawn from its prior.

Each tie point of a site is measured in the bridge image, too; that is what ties the campaign together. A pixel there is
a hundred times as large as in the sites' images: the bridge joins their networks into one, and adds little accuracy.
"""

from dataclasses import dataclass

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.files.tie_points import TiePoints
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import OrientationCorrection
from mgsgraph.geometry.records import Array, Index
from mgsgraph.simulation.camera import interior_orientation, line_image, one_rate
from mgsgraph.simulation.observations import NoiseSettings, free_points, well_inside
from mgsgraph.simulation.orbit import HEADING, CircularPass, circular_trajectory, site_at
from mgsgraph.simulation.site import SimulatedSite, SimulationOptions, simulate_site
from mgsgraph.simulation.sites import SITE_NAMES
from mgsgraph.units import ARCMIN, DEG

SOURCE = "simulated three-site campaign"
"""What messages call observations that were not read from a file."""
BRIDGE = "BRIDGE"
"""Name of the bridge image."""
BRIDGE_PRIOR = NoiseSettings(tie=0.3, position=100.0, angle=ARCMIN)
"""Sigma of a tie's measure in the bridge image, pixels, and a-priori sigmas of its orientation: a nadir image's."""

_EPOCH = 41_000_000.0
"""s TDB past J2000, in April 2001, when none of the sites' images was taken."""
_CROSSING = 202.45 * DEG
"""rad, longitude where the orbit crosses the equator northward at the epoch: it then passes within 0.5 deg of all."""
_SPAN = (-28_500.0, 28_330.0)
"""s past the epoch, of the first line and the last: a minute before Eos and a minute after Isidis."""
_PASSED = {"eos": -28_440.0, "gusev": 6_760.0, "isidis": 28_268.0}
"""s past the epoch, when the sites are passed."""
_ALTITUDE = 380e3
"""m above the ellipsoid at the equator."""
_FOCAL_LENGTH, _PITCH, _SAMPLES = 11.08e-3, 7e-6, 1024
"""m, m, and the samples used, about the axis: MOC-WA's red camera has 11.1 mm and 3456 (Malin et al. 1992)."""
_PERIOD = 0.08
"""s per line: 240 m at 3.0 km/s, as much as a sample."""
_TABLE_STEP = 10.0
"""s between samples of the orientation; what lies between is the nominal orientation, for truth too."""


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedThreeSites:
    """Three simulated sites and their bridge: what an adjustment is given, and the truth it should find."""

    seed: int
    """Of the random generator; each site has it, too."""
    sites: tuple[SimulatedSite, ...]
    """Eos, Gusev, Isidis, with their images, kernels' errors and profiles."""
    bridge: PushbroomImage
    """Nominal."""
    true_bridge: OrientationCorrection
    """True orientation of the bridge = nominal (+) this."""
    ties: TiePoints
    """Tie points of all sites, named after them, each measured in both of its site's images and in the bridge."""
    true_ties: Array
    """(n, 3) m, body-fixed, in the order of `ties.ids`."""

    def __repr__(self) -> str:
        names = ", ".join(site.settings.name for site in self.sites)
        return f"SimulatedThreeSites({names}; {self.ties!r}; seed {self.seed})"


def simulate_three_sites(seed: int = 1, options: SimulationOptions | None = None) -> SimulatedThreeSites:
    """Simulate the three-site campaign; the same seed and options give the same campaign.

    Parameters
    ----------
    seed : int
        zero or positive.
    options : SimulationOptions, optional
        What differs from the published sites, alike for all three.

    Raises
    ------
    InputError
        As `simulate_site` does, or if the bridge does not show all tie points.
    """
    sites = tuple(simulate_site(name, seed, options) for name in SITE_NAMES)
    rng = np.random.default_rng([seed, 33])
    bridge, true = bridge_image(), BRIDGE_PRIOR.correction(rng)
    ties = _all_ties(sites, bridge, true, rng)
    return SimulatedThreeSites(seed, sites, bridge, true, ties, np.concatenate([site.true_ties for site in sites]))


def bridge_image() -> PushbroomImage:
    """The bridge image, nominal: a nadir swath of eight revolutions."""
    first, last = _SPAN
    flown = CircularPass(_EPOCH, site_at(_CROSSING, 0.0), HEADING, _ALTITUDE)
    interior = interior_orientation(_FOCAL_LENGTH, _PITCH, 0.5 * _SAMPLES)
    trajectory = circular_trajectory(flown, max(-first, last), _TABLE_STEP)
    size = round((last - first) / _PERIOD), _SAMPLES
    return line_image(BRIDGE, size, interior, one_rate(first, _PERIOD), trajectory)


def _all_ties(
    sites: tuple[SimulatedSite, ...], bridge: PushbroomImage, true: OrientationCorrection, rng: np.random.Generator
) -> TiePoints:
    """Tie points of the sites with a measure in the bridge image after those in the sites' own."""
    noise, count = BRIDGE_PRIOR.tie, 0
    point, names, measures, sigmas = list[Index](), list[str](), list[Array](), list[Array]()
    for site in sites:
        n = len(site.ties.ids)
        start = np.full(n, float(bridge.timing.lines(np.array([_PASSED[site.settings.name]]))[0]))
        pixels, _ = bridge.ground_to_image(site.true_ties, true, start)
        if not np.all(well_inside(bridge, pixels)):
            raise InputError(SOURCE, f"a tie point of {site.settings.title} that the bridge does not show")
        point += [count + site.ties.measure_point, count + np.arange(n)]
        names += [*site.ties.measure_image, *(bridge.name,) * n]
        measures += [site.ties.measures, pixels + noise * rng.standard_normal((n, 2))]
        sigmas += [site.ties.measure_sigmas, np.full((n, 2), noise)]
        count += n
    order = np.argsort(np.concatenate(point), kind="stable")
    return free_points(
        SOURCE,
        tuple(f"{site.settings.name}-{name}" for site in sites for name in site.ties.ids),
        np.concatenate(point)[order],
        tuple(names[k] for k in order.tolist()),
        np.concatenate(measures)[order],
        np.concatenate(sigmas)[order],
    )

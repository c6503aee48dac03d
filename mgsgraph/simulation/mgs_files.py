"""A study site's images, profiles, kernels and grids as records from which MGS' files are written, and the names."""

from datetime import datetime, timedelta
from pathlib import Path

import numpy as np

from mgsgraph.errors import InputError
from mgsgraph.geometry.body import planetocentric
from mgsgraph.geometry.trajectory import Trajectory
from mgsgraph.io.megdr import REFERENCE_RADIUS
from mgsgraph.simulation.moc_file import MocImageLabel
from mgsgraph.simulation.mola_files import MegdrLayout, PedrFrames, write_megdr
from mgsgraph.simulation.site import SHOTS_PER_FRAME, SimulatedImage, SimulatedSite
from mgsgraph.simulation.spice_files import KernelSegment
from mgsgraph.simulation.terrain import areoid_under

_MOLA_ORBIT = 10_000
"""What MOLA adds to MGS's mapping orbit."""


def shot_names(image: SimulatedImage) -> tuple[str, ...]:
    """Names of an image's shots as the PEDR's reader gives them: orbit, frame and shot."""
    orbit = image.settings.orbit + _MOLA_ORBIT
    numbers = range(image.profile.times.size)
    return tuple(f"{orbit}:{k // SHOTS_PER_FRAME + 1}:{k % SHOTS_PER_FRAME + 1}" for k in numbers)


def moc_file(image: SimulatedImage) -> str:
    """Name of an image's file."""
    return image.settings.name.replace("-", "") + ".img"


def pedr_file(image: SimulatedImage) -> str:
    """Name of the PEDR file along with an image."""
    return image.settings.profile + ".b"


def kernel_segment(image: SimulatedImage) -> KernelSegment:
    """What the kernels are to say of an image."""
    trajectory = image.nominal.trajectory
    if not isinstance(trajectory, Trajectory):
        raise InputError(f"image {image.nominal.name}", "an orientation in polynomials", "tables, as kernels have")
    return KernelSegment(image.settings.name, image.settings.phase, trajectory)


def image_label(image: SimulatedImage, title: str) -> MocImageLabel:
    """What the label of an image says; `title` is the site's."""
    settings = image.settings
    start = datetime.fromisoformat(settings.start)
    stop = start + timedelta(seconds=settings.duration)
    return MocImageLabel(
        product_id=settings.name.replace("-", "/"),
        start_time=label_time(start),
        stop_time=label_time(stop),
        clock_start=image.clock_start,
        exposure=settings.exposure,
        crosstrack_summing=settings.crosstrack_summing,
        downtrack_summing=settings.downtrack_summing,
        edit_mode=settings.edit_mode,
        orbit=settings.orbit,
        rationale=f"Simulated image of {title}",
    )


def label_time(time: datetime) -> str:
    """ISO to hundredths of a second, as labels have it."""
    return time.strftime("%Y-%m-%dT%H:%M:%S") + f".{time.microsecond // 10_000:02d}"


def pedr_frames(image: SimulatedImage) -> PedrFrames:
    """The profile along with an image, as its PEDR file has it."""
    profile = image.profile
    footprints, craft = planetocentric(profile.footprints), planetocentric(profile.spacecraft)
    return PedrFrames(
        orbit=image.settings.orbit + _MOLA_ORBIT,
        times=profile.times,
        longitudes=footprints[:, 0],
        latitudes=footprints[:, 1],
        radii=footprints[:, 2],
        ranges=profile.ranges,
        areoid_radii=profile.areoid_radii,
        spacecraft_longitudes=craft[:, 0],
        spacecraft_latitudes=craft[:, 1],
        spacecraft_radii=craft[:, 2],
        off_nadir=profile.off_nadir,
        ground=profile.ground,
    )


def write_grids(simulated: SimulatedSite, folder: Path) -> None:
    """Planetary radius and topography as a pair of MEGDR products with labels."""
    grid = simulated.grid
    radii = np.asarray(grid.radii, dtype=np.float64)
    heights = radii - areoid_under(simulated.terrain, grid)
    for letter, offset, posts in (("r", REFERENCE_RADIUS, radii), ("t", 0.0, heights)):
        layout = MegdrLayout(posts.shape, grid.first_longitude, grid.first_latitude, grid.longitude_step, offset)
        write_megdr(folder, grid_file(simulated, letter), layout, [posts])


def grid_file(simulated: SimulatedSite, kind: str) -> str:
    """Name, without suffix, of a site's grid: of radii (kind "r") or of topography ("t")."""
    return f"meg{kind}_{simulated.settings.name}"

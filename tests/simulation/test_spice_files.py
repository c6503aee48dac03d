"""The simulated kernels, asked by CSPICE itself: they say what the trajectory says, in the archive's conventions."""

from pathlib import Path

import numpy as np
import pytest
import spiceypy

from mgsgraph.files.labels.kernels import loaded
from mgsgraph.geometry import rotation
from mgsgraph.geometry.body import from_planetocentric, planetocentric
from mgsgraph.geometry.trajectory import Trajectory
from mgsgraph.simulation import orbit
from mgsgraph.simulation.camera import moc_image
from mgsgraph.simulation.orbit import MARS, body_matrix, mars_about_sun, sun_direction
from mgsgraph.simulation.sites import SITE_NAMES, ImageSettings, SiteSettings, site_settings
from mgsgraph.simulation.spice_files import KernelSegment, clock_count, ephemeris_time, write_kernels
from mgsgraph.units import ARCMIN, ARCSEC, DEG

EXACT = 1e-9
"""rad; what rounding of the spacecraft clock leaves."""


def centre(site: SiteSettings) -> np.ndarray:
    direction = from_planetocentric(np.array([site.longitude, site.latitude, 1.0]))
    return direction / np.linalg.norm(direction / [MARS.equatorial, MARS.equatorial, MARS.polar])


def flown(site: SiteSettings, image: ImageSettings) -> orbit.SitePass:
    epoch = float(round(ephemeris_time(image.start) + 0.5 * image.duration))
    return orbit.site_pass(image, epoch, centre(site), site.altitude)


def segments(name: str) -> list[KernelSegment]:
    site, made = site_settings(name), []
    for k, image in enumerate(site.images):
        rng = np.random.default_rng(k)
        nominal = orbit.nominal_trajectory(flown(site, image), image.duration, image.errors, rng)
        made.append(KernelSegment(image.name, image.phase, nominal))
    return made


@pytest.fixture(scope="module")
def gusev(tmp_path_factory: pytest.TempPathFactory) -> tuple[list[KernelSegment], Path]:
    folder = tmp_path_factory.mktemp("gusev")
    made = segments("gusev")
    write_kernels(made, folder)
    return made, folder


def test_positions_are_those_of_the_trajectory(gusev: tuple[list[KernelSegment], Path]) -> None:
    made, folder = gusev
    with loaded([folder / "mgs.tm"]):
        for segment in made:
            at = np.linspace(-10.0, 10.0, 41)
            states, _ = spiceypy.spkezr("-94", segment.trajectory.epoch + at, "J2000", "NONE", "MARS")
            places, speeds = segment.trajectory.position.at(at)
            assert np.abs(1e3 * np.array(states)[:, :3] - places).max() < 1e-4  # ephemeris time resolves 7e-9 s
            assert np.abs(1e3 * np.array(states)[:, 3:] - speeds).max() < 1e-6


def test_attitude_is_stored_earlier_by_the_archives_bias(gusev: tuple[list[KernelSegment], Path]) -> None:
    made, folder = gusev
    with loaded([folder / "mgs.tm"]):
        camera_of_structure = spiceypy.pxform("MGS_SPACECRAFT", "MGS_MOC_NA", 0.0)
        for segment in made:
            for at in (-7.25, 0.0, 0.5, 6.9):
                clock = spiceypy.sce2c(-94, segment.trajectory.epoch + at - 1.15)
                matrix, _ = spiceypy.ckgp(-94000, clock, 0.0, "J2000")
                expected, _ = segment.trajectory.camera.at(np.array([at]))
                turn = rotation.logarithm(camera_of_structure @ matrix @ expected[0].T)
                assert np.linalg.norm(turn) < EXACT


def test_angular_velocities_are_those_of_the_motion(gusev: tuple[list[KernelSegment], Path]) -> None:
    (nadir, held), folder = gusev
    with loaded([folder / "mgs.tm"]):
        for segment, expected in ((nadir, 8.92e-4), (held, 0.0)):
            clock = spiceypy.sce2c(-94, segment.trajectory.epoch)
            _, angular_rate, _ = spiceypy.ckgpav(-94000, clock, 0.0, "J2000")
            assert np.linalg.norm(angular_rate) == pytest.approx(expected, abs=5e-5)  # the noise of the records


def test_body_rotation_and_mount_are_spices(gusev: tuple[list[KernelSegment], Path]) -> None:
    made, folder = gusev
    with loaded([folder / "mgs.tm"]):
        for segment in made:
            turned = spiceypy.pxform("J2000", "IAU_MARS", segment.trajectory.epoch)
            assert np.abs(turned - body_matrix(np.array([segment.trajectory.epoch]))[0]).max() < 1e-11
        assert np.abs(spiceypy.pxform("MGS_SPACECRAFT", "MGS_MOC_NA", 0.0) - orbit.mount()).max() < 1e-15


def test_times_are_spices(gusev: tuple[list[KernelSegment], Path]) -> None:
    _, folder = gusev
    with loaded([folder / "mgs.tm"]):
        for name in SITE_NAMES:
            for image in site_settings(name).images:
                time = ephemeris_time(image.start)
                assert time == pytest.approx(spiceypy.utc2et(image.start), abs=1e-7)
                count, exact = clock_count(time)
                assert exact == pytest.approx(spiceypy.scs2e(-94, count), abs=1e-7)
                assert abs(exact - time) <= 0.5 / 256 + 1e-6


def test_constants_are_those_of_the_real_addendum(gusev: tuple[list[KernelSegment], Path], shared_data: Path) -> None:
    real = shared_data / "mgs_moc_m0402852"
    wanted = ("FOCAL_LENGTH", "PIXEL_PITCH", "BORESIGHT_SAMPLE", "CK_TIME_BIAS", "ITRANSS", "ITRANSL")
    found = []
    for kernels in ([real / "mocAddendum004.ti"], [gusev[1] / "moc.ti"]):
        with loaded(kernels):
            values = [spiceypy.gdpool(f"INS-94031_{name}", 0, 3) for name in wanted]
            found.append(np.concatenate([*values, spiceypy.gdpool("TKFRAME_-94031_ANGLES", 0, 3)]))
    np.testing.assert_allclose(found[1], found[0], rtol=1e-14)


def test_mars_stands_where_it_did(gusev: tuple[list[KernelSegment], Path], shared_data: Path) -> None:
    """The Sun's direction against the real kernels of an hour in 1999, to a tenth of a degree."""
    real = shared_data / "mgs_moc_m0402852"
    with loaded([real / "naif0012.tls", real / "m0402852.ale_1.bsp"]):
        place, _ = spiceypy.spkpos("SUN", -11_224_002.0, "J2000", "NONE", "4")
    ours, _ = mars_about_sun(np.array([-11_224_002.0]))
    cosine = -ours[0] @ place / np.linalg.norm(ours) / np.linalg.norm(place)
    assert np.arccos(cosine) < 0.1 * DEG
    made, folder = gusev
    with loaded([folder / "mgs.tm"]):  # light time needs Mars against the barycentre
        apparent, light_time = spiceypy.spkpos("SUN", made[0].trajectory.epoch, "IAU_MARS", "LT+S", "MARS")
    unit = apparent / np.linalg.norm(apparent)
    assert np.linalg.norm(unit - sun_direction(made[0].trajectory.epoch)) < 0.1 * DEG
    assert 690.0 < light_time < 830.0


def test_eos_has_kernels_of_its_own_for_each_image(tmp_path: Path) -> None:
    names = write_kernels(segments("eos"), tmp_path)
    assert {"mgs_ext1.bsp", "mgs_ext2.bsp", "mgs_sc_ext1.bc", "mgs_sc_ext2.bc"} < set(names)


@pytest.mark.parametrize("name", SITE_NAMES)
def test_published_geometry_comes_out(name: str) -> None:
    site = site_settings(name)
    for settings in site.images:
        found = flown(site, settings)
        truth = orbit.true_trajectory(found, settings.duration)
        image = moc_image(settings, truth, -0.5 * settings.duration)
        middle = np.array([0.5 * settings.lines])
        axis = np.array([1024.0 - settings.edit_mode]) / settings.crosstrack_summing  # sample of the optical axis
        ground, _ = image.image_to_ground(middle, axis)
        assert np.linalg.norm(ground[0] - centre(site)) < 1e-3
        normal = ground[0] / np.array([MARS.equatorial, MARS.equatorial, MARS.polar]) ** 2
        observation = image.pose(middle).position[0] - ground[0]
        emission = np.arccos(observation @ normal / np.linalg.norm(observation) / np.linalg.norm(normal))
        assert emission == pytest.approx(settings.emission, abs=1e-6)
        steps, _ = image.image_to_ground(middle + [[-0.5], [0.5]] @ np.ones((1, 1)).ravel(), np.repeat(axis, 2))
        speed = np.linalg.norm(steps[1] - steps[0]) / settings.period
        assert 0.1 * speed == pytest.approx(settings.spacing, rel=1e-3)
        before, after = rotation.to_matrix(truth.camera.quaternions[[0, -1]])
        turned = np.linalg.norm(rotation.logarithm(after @ before.T))
        assert (turned < 1e-12) == settings.held
        assert found.orbit.eccentricity == pytest.approx(0.0, abs=0.013)
        assert planetocentric(steps)[1, 1] > planetocentric(steps)[0, 1]  # northbound by day


def misplacement(image: ImageSettings, truth: Trajectory, nominal: Trajectory) -> tuple[np.ndarray, np.ndarray]:
    """Metres along and across the flight by which the nominal orientation looks past what was seen, at 31 lines."""
    start = -0.5 * image.duration
    images = [moc_image(image, trajectory, start) for trajectory in (truth, nominal)]
    lines = np.linspace(0.0, image.lines, 31)
    samples = np.full(31, 0.5 * image.samples)
    seen, meant = (one.image_to_ground(lines, samples)[0] for one in images)
    across = images[0].pose(lines).matrix[:, 1]  # the orbit's normal, but for the roll
    along = np.cross(across, seen / np.linalg.norm(seen, axis=1, keepdims=True))
    return np.sum((meant - seen) * along, axis=1), np.sum((meant - seen) * across, axis=1)


def test_angles_of_the_errors_have_the_sense_they_say() -> None:
    site = site_settings("eos")
    left, right = site.images
    run = flown(site, left)
    nominal = orbit.nominal_trajectory(run, left.duration, left.errors, np.random.default_rng(0))
    along, across = misplacement(left, orbit.true_trajectory(run, left.duration), nominal)
    u = np.linspace(-1.0, 1.0, 31)
    pitch = 381e3 * ARCMIN * (1.0 + 6.0 * u)
    assert np.abs(along - pitch - 35.0 * 3391.0 / 3776.0).max() < 381e3 * 25.0 * ARCSEC
    assert np.abs(across + 20.0).max() < 381e3 * 25.0 * ARCSEC
    run = flown(site, right)
    nominal = orbit.nominal_trajectory(run, right.duration, right.errors, np.random.default_rng(0))
    _, across = misplacement(right, orbit.true_trajectory(run, right.duration), nominal)
    rolled = 398.5e3 * ARCMIN * (1.0 + u) / np.cos(right.emission)  # to the right of the flight
    assert np.abs(across - 15.0 + rolled).max() < 398e3 * 25.0 * ARCSEC

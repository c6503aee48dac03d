"""Simulated instruments that are not as their kernels say."""

from dataclasses import replace

import numpy as np
import pytest
from networks import pair

from mgsgraph.errors import InputError
from mgsgraph.geometry import rotation
from mgsgraph.geometry.image import fit_polynomials
from mgsgraph.simulation.camera import InstrumentErrors, as_taken, displaced_footprints
from mgsgraph.simulation.pair import simulate_pair


def test_a_late_clock_reads_its_table_later() -> None:
    """Inertial attitude and position at t are those of t + bias; the body turns by its own clock."""
    image, times = pair().images[0], np.array([-1.0, 0.0, 2.0])
    taken = as_taken(image, InstrumentErrors(attitude_time=0.5, position_time=-0.25)).trajectory
    given = image.trajectory
    np.testing.assert_allclose(taken.camera.at(times)[0], given.camera.at(times + 0.5)[0], atol=1e-14)  # type: ignore[attr-defined]
    np.testing.assert_allclose(taken.position.at(times)[0], given.position.at(times - 0.25)[0], atol=1e-8)  # type: ignore[attr-defined]
    np.testing.assert_array_equal(taken.body.at(times)[0], given.body.at(times)[0])  # type: ignore[attr-defined]


def test_a_turned_camera_sees_what_the_vector_says() -> None:
    """M = Exp([theta]x)' M nominal, as the orientation corrections have it."""
    image, theta = pair().images[0], np.array([1e-3, -2e-3, 5e-3])
    taken = as_taken(image, InstrumentErrors(camera_boresight=theta))
    lines = np.array([0.0, 100.0])
    np.testing.assert_allclose(
        taken.pose(lines).matrix, rotation.exponential(theta).T @ image.pose(lines).matrix, atol=1e-14
    )


def test_a_footprint_is_believed_where_the_straight_beam_ends() -> None:
    """As far from the instrument as the true one, and off by the angle times the distance."""
    image, laser = pair().images[0], pair().laser
    errors = InstrumentErrors(altimeter_boresight=np.array([0.0, 1e-3, 0.0]))
    times = laser.times - image.trajectory.epoch
    believed = displaced_footprints(image, times, pair().true_footprints, errors)
    place = image.trajectory.pose(times).position
    far, off = (np.linalg.norm(d, axis=1) for d in (pair().true_footprints - place, believed - pair().true_footprints))
    np.testing.assert_allclose(np.linalg.norm(believed - place, axis=1), far, rtol=1e-12)
    np.testing.assert_allclose(off, 1e-3 * far, rtol=1e-4)


def test_the_images_stay_nominal() -> None:
    made = simulate_pair(pair().settings, 1, InstrumentErrors(attitude_time=0.2, range_bias=9.0))
    lines = np.array([10.0, 900.0])
    np.testing.assert_array_equal(made.images[0].pose(lines).matrix, pair().images[0].pose(lines).matrix)
    assert abs(np.mean(made.laser.ranges - pair().laser.ranges) - 9.0) < 5.0
    assert np.abs(made.ties.measures - pair().ties.measures).max() > 1.0


def test_what_cannot_be_simulated_is_said() -> None:
    with pytest.raises(InputError, match="attitude_time"):
        InstrumentErrors(attitude_time=float("nan"))
    with pytest.raises(InputError, match=r"shape \(3\)"):
        InstrumentErrors(camera_boresight=np.zeros(2))
    image = fit_polynomials(pair().images[0])
    with pytest.raises(InputError, match="isn't sampled"):
        as_taken(image, InstrumentErrors())
    with pytest.raises(InputError):
        as_taken(replace(pair().images[0]), InstrumentErrors(attitude_time=50.0))

"""Laser profiles: what broad echoes add to ranges and footprints; crossovers, their places, heights, slopes and sigmas,
on ground that is known.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from mgsgraph.geometry.altimetry import AltimeterShots
from mgsgraph.geometry.body import east_north, from_planetocentric, planetocentric
from mgsgraph.geometry.intersection import TrackHeight, crossing, gradient
from mgsgraph.geometry.records import Array
from mgsgraph.units import DEG

LIGHT = 299792458.0


def shots(pulses: Array) -> AltimeterShots:
    """At longitude 0 on the equator, seen from 22 degrees east of the vertical, 400 km off."""
    n, angle = pulses.size, np.radians(22.0)
    footprints = np.tile([3.39e6, 0.0, 0.0], (n, 1))
    nothing, numbers = np.full(n, np.nan), np.arange(1, n + 1)
    return AltimeterShots(
        source="made up", orbits=np.ones(n), frames=numbers, shots=np.ones(n), times=0.1 * numbers,
        footprints=footprints, areoid_radii=nothing, ranges=np.full(n, 4e5), range_corrections=nothing,
        spacecraft=footprints + 4e5 * np.array([np.cos(angle), np.sin(angle), 0.0]), off_nadir=nothing,
        ground=np.ones(n, dtype=bool), channels=np.ones(n), clocks=nothing, pulses=pulses,
    )  # fmt: skip


def test_broad_echoes_make_ranges_and_footprints_worse_along_the_beam() -> None:
    """By a share of half the way of light in an echo's standard deviation, which the two have in common: a range that
    is too long has its footprint too far on, downward.
    """
    given = shots(np.array([np.nan, 8e-9, 80e-9]))
    found = given.profile(1.0, 3.0, height_sigma=2.0, pulse_share=0.1)
    more = (0.1 * 0.5 * LIGHT * np.array([0.0, 8e-9, 80e-9])) ** 2
    assert found.shares is not None
    both = np.einsum("nij,nj->ni", found.covariances, found.shares)
    assert found.range_sigmas**2 + np.einsum("ni,ni->n", both, found.shares) == pytest.approx(1.0 + more)
    beam, across = np.array([np.cos(np.radians(22.0)), np.sin(np.radians(22.0)), 0.0]), np.array([0.0, 0.0, 1.0])
    none = given.profile(1.0, 3.0, height_sigma=2.0)
    assert np.einsum("i,nij,j->n", beam, found.covariances - none.covariances, beam) == pytest.approx(more)
    assert np.einsum("i,nij,j->n", across, found.covariances, across) == pytest.approx(np.full(3, 9.0))
    assert both == pytest.approx(-more[:, None] * beam, abs=1e-9)
    assert none.range_sigmas == pytest.approx(np.ones(3))
    assert none.shares is None
    unseen = replace(given, spacecraft=np.full((3, 3), np.nan)).profile(1.0, 3.0, pulse_share=0.1)
    assert unseen.covariances[:, 0, 0] == pytest.approx(9.0 + more)  # upward, where nothing says from where


# --- crossovers


RADIUS = 3.39e6

CENTRE = np.array([[137.0 * DEG, -5.0 * DEG, RADIUS]])

Ground = Callable[[Array, Array], Array]


def track(azimuth: float, ground: Ground, through: tuple[float, float] = (0.0, 0.0), spacing: float = 300.0) -> Array:
    """(40, 3) m, shots along a great circle, an azimuth (degrees) against north, on ground of (east, north) in m."""
    distance = spacing * (np.arange(40) - 19.3)
    middle = from_planetocentric(CENTRE)[0]
    east, north = east_north(middle[None])[0]
    way = np.sin(azimuth * DEG) * east + np.cos(azimuth * DEG) * north
    points = middle + through[0] * east + through[1] * north + distance[:, None] * way
    return on(points, ground)


def plane(points: Array) -> Array:
    """(n, 2) m, eastward and northward of the centre, where great circles are straight."""
    middle = from_planetocentric(CENTRE)[0]
    return np.asarray(points @ east_north(middle[None])[0].T * RADIUS / (points @ middle / RADIUS)[:, None])


def on(points: Array, ground: Ground) -> Array:
    """The same on the ground."""
    places = planetocentric(points)
    places[:, 2] = RADIUS + ground(*plane(points).T)
    return from_planetocentric(places)


def shifted(points: Array, shift: tuple[float, float]) -> Array:
    return points + np.asarray(shift) @ east_north(points)


def difference(both: tuple[TrackHeight, TrackHeight], tracks: tuple[Array, Array]) -> float:
    """m, of the heights at a crossing."""
    one, two = (
        float(said.shares @ np.linalg.norm(points[said.shots], axis=1))
        for said, points in zip(both, tracks, strict=True)
    )
    return one - two


def slope(east: Array, north: Array) -> Array:
    return 0.08 * east - 0.05 * north


@pytest.mark.parametrize("azimuths", [(7.0, -7.0), (0.0, 90.0)])
def test_a_plane_has_its_gradient_and_no_difference(azimuths: tuple[float, float]) -> None:
    tracks = track(azimuths[0], slope, (40.0, 30.0)), track(azimuths[1], slope, (-20.0, 10.0))
    found = crossing(*tracks, (1.0, 1.0))
    assert found is not None
    assert gradient(found) == pytest.approx([0.08, -0.05], abs=2e-4)
    assert difference(found, tracks) == pytest.approx(0.0, abs=0.02)
    assert all(one.shares.sum() == pytest.approx(1.0) and one.shares.min() >= 0.0 for one in found)
    assert found[0].sigma == pytest.approx(np.linalg.norm(found[0].shares), abs=0.02)  # a plane is not rough
    assert crossing(tracks[0][::-1], tracks[1], (1.0, 1.0)) is not None  # in any order


@pytest.mark.parametrize("shift", [(30.0, 0.0), (-20.0, 15.0)])
def test_a_shift_changes_the_difference_by_the_gradient(shift: tuple[float, float]) -> None:
    """The Jacobian against the geometry itself, on curved ground: where the first track is moved, the rest is found
    anew.
    """

    def hills(east: Array, north: Array) -> Array:
        return slope(east, north) + 200.0 * np.sin(east / 8000.0) * np.cos(north / 9000.0)

    tracks = track(20.0, hills), track(-35.0, hills)
    moved = shifted(tracks[0], shift), tracks[1]
    found, after = crossing(*tracks, (1.0, 1.0)), crossing(*moved, (1.0, 1.0))
    assert found is not None
    assert after is not None
    change = difference(after, moved) - difference(found, tracks)
    assert change == pytest.approx(-gradient(found) @ shift, abs=0.05)
    assert abs(change) > 0.5


def test_several_beams_are_one_track() -> None:
    """Five spots a shot, 25 m apart, as LOLA has them."""
    spots = [track(10.0, slope, (25.0 * k, 9.0 * k), 57.0) for k in range(-2, 3)]
    tracks = np.concatenate(spots), track(-30.0, slope, spacing=57.0)
    found = crossing(*tracks, (0.1, 0.1))
    assert found is not None
    assert abs(difference(found, tracks)) < 3.0 * np.hypot(found[0].sigma, found[1].sigma)
    assert found[0].along @ [0.08, -0.05] == pytest.approx(found[0].slope, abs=0.02)


def test_tracks_that_do_not_cross() -> None:
    first = track(7.0, slope)
    assert crossing(first, track(8.0, slope, (100.0, 0.0)), (1.0, 1.0)) is None  # nearly parallel
    assert crossing(first, track(90.0, slope, (0.0, 9e3)), (1.0, 1.0)) is None  # beyond the end
    assert crossing(np.delete(first, slice(17, 22), axis=0), track(90.0, slope), (1.0, 1.0)) is None  # in a gap
    assert crossing(first[:3], track(90.0, slope), (1.0, 1.0)) is None


@pytest.mark.parametrize(("hurst", "spacing"), [(0.4, 300.0), (0.8, 57.0)])
def test_sigmas_are_those_of_the_differences(hurst: float, spacing: float) -> None:
    """On self-affine ground, rougher than Mars's (0.4) and as rough, under shots with noise of 1 m; 80 crossings."""
    rng = np.random.default_rng(5)
    whitened = []
    for _ in range(80):
        number, azimuth = 2.0 * np.pi / 10.0 ** rng.uniform(1.2, 4.5, 300), rng.uniform(0.0, 2.0 * np.pi, 300)
        waves = number * np.stack([np.cos(azimuth), np.sin(azimuth)])
        heights, phase = 0.02 * rng.normal(size=300) * number**-hurst, rng.uniform(0.0, 2.0 * np.pi, 300)

        def ground(east: Array, north: Array, waves=waves, heights=heights, phase=phase) -> Array:
            return np.sin(np.stack([east, north], axis=1) @ waves + phase) @ heights

        through, way = rng.uniform(-150.0, 150.0, 2), float(rng.uniform(-40.0, 40.0))
        tracks = track(way, ground, through, spacing), track(way + 30.0, ground, spacing=spacing)
        tracks = tuple(points * (1.0 + rng.normal(size=(len(points), 1)) / RADIUS) for points in tracks)
        found = crossing(*tracks, (1.0, 1.0))
        assert found is not None
        whitened.append(difference(found, tracks) / np.hypot(found[0].sigma, found[1].sigma))
    assert 0.55 < np.sqrt(np.mean(np.square(whitened))) < 1.1

"""Shots as observations: what broad echoes add to ranges and footprints."""

from dataclasses import replace

import numpy as np
import pytest

from mgsgraph.geometry.altimetry import AltimeterShots
from mgsgraph.geometry.records import Array

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


@pytest.mark.parametrize("ranged", [False, True])
def test_broad_echoes_make_ranges_and_footprints_worse_along_the_beam(ranged: bool) -> None:
    """By a share of half the way of light in an echo's standard deviation; twice the variance where both are used."""
    given = shots(np.array([np.nan, 8e-9, 80e-9]))
    found = given.profile(1.0, 3.0, height_sigma=2.0, pulse_share=0.1, ranged=ranged)
    more = (1.0 + ranged) * (0.1 * 0.5 * LIGHT * np.array([0.0, 8e-9, 80e-9])) ** 2
    assert found.range_sigmas**2 == pytest.approx(1.0 + more)
    beam, across = np.array([np.cos(np.radians(22.0)), np.sin(np.radians(22.0)), 0.0]), np.array([0.0, 0.0, 1.0])
    none = given.profile(1.0, 3.0, height_sigma=2.0)
    assert np.einsum("i,nij,j->n", beam, found.covariances - none.covariances, beam) == pytest.approx(more)
    assert np.einsum("i,nij,j->n", across, found.covariances, across) == pytest.approx(np.full(3, 9.0))
    assert none.range_sigmas == pytest.approx(np.ones(3))
    unseen = replace(given, spacecraft=np.full((3, 3), np.nan)).profile(1.0, 3.0, pulse_share=0.1, ranged=ranged)
    assert unseen.covariances[:, 0, 0] == pytest.approx(9.0 + more)  # upward, where nothing says from where

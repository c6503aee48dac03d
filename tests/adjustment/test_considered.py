"""Considered unknowns: held at zero, their a-priori covariance carried into all else (Schmidt 1966)."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from explicit_form import by_gtsam
from networks import network, pair, with_shift_and_surface, with_tilting_surface
from sharing import shared

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.adjustment.two_steps import without_terrain
from mgsgraph.analysis.reliability import reliability
from mgsgraph.errors import InputError
from mgsgraph.geometry.body import east_north
from mgsgraph.geometry.records import Array
from mgsgraph.network import TERRAIN, Network, PointClass, SharedKind
from mgsgraph.network.parts import joined, part

SHIFT = 60.0
"""m, a-priori sigma of the profile's shift."""
EXACT = SolverSettings(cost_tolerance=1e-15, step_tolerance=1e-9)


@cache
def with_profile() -> Network:
    """The pair with a laser profile of unknown shift."""
    return replace(with_shift_and_surface(network(pair()), SHIFT), surface=None)


def values(solution: Solution) -> Array:
    """All that is estimated of the orientation and of the points, m and rad."""
    return np.concatenate([*(part.ravel() for part in solution.coefficients), solution.places.ravel()])


def displaced(net: Network, shift: Array) -> Network:
    """The network without an unknown shift, its footprints elsewhere by (2,) m east and north."""
    laser = net.points.classes == PointClass.LASER
    moved = np.einsum("k,nkj->nj", shift, east_north(net.points.places[laser]))
    places = net.points.places.copy()
    places[laser] += moved
    return replace(net, shifts=None, points=replace(net.points, places=places))


def test_the_covariance_is_that_of_estimates_that_a_shift_displaces() -> None:
    """cov = cov without the unknown + S C S', S by adjusting data that truly are displaced, which shares no line of
    code with the covariance.
    """
    net = with_profile()
    found = adjust_network(replace(net, considered=("profile",)), EXACT)
    plain = adjust_network(displaced(net, np.zeros(2)), EXACT)
    assert values(found) == pytest.approx(values(plain), abs=1e-4)
    assert np.abs(found.shifts).max() < 1e-4
    step = 20.0
    slopes = np.stack([
        (values(adjust_network(displaced(net, step * way), EXACT))
         - values(adjust_network(displaced(net, -step * way), EXACT))) / (2.0 * step)
        for way in np.eye(2)
    ])  # fmt: skip
    columns, n = found.joint_covariance.columns - 2, len(net.points)
    of_points = slopes[:, columns:].reshape(2, n, 3)
    added = SHIFT**2 * np.einsum("kni,knj->nij", of_points, of_points)
    size = np.sqrt(np.trace(added, axis1=1, axis2=2))[:, None, None]
    assert size.max() > 10.0
    np.testing.assert_allclose((found.covariances - plain.covariances) / size**2, added / size**2, atol=2e-3)
    images = range(len(net.images))
    more = found.joint_covariance.of(images) - plain.joint_covariance.of(images)
    expected = SHIFT**2 * slopes[:, :columns].T @ slopes[:, :columns]
    units = np.sqrt(np.diagonal(plain.joint_covariance.of(images)))
    np.testing.assert_allclose(more / units / units[:, None], expected / units / units[:, None], atol=2e-3)
    assert found.shift_covariance(0) == pytest.approx(SHIFT**2 * np.eye(2), rel=1e-6, abs=1e-3)


def test_redundancy_is_the_estimators() -> None:
    """What is carried of an unknown doesn't change which blunders show: as where the shift is known."""
    net = with_profile()
    found = reliability(adjust_network(replace(net, considered=("profile",)), EXACT)).measures
    plain = reliability(adjust_network(displaced(net, np.zeros(2)), EXACT)).measures
    assert found.redundancy.min() > -1e-6
    assert found.redundancy.size == plain.redundancy.size + 2  # the shift's priors, which nothing controls
    assert sorted(found.redundancy)[2:] == pytest.approx(sorted(plain.redundancy), abs=1e-5)
    assert found.redundancy.sum() == pytest.approx(plain.redundancy.sum(), abs=1e-4)


@pytest.mark.parametrize("considered", [("profile",), (TERRAIN,), ("profile", TERRAIN, "camera boresight")])
def test_both_forms_agree(considered: tuple[str, ...]) -> None:
    """The bundle form and GTSAM's own marginals; a terrain model's height and tilts are estimated beside its shift."""
    net = with_tilting_surface(network(pair()))
    boresight = shared(SharedKind.CAMERA_BORESIGHT, [0, 1])
    net = replace(net, shared=(boresight,), considered=considered)
    bundle = adjust_network(net, EXACT)
    explicit = by_gtsam(bundle)
    assert bundle.cost_final == pytest.approx(explicit.cost_final, rel=1e-9)
    sigmas = bundle.joint_covariance.sigmas
    dense = [one.joint_covariance.dense() / sigmas / sigmas[:, None] for one in (bundle, explicit)]
    np.testing.assert_allclose(dense[0], dense[1], atol=1e-6)
    np.testing.assert_allclose(bundle.sigmas, explicit.sigmas, rtol=1e-6)
    last = len(net.shift_names) - 1
    before = SHIFT if considered == ("profile",) else 150.0
    spread = bundle.shift_spread(0 if considered == ("profile",) else last)[:2, :2]
    assert spread == pytest.approx(before**2 * np.eye(2), rel=1e-6, abs=1e-2)


def test_parts_of_a_network_keep_what_they_consider() -> None:
    net = replace(with_shift_and_surface(network(pair()), SHIFT), considered=("profile", TERRAIN))
    ties, shots = (np.flatnonzero(net.points.classes == kind) for kind in (PointClass.TIE, PointClass.LASER))
    parts = part(net, ties), part(net, shots)
    assert [one.considered for one in parts] == [(TERRAIN,), ("profile",)]
    assert set(joined(parts).considered) == {"profile", TERRAIN}
    with pytest.raises(InputError, match="profile"):
        joined([part(net, shots[:2]), part(replace(net, considered=()), shots[2:])])


def test_without_its_terrain_a_network_considers_the_rest() -> None:
    net = replace(with_shift_and_surface(network(pair()), SHIFT), considered=("profile", TERRAIN))
    assert without_terrain(net).considered == ("profile",)


def test_names_of_no_unknowns_are_refused() -> None:
    with pytest.raises(InputError, match="profile"):
        replace(with_profile(), considered=("nothing",))
    with pytest.raises(InputError, match="considered"):
        replace(with_profile(), considered=("profile", "profile"))
    tilting = with_tilting_surface(network(pair()))
    assert tilting.surface is not None
    with pytest.raises(InputError, match="horizontal"):
        replace(tilting, surface=replace(tilting.surface, shift_sigma=0.0), considered=(TERRAIN,))

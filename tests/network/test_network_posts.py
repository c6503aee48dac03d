"""Posts of terrain models as points of a network: means of cells, their places, sigmas and unknowns."""

from dataclasses import replace

import networks
import numpy as np
import pytest

from mgsgraph.errors import InputError
from mgsgraph.files.networks.tie_points import PointKind
from mgsgraph.geometry.body import planetocentric
from mgsgraph.geometry.records import Array
from mgsgraph.geometry.terrain import Gaps, TerrainGrid
from mgsgraph.network import PointClass, SharedKind
from mgsgraph.network.observations import TerrainModel, posts_of, with_posts
from mgsgraph.units import DEG

RADIUS = 3_390_000.0
STEP = DEG / 128.0
SIDE = RADIUS * STEP


def model(radii: Array, latitude: float = 0.0, **more: object) -> TerrainModel:
    """Posts from a latitude southward; 10 m each."""
    sigmas = {"vertical_sigma": 10.0, "planimetric_sigma": 200.0}
    return TerrainModel("dtm", TerrainGrid("dtm.tif", radii, 0.3, latitude, STEP, STEP, **sigmas).lattice(), **more)  # type: ignore[arg-type]


def plane(rows: int, columns: int) -> Array:
    """A radius that grows by 3 m a row and 2 m a column."""
    row, column = np.indices((rows, columns), dtype=np.float64)
    return RADIUS + 3.0 * row + 2.0 * column


def test_posts_are_where_the_grid_has_them() -> None:
    posts = posts_of(model(plane(4, 5)), 0.0)
    assert len(set(posts.ids)) == len(posts.ids) == 20
    assert posts.ids[6] == "dtm:2:2"
    assert np.linalg.norm(posts.points, axis=1) == pytest.approx(plane(4, 5).ravel(), abs=1e-6)
    longitude, latitude, _ = planetocentric(posts.points).T
    assert (longitude - 0.3) / STEP == pytest.approx(np.tile(np.arange(5.0), 4), abs=1e-6)
    assert latitude / STEP == pytest.approx(-np.repeat(np.arange(4.0), 5), abs=1e-6)
    assert posts.sigmas == pytest.approx(np.full(20, 10.0))
    assert posts.footprint == pytest.approx(4.0 / np.sqrt(12.0) * SIDE, rel=1e-3)  # the second moment of a square


@pytest.mark.parametrize("holes", [0, 5])
def test_means_of_cells_lie_on_a_plane_wherever_posts_are_missing(holes: int) -> None:
    """A mean height belongs to the mean place of its posts; its sigma is theirs by the root of their number."""
    radii = plane(12, 15)
    chosen = np.random.default_rng(holes).choice(radii.size, holes, replace=False)
    radii.ravel()[chosen] = np.nan
    posts = posts_of(model(radii), 3.0 * SIDE)
    longitude, latitude, radius = planetocentric(posts.points).T
    assert radius == pytest.approx(RADIUS - 3.0 * latitude / STEP + 2.0 * (longitude - 0.3) / STEP, abs=1e-4)
    assert len(posts.ids) == 20
    assert np.sum(100.0 / posts.sigmas**2) == pytest.approx(180 - holes)
    assert posts.footprint == pytest.approx(3.0 * 4.0 / np.sqrt(12.0) * SIDE, rel=1e-3)


def test_cells_are_about_as_wide_as_high_near_the_pole() -> None:
    """At 60 degrees a column is half as wide as a row is high."""
    posts = posts_of(model(plane(4, 8), 60.0 * DEG), 0.0)
    assert len(posts.ids) == 16
    assert posts.footprint == pytest.approx(4.0 / np.sqrt(12.0) * SIDE, rel=0.01)


def test_a_cell_of_few_posts_is_none() -> None:
    radii = plane(4, 4)
    radii[:2, 1:3] = np.nan
    posts = posts_of(model(radii), 2.0 * SIDE)
    assert [name[4:] for name in posts.ids] == ["3:1", "3:3"]
    assert posts.sigmas == pytest.approx(np.full(2, 5.0))


@pytest.mark.parametrize("side", [1.0, 2.0])
def test_cells_in_one_gap_are_worth_no_more_than_its_error(side: float) -> None:
    """Sixteen posts between two tracks that are off by 7 m as one, however they are averaged."""
    between = np.zeros((4, 12))
    between[:, 4:8] = 7.0
    lattice = replace(model(plane(4, 12)).lattice, gaps=Gaps(between, np.full((4, 12), 6.0 * SIDE)))
    posts = posts_of(TerrainModel("dtm", lattice), side * SIDE)
    within = posts.sigmas > 11.0 / side
    assert np.count_nonzero(within) == 16 / side**2
    together = 1.0 / np.sum(posts.sigmas[within] ** -2.0)
    assert together == pytest.approx(7.0**2 + 10.0**2 / 16.0)
    assert posts.sigmas[~within] == pytest.approx(np.full(32 // int(side**2), 10.0 / side))


def test_what_is_not_known_is_said() -> None:
    with pytest.raises(InputError, match="no sigma of its heights"):
        posts_of(TerrainModel("dtm", replace(model(plane(4, 4)).lattice, vertical_sigma=None)), 0.0)
    with pytest.raises(InputError, match="no sigma of its horizontal place"):
        TerrainModel("dtm", replace(model(plane(4, 4)).lattice, planimetric_sigma=None))


def test_models_become_profiles_of_their_own() -> None:
    """Two of them, one of unknown height; what was there stays what it was."""
    net = networks.with_shift_and_surface(networks.network(networks.pair()))
    assert net.shifts is not None
    first, second = model(plane(4, 5), height_sigma=3.0), replace(model(plane(3, 3)), name="other")
    found = with_posts(net, [(one, posts_of(one, 0.0)) for one in (first, second)])
    assert found.shifts is not None
    n = len(net.points)
    assert found.points.ids[:n] == net.points.ids
    assert found.shifts.names == (*net.shifts.names, "dtm", "other")
    assert found.shifts.sigmas[-2:].tolist() == [200.0, 200.0]
    assert np.bincount(found.shifts.profile[n:]).tolist()[-2:] == [20, 9]
    assert set(found.points.classes[n:].tolist()) == {PointClass.POST}
    assert set(found.points.kinds[n:].tolist()) == {PointKind.CONSTRAINED}
    (height,) = (one for one in found.shared if one.kind is SharedKind.PROFILE_HEIGHT)
    assert (height.profile, height.sigmas[0]) == ("dtm", 3.0)
    up = found.points.places[n:] / np.linalg.norm(found.points.places[n:], axis=1, keepdims=True)
    variances = np.einsum("ni,nij,nj->n", up, found.points.covariances[n:], up)
    assert variances == pytest.approx(np.full(29, 100.0))
    assert found.surface is not None
    assert not np.any(np.isfinite(found.surface.sigmas[n:]))
    assert found.classes[-1] is PointClass.POST
    assert PointClass.POST not in net.classes

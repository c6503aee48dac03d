"""The ground of a case: its terrain models, ties that they don't cover, and its images with their pixels over it."""

import re
from pathlib import Path

import matched
import numpy as np
import profiles
import pytest
from outside import refuses
from pass_files import write_block
from PIL import Image
from rasters import PROJECTIONS, RADIUS, SPHERE, ground, pixels, raster
from sites import plain_site

import mgsgraph
from mgsgraph.case.case_file import decode, read_images
from mgsgraph.case.passes import members
from mgsgraph.case.reading import picture_of
from mgsgraph.case.scene import image_priors, read_scene
from mgsgraph.case.terrain import require_level
from mgsgraph.errors import InputError
from mgsgraph.files.altimetry.lidar import read_lidar
from mgsgraph.geometry.body import from_planetocentric, geodetic, planetocentric
from mgsgraph.geometry.records import Array
from mgsgraph.geometry.terrain import TerrainGrid
from mgsgraph.network import Network, PointClass, Surface
from mgsgraph.network.observations import coverage, in_degrees, nominal_ground, posts_of, terrain_ground
from mgsgraph.project.campaign import checksums
from mgsgraph.results.ground import control_section
from mgsgraph.results.inventory import inventory
from mgsgraph.simulation.files import write_site
from mgsgraph.simulation.mola_files import MegdrLayout, write_megdr
from mgsgraph.simulation.orbit import MARS
from mgsgraph.units import DEG, MRAD

STEP = 0.01
"""degrees between posts."""


def ties(net: Network) -> Array:
    """(n, 2) degrees, longitude and latitude of the ties' ground."""
    rays = net.rays.chosen(net.points.classes[net.rays.point] == PointClass.TIE)
    points, first = np.unique(rays.point, return_index=True)
    assert points.size == 20
    return planetocentric(nominal_ground(net.images, rays.chosen(first)))[:, :2] / DEG


def with_terrain(
    case_file: Path, keys: str = "", west: float = -0.5, east: float = 0.5, height: float = 0.0,
    hole: tuple[float, float] | None = None, scale: float = 1.0,
) -> Path:  # fmt: skip
    """The case with a GeoTIFF of heights above a sphere, from `west` to `east` of the ties' middle (degrees)."""
    rasterio = pytest.importorskip("rasterio")
    places = ties(mgsgraph.read_case(case_file).network)
    middle, low, high = places[:, 0].mean(), places[:, 1].min() - 0.3, places[:, 1].max() + 0.3
    columns, rows = round((east - west) / STEP), round((high - low) / STEP)
    latitude = (high - (np.arange(rows) + 0.5) * STEP) * DEG
    a, b = MARS.equatorial, MARS.polar
    radius = a * b / np.sqrt((b * np.cos(latitude)) ** 2 + (a * np.sin(latitude)) ** 2)
    values = np.repeat((radius - 3396190.0 + height)[:, None], columns, axis=1) / scale
    if hole is not None:
        longitude = west + (np.arange(columns) + 0.5) * STEP
        values[:, (longitude > hole[0]) & (longitude < hole[1])] = -1e9
    with rasterio.open(
        case_file.with_name("dtm.tif"), "w", driver="GTiff", height=rows, width=columns, count=1, dtype="float64",
        crs="+proj=longlat +R=3396190 +no_defs", nodata=-1e9,
        transform=rasterio.Affine(STEP, 0, middle + west, 0, -STEP, high),
    ) as file:
        file.write(values, 1)
        file.scales = (scale,)
    return add(case_file, f'radius = "dtm.tif"\nreference_radius_m = 3396190.0\n{keys}')


def add(case_file: Path, keys: str) -> Path:
    without(case_file)
    with case_file.open("a", encoding="utf-8") as file:
        file.write(f"\n[terrain]\n{keys}\n")
    return case_file


def without(case_file: Path) -> Path:
    """The case without its terrain model, which `add` put last."""
    text, _, _ = case_file.read_text(encoding="utf-8").partition("\n[terrain]\n")
    case_file.write_text(text, encoding="utf-8")
    return case_file


def surface_of(case_file: Path) -> Surface:
    """With sigmas as if heights had nothing in common."""
    found = mgsgraph.read_case(case_file).network.independent.surface
    assert found is not None
    return found


def middle_of(case_file: Path) -> Array:
    return ties(mgsgraph.read_case(case_file).network)


def test_its_shift_is_estimated_or_considered(case_file: Path) -> None:
    moving = surface_of(with_terrain(case_file, scale=0.25, height=-4000.0))
    assert np.abs(moving.grid.radii - MARS.equatorial + 4000.0).max() < 200.0
    assert [term.name for term in moving.terms] == ["east shift", "north shift"]
    held = moving.sigmas[np.isfinite(moving.sigmas)]
    assert held.size == 20
    assert np.count_nonzero(held > 13.0) == 2  # a pair of ties lies in half a cell
    assert np.all((held >= 10.0 - 1e-9) & (held < 10.0 * 2**0.5))
    assert mgsgraph.read_case(case_file).network.considered == ()
    path = add(case_file, 'radius = "dtm.tif"\nreference_radius_m = 3396190.0\nshift = false')
    assert mgsgraph.read_case(path).network.considered == ("terrain model",)
    assert surface_of(path).terms == moving.terms
    solution = mgsgraph.adjust(mgsgraph.read_case(path))
    assert np.abs(solution.shift_values[-1]).max() < 1e-3
    assert solution.shift_spread(0) == pytest.approx(200.0**2 * np.eye(2), rel=1e-6, abs=1e-2)


def test_height_and_tilt_may_be_unknown_and_are_said(case_file: Path) -> None:
    path = with_terrain(case_file, "height_sigma_m = 30.0\ntilt_sigma_mrad = 0.1")
    found = surface_of(path)
    assert [term.sigma for term in found.terms] == [200.0, 200.0, 30.0, 0.1 * MRAD, 0.1 * MRAD]
    assert found.middle is not None
    place = planetocentric(found.middle[None])[0, :2] / DEG
    np.testing.assert_allclose(place, middle_of(path).mean(axis=0), atol=1e-3)
    text = inventory(mgsgraph.read_case(path))
    assert re.search(r"upward shift +terrain model +30 m", text)
    assert re.search(r"tilt about north +terrain model +20.6 arcsec", text)
    assert "leaves out" not in text


def test_ties_beside_it_and_over_holes_are_counted(case_file: Path) -> None:
    places = middle_of(case_file)
    east = np.sort(places[:, 0] - places[:, 0].mean())
    edge, hole = 0.5 * (east[14] + east[15]), 0.5 * (east[3] + east[4])
    # posts in steps of 0.01 degrees: which ties they cover follows from the grid
    path = with_terrain(case_file, west=-0.3, east=edge, hole=(-0.3, hole))
    net = mgsgraph.read_case(path).network
    assert net.surface is not None
    on = int(np.isfinite(net.surface.sigmas).sum())
    assert 0 < on < 20
    ground = terrain_ground(net.images, net.rays, net.surface.grid)
    points, first = np.unique(net.rays.point, return_index=True)
    mine = net.points.classes[points] == PointClass.TIE
    covered = coverage(net.surface.grid, ground[first[mine]])
    assert (covered.on, covered.total) == (on, 20)
    assert covered.beside > 0
    assert covered.over_holes > 0
    text = inventory(mgsgraph.read_case(path))
    assert re.search(r"of 20 tie points it leaves out \d+ outside the model \(points .* E, .* N; model ", text)
    assert re.search(r"and \d+ over missing posts: these have no such row", text)
    solution = mgsgraph.adjust(mgsgraph.read_case(path))
    record = control_section(solution).numbers["surface"]
    assert record["outside"] > 0
    assert record["over_missing_posts"] > 0
    assert 18 <= record["count"] + record["outside"] + record["over_missing_posts"] <= 20


def test_boxes_are_said_in_0_to_360() -> None:
    box = np.array([[-180.25, -30.5], [-179.75, 89.0]])
    assert in_degrees(box * DEG) == "179.750 .. 180.250 E, -30.500 .. +89.000 N"
    assert in_degrees((box + np.array([180.0, 0.0])) * DEG) == "359.750 .. 0.250 E, -30.500 .. +89.000 N"


def test_a_model_of_other_ground_is_an_error_with_both_boxes(case_file: Path) -> None:
    said = r"no tie point lies over.*of 20, 20 outside the model \(points .*; model "
    with pytest.raises(InputError, match=said) as error:
        mgsgraph.read_case(with_terrain(case_file, west=0.1, east=4.0))
    numbers = [float(x) for x in re.findall(r"-?\d+\.\d{3}", str(error.value).replace("+", ""))]
    assert len(numbers) == 8
    assert numbers[4] > numbers[1]
    with pytest.raises(InputError, match=r"no post within 8 km of the images \(.*; expected a model of their ground"):
        mgsgraph.read_case(with_terrain(without(case_file), west=3.0, east=4.0))
    case = with_terrain(without(case_file), hole=(-0.15, 0.15))
    refuses("of 20, 20 over missing posts", mgsgraph.read_case, case)


def test_ground_is_found_where_the_terrain_is(case_file: Path) -> None:
    """4 km below the ellipsoid an oblique ray ends a kilometre farther on."""
    net = mgsgraph.read_case(with_terrain(case_file, height=-4000.0)).network
    assert net.surface is not None
    ground = terrain_ground(net.images, net.rays, net.surface.grid)
    assert np.abs(np.linalg.norm(ground, axis=1) - net.surface.grid.at(ground)).max() < 1.0
    origins = np.empty_like(ground)
    for j, image in enumerate(net.images):
        mine = net.rays.image == j
        start, direction = image.sightlines(*net.rays.places[mine].T)
        along = ground[mine] - start
        direction = direction / np.linalg.norm(direction, axis=1)[:, None]
        origins[mine] = along - np.einsum("ni,ni->n", along, direction)[:, None] * direction
    assert np.abs(origins).max() < 1e-5


def test_tiles_and_heights_above_the_areoid_are_the_same_model(case_file: Path) -> None:
    rasterio = pytest.importorskip("rasterio")
    whole = surface_of(with_terrain(case_file, height=-500.0))
    folder = case_file.parent
    with rasterio.open(folder / "dtm.tif") as file:
        values, place, kind = file.read(1), file.transform, dict(file.profile)
    for name, columns in (("west", slice(0, 48)), ("east", slice(48, None))):
        part = values[:, columns]
        own = kind | {"width": part.shape[1], "transform": place @ rasterio.Affine.translation(columns.start, 0)}
        with rasterio.open(folder / f"{name}.tif", "w", **own) as file:
            file.write(part, 1)
    with rasterio.open(folder / "areoid.tif", "w", **kind) as file:
        file.write(np.full_like(values, 3396190.0), 1)
    path = add(case_file, 'radius = ["east.tif", "west.tif"]\nareoid = "areoid.tif"')
    net = mgsgraph.read_case(path).network
    assert net.surface is not None
    np.testing.assert_allclose(net.surface.grid.radii, whole.grid.radii, rtol=0, atol=1e-6)
    assert net.independent.surface is not None
    np.testing.assert_allclose(net.independent.surface.sigmas, whole.sigmas, rtol=1e-9)
    assert net.areoid is not None
    assert abs(np.nanmean(net.areoid.radii) - 3396190.0) < 1e-6
    assert {"east.tif", "west.tif", "areoid.tif"} <= {Path(name).name for name in checksums(path)}


@pytest.mark.parametrize("name", ["areoid", "topography as radius", "on the equator"])
def test_the_difference_of_two_grids_of_one_kind_is_no_areoid(name: str) -> None:
    """MEGDR's topography under the name of its radii leaves a sphere."""
    latitudes = (60.0 if name != "on the equator" else 1.0) * DEG - 0.01 * np.arange(3)
    a, b = MARS.equatorial, MARS.polar
    level = a * b / np.hypot(b * np.cos(latitudes), a * np.sin(latitudes)) + 1500.0
    radii = np.repeat((level if name == "areoid" else np.full(3, 3396e3))[:, None], 4, axis=1)
    areoid = TerrainGrid("a", radii, 1.0, float(latitudes[0]), 0.01, 0.01, kind="areoid")
    if name == "topography as radius":
        refuses(r"an areoid 14\.7 km off the ellipsoid", require_level, areoid, MARS)
    else:
        require_level(areoid, MARS)


def test_between_tracks_ties_are_held_by_what_interpolation_misses(tmp_path: Path) -> None:
    """Counts beside MEGDR's radii are taken: cells with shots in every fourth column of posts."""
    site, path = plain_site(), write_site(plain_site(), tmp_path)
    grid, name = site.grid, f"megc_{site.settings.name}"
    places = grid.radii.shape, grid.first_longitude, grid.first_latitude, grid.longitude_step
    shots = np.zeros(grid.radii.shape)
    shots[:, ::4] = 2.0
    measured = surface_of(path).sigmas
    write_megdr(tmp_path, name, MegdrLayout(*places, 0.0), [shots])
    surface, ties = surface_of(path), np.isfinite(measured)
    assert surface.grid.gaps is not None
    assert np.all(surface.sigmas[ties] >= 0.98 * measured[ties])
    assert np.median(surface.sigmas[ties]) > 1.5 * np.median(measured[ties])
    assert f"{name}.lbl" in checksums(path)
    text = path.read_text(encoding="utf-8")
    path.write_text(f"{text}\ncounts = false\n", encoding="utf-8")
    np.testing.assert_array_equal(surface_of(path).sigmas, measured)
    path.write_text(f'{text}\ncounts = "{name}.img"\n', encoding="utf-8")
    np.testing.assert_allclose(surface_of(path).sigmas, surface.sigmas, rtol=1e-9)
    path.write_text(f'{text}\ncounts = "megt_{site.settings.name}.lbl"\n', encoding="utf-8")
    refuses("a grid of topography; expected one of counts", mgsgraph.read_case, path)


def hills(longitudes: Array, latitudes: Array) -> Array:
    """m above the sphere: the ellipsoid, where the ties are, and 15 m up and down on it."""
    directions = from_planetocentric(np.column_stack([longitudes, latitudes, np.ones(longitudes.size)]))
    return MARS.radius(directions) - RADIUS + 0.05 * (ground(longitudes, latitudes) + 2000.0)


def test_any_projection_has_the_same_posts_and_the_same_adjustment(case_file: Path) -> None:
    """Models of the same hills, by meridians and in projections: posts on the hills, and ties to sigma / 100."""
    middle = middle_of(case_file).mean(axis=0) * DEG
    definitions = {"plain": (f"+proj=longlat {SPHERE}", lambda x, y: np.stack([x, y]) * DEG)} | PROJECTIONS
    found = []
    for crs, inverse in definitions.values():
        place, x, y = pixels(crs, shape=(350, 350), step=200.0, middle=middle)
        raster(case_file.with_name("hills.tif"), hills(*inverse(x, y)).reshape(350, 350), crs, place)
        without(case_file)
        case = mgsgraph.read_case(add(case_file, f'radius = "hills.tif"\nreference_radius_m = {RADIUS}'))
        posts = posts_of(case.terrain[0], 800.0)
        longitude, latitude, radius = planetocentric(posts.points).T
        # a mean of four by four posts is that of the hills but for their curvature within the cell
        assert np.abs(radius - RADIUS - hills(longitude, latitude)).max() < 0.05
        assert len(posts.ids) < 80**2  # what lies near the images
        found.append(mgsgraph.adjust(case))
    off = np.abs([one.places - found[0].places for one in found[1:]]) / found[0].sigmas
    spacing = np.array([one.network.surface.grid.latitude_step for one in found])  # type: ignore[union-attr]
    alike = np.abs(spacing[1:] / spacing[0] - 1.0) < 0.1
    assert np.count_nonzero(alike) >= 3
    assert off[alike].max() < 0.01
    assert off.max() < 1.0  # posts twice as close are levelled less
    assert off.max(axis=(1, 2)).min() > 0.0


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ('tracks = "b.csv"', "tracks: a word of earlier versions; expected radius"),
        ('radius = "a.img"\nareoid = "b.img"\ntopography = "c.img"', "both areoid and topography"),
        ('radius = "a.tif"\nareoid = "b.img"\nreference_radius_m = 3396000.0', "both areoid and reference_radius_m"),
        ('radius = "a.img"\nreference_radius_m = 3396190.0', "a.img: a MEGDR grid, beside reference_radius_m"),
        ('radius = "a.img"\npost_step_deg = 3.0', "post_step_deg: a word of earlier versions"),
    ],
)
def test_what_it_cannot_say(case_file: Path, keys: str, said: str) -> None:
    refuses(said, mgsgraph.read_case, add(case_file, keys))


def several(case_file: Path, keys: str) -> Path:
    """The case with its terrain model twice, the second with other keys."""
    text, _, model = with_terrain(case_file).read_text(encoding="utf-8").partition("\n[terrain]\n")
    again = f'[[terrain]]\nradius = "dtm.tif"\nreference_radius_m = 3396190.0\n{keys}\n'
    case_file.write_text(f"{text}\n[[terrain]]\n{model}\n{again}", encoding="utf-8")
    return case_file


def test_of_several_models_tie_points_lie_on_the_first(case_file: Path) -> None:
    """All have posts, sigmas and unknowns of their own."""
    only = mgsgraph.read_case(with_terrain(case_file))
    case = mgsgraph.read_case(several(case_file, 'name = "b"\nplanimetric_sigma_m = 50.0\nheight_sigma_m = 4.0'))
    assert case.network.surface is not None
    assert only.network.surface is not None
    assert case.network.surface.grid.source == only.network.surface.grid.source
    assert np.array_equal(case.network.surface.sigmas, only.network.surface.sigmas)
    assert [one.name for one in only.terrain] == ["dtm"]
    assert [(one.name, one.lattice.planimetric_sigma, one.height_sigma) for one in case.terrain] == [
        ("dtm", 200.0, None), ("b", 50.0, 4.0),
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ("", "the id 'dtm' twice"),
        ('name = "b"\nshift = false', "an unknown horizontal place"),
        ('name = "b"\ncontrol = false', "an unknown horizontal place"),
    ],
)
def test_further_models_are_control_by_their_posts(case_file: Path, keys: str, said: str) -> None:
    refuses(said, mgsgraph.read_case, several(case_file, keys))


@pytest.mark.parametrize("keys", ["shift = false", "tilt_sigma_mrad = 0.1", "control = false"])
def test_a_model_that_stays_or_tilts_has_no_posts(case_file: Path, keys: str) -> None:
    assert mgsgraph.read_case(with_terrain(case_file, keys)).terrain == ()


@pytest.mark.parametrize(("height", "keys"), [(600.0, ""), (-600.0, ""), (600.0, "height_sigma_m = 300.0")])
def test_a_model_off_the_laser_in_height_is_refused(case_file: Path, height: float, keys: str) -> None:
    """Heights above another sphere than stated; not where its height as a whole is unknown to as much."""
    path = profiles.with_profile(case_file)
    level = mgsgraph.read_case(with_terrain(path, height=-0.0)).network
    shots = level.points.places[level.points.classes == PointClass.LASER]
    assert level.surface is not None
    off = float(np.median(np.linalg.norm(shots, axis=1) - level.surface.grid.at(shots)))
    path = with_terrain(without(path), keys, height=off + height)
    if keys:
        assert mgsgraph.read_case(path).network.surface is not None
        return
    refuses(re.escape(f"{height:+.0f} m off"), mgsgraph.read_case, path)


# --- a case's images with their pixels over its ground, and what must be in it for them to be matched


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return matched.write(tmp_path_factory.mktemp("site"))


def test_a_site_is_what_was_written(site: Path) -> None:
    name, scene = read_scene(site)
    assert name == "Gusev Crater"
    ground, ours = scene.ground, matched.ground(matched.site().grid)
    assert ground.height_sigma == 100.0
    assert ground.height == pytest.approx(matched.HEIGHT, abs=60.0)
    for picture, image, made in zip(scene.pictures, matched.site().images, matched.scene().pictures, strict=True):
        assert picture.image.name == image.true.name
        np.testing.assert_array_equal(picture.pixels, image.pixels)
        np.testing.assert_allclose(picture.prior.sigmas[:, :3], made.prior.sigmas[:, :3], rtol=1e-3)
        points = ours.points(ours.chart.plane(matched.inner(40)))
        assert np.abs(ground.points(ground.chart.plane(points)) - points).max() < 1.0  # posts of whole metres
        # polynomials in place of the kernels' noise of four seconds of arc
        assert np.abs(picture.project(points) - made.project(points)).max() < 6.0
    ends = np.array([[0.0, 512.0], [matched.LINES, 512.0]])
    across, along = np.diff(scene.pictures[0].on_chart(ground, ends), axis=0)[0]
    assert abs(across) < 0.02 * along  # y is along the flight


def test_heights_come_from_where_they_are_known(pictured_case: Path) -> None:
    """Given; else of the laser shots, whose scatter says how sure it is."""
    _, told = read_scene(pictured_case, height=-1234.0, height_sigma=56.0)
    assert (told.ground.height, told.ground.height_sigma, told.ground.terrain) == (-1234.0, 56.0, None)
    _, of_shots = read_scene(pictured_case)
    heights = geodetic(read_lidar(pictured_case.with_name("lidar.json")).footprints, of_shots.ground.body)[:, 2]
    assert of_shots.ground.height == pytest.approx(heights.mean())
    assert of_shots.ground.height_sigma == pytest.approx(max(100.0, 2.0 * heights.std()))
    assert read_scene(pictured_case, height_sigma=20.0)[1].ground.height_sigma == 20.0
    profile = profiles.with_profile(pictured_case)
    assert read_scene(profile)[1].ground.height == pytest.approx(0.0, abs=20.0)


def test_pixels_are_those_that_the_case_names(pictured_case: Path) -> None:
    wanted = decode(pictured_case)
    assert picture_of(wanted.images[0], pictured_case.parent) == pictured_case.with_name("A.tif")
    _, scene = read_scene(pictured_case)
    assert scene.pictures[1].pixels.shape == (5000, 1024)
    np.testing.assert_allclose(scene.pictures[0].prior.sigmas[0], [30.0] * 3 + [1e-4] * 3)


def test_images_of_passes_have_the_prior_of_their_pass(tmp_path: Path) -> None:
    path = write_block(tmp_path)
    refuses("no pixels", read_scene, path)
    wanted = decode(path)
    of_strips = members(wanted.passes, [image.name for image in wanted.images], str(path))
    images = read_images(wanted, wanted.orientations, of_strips, path)
    for prior in image_priors(wanted, of_strips, images, path):
        assert prior.sigmas.shape == (2, 6)
        assert np.all(np.isfinite(prior.sigmas))
        assert np.all(prior.sigmas > 0.0)


def test_what_cannot_be_matched_is_refused(pictured_case: Path) -> None:
    text = pictured_case.read_text(encoding="utf-8")
    first, second = (text.index(f'[[images]]\nname = "SIM/{letter}"') for letter in "AB")
    alone = pictured_case.with_name("alone.toml")
    alone.write_text(text[:first] + text[second:], encoding="utf-8")
    refuses(r"alone\.toml: one image; expected two that overlap", read_scene, alone)
    Image.fromarray(np.zeros((50, 60), dtype=np.uint8)).save(pictured_case.with_name("B.tif"))
    refuses(r"SIM/B: pixels of shape \(50, 60\); expected 5000 lines x 1024 samples", read_scene, pictured_case)

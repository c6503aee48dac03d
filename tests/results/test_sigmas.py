"""The sigma raster in GDAL's hands: bands, units, and each cell in its place."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rasterio
from full_disk import files_of_at_most
from networks import network, pair
from rasterio.crs import CRS

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.analysis.places import BANDS, SigmaGrid
from mgsgraph.analysis.posterior import Posterior
from mgsgraph.errors import InputError
from mgsgraph.geometry.body import Ellipsoid
from mgsgraph.results.answers import Questions, answered, write_sigma_raster

MARS = Ellipsoid(3396190.0, 3376200.0)
STEP = np.radians(0.01)
GRID = SigmaGrid(
    ("A", "B"), 0.7, np.radians(175.0), np.radians(-14.0), (2.0 * STEP, STEP),
    np.arange(60.0).reshape(4, 3, 5), np.full((3, 5), 2),
)  # fmt: skip


def test_each_cell_is_found_by_its_coordinates(tmp_path: Path) -> None:
    write_sigma_raster(GRID, MARS, tmp_path / "sigmas.tif")
    with rasterio.open(tmp_path / "sigmas.tif") as file:
        assert file.crs == CRS.from_user_input("IAU_2015:49900")
        assert file.descriptions == BANDS
        assert set(file.units) == {"m"}
        assert file.tags()["images"] == "A, B"
        for row, column in ((0, 0), (2, 4), (1, 3)):
            place = (175.0 + 0.02 * (column + 0.5), -14.0 - 0.01 * (row + 0.5))
            assert np.array_equal(next(file.sample([place])), GRID.values[:, row, column])


def test_what_is_not_known_is_nodata(tmp_path: Path) -> None:
    values = GRID.values.copy()
    values[:, 1, 2] = np.nan
    write_sigma_raster(replace(GRID, values=values), Ellipsoid(1000e3, 990e3), tmp_path / "sigmas.tif")
    with rasterio.open(tmp_path / "sigmas.tif") as file:
        assert np.array_equal(file.dataset_mask() == 0, np.isnan(values[0]))
        assert "1000000" in file.crs.to_wkt()


def test_a_place_that_can_not_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(InputError, match="can't be written"):
        write_sigma_raster(GRID, MARS, tmp_path / "file" / "sigmas.tif")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_a_file_that_does_not_fit_is_an_error(tmp_path: Path) -> None:
    with files_of_at_most(500), pytest.raises(InputError, match="can't be written"):
        write_sigma_raster(GRID, MARS, tmp_path / "sigmas.tif")
    assert list(tmp_path.iterdir()) == []


def test_every_question_has_its_answer_in_words_and_figures() -> None:
    posterior = Posterior.of(adjust_network(network(pair()), SolverSettings()))
    points, images = posterior.network.points.ids, [image.name for image in posterior.network.images]
    asked = Questions(
        points=points[:1], pairs=((points[0], points[1]),), poses=((images[0], 100.0), (images[1], 50.0)),
        projections=((points[0], images[1]),), correlations=True,
    )  # fmt: skip
    found = {answer.numbers["question"]: answer for answer in answered(posterior, asked)}
    assert list(found) == ["point", "pair", "pose", "projection", "correlations"]
    assert len(found["correlations"].numbers["names"]) == 3 + 3 + 6 + 6 + 2
    assert "95 % error ellipsoid" in found["point"].text()

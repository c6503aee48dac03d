"""Refinement of clicked places on rendered images whose truth is known: near the truth, and honest about how near."""

from dataclasses import replace
from pathlib import Path

import matched
import numpy as np
import pytest
from PIL import Image

pytest.importorskip("cv2")

from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.errors import InputError
from mgsgraph.network.parts import KnownImage, alone, with_images
from mgsgraph.studio.linked import LinkedImages
from mgsgraph.studio.opened import Block
from mgsgraph.studio.point_sheet import refine

Clicked = tuple[str, float, float]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> tuple[LinkedImages, dict[str, Path | None]]:
    """The rendered pair over a terrain model that is 40 m off, and files of its pixels."""
    folder, scene = tmp_path_factory.mktemp("pixels"), matched.true_scene()
    known = [KnownImage(one.image, matched.prior(100.0)) for one in scene.pictures]
    network = with_images(alone(known[0]), known)
    files = dict[str, Path | None]()
    for number, one in enumerate(scene.pictures):
        pixels = np.asarray(one.pixels)
        files[one.image.name] = folder / f"{number}.tif"
        Image.fromarray(np.asarray(pixels)).save(folder / f"{number}.tif")
    return LinkedImages(replace(Block.of_network(network, SolverSettings()), terrain=matched.true_terrain())), files


def test_a_click_goes_to_the_ground_of_the_reference(
    site: tuple[LinkedImages, dict[str, Path | None]],
) -> None:
    linked, files = site
    one, two = list(files)
    rng, away, squares, sigmas = np.random.default_rng(4), list[float](), list[float](), list[float]()
    size = [linked.block.images[0].lines, linked.block.images[0].samples]
    for place in rng.uniform(60.0, np.array(size) - 60.0, (60, 2)):
        true = matched.true_places(one, place[None], two)[0]
        start = true + rng.normal(0.0, 1.0, 2)
        try:
            found = refine(linked, files, (one, *place.tolist()), (two, *start.tolist()))
        except InputError:  # flat ground, or beside the other image
            continue
        off = found.place - true
        away.append(float(np.linalg.norm(off)))
        squares.append(float(off @ np.linalg.solve(found.covariance, off)))
        sigmas.append(float(np.sqrt(0.5 * found.covariance.trace())))
        assert 0.3 < found.correlation <= 1.0
    assert len(away) > 25
    assert np.median(away) < 0.2  # clicked 1 px beside in each direction
    assert np.median(sigmas) < 0.2
    assert 0.4 < np.median(squares) / 1.386 < 2.5  # median of chi square with two degrees of freedom


@pytest.mark.parametrize(("what", "said"), [
    ("file", "no file of its pixels"), ("edge", "too near to its edge|leaves the picture"),
    ("image", "image nobody: no such image"), ("elsewhere", "isn't in it|no least-squares match"),
])  # fmt: skip
def test_what_cannot_be_refined_is_said(
    site: tuple[LinkedImages, dict[str, Path | None]], what: str, said: str
) -> None:
    linked, files = site
    one, two = list(files)
    place = np.array([300.0, 250.0])
    true = matched.true_places(one, place[None], two)[0]
    first, second = (one, *place.tolist()), (two, *true.tolist())
    if what == "file":
        files = files | {two: None}
    elif what == "edge":
        first = one, 0.5, 0.5
    elif what == "image":
        first = "nobody", 1.0, 1.0
    else:
        second = two, float(true[0]) + 200.0, float(true[1])
    with pytest.raises(InputError, match=said):
        refine(linked, files, first, second)

"""The sheet of a point: what it says near by, without the rest of the block, is what the whole posterior says."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

pytest.importorskip("starlette")

from mgsgraph.analysis.measures import MeasureKind
from mgsgraph.analysis.posterior import cross_covariances
from mgsgraph.analysis.reliability import reliability
from mgsgraph.cli import group
from mgsgraph.errors import InputError
from mgsgraph.geometry.body import east_north_up
from mgsgraph.project.reading import posterior_near, read_posterior
from mgsgraph.studio.changes import change
from mgsgraph.studio.opened import Opened
from mgsgraph.studio.point_sheet import correlations, point_sheet
from mgsgraph.studio.point_sheet import tests_of as judged


def command(*words: object) -> None:
    run = CliRunner().invoke(group, [str(word) for word in words])
    assert run.exit_code == 0, run.output


@pytest.fixture
def changed(solved: Path, tmp_path: Path) -> tuple[Opened, str]:
    """A project after a change of one of its ties, and that tie."""
    opened = Opened(Path(shutil.copytree(solved, tmp_path / "project")))
    ids = opened.block().network.points.ids
    name = ids[int(np.flatnonzero(opened.block().network.points.classes == 0)[4])]
    ray = point_sheet(opened, name)["rays"][0]
    change(opened, {"kind": "move", "point": name, "image": ray["image"], "line": ray["line"] + 0.5,
                    "sample": ray["sample"]})  # fmt: skip
    return opened, name


def test_after_a_change_the_sheet_reads_its_point_alone(changed: tuple[Opened, str]) -> None:
    opened, name = changed
    sheet = point_sheet(opened, name)
    assert not opened.is_read
    whole = read_posterior(opened.path)[1]
    found = whole.point(name)
    frame = east_north_up(found.position[None])[0]
    np.testing.assert_allclose(sheet["sigmas_m"], np.sqrt(np.diag(frame @ found.covariance @ frame.T)), rtol=1e-5)
    assert sheet["edited"]
    for ray in sheet["rays"]:
        at = whole.projection(name, ray["image"]).pixel
        np.testing.assert_allclose(ray["residual_px"], [ray["line"] - at[0], ray["sample"] - at[1]], atol=1e-4)
    assert name in sheet["answer"]


def test_tests_of_a_point_are_those_of_the_whole_block(changed: tuple[Opened, str]) -> None:
    opened, name = changed
    found = judged(opened, name)
    assert not opened.is_read
    whole = reliability(read_posterior(opened.path)[1].linearised)
    every, number = whole.measures, whole.at.network.points.ids.find([name])[0]
    mine = np.flatnonzero((every.kind == MeasureKind.RAY) & (every.point == number))
    assert mine.size == 4
    for k in mine.tolist():
        ray = found["rays"][whole.at.network.images[int(every.image[k])].name]
        for key, value in (("redundancy", every.redundancy), ("w", every.test), ("detectable_px", every.detectable)):
            said = ray[key][int(every.component[k])]
            if said is None:  # nothing controls the measure
                assert not np.isfinite(value[k])
            else:
                np.testing.assert_allclose(said, value[k], rtol=1e-3, atol=1e-5)
    assert found["critical"] == pytest.approx(whole.critical)


def test_correlations_are_those_most_correlated(changed: tuple[Opened, str], solved: Path) -> None:
    name = changed[1]
    for opened in (changed[0], Opened(solved), Opened(solved / "solutions" / "0001")):
        found = correlations(opened, name)
        posterior = opened.posterior()
        ids = posterior.network.points.ids
        (k,) = ids.find([name]).tolist()
        cross = cross_covariances(posterior.linearised, k)
        frames = east_north_up(posterior.linearised.places)
        sigmas = np.array([
            np.sqrt(np.diag(frame @ posterior.point(one).covariance @ frame.T))
            for frame, one in zip(frames, ids, strict=True)
        ])  # fmt: skip
        every = np.einsum("ab,nbd,nad->na", frames[k], cross, frames) / (sigmas[k] * sigmas)
        every[k] = 0.0
        order = np.argsort(-np.abs(every).max(axis=1))[:12]
        rows = {row["name"]: row["correlation"] for row in found["rows"]}
        sizes = np.abs(list(rows.values())).max(axis=1)
        # iSAM2's covariance is that of its last linearisation
        np.testing.assert_allclose(sizes[:8], np.abs(every[order[:8]]).max(axis=1), rtol=1e-3)
        for other, values in rows.items():
            np.testing.assert_allclose(values, every[ids.find([other])[0]], atol=1e-3)
        assert set(found["distance_m"]) == set(rows)


def test_a_point_held_where_its_sheet_says_it_is_stays_there(changed: tuple[Opened, str]) -> None:
    opened, name = changed
    place = point_sheet(opened, name)["place"]
    before = read_posterior(opened.path)[1].point(name).position
    sigmas = {f"sigma_{axis}_m": 5.0 for axis in ("east", "north", "up")}
    keys = "longitude_deg", "geodetic_latitude_deg", "height_m"
    change(opened, {"kind": "hold", "point": name, **{key: place[key] for key in keys}, **sigmas})
    held = read_posterior(opened.path)[1]
    np.testing.assert_allclose(held.point(name).position, before, rtol=0.0, atol=1e-3)
    sheet = point_sheet(opened, name)
    assert (sheet["class"], sheet["kind"]) == ("control", "constrained")
    assert max(sheet["sigmas_m"]) < 5.0


def test_near_by_there_is_nothing_without_the_point_or_an_adjustment(
    solved: Path, case_file: Path, tmp_path: Path
) -> None:
    assert posterior_near(solved, "nobody") is None
    command("init", tmp_path / "new", "--case", case_file)
    opened = Opened(tmp_path / "new")
    name = opened.block().network.points.ids[0]
    assert posterior_near(tmp_path / "new", name) is None
    assert point_sheet(opened, name)["answer"] is None
    with pytest.raises(InputError, match="nothing has been adjusted"):
        judged(opened, name)
    with pytest.raises(InputError, match="no"):
        point_sheet(opened, "nobody")

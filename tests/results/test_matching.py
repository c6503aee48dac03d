"""What matching writes: networks, table, record and figure, whole or not at all; and tiles that are kept."""

import csv
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import matched
import numpy as np
import pytest

from mgsgraph.errors import InputError
from mgsgraph.files.networks.network_file import read_control_network
from mgsgraph.files.networks.table import read_tie_points
from mgsgraph.matching.match import Matches, digest
from mgsgraph.results import matching as module
from mgsgraph.results.figures.matches import matches_sheet
from mgsgraph.results.matching import KeptTiles, match_into, match_statements, write_matches

TABLES = {"match.json", "matches.csv", "network.net", "network.pvl"}
FIGURES = {"matches.png"}


@pytest.fixture
def ready(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is found is known already."""
    monkeypatch.setattr(module, "match_scene", lambda *_: matched.matches())


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("matches") / "out"
    write_matches(matched.matches(3), matched.scene(3), "three images", matched.SETTINGS, folder)
    return folder


def test_folder_holds_what_it_says(written: Path) -> None:
    assert {path.name for path in written.iterdir()} == TABLES | FIGURES
    assert [path.name for path in written.parent.iterdir()] == ["out"]


@pytest.mark.parametrize("name", ["network.pvl", "network.net"])
def test_networks_hold_the_ties(written: Path, name: str) -> None:
    ties, found = matched.matches(3).ties, read_tie_points(written / name, matched.scene(3).ground.body)
    assert found.ids == ties.ids
    assert found.measure_image == ties.measure_image
    np.testing.assert_array_equal(found.measure_point, ties.measure_point)
    np.testing.assert_allclose(found.measures, ties.measures, atol=1e-9)
    np.testing.assert_allclose(found.measure_sigmas, ties.measure_sigmas, rtol=1e-6)
    np.testing.assert_array_equal(found.kinds, ties.kinds)


def test_pixels_in_networks_are_those_of_isis(written: Path) -> None:
    text = (written / "network.pvl").read_text(encoding="utf-8")
    line = matched.matches(3).ties.measures[0, 0]
    assert f"= {line + 0.5:g}" in text


def test_table_has_every_measure(written: Path) -> None:
    found = matched.matches(3)
    with (written / "matches.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(found.ties.measure_image)
    assert [row["image"] for row in rows] == list(found.ties.measure_image)
    assert [row["id"] for row in rows] == [found.ties.ids[i] for i in found.ties.measure_point.tolist()]
    assert [row["reference"] == "true" for row in rows] == found.reference.tolist()
    for name, values in (
        ("isis_line", found.ties.measures[:, 0] + 0.5),
        ("isis_sample", found.ties.measures[:, 1] + 0.5),
        ("sigma_line_px", found.ties.measure_sigmas[:, 0]),
        ("against_reference_line_sample_px2", found.covariances[:, 0, 1]),
        ("correlation", found.correlation),
        ("coplanarity_m", found.misfit),
    ):
        told = np.array([float(row[name]) if row[name] else np.nan for row in rows])
        np.testing.assert_array_equal(told, values)


def test_record_and_sentences(written: Path) -> None:
    found = matched.matches(3)
    record = json.loads((written / "match.json").read_text(encoding="utf-8"))
    assert record["program"] == "mgsgraph"
    assert record["points"] == len(found.ties.ids)
    assert record["measures"] == len(found.ties.measure_image)
    assert record["losses"]["kept"] == found.losses.kept
    assert record["settings"]["cells"] == matched.SETTINGS.cells
    assert (record["cells_with_matches"], record["cells"]) == found.cells
    assert None in [one["height_sigma_m"] for one in record["orientations"]]  # parallel rays
    statements = record["statements"]
    assert statements == match_statements(found, matched.scene(3))
    assert len(statements) == len(found.agreements) + 3
    assert f"{len(found.ties.ids)} tie points with 2 to 3 measures" in statements[-2]


def test_figure_shows_every_match() -> None:
    sheet = matches_sheet(matched.matches(), matched.scene(), "pair")
    where, nominal, sigmas, left = sheet.figure.axes
    count = len(matched.matches().ties.ids)
    assert len(where.lines[-1].get_xdata()) == count
    across, along = (np.asarray(line.get_xdata()) for line in nominal.lines[:2])
    assert np.median(np.hypot(across, along)) == pytest.approx(229.0, abs=20.0)  # as published
    for panel in (sigmas, left):
        assert sum(bar.get_height() for bar in panel.patches) >= 0.97 * count  # type: ignore[attr-defined]


@pytest.mark.usefixtures("ready")
def test_results_are_replaced_and_nothing_else_is(tmp_path: Path) -> None:
    out, scene = tmp_path / "out", matched.scene()
    for figures, names in ((True, TABLES | FIGURES), (False, TABLES)):
        match_into("pair", scene, out, matched.SETTINGS, figures=figures)
        assert {path.name for path in out.iterdir()} == names
    (out / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match=r"notes\.txt"):
        match_into("pair", scene, out, matched.SETTINGS, figures=False)
    foreign = tmp_path / "foreign"
    foreign.mkdir()
    (foreign / "a").write_text("")
    with pytest.raises(InputError, match="not a result of mgsgraph"):
        match_into("pair", scene, foreign, matched.SETTINGS, figures=False)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["foreign", "out"]
    assert {path.name for path in out.iterdir()} == TABLES | {"notes.txt"}


@pytest.mark.usefixtures("ready")
def test_a_failure_leaves_what_was_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out, scene = tmp_path / "out", matched.scene()
    match_into("pair", scene, out, matched.SETTINGS, figures=False)
    before = {path.name: path.read_bytes() for path in out.iterdir()}

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(module, "write_binary_network", full)
    with pytest.raises(InputError, match="No space left"):
        match_into("other", scene, out, matched.SETTINGS, figures=False)
    assert {path.name: path.read_bytes() for path in out.iterdir()} == before
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


# ---- tiles that are kept


def some() -> dict[str, np.ndarray[Any, Any]]:
    return {"plane": np.arange(6.0).reshape(3, 2), "links": np.zeros((0, 2), dtype=np.int64)}


def test_kept_tiles_come_back(tmp_path: Path) -> None:
    store = KeptTiles(tmp_path / "deep" / "out", "key")
    assert store.load("tile_00000") is None
    store.keep("tile_00000", some())
    again = KeptTiles(tmp_path / "deep" / "out", "key")
    found = again.load("tile_00000")
    assert found is not None
    assert set(found) == set(some())
    for name, array in some().items():
        np.testing.assert_array_equal(found[name], array)
        assert found[name].dtype == array.dtype
    assert again.resumed == 1
    assert KeptTiles(tmp_path / "deep" / "out", "other").load("tile_00000") is None  # of other inputs
    assert [path.name for path in (tmp_path / "deep").iterdir()] == [".out.matching"]
    again.drop()
    assert list((tmp_path / "deep").iterdir()) == []


@pytest.mark.parametrize(
    "damage",
    [lambda data: data[: len(data) // 2], lambda data: b"", lambda data: b"PK" + bytes(100),
     lambda data: data[:60] + b"\xff" * 40 + data[100:]],
)  # fmt: skip
def test_damaged_tiles_are_made_again(tmp_path: Path, damage: Callable[[bytes], bytes]) -> None:
    store = KeptTiles(tmp_path / "out", "key")
    store.keep("tile_00000", some())
    (path,) = store.folder.iterdir()
    path.write_bytes(damage(path.read_bytes()))
    assert store.load("tile_00000") is None
    assert store.resumed == 0


def test_a_flipped_bit_of_a_tile_is_found(tmp_path: Path) -> None:
    """It is made again, or all its numbers are as they were."""
    store = KeptTiles(tmp_path / "out", "key")
    store.keep("tile_00000", some())
    (path,) = store.folder.iterdir()
    whole, again = path.read_bytes(), 0
    for place in range(0, len(whole), max(len(whole) // 300, 1)):
        broken = bytearray(whole)
        broken[place] ^= 1 << place % 8
        path.write_bytes(broken)
        found = store.load("tile_00000")
        again += found is None
        if found is not None and found.keys() == some().keys():  # others are made again by whoever asks
            assert all(found[name].tobytes() == array.tobytes() for name, array in some().items())
            assert all(found[name].shape == array.shape for name, array in some().items())
    assert again > 100


def test_networks_are_held_against_their_record(tmp_path: Path) -> None:
    write_matches(matched.matches(), matched.scene(), "pair", matched.SETTINGS, tmp_path / "out", figures=False)
    for name in ("network.pvl", "network.net"):
        path = tmp_path / "out" / name
        assert read_control_network(path).ids
        content = bytearray(path.read_bytes())
        content[-40] ^= 1
        path.write_bytes(content)
        with pytest.raises(InputError, match=f"{name}: is damaged"):
            read_control_network(path)


def test_a_place_that_cannot_be_written_is_told(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="can't be written"):
        KeptTiles(tmp_path / "file" / "out", "key").keep("tile", some())


def test_nothing_is_kept_of_work_that_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(_scene: object, _settings: object, store: KeptTiles, *_: object) -> Matches:
        store.keep("tile_00000", some())
        raise InputError("matching", "no match is left")

    monkeypatch.setattr(module, "match_scene", fails)
    with pytest.raises(InputError, match="no match is left"):
        match_into("pair", matched.scene(), tmp_path / "out", matched.SETTINGS)
    assert list(tmp_path.iterdir()) == []


def test_tiles_of_an_interrupted_run_wait_for_the_same_call(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mgsgraph.matching.patches._SIZE", 400)
    scene, settings = matched.scene(), replace(matched.SETTINGS, cells=20, features=300)
    keep, kept = KeptTiles.keep, list[str]()

    def keep_two(self: KeptTiles, name: str, arrays: dict[str, Any]) -> None:
        if len(kept) == 2:
            raise KeyboardInterrupt
        kept.append(name)
        keep(self, name, arrays)

    with monkeypatch.context() as patch:
        patch.setattr(KeptTiles, "keep", keep_two)
        with pytest.raises(KeyboardInterrupt):
            match_into("pair", scene, tmp_path / "out", settings, 1, figures=False)
    assert [path.name for path in tmp_path.iterdir()] == [".out.matching"]
    names = sorted(path.name for path in (tmp_path / ".out.matching").iterdir())
    assert names == [f"{digest(scene, settings)}_{name}.npz" for name in sorted(kept)]

    computed = list[str]()

    def counted(self: KeptTiles, name: str, arrays: dict[str, Any]) -> None:
        computed.append(name)
        keep(self, name, arrays)

    monkeypatch.setattr(KeptTiles, "keep", counted)
    match_into("pair", scene, tmp_path / "out", settings, figures=False)
    assert computed
    assert not set(computed) & set(kept)
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
    assert read_control_network(tmp_path / "out" / "network.pvl").ids[0].endswith("_000001")

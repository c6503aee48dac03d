"""What matching writes: networks, table, record and figure, whole or not at all."""

import csv
import json
from pathlib import Path

import matched
import numpy as np
import pytest

from mgsgraph.errors import InputError
from mgsgraph.files.networks.binary import read_control_network
from mgsgraph.files.networks.table import read_tie_points
from mgsgraph.results.figures.matches import matches_sheet
from mgsgraph.results.matching import match_statements, write_matches

TABLES = {"match.json", "matches.csv", "network.net", "network.pvl"}
FIGURES = {"matches.png"}


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
    where, nominal = sheet.figure.axes
    count = len(matched.matches().ties.ids)
    assert len(where.lines[-1].get_xdata()) == count
    across, along = (np.asarray(line.get_xdata()) for line in nominal.lines[:2])
    assert np.median(np.hypot(across, along)) == pytest.approx(229.0, abs=20.0)  # as published


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

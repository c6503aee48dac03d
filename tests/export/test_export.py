"""Exports as a whole, written whole or not at all and verified where asked; those for the Ames Stereo Pipeline, read
back by our own readers and by a few lines that know the formats.
"""

import json
import struct
from dataclasses import replace
from pathlib import Path
from platform import node

import numpy as np
import pytest
from networks import network, pair
from outside import refuses

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.cli import group
from mgsgraph.errors import InputError
from mgsgraph.export import Target, spice_back
from mgsgraph.export import solution_export as exports
from mgsgraph.export.asp import write_asp
from mgsgraph.export.csm import write_csm
from mgsgraph.export.solution_export import ExportSettings, export_solution
from mgsgraph.files.networks.asp_text import read_ground_control
from mgsgraph.files.networks.tie_points import PointKind
from mgsgraph.files.writing import account
from mgsgraph.network import PointClass
from mgsgraph.results.results import write_results
from mgsgraph.text import many

FINE = 0.01
"""pixels, that a product may be off."""


@pytest.fixture(scope="module")
def _made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("export") / "solution"
    write_results(adjust_network(network(pair(ties=40)), SolverSettings(), "pair"), folder, figures=False)
    return folder


@pytest.fixture
def solution(_made: Path, tmp_path: Path) -> Path:
    """A folder of its own."""
    folder = tmp_path / "solution"
    folder.mkdir()
    for file in _made.iterdir():
        (folder / file.name).write_bytes(file.read_bytes())
    return folder


@pytest.mark.parametrize("target", [target for target in Target if target != Target.CUBES])
def test_an_export_says_its_files(target: Target, solution: Path, tmp_path: Path) -> None:
    done = export_solution(solution, target, tmp_path / "out")

    there = {path.relative_to(tmp_path / "out").as_posix() for path in (tmp_path / "out").rglob("*") if path.is_file()}
    assert there == {"export.json", *done.files}
    assert done.sentence == f"{many(len(done.files), 'file')} for {target.value}."
    record = json.loads((tmp_path / "out" / "export.json").read_text())
    assert (record["target"], record["files"]) == (target.value, list(done.files))


def test_kernels_are_verified_where_asked(solution: Path, tmp_path: Path) -> None:
    done = export_solution(solution, "spice", tmp_path / "out", ExportSettings(verify=True))
    assert done.measures > 50
    assert done.largest < FINE
    assert "read back by SPICE alone" in done.sentence
    words = " ".join((tmp_path / "out" / "adjusted.tm").read_text().split())
    assert f"Made by {account()} on {node()} from {solution} (adjusted 20" in words
    noted = json.loads((tmp_path / "out" / "export.json").read_text())
    assert (noted["measures"], noted["largest_difference_px"]) == (done.measures, done.largest)


def test_an_earlier_export_is_replaced_by_one_of_its_kind(solution: Path, tmp_path: Path) -> None:
    for target in ("spice", "csm", "csm"):
        export_solution(solution, target, tmp_path / "out" / target)
    refuses(r"spice: an export to spice.*csm", export_solution, solution, "csm", tmp_path / "out" / "spice")
    assert list((tmp_path / "out" / "spice").glob("*.bsp"))


def test_other_folders_are_left_alone(solution: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    export_solution(solution, "asp", out)
    export_solution(solution, "asp", out)
    (out / "matches" / "mine.match").write_text("kept")
    refuses(r"matches/mine\.match", export_solution, solution, "asp", out)
    refuses("another kind of result", export_solution, solution, "csm", solution)


def test_a_damaged_record_is_refused_where_it_is_needed(solution: Path, tmp_path: Path) -> None:
    record, sound = solution / "solution.json", (solution / "solution.json").read_text()
    for damaged in ("[]", "{", sound.replace('"name"', '"nome"'), sound.replace('"crc32": "', '"crc32": "0')):
        record.write_text(damaged)
        export_solution(solution, "csm", tmp_path / "out")
        with pytest.raises(InputError, match=r"solution\.json"):  # it knows the networks whose content is kept
            export_solution(solution, "isis", tmp_path / "isis")


@pytest.mark.parametrize(
    ("target", "settings", "found"),
    [
        ("spice", ExportSettings(scaled=True), "scaled.*isis or asp"),
        ("csm", ExportSettings(raster=True), "raster.*gis"),
        ("csm", ExportSettings(verify=True), "verify.*spice alone"),
        ("isis", ExportSettings(support={}), "case.*csm or asp"),
        ("asp", ExportSettings(support={"OTHER": Path("other.isd")}), "file of OTHER: no image"),
    ],
)
def test_settings_that_would_do_nothing_are_refused(
    target: str, settings: ExportSettings, found: str, solution: Path, tmp_path: Path
) -> None:
    refuses(found, export_solution, solution, target, tmp_path / "out", settings)
    assert not (tmp_path / "out").exists()


def test_a_full_disk_is_said_of_the_folder_that_was_asked_for(
    solution: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(solution: object, folder: Path, settings: object, path: Path) -> None:
        raise InputError(str(folder / "network.net"), "can't be written (No space left on device)")

    monkeypatch.setitem(exports._WRITERS, Target.ISIS, full)
    with pytest.raises(InputError, match="free some space") as caught:
        export_solution(solution, "isis", tmp_path / "out")
    assert caught.value.where == str(tmp_path / "out" / "network.net")
    assert list(tmp_path.iterdir()) == [solution]


@pytest.mark.parametrize("bad", [np.inf, np.nan])
def test_what_does_not_come_back_is_not_there(
    bad: float, solution: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(spice_back, "spice_differences", lambda *_: np.array([0.0, bad]))
    with pytest.raises(InputError, match="1 measures don't come back"):
        export_solution(solution, "spice", tmp_path / "out", ExportSettings(verify=True))
    assert not (tmp_path / "out").exists()


def test_the_command(solution: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = ["export", str(solution), "--to", "spice", "--verify", "--out", str(tmp_path / "out")]
    group(command, standalone_mode=False)
    assert "read back by SPICE alone" in capsys.readouterr().out
    case = tmp_path / "case.toml"
    labels = '[[images]]\nname = "A"\nlabel = "a.img"\n[[images]]\nname = "B"\nlabel = "b.img"\n'
    case.write_text(f'format = 1\nname = "labels"\n{labels}[ties]\nnetwork = "network.pvl"\n')
    command = ["export", str(solution), "--to", "csm", "--out", str(tmp_path / "x"), "--case", str(case)]
    refuses("no image of the solution", group, command, standalone_mode=False)


def test_sigmas_of_new_points_go_along_where_asked(solution: Path, tmp_path: Path) -> None:
    done = export_solution(solution, "gis", tmp_path / "out", ExportSettings(raster=True))
    assert "sigmas.tif" in done.files


# --- for the Ames Stereo Pipeline


@pytest.fixture(scope="module")
def solved() -> Solution:
    return adjust_network(network(pair()), SolverSettings(), "pair")


def matches(path: Path) -> np.ndarray:
    """Columns and rows (2, n, 2) of a match file without descriptors, by struct alone."""
    data, record = path.read_bytes(), struct.Struct("<ffiifffBIIQ")
    first, second = struct.unpack_from("<QQ", data)
    assert first == second
    assert len(data) == 16 + 2 * first * record.size
    places = [record.unpack_from(data, 16 + k * record.size)[:2] for k in range(2 * first)]
    return np.array(places).reshape(2, first, 2)


def test_free_points_are_matches(solved: Solution, tmp_path: Path) -> None:
    write_asp(solved, tmp_path)
    (path,) = (tmp_path / "matches").iterdir()
    found, rays, net = matches(path), solved.network.rays, solved.network
    ties = net.points.classes[rays.point] == PointClass.TIE
    for j in range(2):
        mine = np.flatnonzero(ties & (rays.image == j))
        mine = mine[np.argsort(rays.point[mine])]
        np.testing.assert_allclose(found[j], rays.places[mine, ::-1] - 0.5, atol=1e-3)


def test_control_points_are_as_given_and_adjusted_ones_as_adjusted(solved: Solution, tmp_path: Path) -> None:
    write_asp(solved, tmp_path)
    net, body = solved.network, solved.network.body
    control, adjusted = (read_ground_control(tmp_path / f"{name}.gcp", body) for name in ("control", "adjusted"))
    given = np.flatnonzero(net.points.kinds == PointKind.CONSTRAINED)
    np.testing.assert_allclose(control.places, net.points.places[given], atol=1e-6, rtol=0.0)
    sigmas = np.sqrt(np.diagonal(net.points.covariances[given], axis1=1, axis2=2))
    np.testing.assert_allclose(np.sqrt(np.diagonal(control.covariances, axis1=1, axis2=2)), sigmas, rtol=1e-12)
    np.testing.assert_allclose(adjusted.places, solved.places, atol=1e-6, rtol=0.0)
    np.testing.assert_allclose(np.sqrt(np.diagonal(adjusted.covariances, axis1=1, axis2=2)), solved.sigmas, rtol=1e-9)
    places = solved.network.rays.places[np.argsort(solved.network.rays.point, kind="stable")]
    np.testing.assert_allclose(adjusted.measures, places, atol=1e-9)
    write_asp(solved, tmp_path, scaled=True)
    scaled = read_ground_control(tmp_path / "adjusted.gcp", body)
    np.testing.assert_allclose(scaled.covariances, adjusted.covariances * solved.sigma0**2, rtol=1e-9)


def test_rejected_measures_are_left_out(solved: Solution, tmp_path: Path) -> None:
    rays = solved.network.rays
    used = solved.rays_used & ~np.isin(rays.point, [0, 1])
    some = replace(solved, rays_used=used)
    write_asp(some, tmp_path)
    (path,) = (tmp_path / "matches").iterdir()
    ties = int(np.sum(solved.network.points.classes == PointClass.TIE))
    assert matches(path).shape[1] == ties - 2
    nothing = replace(solved, rays_used=np.zeros_like(used))
    refuses("no measure that took part", write_asp, nothing, tmp_path / "nothing")


def test_lists_go_together_and_name_files_that_are_there(solved: Solution, tmp_path: Path) -> None:
    names = solved.network.image_names
    files = write_asp(solved, tmp_path, {names[1]: "cubes/other.cub"})
    images, cameras = ((tmp_path / f"{name}.txt").read_text().split() for name in ("images", "cameras"))
    assert len(images) == len(cameras) == len(names)
    assert images[1] == "cubes/other.cub"
    assert all(camera.endswith(".adjusted_state.json") for camera in cameras)
    assert Path(images[0]).stem == cameras[0].removesuffix(".adjusted_state.json")
    assert all(path.is_file() for path in files)
    assert "cubes/other.cub" in (tmp_path / "adjusted.gcp").read_text(encoding="utf-8")


def test_cameras_are_called_like_the_files_of_their_images(solved: Solution, tmp_path: Path) -> None:
    """Support data are no pixels: the cube of that name is meant."""
    names = solved.network.image_names
    write_asp(solved, tmp_path, {names[0]: "first.isd", names[1]: "cubes/second.tif"})
    images, cameras = ((tmp_path / f"{name}.txt").read_text().split() for name in ("images", "cameras"))
    assert images[:2] == ["first.cub", "cubes/second.tif"]
    assert cameras[:2] == ["first.adjusted_state.json", "second.adjusted_state.json"]
    csm = write_csm(solved, tmp_path, files={names[0]: "first.cub"})
    assert {path.name for path in csm} >= {"first.json", "first.adjusted_state.json"}


def test_without_free_or_control_points(solved: Solution, tmp_path: Path) -> None:
    ties = adjust_network(network(pair(), laser=False), SolverSettings(), "ties")
    names = {path.name for path in write_asp(ties, tmp_path / "ties")}
    assert "control.gcp" not in names
    net = solved.network
    kinds = np.where(net.points.kinds == PointKind.FREE, PointKind.FIXED, net.points.kinds)
    fixed = replace(net, points=replace(net.points, kinds=kinds, places=solved.places))
    names = {path.name for path in write_asp(replace(solved, network=fixed), tmp_path / "fixed")}
    assert not any(name.endswith(".match") for name in names)
    assert "1e-10" in (tmp_path / "fixed" / "control.gcp").read_text()


@pytest.mark.parametrize(
    ("images", "said"),
    [
        ({"nobody": "a.cub"}, "the image 'nobody'"),
        ({0: "a b.cub"}, "a name without blanks"),
        ({0: "a/same.cub", 1: "b/same.cub"}, "called same"),
    ],
)
def test_files_that_cant_be_told_apart(solved: Solution, tmp_path: Path, images: dict, said: str) -> None:
    names = solved.network.image_names
    asked = {names[key] if isinstance(key, int) else key: file for key, file in images.items()}
    refuses(said, write_asp, solved, tmp_path, asked)
    assert not list(tmp_path.iterdir())

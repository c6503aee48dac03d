"""init, status, add, remove, solve as a person uses them; what is added in the end equals what batch makes of all."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import click
import numpy as np
import profiles
import pytest
from commands import call
from msgspec import structs
from outside import refuses
from projects import digest

import mgsgraph
from mgsgraph.atomic_write import beside
from mgsgraph.errors import InputError
from mgsgraph.files.networks.binary import read_network
from mgsgraph.files.networks.pvl import write_pvl_network
from mgsgraph.files.networks.record import ControlNetwork
from mgsgraph.project.project import open_project
from mgsgraph.results.archive import read_solution


@pytest.fixture
def project(case_file: Path, tmp_path: Path) -> Path:
    call("project", "init", tmp_path / "project", "--case", case_file)
    return tmp_path / "project"


def state(project: Path) -> tuple[str, int]:
    with open_project(project) as opened:
        return digest(opened.store), len(opened.changes())


def other_image(case_file: Path, lines: int = 1) -> Path:
    """Support data of image B without its last lines: another image."""
    support = json.loads(case_file.with_name("image_B.isd").read_text(encoding="utf-8"))
    path = case_file.with_name(f"shorter_{lines}.isd")
    path.write_text(json.dumps(support | {"image_lines": support["image_lines"] - lines}), encoding="utf-8")
    return path


HEAVY = {
    "numba", "llvmlite", "scipy", "gtsam", "pandas", "matplotlib", "jinja2", "shapely", "rasterio", "spiceypy", "dask",
    "cv2",
}  # fmt: skip
"""Libraries that take a tenth of a second or more to load, or that solving and drawing alone need."""


def loaded(*arguments: str | Path) -> set[str]:
    """Packages that a process has loaded after a command."""
    code = (
        "import sys; from mgsgraph.cli import group; group(sys.argv[1:], standalone_mode=False);"
        "print(*sys.modules, file=sys.stderr)"
    )
    command = [sys.executable, "-c", code, *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=os.environ | {"COLUMNS": "80"})
    return set(done.stderr.split())


def test_looking_at_a_project_loads_no_solver(project: Path) -> None:
    there = loaded("project", "status", project)
    assert "mgsgraph.project.store" in there
    assert {name.split(".")[0] for name in there} & HEAVY == {"scipy"}
    assert not [name for name in there if name.startswith(("mgsgraph.kernel", "mgsgraph.results.figures"))]
    solver = {name for name in there if name.startswith("mgsgraph.adjustment.")}
    assert solver == {f"mgsgraph.adjustment.{name}" for name in ("settings", "incremental", "incremental.state")}


def test_a_pixel_of_a_case_is_projected_without_compiler_and_solver(case_file: Path) -> None:
    there = loaded("locate", case_file, "SIM/A", "--pixel", "10", "10", "--ellipsoid")
    assert "mgsgraph.geometry.compiled_pose" in there
    assert not {name.split(".")[0] for name in there} & HEAVY
    assert not [name for name in there if name.startswith(("mgsgraph.kernel.sweep", "mgsgraph.adjustment.graph"))]


@pytest.mark.parametrize("words", [("check", "CASE"), ("adjust", "CASE", "--no-figures", "--out", "OUT")])
def test_two_images_are_adjusted_without_gtsam(words: tuple[str, ...], case_file: Path, tmp_path: Path) -> None:
    """All of their unknowns share points, so that their order does not matter."""
    paths = {"CASE": case_file, "OUT": tmp_path / "out"}
    there = loaded(*(paths.get(word, word) for word in words))
    assert {name.split(".")[0] for name in there} & HEAVY <= {"numba", "llvmlite", "scipy", "shapely", "jinja2"}


def refused(project: Path, said: str, *arguments: str | Path) -> None:
    """One line, and nothing has changed."""
    before = state(project)
    with pytest.raises(InputError, match=said) as caught:
        call("project", *arguments)
    assert "\n" not in str(caught.value)
    assert state(project) == before


def test_from_a_case_to_a_solution_and_back(project: Path, case_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """An image that is taken out and added again is where it was, and batch agrees."""
    folder = case_file.parent
    assert call("project", "solve", project, "--no-figures") == 0
    moved = folder.parent / "moved.csv"
    assert call("project", "remove", project, "SIM/B", "--impact", moved) == 0
    names = moved.read_text(encoding="utf-8").splitlines()
    assert names[0].startswith("point,new,move_x_m,move_y_m,move_z_m,move_sigmas,sigma_before_x_m")
    assert [line.split(",")[1] for line in names[1:]] == ["false"] * len(names[1:])
    ties = ("--ties", folder / "network.pvl", "--shots", folder / "lidar.json")
    assert call("project", "add", project, folder / "image_B.isd", *ties) == 0
    capsys.readouterr()
    call("project", "status", project)
    said = capsys.readouterr().out
    for words in ("2 images", "20 tie, 8 laser", "Solution 3 (incremental", "2 changes since the last batch", "SIM/B"):
        assert words in said
    assert call("project", "solve", project, "--no-figures") == 0
    found = re.search(r"largest difference (\S+) sigmas .*, (\S+) sigmas for point", capsys.readouterr().out)
    assert found is not None
    assert max(map(float, found.groups())) < 1e-4
    first, last = (read_solution(project / "solutions" / name) for name in ("0001", "0004"))
    assert last.cost_final == pytest.approx(first.cost_final, rel=1e-9)
    with open_project(project) as opened:
        assert [change.verb for change in opened.changes()] == ["init", "solve", "remove", "add", "solve"]
        row = opened.last_solution()
        assert row is not None
        assert (row.cost, row.sigma0, row.folder) == (last.cost_final, last.sigma0, "solutions/0004")


def test_images_come_into_an_empty_project(case_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder, project = case_file.parent, tmp_path / "project"
    text = case_file.read_text(encoding="utf-8")
    (tmp_path / "settings.toml").write_text(
        "format = 1\n" + text[text.index("[orientation]") : text.index("[ties]")], encoding="utf-8"
    )
    call("project", "init", project, "--settings", tmp_path / "settings.toml")
    call("project", "add", project, f"SIM/A={folder / 'image_A.isd'}")
    assert "Unconnected: SIM/A" in capsys.readouterr().out
    call("project", "add", project, folder / "image_B.isd", "--ties", folder / "network.pvl")
    assert "20 with SIM/A" in capsys.readouterr().out
    call("project", "solve", project, "--no-figures")
    assert "Check against batch: the same" in capsys.readouterr().out


def test_measures_in_images_that_the_project_lacks_are_left_out_and_counted(
    project: Path, case_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A network of three images, of which the project gets the second back and the third never: a point of the project
    that the third one sees, too, keeps its measure in the second; one that is new and that only these two see goes.
    """
    network = read_network(case_file.with_name("network.pvl"))
    call("project", "remove", project, "SIM/B")
    first = network.points[0]
    third = structs.replace(first.measures[1], serial_number="SIM/X")
    only = [one for one in first.measures if one.serial_number == "SIM/B"]
    points = (
        structs.replace(first, measures=(*only, third), reference=None),
        structs.replace(first, id="new", measures=(*only, third), reference=None), *network.points[1:],
    )  # fmt: skip
    wide = project.with_name("wide.pvl")
    write_pvl_network(structs.replace(network, points=points), wide)
    capsys.readouterr()
    assert call("project", "add", project, f"SIM/B={case_file.with_name('image_B.isd')}", "--ties", wide) == 0

    said = capsys.readouterr().out
    assert re.search(r"2 measures in 1 image that the project doesn't hold \(SIM/X\), and 1 point", said)
    with open_project(project) as opened:
        assert wide.resolve() in opened.networks
        assert opened.store.bundles_of(["new"]) == {}
        rays = opened.store.network().rays
        assert rays.point.size == 2 * len(network.points) + 8  # and those of the laser in SIM/A
    refused(project, "measured in SIM/X", "add", project, "--ties", in_third(network, project.with_name("third.pvl")))


def in_third(network: ControlNetwork, path: Path) -> Path:
    """A network of which the project has no image."""
    points = tuple(
        structs.replace(one, measures=tuple(structs.replace(m, serial_number="SIM/X") for m in one.measures[:1]),
                        reference=None)
        for one in network.points
    )  # fmt: skip
    write_pvl_network(structs.replace(network, points=points), path)
    return path


def test_shots_get_the_sigmas_and_checks_that_they_get_in_a_case(project: Path, case_file: Path) -> None:
    """A profile of LOLA, as its selection says, has LOLA's sigmas; ranges in other units, shots on another body and an
    altimeter of which nothing is known are refused.
    """
    profiles.write_profile(case_file.with_name("profile.csv"))
    _, *rows = case_file.with_name("profile.csv").read_text(encoding="utf-8").splitlines()

    def selection(altimeter: str, column: int = 0, factor: float = 1.0) -> Path:
        values = [row.split(",") for row in rows]
        for one in values:
            one[column] = repr(float(one[column]) * factor)
        path = case_file.with_name(f"{altimeter}.csv")
        head = "longitude_deg,latitude_deg,radius_m,range_m,time_s,orbit,altimeter"
        path.write_text("\n".join([head, *(",".join([*one, altimeter]) for one in values)]), encoding="utf-8")
        return path

    refused(project, "metres stand where", "add", project, "--shots", selection("MOLA", 3, 1000.0))
    refused(project, "a radius of .* km", "add", project, "--shots", selection("MOLA", 2, 0.5))
    refused(project, "for LOLA", "add", project, "--shots", selection("LOLA"))
    refused(project, "shot_range_sigma_m in a project", "add", project, "--shots", selection("an altimeter"))
    assert call("project", "add", project, "--shots", selection("MOLA")) == 0
    with open_project(project) as opened:
        found = opened.store.network()
    case = profiles.with_profile(case_file)
    case.write_text(case.read_text(encoding="utf-8").replace('"profile.csv"', '"MOLA.csv"'), encoding="utf-8")
    expected = mgsgraph.read_case(case).network
    for net in (found, expected):
        mine = [k for k, name in enumerate(net.points.ids) if name.startswith("MOLA:")]
        assert len(mine) == profiles.SHOTS
        assert net.points.covariances[mine] == pytest.approx(np.tile(100.0 * np.eye(3), (len(mine), 1, 1)))
        assert set(net.ranges.sigmas[np.isin(net.ranges.point, mine)].tolist()) == {10.0}


def test_check_changes_nothing(project: Path, case_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = (project / "project.sqlite").read_bytes()
    call("project", "add", project, f"new={other_image(case_file)}", "--dry-run")
    assert "would add 1 image (new)" in capsys.readouterr().out
    assert (project / "project.sqlite").read_bytes() == before


def test_an_image_without_overlap_is_added_and_named(
    project: Path, case_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for k in range(2):
        name = f"alone{k}"
        isd = other_image(case_file, k + 1)
        call("project", "add", project, f"{name}={isd}", "--ties", case_file.parent / "network.pvl")
        assert f"Unconnected: {name}" in capsys.readouterr().out
        call("project", "solve", project, "--no-figures")
    call("project", "status", project)
    assert "Unconnected images: alone0, alone1" in capsys.readouterr().out


def test_before_the_first_solution_images_are_only_put_in(
    project: Path, case_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """In whatever order: the state is the same, and so is what batch makes of it."""
    call("project", "solve", project, "--no-figures")
    other = project.with_name("other")
    call("project", "init", other, "--case", case_file)
    call("project", "remove", other, "SIM/B")
    capsys.readouterr()
    folder = case_file.parent
    ties = ("--ties", folder / "network.pvl", "--shots", folder / "lidar.json")
    call("project", "add", other, folder / "image_B.isd", *ties)
    said = capsys.readouterr().out
    assert "Unconnected" not in said
    assert "mgsgraph project solve" in said
    call("project", "solve", other, "--no-figures")
    one, two = (read_solution(path / "solutions" / "0001") for path in (project, other))
    assert two.cost_final == pytest.approx(one.cost_final, rel=1e-9)


def test_what_is_refused(project: Path, case_file: Path, tmp_path: Path) -> None:
    folder, b = case_file.parent, case_file.with_name("image_B.isd")
    network = (folder / "network.pvl").read_text(encoding="utf-8")
    line = re.search(r"( Line *= )([\d.]+)", network)
    assert line is not None
    isd = other_image(case_file)
    moon = json.loads(isd.read_text(encoding="utf-8"))
    moon["radii"] |= {"semimajor": 1737.4, "semiminor": 1737.4}
    moon["naif_keywords"] = {}  # they say whose radii these are
    shots = json.loads((folder / "lidar.json").read_text(encoding="utf-8"))
    shots["points"][0]["range"] += 0.5
    other, moved, of_moon, ranges, mine = (
        tmp_path / name for name in ("other.pvl", "moved.pvl", "moon.isd", "shots.json", "mine.csv")
    )
    other.write_text(network.replace("SIM/A", "SIM/Y").replace("SIM/B", "SIM/Z"))
    moved.write_text(network.replace(line.group(), f"{line.group(1)}{float(line.group(2)) + 1.0}", 1))
    of_moon.write_text(json.dumps(moon), encoding="utf-8")
    ranges.write_text(json.dumps(shots), encoding="utf-8")
    mine.write_text("mine\n", encoding="utf-8")
    for said, verb, *arguments in (
        ("in the project already", "add", f"SIM/B={b}"),
        ("in the project already", "add", case_file),
        ("given twice", "add", f"x={b}", f"x={b}"),
        ("SIM/B and x, which are one image", "add", f"x={b}"),
        ("unknown image 'SIM/[YZ]'", "add", f"x={isd}", "--ties", other),
        ("measured there before", "add", "--ties", moved),
        ("no such file", "add", tmp_path / "x.isd"),
        ("at least one", "add"),
        ("no such image", "remove", "x"),
        ("not empty", "init"),
        ("image moon: a body of 1737.4 km", "add", f"moon={of_moon}"),
        ("one range", "add", "--shots", ranges),
        ("lies in the project", "remove", "SIM/B", "--impact", project / "x.csv"),
        (".csv", "remove", "SIM/B", "--impact", isd),
        ("not an earlier impact", "remove", "SIM/B", "--impact", mine),
    ):
        refused(project, said, verb, project, *arguments)
    with open_project(project, write=True):
        for verb, *arguments in (("solve",), ("add", f"x={isd}"), ("remove", "SIM/B")):
            refuses("another mgsgraph process", call, "project", verb, project, *arguments)


def test_a_result_that_nobody_knows_of_is_swept(project: Path) -> None:
    """A process was killed between writing the results and saying so."""
    left = project / "solutions" / "0001"
    left.mkdir(parents=True)
    (left / "solution.json").write_text("{}")
    aside = beside(left)
    aside.mkdir()
    assert call("project", "solve", project, "--no-figures") == 0
    assert not aside.exists()
    assert json.loads((left / "solution.json").read_text())["status"] == "converged"


def test_a_point_is_measured_rejected_and_given_back(project: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first, second = "SIM/A", "SIM/B"
    refused(project, "no such point", "measure", project, "HAND1", "--pixel", first, "100", "50")
    pixels = ("--pixel", first, "100.5", "50", "--pixel", second, "102", "51")
    call("project", "measure", project, "HAND1", "--new", *pixels)
    assert "Nothing is adjusted yet" in capsys.readouterr().out
    refused(project, "it is there already", "measure", project, "HAND1", "--new", *pixels)
    call("project", "solve", project, "--no-figures")
    capsys.readouterr()
    call("project", "measure", project, "HAND1", "--pixel", first, "101", "50", "--sigma-px", "0.5", "--reject", second)
    said = capsys.readouterr().out
    assert f"change 4. Point HAND1: moved in {first}" in said
    assert f"change 5. Point HAND1: rejected in {second}" in said
    refused(project, f"image {second}: no measure", "measure", project, "HAND1", "--reject", second)
    call("project", "measure", project, "HAND1", "--accept", second)
    refused(project, "change 5 has changed point HAND1 since", "undo", project, "4")
    for _ in range(3):
        call("project", "undo", project, "--why", "a test")
    refused(project, "change 4 is undone", "undo", project, "4")
    refused(project, "no change 3 to undo", "undo", project, "3")
    capsys.readouterr()
    call("project", "status", project)
    assert "a test" in capsys.readouterr().out
    call("project", "measure", project, "HAND1", "--remove")
    call("project", "undo", project)
    call("project", "redo", project)
    call("project", "undo", project)
    for wrong in ((), ("--new", "--remove"), ("--sigma-px", "1", "--remove")):
        with pytest.raises(click.UsageError):
            call("project", "measure", project, "HAND1", *wrong)
    refused(project, "a positive number", "measure", project, "HAND1", "--pixel", first, "1", "1", "--sigma-px", "nan")
    with open_project(project) as opened:
        network = opened.store.network()
        mine = network.rays.point == network.points.ids.tolist().index("HAND1")
        assert network.rays.places[mine].tolist() == [[100.5, 50.0], [102.0, 51.0]]


def test_shots_given_again_are_said_when_they_are_added(
    project: Path, case_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lidar = json.loads(case_file.with_name("lidar.json").read_text(encoding="utf-8"))
    for point in lidar["points"][:5]:
        point["id"] += "again"
    lidar["points"] = lidar["points"][:6]
    path = case_file.with_name("again.json")
    path.write_text(json.dumps(lidar), encoding="utf-8")
    capsys.readouterr()
    for more in (("--dry-run",), ()):
        assert call("project", "add", project, "--shots", path, *more) == 0
        assert re.search(r"5 \S+ \S+ of 13 .*again", capsys.readouterr().out)
    both = case_file.with_name("both.json")
    every = json.loads(case_file.with_name("lidar.json").read_text(encoding="utf-8"))
    both.write_text(json.dumps(every | {"points": every["points"] + lidar["points"][:5]}), encoding="utf-8")
    case_file.write_text(case_file.read_text(encoding="utf-8").replace("lidar.json", "both.json"), encoding="utf-8")
    call("project", "init", case_file.parent / "project", "--case", case_file)
    assert re.search(r"5 \S+ \S+ of 13 .*again", capsys.readouterr().out)


def test_a_removed_point_stays_out_when_its_network_is_given_again(shared_data: Path, tmp_path: Path) -> None:
    """Field case 19: cubes 1 and 2, a point removed by hand, then cube 3 with the control network of all three."""
    folder, project = shared_data / "mgs_moc_wa_three", tmp_path / "project"
    images = "".join(f'[[images]]\nimage = "{folder / name}.isd"\n' for name in ("cube1", "cube2"))
    case = tmp_path / "case.toml"
    case.write_text(
        f'format = 1\nname = "MOC"\n{images}[orientation]\nposition_sigma_m = 100.0\nangle_sigma_mrad = 0.29\n'
        f'[ties]\nnetwork = "{folder / "controlnetwork.net"}"\n', encoding="utf-8",
    )  # fmt: skip
    call("project", "init", project, "--case", case)
    call("project", "solve", project, "--no-figures")
    with open_project(project) as opened:
        point = opened.store.network().points.ids[0]
    call("project", "measure", project, point, "--remove", "--why", "a shadow")
    call("project", "add", project, folder / "cube3.isd", "--ties", folder / "controlnetwork.net")
    with open_project(project) as opened:
        points = opened.store.network().points.ids.tolist()
    assert len(points) > 3
    assert point not in points
    call("project", "undo", project)
    call("project", "undo", project)
    with open_project(project) as opened:
        assert point in opened.store.network().points.ids.tolist()
    call("project", "add", project, folder / "cube3.isd", "--ties", folder / "controlnetwork.net")
    assert call("project", "solve", project, "--no-figures") == 0

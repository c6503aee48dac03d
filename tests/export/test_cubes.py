"""Cubes written back, read by our reader (inside `write_cubes`) and by a few lines that know ISIS's layout."""

import json
import os
import re
import signal
import struct
from collections.abc import Callable
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mex
import numpy as np
import pytest
from commands import call, refusal
from cubes import LINES, MAPPED, PERIOD, START, written
from full_disk import files_of_at_most
from outside import refuses
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial.transform import Rotation, Slerp

from mgsgraph.analysis import verdict as analysis
from mgsgraph.analysis.verdict import Cause, Reason, State
from mgsgraph.errors import InputError
from mgsgraph.export import cubes as writer
from mgsgraph.export.cubes import LARGEST, replace_cubes, write_cubes
from mgsgraph.export.spice_nodes import AdjustedNodes, adjusted_nodes
from mgsgraph.files import writing
from mgsgraph.files.labels.isis_cube import read_isis_cube
from mgsgraph.files.labels.labelled_image import read_labelled_image
from mgsgraph.files.opening import read_json
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import OrientationCorrection
from mgsgraph.geometry.records import Array
from mgsgraph.geometry.rotation import angles_313, from_matrix, unit_vectors
from mgsgraph.geometry.trajectory import Trajectory
from mgsgraph.results.archive import read_solution

ROOT = Path(__file__).resolve().parents[2]
REAL = (
    "mgs_moc_pair/E0201461.tiny.cub", *(f"mgs_moc_wa_three/cube{k}.pvl" for k in (1, 2, 3)),
    *(f"lro_nac_lola/lidarObservationImage{k}.pvl" for k in (1, 2)),
    *(f"lro_nac_hadley/observationImage{side}.pvl" for side in "LR"), "mro_ctx_b10/B10_013341_1010_XN_79S172W.cub",
)  # fmt: skip
LABELS = (
    "mex_hrsc_h5270/h5270_0000_ir2_isis3.lbl", "kaguya_tc/TC1S2B0_01_06691S820E0465_isis3.lbl",
    "mro_ctx_b10/B10_013341_1010_XN_79S172W_isis3.lbl",
)  # fmt: skip
"""Of cubes that lie elsewhere, in each a place for tables."""
DESCRIBED = ("start_time", "end_time", "original_size")
WANTED = ("InstrumentPointing", "InstrumentPosition", "BodyRotation")
PLACE = r"Name += (\w+)\n +StartByte += (\d+)\n +Bytes += \d+\n"
KINDS = (".bsp", ".bc", ".tf", ".ti", ".tsc", ".tpc", ".tls")
COEFFICIENTS = np.array([
    [120.0, -80.0, 60.0, 3e-4, -2e-4, 1e-4], [5.0, 3.0, -2.0, 1e-5, 2e-5, -3e-5], [0.0, 0.0, 0.0, 4e-6, -6e-6, 3e-6],
])  # fmt: skip
WHEN = datetime(2026, 11, 30, 7)


def adjusted(image: PushbroomImage, converged: bool = True) -> Any:
    """What of a solution is asked: an image and its correction."""
    correction = OrientationCorrection(COEFFICIENTS[: 3 if image.lines > 1 else 1])
    return SimpleNamespace(
        network=SimpleNamespace(images=(image,), image_names=(image.name,)),
        image=lambda j: image, correction=lambda j: correction, converged=converged, versions={"mgsgraph": "1.2.3"},
    )  # fmt: skip


def copied(cube: Path, folder: Path, image: PushbroomImage | None = None) -> tuple[Any, Path]:
    """A solution of a cube, and the adjusted copy."""
    solution = adjusted(image or read_isis_cube(cube, "mine"))
    folder.mkdir(exist_ok=True)
    write_cubes(solution, folder, {solution.image(0).name: cube}, WHEN, "SUSPECT, converged")
    return solution, folder / cube.name


# --- by the published layout alone


def label_of(path: Path) -> str:
    return path.read_bytes()[: 1 << 17].split(b"\0")[0].decode("latin-1")


def rows_of(path: Path) -> dict[str, Array]:
    """Tables of doubles behind a label, or in its JSON: a row for each record."""
    beside, found = path.with_suffix(".isd"), {}
    if beside.exists():
        for name, *keys in (
            ("instrument_pointing", "quaternions"), ("body_rotation", "quaternions"),
            ("instrument_position", "positions", "velocities"),
        ):  # fmt: skip
            table = read_json(beside)[name]
            columns = [np.array(table[key]) for key in keys]
            found[name.title().replace("_", "")] = np.column_stack([*columns, table["ephemeris_times"]])
        return found
    for text in re.findall(r"^Object = Table\n(.*?)^End_Object", label_of(path), re.DOTALL | re.MULTILINE):
        of = dict(re.findall(r"^  (\S+)\s*= (\S+)$", text, re.MULTILINE))
        if of.get("Name") not in WANTED:
            continue
        file = path.with_name(of.get("^Table", path.name))
        start, count, fields = int(of["StartByte"]) - 1, int(of["Records"]), text.count("Type = Double")
        assert int(of["Bytes"]) == count * fields * 8
        form = (">" if of["ByteOrder"] == "Msb" else "<") + f"{fields}d"
        raw = file.read_bytes()[start : start + int(of["Bytes"])]
        found[of["Name"]] = np.array(list(struct.iter_unpack(form, raw)))
    return found


def turned(rows: Array, times: Array) -> Array:
    """Matrices on the great arcs between quaternions, scalar first, in the first four columns."""
    return Slerp(rows[:, -1], Rotation.from_quat(rows[:, [1, 2, 3, 0]]))(times).as_matrix()


def constant_of(path: Path, name: str) -> Array:
    """ConstantRotation of a table, by its label or JSON."""
    if path.with_suffix(".isd").exists():
        table = read_json(path.with_suffix(".isd"))["instrument_pointing" if "Point" in name else "body_rotation"]
        return np.array(table.get("constant_rotation", np.eye(3))).reshape(3, 3)
    return constant_in(label_of(path), name)


def constant_in(label: str, name: str) -> Array:
    text = re.search(rf"Name\s+= {name}\n.*?End_Object", label, re.DOTALL)
    found = re.search(r"ConstantRotation\s+= \((.*?)\)", text[0] if text else "", re.DOTALL)
    return np.array(found[1].split(","), dtype=float).reshape(3, 3) if found else np.eye(3)


def off(path: Path, solution: Any) -> float:
    """px, largest of the angle between where tables and solution look for the ground of 25 pixels, at their times."""
    image, correction, rows = solution.image(0), solution.correction(0), rows_of(path)
    shares = (np.arange(5) + 0.5) / 5
    lines, samples = (axis.ravel() for axis in np.meshgrid(shares * image.lines, shares * image.samples))
    ground, _ = image.image_to_ground(lines, samples, 0.0, correction)
    pose, times = image.pose(lines, correction), image.timing.at(lines)[0]
    for name in WANTED:
        rows[name][:, -1] -= image.trajectory.epoch
    pointing, position, body = (rows[name] for name in WANTED)
    place = 1e3 * CubicHermiteSpline(position[:, -1], position[:, :3], position[:, 3:6])(times)
    to_body = constant_of(path, "BodyRotation") @ turned(body, times)
    to_camera = constant_of(path, "InstrumentPointing") @ turned(pointing, times)
    seen = to_camera @ (to_body.mT @ ground[:, :, None] - place[:, :, None])
    want = pose.matrix @ (ground - pose.position)[:, :, None]
    apart = unit_vectors(seen[..., 0]) - unit_vectors(want[..., 0])
    return float(np.linalg.norm(apart, axis=1).max() / image.pixel_angle)


# --- every camera


def spiceinited(label: Path, shared_data: Path, folder: Path) -> Path:
    """The cube of a label: noise for its pixels, and tables of the kernels beside it in their places."""
    kernels = [path for path in sorted(label.parent.iterdir()) if path.suffix.lower() in KINDS]
    if "kaguya" in str(label):
        kernels += [shared_data / "lro_nac_m103595705" / name for name in ("moon_080317.tf", "moon_assoc_me.tf")]
        kernels += [shared_data / "kernels" / "moon_pa_de421_1900-2050.bpc"]
    times_file = {"line_times": mex.times_file(folder)} if "hrsc" in str(label) else {}
    image = read_labelled_image(label, mex.kernels(shared_data) if times_file else kernels, interval=0.1, **times_file)
    assert isinstance(image.trajectory, Trajectory)
    text, path, epoch = label.read_text("latin-1"), folder / f"{label.stem}.cub", image.trajectory.epoch
    ends = image.timing.at(np.array([0.0, image.lines]))[0]
    with path.open("wb") as file:
        file.write(text.encode("latin-1").ljust(65536, b"\0") + np.random.default_rng(1).bytes(1 << 20))
        for name, start, count in re.findall(PLACE + r" +Records += (\d+)", text):
            times = np.linspace(*ends, int(count))
            table = image.trajectory.body if name == "BodyRotation" else image.trajectory.camera
            matrix, rate = table.at(times)
            turn = from_matrix(constant_in(text, name).T @ matrix)
            rows = np.column_stack([turn, np.einsum("nji,nj->ni", matrix, rate), times + epoch])
            if name.endswith("Position"):
                place = np.hstack(image.trajectory.position.at(times)) / 1e3
                place = place if name != "SunPosition" else np.tile([1e8, 1e8, 1e8, -15.0, 15.0, 8.0], (times.size, 1))
                rows = np.column_stack([place, times + epoch])
            file.seek(int(start) - 1)
            scan = b"".join(struct.pack("<ddi", *row) for row in mex.CHANGES)
            file.write(scan if name == "LineScanTimes" else rows.astype("<f8").tobytes())
        places = re.findall(r"StartByte += (\d+)\n +Bytes += (\d+)", text)
        file.truncate(max(int(start) + int(size) - 1 for start, size in places))
    return path


@pytest.mark.parametrize("name", [*REAL, *LABELS])
def test_both_readers_see_the_ground_where_the_solution_does(name: str, shared_data: Path, tmp_path: Path) -> None:
    cube = spiceinited(shared_data / name, shared_data, tmp_path) if name in LABELS else shared_data / name
    before = cube.read_bytes()
    solution, copy = copied(cube, tmp_path / "out")
    assert off(copy, solution) < LARGEST
    if cube.suffix == ".cub":
        assert copy.read_bytes()[65536 : len(before)] == before[65536:]
        assert "# Jigged = 2026-11-30T07:00:00\nObject = Table\n  Name " in label_of(copy)
    else:
        made = read_json(copy.with_suffix(".isd"))
        for table, kind in ((made["instrument_pointing"], "ck"), (made["instrument_position"], "spk")):
            first, *_, last = times = table["ephemeris_times"]
            assert [table[f"{kind}_table_{key}"] for key in DESCRIBED] == [first, last, len(times)]
    assert cube.read_bytes() == before
    bias = "once" in (label_of(copy) if cube.suffix == ".cub" else copy.with_suffix(".isd").read_text())
    assert bias == ("moc" in name)


# --- labels of all kinds, and what is not as expected


@pytest.mark.parametrize("order", ["Lsb", "Msb"])
def test_a_small_cube(tmp_path: Path, order: str) -> None:
    cube = written(tmp_path, order=order)
    solution, copy = copied(cube, tmp_path / "out")
    assert off(copy, solution) < LARGEST
    again, second = copied(copy, tmp_path / "again")  # a copy is a cube: its positions are geometric, its marks are one
    assert off(second, again) < LARGEST
    assert label_of(second).count("# Jigged") == 2
    entries = second.read_bytes().split(b"Object = mgsgraph\n  ExecutionDateTime = 2026-11-30T07:00:00\n")[1:]
    assert [entry.split()[:6:3] for entry in entries] == [[b"HostName", b"UserName"]] * 2
    assert 100 < second.stat().st_size - copy.stat().st_size < 400  # an entry of the history more
    assert [len(rows_of(second)[name]) for name in WANTED] == [len(rows_of(copy)[name]) for name in WANTED]


def test_a_label_that_has_no_room_gets_some(tmp_path: Path) -> None:
    label = ("  Group = Archive", "Object = Label\n  Bytes = 65536\nEnd_Object\nObject = Polygon\nEnd_Object\n")
    cube = written(tmp_path, ("End_Object\nObject = Table", f"End_Object\n{label[1]}Object = Table"))
    text, rest = label_of(cube), cube.read_bytes()[65536:]
    filler = f"# {'x' * 76}\n" * ((65500 - len(text)) // 79)
    cube.write_bytes(text.replace(label[0], filler + label[0]).encode().ljust(65536, b"\0") + rest)
    solution, copy = copied(cube, tmp_path / "out")
    assert off(copy, solution) < LARGEST
    assert copy.read_bytes()[131072:].startswith(rest)
    found = label_of(copy)
    assert ("  Bytes = 131072\n" in found, "StartByte = 131073\n" in found, "Polygon" in found) == (True, True, False)


def test_a_detached_label_and_its_files(tmp_path: Path) -> None:
    """Objects name the file that has their bytes; new ones have a file of their own."""
    cube = written(tmp_path, ("    StartByte", "    ^Core = image.cub\n    StartByte"))
    label = label_of(cube).replace("  ByteOrder = Lsb", "  ByteOrder = Lsb\n  ^Table = image.cub")
    (tmp_path / "image.lbl").write_text(label)
    solution, copy = copied(tmp_path / "image.lbl", tmp_path / "out")
    assert off(copy, solution) < LARGEST
    assert (tmp_path / "out" / "image.cub").read_bytes() == cube.read_bytes()
    assert len(list((tmp_path / "out").glob("image.*.tables"))) == 1


def test_polynomials_stay_polynomials_where_they_can(tmp_path: Path) -> None:
    """A straight flight and an even turn, with their correction: read back to 1e-4 px, or refused."""
    stop, last = START + LINES * PERIOD, [START + 0.5 * LINES * PERIOD, 0.5 * LINES * PERIOD, 1.0]
    nadir = angles_313(np.array([[0.0, 0.0, -1.0], [0.0, -1.0, 0.0], [-1.0, 0.0, 0.0]])).tolist()
    changes, other = list[tuple[str, str]](), dict[str, tuple[tuple[str, ...], Array]]()
    for name, kind, fields, rows in (
        ("InstrumentPosition", "Spk", ("J2000SVX", "J2000SVY", "J2000SVZ"), [[3800.0, 0.0, 0.15], [0.0, 0.0, 0.15]]),
        ("InstrumentPointing", "Ck", ("J2000Ang1", "J2000Ang2", "J2000Ang3"), [nadir, [0.0, 1e-5, 0.0]]),
    ):
        said = f"  Name = {name}"
        changes.append((said, f"{said}\n  {kind}TableStartTime = {START!r}\n  {kind}TableEndTime = {stop!r}"))
        other[name] = fields, np.array([*rows, last])
    _, copy = copied(written(tmp_path, *changes, other=other), tmp_path / "out")
    found = [rows_of(copy)[name] for name in WANTED[:2]]
    assert [(rows.shape[1], rows[-1, 2]) for rows in found] == [(3, len(rows) - 2.0) for rows in found]


def twice(image: PushbroomImage, *rest: Any) -> AdjustedNodes:
    """Attitudes of 1.15 s before."""
    trajectory: Any = image.trajectory
    camera = replace(trajectory.camera, times=trajectory.camera.times + 1.15)
    return adjusted_nodes(replace(image, trajectory=replace(trajectory, camera=camera)), *rest)


def test_what_is_read_back_otherwise_is_refused(shared_data: Path, tmp_path: Path, monkeypatch: Any) -> None:
    """A bias of MOC that is there twice, and another focal length, which tables don't have."""
    cube = shared_data / REAL[0]
    image = read_isis_cube(cube)
    longer = replace(image, interior=replace(image.interior, focal_length=1.001 * image.interior.focal_length))
    refuses(r"px off the solution's; expected at most 0.0001 px; export csm or spice", copied, cube, tmp_path, longer)
    monkeypatch.setattr(writer, "adjusted_nodes", twice)
    refuses(r"a camera \d\.\d+ px off the solution's", copied, shared_data / REAL[1], tmp_path)


def test_a_cube_of_another_time_is_refused(shared_data: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"positions from .*; expected those of .*; name its own cube"):
        copied(shared_data / REAL[1], tmp_path, read_isis_cube(shared_data / REAL[2]))


def test_images_without_cubes_and_maps(tmp_path: Path) -> None:
    cube = written(tmp_path, MAPPED)
    solution = adjusted(read_isis_cube(cube))
    with pytest.raises(InputError, match=r"no ISIS cube with tables of spiceinit of .*; name the case that has them"):
        write_cubes(solution, tmp_path, {}, WHEN, "")
    (tmp_path / "out").mkdir()
    _, notes, new = write_cubes(solution, tmp_path / "out", {solution.image(0).name: cube}, WHEN, "")
    assert new == [(tmp_path / "out" / "image.cub", cube)]
    found = [note.split(": ")[1].split(",")[0] for note in notes[1:]]
    assert found == ["attitude times hold MOC's -1.15 s once", "a map"]


def test_images_without_cubes_stay_out_and_cubes_may_have_one_name(shared_data: Path, tmp_path: Path) -> None:
    """A PDS label, a cube without tables, an image that no case names; and a cube of the same name elsewhere."""
    for folder in ("a", "b", "c", "out"):
        (tmp_path / folder).mkdir()
    cubes = [written(tmp_path / folder) for folder in "abc"]
    bare = label_of(cubes[1]).replace("InstrumentPointing", "Other")
    cubes[1].write_bytes(bare.encode().ljust(65536, b"\0") + cubes[1].read_bytes()[65536:])
    one = adjusted(read_isis_cube(cubes[0]))
    names = [SimpleNamespace(name=name) for name in "apbxc"]
    solution = SimpleNamespace(**{**vars(one), "network": SimpleNamespace(images=names, image_names=tuple("apbxc"))})
    files = dict(zip("apbc", [cubes[0], shared_data / "mgs_moc_pair" / "M0100115.img", *cubes[1:]], strict=True))
    _, notes, new = write_cubes(solution, tmp_path / "out", files, WHEN, "")
    assert new == [(tmp_path / "out" / "image.cub", cubes[0]), (tmp_path / "out" / "5" / "image.cub", cubes[2])]
    assert "3 of 5 images, p, b, x." in notes[1]


# --- in place


@pytest.fixture
def pairs(tmp_path: Path) -> tuple[list[tuple[Path, Path]], Callable[[], list[bytes]]]:
    """Two cubes with their copies, and what the cubes hold."""
    cubes = [written(tmp_path, name=name) for name in ("a.cub", "b.cub")]
    made = [(copied(cube, tmp_path / "out")[1], cube) for cube in cubes]
    return made, lambda: [cube.read_bytes() for cube in cubes]


def test_a_full_disk_leaves_the_originals(pairs: Any, tmp_path: Path) -> None:
    made, held = pairs
    before = held()
    with files_of_at_most(66000):
        refuses(r"b.cub: can't be written \(File too large\)", replace_cubes, made)
        refuses("can't be written", copied, made[0][1], tmp_path / "other")
    assert held() == before
    assert not list(tmp_path.rglob(".*"))


def test_a_write_protected_cube_stays(pairs: Any) -> None:
    made, held = pairs
    before = held()
    made[1][1].chmod(0o444)
    refuses("a write-protected cube", replace_cubes, made)
    assert held() == before
    made[1][1].chmod(0o640)
    os.chown(made[1][1], *((12345, 54321) if os.geteuid() == 0 else (-1, -1)))
    owned = [getattr(made[1][1].stat(), key) for key in ("st_uid", "st_gid", "st_mode")]
    replace_cubes(made)
    assert [getattr(made[1][1].stat(), key) for key in ("st_uid", "st_gid", "st_mode")] == owned


@pytest.mark.parametrize("after", [0, 1])
def test_a_kill_leaves_each_cube_whole(pairs: Any, tmp_path: Path, monkeypatch: Any, after: int) -> None:
    """Killed before the first takes its place, or between the two: in order, and the next one ends it."""
    made, held = pairs
    before, wanted, put, count = held(), [copy.read_bytes() for copy, _ in made], writing.put_file, 0

    def killed(new: Path, target: Path) -> None:
        nonlocal count
        if count == after:
            os.kill(os.getpid(), signal.SIGKILL)
        count += 1
        put(new, target)

    child = os.fork()
    if child == 0:
        writing.put_file = killed
        replace_cubes(made)
        os._exit(0)
    assert os.WTERMSIG(os.waitpid(child, 0)[1]) == signal.SIGKILL
    assert held() == [*wanted[:after], *before[after:]]
    replace_cubes(made)
    assert held() == wanted
    assert not list(tmp_path.glob(".*"))


def test_the_command_updates_the_cubes_of_the_case(shared_data: Path, tmp_path: Path, monkeypatch: Any) -> None:
    """Adjusted anew, they need no correction any more."""
    for file in (shared_data / "mgs_moc_wa_three").iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    case = (ROOT / "scripts" / "cases" / "moc_wa_three.toml").read_text()
    (tmp_path / "case.toml").write_text(re.sub("(?m)^files_from.*|../../../shared/data/mgs_moc_wa_three/", "", case))
    for result in ("first", "second"):
        assert call("adjust", tmp_path / "case.toml", "--out", tmp_path / result, "--no-figures") == 0
        out = tmp_path / f"{result}-cubes"
        assert call("export", tmp_path / result, "--to", "cubes", "--out", out, "--update") == 0
        assert (out / "cube1.isd").read_bytes() == (tmp_path / "cube1.isd").read_bytes()
    kept, reason = (tmp_path / "cube1.isd").read_bytes(), Reason(State.INVALID, Cause.SIGMA0, "all", 9.0, "factor")
    with monkeypatch.context() as patch:
        patch.setattr(analysis, "_verdict", lambda _: SimpleNamespace(state=State.INVALID, reasons=(reason,)))
        assert "INVALID, converged" in refusal("export", tmp_path / "second", "--to", "cubes", "--out", out, "--update")
        assert call("export", tmp_path / "second", "--to", "cubes", "--out", tmp_path / "invalid") == 0
    assert (tmp_path / "cube1.isd").read_bytes() == kept
    assert "INVALID" in read_json(tmp_path / "invalid" / "cube1.isd")["mgsgraph"]
    first, second = (read_solution(tmp_path / result) for result in ("first", "second"))
    assert [np.abs(part.correction(0).coefficients[0, 3:]).max() > 1e-6 for part in (first, second)] == [True, False]
    cube, again = tmp_path / "cube1.isd", ("export", tmp_path / "second", "--to", "cubes", "--out", out, "--update")
    assert call(*again) == 0  # an adjusted cube, as a killed update leaves some
    content, moved = cube.read_text(), read_json(cube)
    moved["instrument_position"]["positions"] = (np.array(moved["instrument_position"]["positions"]) + 1.0).tolist()
    cube.write_text(json.dumps(moved))
    assert "a cube that changed since it was adjusted; expected as it was" in refusal(*again)
    cube.write_text(content)
    project = tmp_path / "project"
    assert call("project", "init", project, "--case", tmp_path / "case.toml") == 0
    assert call("project", "solve", project, "--no-figures") == 0
    assert call("export", project, "--to", "cubes", "--out", tmp_path / "of-project") == 0
    case = tmp_path / "again.toml"
    case.write_text((tmp_path / "case.toml").read_text().replace('image = "', 'image = "second-cubes/'))
    message = refusal("export", tmp_path / "first", "--to", "cubes", "--case", case, "--out", out)
    assert "cubes of the case lie in it" in message
    assert "a case file" in refusal("export", tmp_path / "case.toml", "--to", "cubes", "--out", out)
    (tmp_path / "case.toml").unlink()
    assert "name it with --case" in refusal("export", tmp_path / "first", "--to", "cubes", "--out", tmp_path / "gone")
    message = refusal("export", tmp_path / "first", "--to", "csm", "--out", tmp_path / "csm", "--update")
    assert "an option that it ignores; expected it with cubes alone" in message

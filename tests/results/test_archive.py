"""The archive gives the same solution back bit for bit, and says in one line what is wrong with any other file."""

import io
import itertools
import json
import math
import tracemalloc
import zipfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from networks import network, pair, with_shift_and_surface

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.solution import Solution
from mgsgraph.case.reading import Case
from mgsgraph.errors import InputError
from mgsgraph.geometry.camera import CahvorDistortion, KaguyaDistortion, LrocNacDistortion, RadialDistortion
from mgsgraph.geometry.image import fit_polynomials
from mgsgraph.geometry.orientation import OrientationPrior
from mgsgraph.geometry.terrain import Gaps, TerrainGrid
from mgsgraph.geometry.trajectory import AttitudeTable, FixedTrajectory, PositionTable
from mgsgraph.network import ImageRays
from mgsgraph.results.archive import FORMAT, pack, read_solution, unpack, unpack_parts, write_archive


@pytest.fixture(scope="module")
def case(pair_case: Case) -> Case:
    return pair_case


@pytest.fixture(scope="module")
def solution(pair_solution: Solution) -> Solution:
    return pair_solution


@pytest.fixture(scope="module")
def archive(solution: Solution, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("results") / "solution.npz"
    write_archive(solution, path)
    return path


def leaves(value: Any, where: str = "solution") -> Iterator[tuple[str, Any]]:
    """Everything in a record that is no record itself, with the path to it; types too."""
    if is_dataclass(value):
        yield where, type(value)
        for field in fields(value):
            yield from leaves(getattr(value, field.name), f"{where}.{field.name}")
    elif isinstance(value, tuple):
        yield where, len(value)
        for k, item in enumerate(value):
            yield from leaves(item, f"{where}[{k}]")
    elif isinstance(value, Mapping):
        yield where, tuple(value)
        for key, item in value.items():
            yield from leaves(item, f"{where}[{key}]")
    else:
        yield where, value


def same(one: Any, other: Any) -> bool:
    if isinstance(one, np.ndarray):
        return (
            isinstance(other, np.ndarray)
            and (one.dtype, one.shape) == (other.dtype, other.shape)
            and np.ascontiguousarray(one).tobytes() == np.ascontiguousarray(other).tobytes()
        )
    if isinstance(one, float):  # np.float64 is a float too, and comes back as Python's
        return isinstance(other, float) and (one == other or (math.isnan(one) and math.isnan(other)))
    return type(one) is type(other) and bool(one == other)


def differences(one: Solution, other: Solution) -> list[str]:
    want, got = list(leaves(one)), list(leaves(other))
    assert [where for where, _ in want] == [where for where, _ in got]
    return [where for (where, value), (_, back) in zip(want, got, strict=True) if not same(value, back)]


def there_and_back(solution: Solution, folder: Path) -> Solution:
    write_archive(solution, folder / "solution.npz")
    return read_solution(folder)


def test_the_same_solution_comes_back(solution: Solution, archive: Path) -> None:
    for path in (archive, archive.parent, str(archive)):
        assert differences(solution, read_solution(path)) == []


def test_the_comparison_sees_one_bit(solution: Solution) -> None:
    moved = solution.places.copy()
    moved[3, 1] = np.nextafter(moved[3, 1], np.inf)
    assert differences(solution, replace(solution, places=moved)) == ["solution.places"]
    assert differences(solution, replace(solution, cost_final=1)) == ["solution.cost_final"]


def test_every_kind_of_solution_comes_back(case: Case, tmp_path: Path) -> None:
    """Held, robust, with blunder passes, without some priors, with lost points and odd names."""
    network, prior = case.network, case.network.priors[0].sigmas.copy()
    prior[0, 2] = np.inf
    kept = np.flatnonzero(network.rays.point != 1).tolist() + np.flatnonzero(network.rays.point == 1)[:1].tolist()
    r = network.rays
    lossy = ImageRays(r.point[kept], r.image[kept], r.places[kept], r.sigmas[kept])
    odd = replace(network.points, ids=("né, \"1\"", "trailing ", "", *network.points.ids[3:]))
    chosen = case.settings
    for name, net, how in (
        ("held and robust", replace(network, held=np.array([True, False])),
         replace(chosen, loss="cauchy", loss_width=2, reject=4.0, angles="opk-paper", line="measured")),
        ("all held", replace(network, held=np.array([True, True])), chosen),
        ("free and lossy", replace(network, rays=lossy, points=odd,
                                   priors=(OrientationPrior(prior), network.priors[1])), chosen),
        ("impatient", network, replace(chosen, max_iterations=1)),
        ("shifted", with_shift_and_surface(network), chosen),
        ("polynomials", replace(network, images=(fit_polynomials(network.images[0], 3), network.images[1])), chosen),
    ):
        solved = adjust_network(net, how, name)
        assert differences(solved, there_and_back(solved, tmp_path)) == [], name


def test_every_distortion_comes_back(solution: Solution, tmp_path: Path) -> None:
    network = solution.network
    optics = (
        LrocNacDistortion(1.81e-5), CahvorDistortion(RadialDistortion(1e-4, -2.0, 0.1), 1e-3, -2e-3),
        KaguyaDistortion((1e-6, 2e-4, 0.3, 4.0), (-1e-6, 0.0, 1.0, 2.0)),
    )  # fmt: skip
    for distortion in optics:
        images = tuple(
            replace(image, interior=replace(image.interior, distortion=distortion)) for image in network.images
        )
        bent = replace(solution, network=replace(network, images=images))
        assert differences(bent, there_and_back(bent, tmp_path)) == []


def test_what_is_no_number_comes_back(solution: Solution, tmp_path: Path) -> None:
    history = tuple(replace(step, cost=math.inf, decrease=-math.inf, predicted=math.nan) for step in solution.history)
    odd = replace(solution, history=history, sigmas_without_laser=None, cost_initial=math.nan, seconds={})
    assert differences(odd, there_and_back(odd, tmp_path)) == []


def test_fields_with_defaults_may_be_missing(solution: Solution, archive: Path, tmp_path: Path) -> None:
    """What is added to a record later has a default, so that older archives stay readable."""
    path = in_record(archive, tmp_path / "x.npz", lambda record: record["settings"].pop("step_tolerance"))
    assert differences(solution, read_solution(path)) == []


def test_gaps_between_tracks_come_back() -> None:
    """What a terrain model's counts of shots say of its posts."""
    surface = with_shift_and_surface(network(pair(20, 12, 1))).surface
    assert surface is not None
    shape = surface.grid.radii.shape
    gaps = Gaps(np.arange(np.prod(shape), dtype=float).reshape(shape), np.full(shape, 900.0))
    grid = replace(surface.grid, gaps=gaps)
    found = unpack(pack(grid), TerrainGrid, "grid")
    assert found.gaps is not None
    for one, other in zip(found.gaps, gaps, strict=True):
        np.testing.assert_array_equal(one, other)


def test_arrays_are_read_only(archive: Path) -> None:
    back = read_solution(archive)
    with pytest.raises(ValueError, match="read-only"):
        back.places[0, 0] = 0.0


def test_plain_numpy_reads_it_without_pickle(solution: Solution, archive: Path) -> None:
    with np.load(archive, allow_pickle=False) as arrays:
        assert not any(arrays[name].dtype.hasobject for name in arrays.files)
        ends, text = arrays["network.points.ids.offsets"].tolist(), arrays["network.points.ids.data"].tobytes()
        ids = [text[a:b].decode() for a, b in itertools.pairwise(ends)]
        assert ids == list(solution.network.points.ids)
        np.testing.assert_array_equal(arrays["places"], solution.places)
        np.testing.assert_array_equal(arrays["joint_covariance.blocks"], solution.joint_covariance.blocks)


def test_the_same_solution_gives_the_same_bytes(solution: Solution, archive: Path, tmp_path: Path) -> None:
    write_archive(solution, tmp_path / "again.npz")
    assert (tmp_path / "again.npz").read_bytes() == archive.read_bytes()


# --- refusals


def assert_refused(path: Path, says: str = "") -> str:
    with pytest.raises(InputError, match=says) as caught:
        read_solution(path)
    message = str(caught.value)
    assert message.startswith(str(path))
    assert "\n" not in message
    assert len(message) < 500
    return message


def edited(archive: Path, path: Path, change: Callable[[dict[str, Any]], None]) -> Path:
    with np.load(archive) as arrays:
        parts = {name: arrays[name] for name in arrays.files}
    change(parts)
    np.savez(path, **parts)
    return path


def in_record(archive: Path, path: Path, change: Callable[[dict[str, Any]], None]) -> Path:
    def apply(parts: dict[str, Any]) -> None:
        record = json.loads(parts["record"].tobytes())
        change(record)
        parts["record"] = np.frombuffer(json.dumps(record).encode(), dtype=np.uint8)

    return edited(archive, path, apply)


def test_no_archive_at_all(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"solution\.npz: no such file"):
        read_solution(tmp_path)
    assert_refused(tmp_path / "absent.npz", "no such file")


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04", b"\x93NUMPY\x01\x00"])
def test_foreign_files(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "x.npz").write_bytes(content)
    assert_refused(tmp_path / "x.npz", "is not an archive of mgsgraph|no NumPy array|packed ones")


def test_foreign_archives(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", places=np.zeros(3))
    assert_refused(tmp_path / "a.npz", "is not an archive of mgsgraph|no NumPy array|packed ones")
    np.save(tmp_path / "b.npy", np.zeros(3))
    assert_refused(tmp_path / "b.npy", "is not an archive of mgsgraph|no NumPy array|packed ones")
    with zipfile.ZipFile(tmp_path / "c.npz", "w") as empty:
        empty.writestr("format", "1")
    assert_refused(tmp_path / "c.npz", "format: no NumPy array")


class _Poison:
    """Makes a file as soon as it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Any, ...]:
        return Path.touch, (self.path,)


def test_no_code_of_an_archive_is_run(archive: Path, tmp_path: Path) -> None:
    def poison(parts: dict[str, Any]) -> None:
        parts["places"] = np.array([_Poison(tmp_path / "ran")], dtype=object)

    path = edited(archive, tmp_path / "x.npz", poison)
    assert_refused(path, "places: no NumPy array of numbers")
    assert not (tmp_path / "ran").exists()
    with np.load(path, allow_pickle=True) as arrays:  # it would have run
        assert arrays["places"].shape == (1,)
    assert (tmp_path / "ran").exists()


@pytest.mark.parametrize("name", ["sigmas_without_laser", "median_sigmas_without_laser"])
def test_sigmas_that_are_no_numbers(archive: Path, tmp_path: Path, name: str) -> None:
    def other(parts: dict[str, Any]) -> None:
        parts[name] = np.full(3, np.nan)

    assert_refused(edited(archive, tmp_path / "x.npz", other), name)


def test_checksums_are_looked_at_first(archive: Path, tmp_path: Path) -> None:
    content = bytearray(archive.read_bytes())
    content[content.index(b"{'descr': '<f8'")] ^= 1  # NumPy would trip over the header
    (tmp_path / "x.npz").write_bytes(content)
    assert_refused(tmp_path / "x.npz", "Bad CRC-32")


@pytest.mark.parametrize(
    ("version", "remedy"),
    [
        (1, "adjust the case again"), (FORMAT + 1, "or a newer one"),
    ],
)
def test_other_formats_are_refused(archive: Path, tmp_path: Path, version: int, remedy: str) -> None:
    def other(parts: dict[str, Any]) -> None:
        parts.update(format=np.array(version), record=np.zeros(0, dtype=np.uint8))

    message = assert_refused(edited(archive, tmp_path / "x.npz", other), f"format: {version}; expected {FORMAT}")
    assert "version of mgsgraph that wrote it" in message
    assert remedy in message


@pytest.mark.parametrize(
    ("name", "value", "says"),
    [
        ("places", None, "places"),
        ("places", np.zeros((3, 3)), r"places: shape \(3, 3\); expected \(28, 3\)"),
        ("places", np.zeros((28, 3), dtype=np.int64), "places: an array of int64; expected of float64"),
        ("rays_used", np.zeros(56), "rays_used: an array of float64"),
        ("joint_covariance.square_root.first", np.array([18, 0]), "square root"),
        ("joint_covariance.blocks", np.zeros(35), r"joint covariance: shape \(35,\); expected \(1296,\)"),
        ("joint_covariance.square_root.rows", np.zeros(35), "square root: cliques, variables and rows that contradict"),
        ("joint_covariance.square_root.members", np.array([0, 0]), "square root"),
        ("joint_covariance.square_root.width", np.array([12, 24]), "square root"),
        ("coefficients.0", np.zeros((2, 6)), "coefficients: shapes"),
        ("network.points.ids.data", np.full(140, ord("a"), dtype=np.uint8), "names: places"),
        ("network.points.ids.offsets", np.arange(28), "names: places"),
        ("network.rays.point", np.full(56, 28), r"rays, points: index 28 .. 28; expected 0 .. 27"),
        ("network.images.0.trajectory.camera.quaternions", np.zeros((5, 4)), "attitude table"),
    ],
)
def test_arrays_that_do_not_fit(archive: Path, tmp_path: Path, name: str, value: Any, says: str) -> None:
    def change(parts: dict[str, Any]) -> None:
        assert name in parts
        if value is None:
            del parts[name]
        else:
            parts[name] = value

    assert_refused(edited(archive, tmp_path / "x.npz", change), says)


def test_joint_covariance_of_another_network(case: Case, solution: Solution, tmp_path: Path) -> None:
    held = adjust_network(replace(case.network, held=np.array([True, False])), case.settings)
    write_archive(replace(solution, joint_covariance=held.joint_covariance), tmp_path / "x.npz")
    assert_refused(tmp_path / "x.npz", r"joint_covariance.square_root.first: \[-1, 0\]; expected \[0, 18\]")


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda record: record.update(converged="yes"), "converged: 'yes'; expected a value of type bool"),
        (lambda record: record.update(history=3), "is not an archive of mgsgraph, or a damaged one"),
        (lambda record: record.pop("message"), "message"),
        (lambda record: record["network"].update(tides=None), "network.tides: a field that this version doesn't know"),
        (lambda record: record["settings"].update(loss="square"), "solver, loss: 'square'"),
        (lambda record: record["fit"].update(squares=None), "fit.squares: None; expected a value of type float"),
        (lambda record: record["network"]["images"][0]["interior"]["distortion"].update(kind="Fisheye"), "Fisheye"),
        (lambda record: record["network"]["images"].pop(), "does not name"),
    ],
)
def test_records_that_do_not_fit(
    archive: Path, tmp_path: Path, change: Callable[[dict[str, Any]], None], says: str
) -> None:
    assert_refused(in_record(archive, tmp_path / "x.npz", change), says)


def test_members_that_the_record_does_not_name(archive: Path, tmp_path: Path) -> None:
    path = edited(archive, tmp_path / "x.npz", lambda parts: parts.update(places_2=np.zeros(3)))
    assert_refused(path, "places_2: an array that the archive's record does not name")


def test_members_that_are_larger_than_the_file(archive: Path, tmp_path: Path) -> None:
    """What is packed is not unpacked, and what two members share is not read twice."""
    (tmp_path / "x.npz").write_bytes(archive.read_bytes())
    with zipfile.ZipFile(tmp_path / "x.npz", "a", zipfile.ZIP_DEFLATED) as more:
        more.writestr("unknown.npy", bytes(30_000_000))
    assert (tmp_path / "x.npz").stat().st_size < 1_000_000
    tracemalloc.start()
    assert_refused(tmp_path / "x.npz", "in a file of")
    assert tracemalloc.get_traced_memory()[1] < 10_000_000
    tracemalloc.stop()


@pytest.mark.parametrize("header", [
    "{'descr': '<f8', 'fortran_order': False, 'shape': (4000000000, 1000), }",
    "{'descr': '<f8', 'fortran_order': False, 'shape': (-3, -1), }", "{'descr': '|O8', 'fortran_order': False, ",
    "{'descr': [('a', '<f8')], 'fortran_order': False, 'shape': (3,), }", "{'descr': '<f8', 'shape': (3L,), }",
])  # fmt: skip
def test_headers_of_arrays_that_cannot_be(archive: Path, tmp_path: Path, header: str) -> None:
    """Nothing is evaluated or set aside for them."""
    file = io.BytesIO()
    np.save(file, np.zeros(3))
    with zipfile.ZipFile(archive) as good, zipfile.ZipFile(tmp_path / "x.npz", "w") as bad:
        for name in good.namelist():
            content = good.read(name)
            other = content[:10] + header.ljust(117).encode() + b"\n" + content[128:]
            bad.writestr(name, other if name == "places.npy" else content)
    assert_refused(tmp_path / "x.npz", "places: ")


def test_record_that_is_no_json(archive: Path, tmp_path: Path) -> None:
    def spoil(parts: dict[str, Any]) -> None:
        parts["record"] = np.frombuffer(b"{" * 10, dtype=np.uint8)

    assert_refused(edited(archive, tmp_path / "x.npz", spoil), "malformed or truncated JSON")


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
@given(st.floats(0.0, 0.999))
def test_truncated_archives(archive: Path, tmp_path: Path, share: float) -> None:
    content = archive.read_bytes()
    (tmp_path / "x.npz").write_bytes(content[: int(share * len(content))])
    assert_refused(tmp_path / "x.npz", "is not an archive of mgsgraph, or a damaged one")


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
@given(st.floats(0.0, 0.999999), st.integers(1, 255), st.booleans())
def test_damaged_archives(
    solution: Solution, archive: Path, tmp_path: Path, share: float, flip: int, near_end: bool
) -> None:
    """One byte changed anywhere: refused in one line, or without effect (zip has bytes that say nothing)."""
    content = bytearray(archive.read_bytes())
    span = min(len(content), 12_000) if near_end else len(content)  # the directory, where zip has most to trip over
    content[len(content) - span + int(share * span)] ^= flip
    (tmp_path / "x.npz").write_bytes(content)
    try:
        back = read_solution(tmp_path / "x.npz")
    except InputError as error:
        assert "\n" not in str(error)  # noqa: PT017
    else:
        assert differences(solution, back) == []


def test_parts_of_a_record_are_those_of_the_whole_and_read_alone() -> None:
    """An array of another part may be damaged; one of theirs may not."""
    table = PositionTable(np.arange(3.0), np.eye(3), np.eye(3))
    data = pack(FixedTrajectory(7.25, table, AttitudeTable(np.arange(2.0), np.eye(4)[[0, 0]], np.eye(3))))
    parts = {"epoch": float, "position": PositionTable}
    epoch, position = unpack_parts(data, parts, "here")
    assert epoch == 7.25
    assert pack(position) == pack(table)

    def flipped(name: str) -> bytes:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            at = archive.getinfo(f"{name}.npy")
        last = at.header_offset + 30 + int.from_bytes(data[at.header_offset + 26 :][:2], "little")
        last += int.from_bytes(data[at.header_offset + 28 :][:2], "little") + at.file_size - 1
        return data[:last] + bytes([data[last] ^ 1]) + data[last + 1 :]

    assert pack(unpack_parts(flipped("camera.quaternions"), parts, "here")[1]) == pack(table)
    with pytest.raises(InputError, match=r"here.*Bad CRC-32"):
        unpack_parts(flipped("position.positions"), parts, "here")
    with pytest.raises(InputError, match=r"here.*speed"):
        unpack_parts(data, {"position.speed": float}, "here")

"""The archive gives the same solution back bit for bit, is as its page says, and says in one line what is wrong with
any other file.
"""

import io
import itertools
import json
import math
import re
import sys
import tracemalloc
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from networks import network, pair, with_shift_and_surface
from outside import refuses
from pass_files import block
from projects import leaves
from sharing import with_all_kinds

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.case.reading import Case
from mgsgraph.errors import InputError
from mgsgraph.geometry.camera import CahvorDistortion, KaguyaDistortion, LrocNacDistortion, RadialDistortion
from mgsgraph.geometry.image import fit_polynomials
from mgsgraph.geometry.orientation import OrientationPrior, evenly_spaced
from mgsgraph.geometry.records import Array
from mgsgraph.geometry.terrain import Gaps
from mgsgraph.geometry.trajectory import AttitudeTable, FixedTrajectory, PositionTable
from mgsgraph.network import Network, Pass, PolynomialPrior
from mgsgraph.network.joining import seconds
from mgsgraph.results.archive import FORMAT, pack, read_solution, unpack_parts, write_archive

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "files.md"


@pytest.fixture(scope="module")
def archive(pair_solution: Solution, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("results") / "solution.npz"
    write_archive(pair_solution, path)
    return path


def differences(one: Solution, other: Solution) -> list[str]:
    want, got = dict(leaves("solution", one)), dict(leaves("solution", other))
    return [name for name in want | got if want.get(name, "nothing") != got.get(name, "nothing")]


def there_and_back(solution: Solution, folder: Path) -> Solution:
    write_archive(solution, folder / "solution.npz")
    return read_solution(folder)


def polynomial_pass() -> Network:
    """The pair: its first image a pass with polynomials on its four nodes, the other one by itself."""
    net = network(pair())
    start, stop = seconds(net.images[0])
    epoch = net.images[0].trajectory.epoch
    nodes = evenly_spaced("lagrange", epoch, (start - epoch, stop - epoch), (stop - start) / 2.0)
    trend = np.array([1.0, 0.3, 0.1, 0.05])[:, None] * net.priors[0].sigmas[0]
    pass_ = Pass('one, "A"', np.array([0]), nodes, PolynomialPrior(trend[:, :3], trend[:, 3:]))
    return replace(net, passes=(pass_,))


def all_shared() -> Network:
    """Unknowns of all kinds that images share, and what a terrain model's counts of shots say of its posts."""
    net = with_all_kinds(with_shift_and_surface(network(pair())))
    assert net.surface is not None
    grid = net.surface.grid
    gaps = Gaps(np.arange(float(grid.radii.size)).reshape(grid.radii.shape), np.full(grid.radii.shape, 900.0))
    return replace(net, surface=replace(net.surface, grid=replace(grid, gaps=gaps)))


def kinds(case: Case) -> dict[str, tuple[Network, SolverSettings]]:
    """Held, robust, with blunder passes, without some priors, with lost points and odd names, of passes."""
    net, chosen, prior = case.network, case.settings, case.network.priors[0].sigmas.copy()
    prior[0, 2] = np.inf
    kept = np.concatenate([np.flatnonzero(net.rays.point != 1), np.flatnonzero(net.rays.point == 1)[:1]])
    odd = replace(net.points, ids=("né, \"1\"", "trailing ", "", *net.points.ids[3:]))
    free = replace(net, rays=net.rays.chosen(kept), points=odd, priors=(OrientationPrior(prior), net.priors[1]))
    robust = replace(chosen, loss="cauchy", loss_width=2, reject=4.0, angles="opk-paper", line="measured")
    return {
        "held and robust": (replace(net, held=np.array([True, False])), robust),
        "all held": (replace(net, held=np.array([True, True])), chosen), "free and lossy": (free, chosen),
        "impatient": (net, replace(chosen, max_iterations=1)),
        "all kinds shared": (all_shared(), chosen),
        "polynomials": (replace(net, images=(fit_polynomials(net.images[0], 3), net.images[1])), chosen),
        "a polynomial pass": (polynomial_pass(), chosen), "passes": (block().network, SolverSettings()),
        "without laser": (network(pair(), laser=False), replace(chosen, reject=4.0)),
    }


@pytest.mark.parametrize("name", [
    "held and robust", "all held", "free and lossy", "impatient", "all kinds shared", "polynomials",
    "a polynomial pass", "passes", "without laser",
])  # fmt: skip
def test_every_kind_of_solution_comes_back_and_is_as_the_page_says(
    name: str, pair_case: Case, tmp_path: Path
) -> None:
    solved = adjust_network(*kinds(pair_case)[name], name)
    assert differences(solved, there_and_back(solved, tmp_path)) == []
    rows = page_rows()
    with np.load(tmp_path / "solution.npz", allow_pickle=False) as arrays:
        assert len(arrays.files) > 40
        for path in arrays.files:
            mine = [row for row in rows if re.fullmatch(re.escape(row.path).replace(r"\*", r"[^.]+"), path)]
            assert any(fits(row, arrays[path]) for row in mine), (path, arrays[path].dtype, mine)
        np.testing.assert_array_equal(arrays["places"], solved.places)
        ends, text = arrays["network.points.ids.offsets"].tolist(), arrays["network.points.ids.data"].tobytes()
        assert [text[a:b].decode() for a, b in itertools.pairwise(ends)] == list(solved.network.points.ids)


def test_odd_values_come_back(pair_solution: Solution, archive: Path, tmp_path: Path) -> None:
    """Numbers that are none; and an older archive, which lacks a field that has a default."""
    steps = pair_solution.history
    history = tuple(replace(step, cost=math.inf, decrease=-math.inf, predicted=math.nan) for step in steps)
    odd = replace(pair_solution, history=history, sigmas_without_laser=None, cost_initial=math.nan, seconds={})
    assert differences(odd, there_and_back(odd, tmp_path)) == []
    path = in_record(archive, tmp_path / "x.npz", lambda record: record["settings"].pop("step_tolerance"))
    for one in (path, archive, archive.parent, str(archive)):
        assert differences(pair_solution, read_solution(one)) == []


def test_every_distortion_comes_back(pair_solution: Solution, tmp_path: Path) -> None:
    network = pair_solution.network
    optics = (
        LrocNacDistortion(1.81e-5), CahvorDistortion(RadialDistortion(1e-4, -2.0, 0.1), 1e-3, -2e-3),
        KaguyaDistortion((1e-6, 2e-4, 0.3, 4.0), (-1e-6, 0.0, 1.0, 2.0)),
    )  # fmt: skip
    for distortion in optics:
        images = tuple(
            replace(image, interior=replace(image.interior, distortion=distortion)) for image in network.images
        )
        bent = replace(pair_solution, network=replace(network, images=images))
        assert differences(bent, there_and_back(bent, tmp_path)) == []


def test_arrays_are_read_only(archive: Path) -> None:
    back = read_solution(archive)
    with pytest.raises(ValueError, match="read-only"):
        back.places[0, 0] = 0.0


# --- the page about it


class Row(NamedTuple):
    path: str
    types: tuple[str, ...]
    shape: tuple[str, ...]
    unit: str


def page_rows() -> list[Row]:
    found, group = list[Row](), ""
    for line in PAGE.read_text(encoding="utf-8").splitlines():
        if line.startswith("## "):
            group = f"{line.split('`')[1]}." if "`" in line else ""
        if said := re.fullmatch(r"\| `([^`]+)` \| ([^|(]+) \(([^|]*)\) \| ([^|]+) \| (.+) \|", line):
            shape = tuple(one.strip() for one in said[3].split(",") if one.strip())
            found.append(Row(group + said[1], tuple(said[2].split(" or ")), shape, said[4]))
    return found


def fits(row: Row, array: np.ndarray[Any, Any]) -> bool:
    """Whether an array is of a row's type and shape, but for sizes that are letters."""
    kind = "str" if array.dtype.kind == "U" else array.dtype.name
    sizes = zip(row.shape, array.shape, strict=False)
    return kind in row.types and len(row.shape) == array.ndim and all(
        said == str(size) for said, size in sizes if said.isdigit()
    )


def test_the_page_is_the_one_that_the_records_make() -> None:
    sys.path.append(str(ROOT / "scripts"))
    from pages import array_tables

    text = PAGE.read_text(encoding="utf-8")
    assert text.endswith("\n".join(array_tables()) + "\n"), "write it anew: python scripts/pages.py"
    assert f"This page is of {FORMAT};" in text
    units = {row.path: row.unit for row in page_rows()}
    assert (units["places"], units["residuals"], units["covariances"]) == ("m", "pixels", "m^2")
    assert (units["network.ranges.times"], units["coefficients.*"]) == ("s", "m and rad")


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


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04", b"\x93NUMPY\x01\x00"])
def test_foreign_and_truncated_files(archive: Path, tmp_path: Path, content: bytes) -> None:
    (tmp_path / "x.npz").write_bytes(content)
    (tmp_path / "half.npz").write_bytes(archive.read_bytes()[:-99])
    np.savez(tmp_path / "a.npz", places=np.zeros(3))
    for name in ("x.npz", "half.npz", "a.npz"):
        assert_refused(tmp_path / name, "is not an archive of mgsgraph|no NumPy array|packed ones")
    assert_refused(tmp_path / "absent.npz", "no such file")


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


def test_joint_covariance_of_another_network(pair_case: Case, pair_solution: Solution, tmp_path: Path) -> None:
    held = adjust_network(replace(pair_case.network, held=np.array([True, False])), pair_case.settings)
    write_archive(replace(pair_solution, joint_covariance=held.joint_covariance), tmp_path / "x.npz")
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


@pytest.mark.parametrize(
    ("name", "value", "says"),
    [
        ("places", None, "places"),
        ("places", np.zeros((3, 3)), r"places: shape \(3, 3\); expected \(28, 3\)"),
        ("places", np.zeros((28, 3), dtype=np.int64), "places: an array of int64; expected of float64"),
        ("places_2", np.zeros(3), "places_2: an array that the archive's record does not name"),
        ("record", np.frombuffer(b"{" * 10, dtype=np.uint8), "malformed or truncated JSON"),
        ("sigmas_without_laser", np.full(3, np.nan), "sigmas_without_laser"),
        ("joint_covariance.square_root.first", np.array([18, 0]), "square root"),
        ("joint_covariance.blocks", np.zeros(35), r"joint covariance: shape \(35,\); expected \(1296,\)"),
        ("joint_covariance.square_root.members", np.array([0, 0]), "square root"),
        ("coefficients.0", np.zeros((2, 6)), "coefficients: shapes"),
        ("network.points.ids.offsets", np.arange(28), "names: places"),
        ("network.rays.point", np.full(56, 28), r"rays, points: index 28 .. 28; expected 0 .. 27"),
        ("network.images.0.trajectory.camera.quaternions", np.zeros((5, 4)), "attitude table"),
    ],
)
def test_arrays_that_do_not_fit(archive: Path, tmp_path: Path, name: str, value: Any, says: str) -> None:
    change = (lambda parts: parts.pop(name)) if value is None else (lambda parts: parts.update({name: value}))
    assert_refused(edited(archive, tmp_path / "x.npz", change), says)


@pytest.mark.parametrize(
    ("name", "value", "says"),
    [
        ("nodes.0", np.zeros((3, 6)), r"nodes: shapes \[\(3, 6\)"),
        ("trends.1", np.full(12, np.nan), "trends: not a number"),
        ("network.passes.0.nodes.times", np.arange(3.0), "3 nodes; expected at least 4"),
        ("network.passes.1.images", np.array([0, 1]), "image 0; expected an image of the network, of one"),
    ],
)
def test_arrays_of_passes_that_do_not_fit(tmp_path: Path, name: str, value: Array, says: str) -> None:
    write_archive(adjust_network(block().network, SolverSettings()), tmp_path / "solution.npz")
    change = lambda parts: parts.update({name: value})  # noqa: E731
    assert_refused(edited(tmp_path / "solution.npz", tmp_path / "x.npz", change), says)


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


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
@given(st.floats(0.0, 0.999999), st.integers(1, 255), st.booleans())
def test_damaged_archives(
    pair_solution: Solution, archive: Path, tmp_path: Path, share: float, flip: int, near_end: bool
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
        assert differences(pair_solution, back) == []


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
    refuses(r"here.*Bad CRC-32", unpack_parts, flipped("position.positions"), parts, "here")
    refuses(r"here.*speed", unpack_parts, data, {"position.speed": float}, "here")

"""The page about solution.npz says what real archives hold: names, types, shapes."""

import json
import re
import sys
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from gis_files import odd_solution
from networks import network, pair

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.case.reading import adjust, read_case
from mgsgraph.results.archive import FORMAT, read_solution, write_archive
from mgsgraph.simulation.files import write_pair
from mgsgraph.simulation.pair import PairSettings, simulate_pair

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "solution_npz.md"
if not PAGE.is_file():
    pytest.skip("the pages are not beside the tests", allow_module_level=True)
PASSES = '\n[[shared]]\nkind = "range bias"\nsigma_m = 5.0\n\n[[passes]]\nname = "A"\nimages = ["SIM/A"]\n\n' \
    "[solver]\nreject = 4.0\n"  # fmt: skip


class Row(NamedTuple):
    path: str
    types: tuple[str, ...]
    shape: tuple[str, ...]
    unit: str
    meaning: str


def page_rows() -> list[Row]:
    found, group = list[Row](), ""
    for line in PAGE.read_text(encoding="utf-8").splitlines():
        if line.startswith("## "):
            group = f"{line.split('`')[1]}." if "`" in line else ""
        if said := re.fullmatch(r"\| `([^`]+)` \| ([^|(]+) \(([^|]*)\) \| ([^|]+) \| (.+) \|", line):
            shape = tuple(one.strip() for one in said[3].split(",") if one.strip())
            found.append(Row(group + said[1], tuple(said[2].split(" or ")), shape, said[4], said[5]))
    return found


def solutions() -> dict[str, Callable[[Path], Solution]]:
    def with_passes(folder: Path) -> Solution:
        case = write_pair(simulate_pair(PairSettings(ties=20, shots=8), seed=1), folder)
        case.write_text(case.read_text(encoding="utf-8") + PASSES, encoding="utf-8")
        return adjust(read_case(case))

    return {
        "odd": lambda folder: odd_solution(),
        "without laser": lambda folder: adjust_network(network(pair(), laser=False), SolverSettings()),
        "passes": with_passes,
    }


def fits(row: Row, array: np.ndarray[Any, Any], sizes: dict[str, int]) -> bool:
    """Whether an array is as a row says; sizes of letters are those of the solution."""
    kind = "str" if array.dtype.kind == "U" else array.dtype.name
    if kind not in row.types or len(row.shape) != array.ndim:
        return False
    for said, size in zip(row.shape, array.shape, strict=True):
        if said.isdigit() and int(said) != size:
            return False
        if set(re.findall(r"[a-z]+", said)) <= set(sizes) and eval(said, {}, sizes) != size:  # of our own page
            return False
    return True


@pytest.mark.parametrize("name", solutions())
def test_every_array_is_on_the_page(name: str, tmp_path: Path) -> None:
    solution = solutions()[name](tmp_path)
    write_archive(solution, tmp_path / "solution.npz")
    top = {
        "n": len(solution.network.points), "k": solution.network.rays.point.size,
        "r": solution.network.ranges.point.size, "p": len(solution.network.shift_names), "v": len(solution.values),
    }  # fmt: skip
    rows = page_rows()
    with np.load(tmp_path / "solution.npz", allow_pickle=False) as archive:
        assert len(archive.files) > 40
        for path in archive.files:
            mine = [row for row in rows if re.fullmatch(re.escape(row.path).replace(r"\*", r"[^.]+"), path)]
            own = re.match(r"network\.(images|passes|stereo\.surfaces|shared|areoid|surface\.grid)|nodes|trends", path)
            sizes = {} if own else top
            assert any(fits(row, archive[path], sizes) for row in mine), (path, archive[path].dtype, mine)
        record = json.loads(archive["record"].tobytes())
        assert int(archive["format"]) == FORMAT
        assert record["places"] == {"array": "places"}
        np.testing.assert_array_equal(archive["places"], solution.places)
        ids, begins = archive["network.points.ids.data"].tobytes(), archive["network.points.ids.offsets"]
        assert [ids[a:b].decode() for a, b in pairwise(begins)] == list(
            solution.network.points.ids
        )
    np.testing.assert_array_equal(read_solution(tmp_path / "solution.npz").places, solution.places)


def test_a_wrong_row_is_found(tmp_path: Path) -> None:
    solution = odd_solution()
    row = next(row for row in page_rows() if row.path == "residuals")
    sizes = {"n": len(solution.network.points), "k": solution.network.rays.point.size}
    assert fits(row, solution.residuals, sizes)
    assert not fits(row, solution.residuals[:-1], sizes)
    assert not fits(row, solution.residuals.astype(np.float32), sizes)
    assert not fits(row, solution.residuals[:, :1], sizes)


def test_the_page_is_the_one_that_the_records_make() -> None:
    sys.path.append(str(ROOT / "scripts"))
    from pages import array_rows, array_tables

    text = PAGE.read_text(encoding="utf-8")
    assert text.endswith("\n".join(array_tables()) + "\n"), "write it anew: python scripts/pages.py"
    assert f"This page is of {FORMAT};" in text
    assert all(row.meaning and row.shape for row in array_rows())
    units = {row.path: row.unit for row in page_rows()}
    assert (units["places"], units["residuals"], units["covariances"]) == ("m", "pixels", "m^2")
    assert (units["network.ranges.times"], units["coefficients.*"]) == ("s", "m and rad")

"""What the program computes is what `golden_results` have; what changes on purpose goes there by scripts/golden.py."""

from collections.abc import Iterator
from copy import deepcopy
from pathlib import Path

import golden
import numpy as np
import pytest
from golden import GOLDEN, LOOSER, RESULTS, ROOT, TOLERANCES, Result, computed, differences, stored, tolerances
from outside import require


# above two seconds: whole commands on whole sites, `grown` and `gusev_files` eight of them
@pytest.mark.parametrize("name", GOLDEN)
def test_result_is_the_golden_one(name: str, tmp_path: Path) -> None:
    for folder in GOLDEN[name].data:
        require(ROOT.parent / "shared" / "data" / folder, "real data")
    beyond = _beyond(stored(name), computed(name, tmp_path), tolerances())
    assert not beyond, f"differences in tolerances; where they are wanted: python scripts/golden.py {name} --write"


def test_each_golden_result_has_a_case() -> None:
    assert {path.stem for path in RESULTS.iterdir()} == {*GOLDEN, "versions"}
    assert all(bool(one.reason) == bool(one.without) for one in GOLDEN.values())


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> Result:
    return computed("strip_12", tmp_path_factory.mktemp("strip"))


def test_two_tolerances_are_seen_and_named(found: Result) -> None:
    """Half of one is not: one quantity of each kind."""
    kinds, point = set(), next(name for name in found if name.startswith("covariance of T"))
    for name in ("cost", "STRIP/004N", point, "rms of ranges"):
        for changed in _moved(found, name, 0.5):
            assert not _beyond(found, changed, TOLERANCES)
        for changed in _moved(found, name, 2.0):
            assert list(_beyond(found, changed, TOLERANCES)) == [name]
        kinds.add(found[name][0])
    assert kinds | {"count"} == set(TOLERANCES)
    assert list(_beyond(found, found | {"rays": ["count", found["rays"][1] - 1]}, TOLERANCES)) == ["rays"]


def _moved(result: Result, name: str, off: float) -> Iterator[Result]:
    """Each number of a quantity moved in turn."""
    kind, numbers, *scale = result[name]
    for k in range(np.size(numbers)):
        changed = deepcopy(result)
        if kind == "cost":
            changed[name][1] = numbers * (1.0 + 1e-9 * off)
        elif kind == "covariance":
            row, column = ((0, 0), (1, 0), (1, 1), (2, 0), (2, 1), (2, 2))[k]
            changed[name][1][k] += 1e-6 * off * np.sqrt(numbers[(0, 2, 5)[row]] * numbers[(0, 2, 5)[column]])
        else:
            changed[name][1][k] += 1e-6 * off * scale[0][k]
        yield changed


def test_what_is_lost_or_new_or_no_number_is_named(found: Result) -> None:
    lost, blank = deepcopy(found), found | {"cost": ["cost", float("nan")]}
    del lost["rms of ranges"]
    for one, other in ((found, lost), (lost, found)):
        assert _beyond(one, other, TOLERANCES) == {"rms of ranges": np.inf}
    assert _beyond(found, blank, TOLERANCES) == {"cost": np.inf}
    assert not _beyond(blank, blank, TOLERANCES)


def test_other_versions_have_looser_tolerances(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(golden, "versions", lambda: {"numpy": "1.0"})
    assert tolerances() == {one: off if one == "count" else LOOSER * off for one, off in TOLERANCES.items()}


def _beyond(one: Result, other: Result, allowed: dict[str, float]) -> dict[str, float]:
    return {name: off for name, off in differences(one, other, allowed).items() if off > 1.0}

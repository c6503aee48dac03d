"""The planted faults fit the sources: what one replaces is there, once, and the tests that are to find it exist.

`scripts/faults.py` puts them into a copy, one by one, and runs these tests.
"""

import ast
import sys
from collections import Counter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
SCRIPTS = ROOT / "scripts"
if not SCRIPTS.is_dir():
    pytest.skip("the scripts are not beside the tests", allow_module_level=True)
sys.path.append(str(SCRIPTS))

from faults import Fault, read_faults  # noqa: E402

FAULTS = read_faults()
MOST_SLOW = 2
"""Faults that only slow tests find."""

of_each = pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.name)


@of_each
def test_a_fault_fits_its_file(fault: Fault) -> None:
    """Its old text occurs once, and the new one leaves another program that Python can read."""
    text = (ROOT / fault.file).read_text(encoding="utf-8")
    assert text.count(fault.old) == 1
    assert ast.dump(ast.parse(text.replace(fault.old, fault.new))) != ast.dump(ast.parse(text))
    assert not any(line.lstrip().startswith(("import ", "from ")) for line in fault.old.splitlines())


@of_each
def test_its_tests_exist(fault: Fault) -> None:
    """One to three functions of modules."""
    assert 1 <= len(fault.tests) <= 3
    for node in fault.tests:
        file, _, name = node.partition("::")
        body = ast.parse((ROOT / file).read_text(encoding="utf-8")).body
        assert name in {one.name for one in body if isinstance(one, ast.FunctionDef)}


def test_the_faults_are_in_all_rooms() -> None:
    """A room is a folder of the package that holds sources; `factors` lies beside it."""
    assert len(FAULTS) == 43
    assert max(Counter(fault.name for fault in FAULTS).values()) == 1
    assert sum(fault.slow for fault in FAULTS) <= MOST_SLOW
    rooms = {path.parent.name for path in (ROOT / "mgsgraph").glob("*/[a-z]*.py")}
    assert rooms <= {Path(fault.file.removeprefix("mgsgraph/")).parts[0] for fault in FAULTS}

"""The planted faults are such: each text that one replaces is there, once, and the tests that are to find it exist.

`scripts/faults.py` puts them into a copy, one by one, and runs these tests.
"""

import ast
import sys
from collections import Counter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "scripts"))

from faults import Fault, read_faults  # noqa: E402

FAULTS = read_faults()
MOST_SLOW = 2
"""Faults that the default suite need not find."""


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.name)
def test_a_fault_fits_its_file(fault: Fault) -> None:
    """Its old text occurs once; the new one is another, and leaves a file that Python reads as another program."""
    text = (ROOT / fault.file).read_text(encoding="utf-8")
    assert text.count(fault.old) == 1
    changed = text.replace(fault.old, fault.new)
    assert ast.dump(ast.parse(changed)) != ast.dump(ast.parse(text))
    assert not any(line.lstrip().startswith(("import ", "from ")) for line in fault.old.splitlines())


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.name)
def test_its_tests_exist(fault: Fault) -> None:
    assert 1 <= len(fault.tests) <= 3
    for node in fault.tests:
        file, _, name = node.partition("::")
        tree = ast.parse((ROOT / file).read_text(encoding="utf-8"))
        assert name in {one.name for one in tree.body if isinstance(one, ast.FunctionDef)}


def test_there_are_forty_in_all_rooms() -> None:
    """Names differ; every folder of the package that holds sources has a fault."""
    assert len(FAULTS) == 40
    assert max(Counter(fault.name for fault in FAULTS).values()) == 1
    assert sum(fault.slow for fault in FAULTS) <= MOST_SLOW
    rooms = {path.parent.name for path in (ROOT / "mgsgraph").glob("*/[a-z]*.py")}
    assert rooms <= {Path(fault.file).parts[-2] if fault.file.startswith("factors/") else Path(fault.file).parts[1] for fault in FAULTS}

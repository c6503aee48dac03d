"""The size of each room: lines of code, syntax nodes and files stay below their ceilings.

A line of code holds a token that is no comment, docstring or import. Nodes of the syntax tree do not depend on how
lines are broken. Every tracked Python file counts. A change that makes a room smaller lowers its ceiling; a ceiling
rises only for a capability that an issue names, with its reason in CHANGELOG.md (Sizes).
"""

import ast
import subprocess
from collections import Counter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
CEILINGS = {
    "cli": (1420, 15129, 11),
    "studio": (2453, 39267, 19),
    "fetch": (1380, 17274, 9),
    "project": (2663, 38636, 18),
    "export": (2967, 44321, 19),
    "simulation": (2814, 42460, 22),
    "results": (4277, 64924, 35),
    "registration": (1685, 25890, 12),
    "planning": (874, 13648, 6),
    "case": (2360, 36132, 12),
    "analysis": (5045, 81315, 29),
    "adjustment": (7460, 113744, 43),
    "matching": (2107, 34915, 13),
    "network": (3233, 52645, 16),
    "files": (8739, 124335, 55),
    "kernel": (2747, 47274, 15),
    "geometry": (2907, 48952, 18),
    "factors": (853, 13874, 18),
    "single files": (939, 11433, 10),
    "scripts": (7001, 112187, 51),
    "tests": (39695, 602357, 222),
    "docs": (157, 1791, 4),
}  # fmt: skip
"""Room: lines of code, nodes, files."""


def size(text: str) -> Counter[str]:
    """Lines of code, nodes, and one file."""
    tree, passed, texts, nodes = ast.parse(text), set[int](), set[int](), 0
    for node in ast.walk(tree):
        nodes += 1
        if isinstance(node, ast.Constant | ast.JoinedStr) and node.end_lineno != node.lineno:  # with blank lines, too
            texts |= set(range(node.lineno, (node.end_lineno or node.lineno) + 1))
        inner: list[ast.stmt] = [node] if isinstance(node, ast.Import | ast.ImportFrom) else []
        body = getattr(node, "body", None)
        for part in body if isinstance(body, list) else []:
            match part:
                case ast.Expr(value=ast.Constant(value=str())):
                    inner.append(part)
        for part in inner:
            passed |= set(range(part.lineno, (part.end_lineno or part.lineno) + 1))
    written = {k for k, line in enumerate(text.splitlines(), 1) if line.strip() and not line.lstrip().startswith("#")}
    return Counter(code=len((written | texts) - passed), nodes=nodes, files=1)


def room_of(path: str) -> str:
    """The room that a tracked file counts for."""
    first, *rest = Path(path).parts
    if first != "mgsgraph":
        return first
    return "single files" if len(rest) == 1 else rest[0]


def sizes() -> dict[str, Counter[str]]:
    """Size of each room."""
    listed = subprocess.run(["git", "ls-files", "*.py"], capture_output=True, text=True, cwd=ROOT, check=True).stdout
    found: dict[str, Counter[str]] = {}
    for path in listed.splitlines():
        if (ROOT / path).exists():
            found.setdefault(room_of(path), Counter()).update(size((ROOT / path).read_text(encoding="utf-8")))
    return found


@pytest.fixture(scope="module")
def measured() -> dict[str, Counter[str]]:
    if not (ROOT / ".git").exists():
        pytest.skip("not a git checkout: which files are tracked is unknown")
    return sizes()


def test_every_room_has_a_ceiling(measured: dict[str, Counter[str]]) -> None:
    assert set(measured) == set(CEILINGS)


# above two seconds: every file of the project is parsed, once in each process of the run
@pytest.mark.parametrize("room", CEILINGS)
def test_no_room_is_above_its_ceiling(room: str, measured: dict[str, Counter[str]]) -> None:
    found = measured[room]
    for name, ceiling in zip(("code", "nodes", "files"), CEILINGS[room], strict=True):
        assert found[name] <= ceiling, f"{room}: {found[name]} {name}, ceiling {ceiling}"


def test_ceilings_are_what_was_reached(measured: dict[str, Counter[str]]) -> None:
    """A ceiling much higher than its room would let it grow unseen: at most 2 % and 20 lines, 300 nodes, 0 files."""
    slack = {"code": 20, "nodes": 300, "files": 0}
    for room, ceilings in CEILINGS.items():
        for name, ceiling in zip(slack, ceilings, strict=True):
            assert ceiling <= 1.02 * measured[room][name] + slack[name], f"{room}: lower the ceiling of {name}"


def test_what_counts_as_code() -> None:
    text = '"""Doc."""\n\nimport os\n\n\ndef f():\n    """Doc."""\n    # comment\n    return (1,\n            2)\n'
    assert size(text) == {"code": 3, "nodes": len(list(ast.walk(ast.parse(text)))), "files": 1}

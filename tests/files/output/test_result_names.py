"""Whatever a result holds, the next run may replace."""

import ast
import errno
import os
import re
from pathlib import Path

import pytest

from mgsgraph.errors import InputError
from mgsgraph.files.output import folders
from mgsgraph.files.output.folders import FIGURES, TABLES, fresh_folder, require_replaceable

HOUSE = Path(folders.__file__).parents[2]
ROOMS = ("files/output", "matching", "registration", "results", "simulation/demo")
"""That write results; `export` says itself what it has made, in export.json."""
FILE = re.compile(r"[a-z_]+\.(json|csv|txt|npz|tif|png|svg)")


def test_every_name_of_a_result_is_known() -> None:
    found = {
        node.value
        for room in ROOMS
        for path in (HOUSE / room).rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and FILE.fullmatch(node.value)
    }
    assert not found - set(TABLES)
    assert len(found) > 20


def test_every_kind_of_figure_is_known() -> None:
    """What is handed to `new_sheet` and `sheet_name` by name."""
    found = {
        node.args[0].value
        for path in (HOUSE / "results" / "figures").rglob("*.py")
        # sheets of the page stand in it, those of the studio's views are handed out one by one
        if not path.stem.startswith("page") and not path.stem.endswith("_views")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Call)
        and isinstance(node.func, ast.Name)
        and node.func.id in {"new_sheet", "sheet_name"}
        and isinstance(node.args[0], ast.Constant)
    }
    assert found <= set(FIGURES)
    assert {"residuals", "map", "quantiles"} <= found


def test_a_file_that_could_not_be_replaced_is_told_of(tmp_path: Path) -> None:
    with pytest.warns(UserWarning, match="'jitter.png' is not a name"):
        write(tmp_path / "out", ["jitter.png"])
    assert (tmp_path / "out" / "jitter.png").exists()

    figures = [f"{kind}{number}.png" for kind in FIGURES for number in ("", "_1", "_12")]
    write(tmp_path / "fine", [*figures, *TABLES])
    require_replaceable(tmp_path / "fine")


def write(out: Path, names: list[str]) -> None:
    with fresh_folder(out) as folder:
        for name in names:
            (folder / name).touch()
        (folder / "solution.json").write_text('{"program": "mgsgraph"}', encoding="utf-8")


def test_a_folder_that_cannot_be_written_is_refused_before_any_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(path: str, mode: int = 0o777) -> None:
        raise PermissionError(errno.EACCES, "Permission denied", path)

    (tmp_path / "empty").mkdir()
    monkeypatch.setattr(os, "mkdir", refuse)
    for out in (tmp_path / "out", tmp_path / "deep" / "out", tmp_path / "empty"):
        with pytest.raises(InputError) as caught:
            require_replaceable(out)
        assert str(caught.value).startswith(f"{out}: can't be written (Permission denied);")

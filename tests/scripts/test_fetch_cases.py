"""Real cases: each file has a source and a checksum, and what comes from a server is these files or nothing."""

import hashlib
import re
import sys
from pathlib import Path

import pytest
from flaky_archive import Flaky

import mgsgraph
from mgsgraph.case.case_file import decode
from mgsgraph.errors import InputError

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"
if not SCRIPTS.is_dir():
    pytest.skip("the scripts are not beside the tests", allow_module_level=True)
sys.path.append(str(SCRIPTS))

import fetch_cases  # noqa: E402

CASES = sorted(fetch_cases.CASES.glob("*.toml"))
NAMES = [path.stem for path in CASES]


def test_each_file_that_a_case_names_has_a_source() -> None:
    listed = {f"{one.folder}/{one.name}" for one in fetch_cases.sources(fetch_cases.CASES / "README.md")}
    text = "".join(path.read_text(encoding="utf-8") for path in CASES)
    named = set(re.findall(rf'"{re.escape(fetch_cases.SHARED)}([^"]+)"', text))
    assert named
    assert named <= listed
    assert {name.partition("/")[0] for name in listed} == {name.partition("/")[0] for name in named}


def test_checksums_are_those_of_the_files(shared_data: Path) -> None:
    for one in fetch_cases.sources(fetch_cases.CASES / "README.md"):
        one.check(shared_data / one.folder / one.name)


@pytest.mark.parametrize("name", NAMES)
def test_a_case_without_its_files_says_how_to_get_them(name: str, tmp_path: Path) -> None:
    path = tmp_path / f"{name}.toml"
    path.write_bytes((fetch_cases.CASES / path.name).read_bytes())
    with pytest.raises(InputError) as error:
        decode(path)
    assert f"scripts/fetch_cases.py {name};" in error.value.remedy
    assert "\n" not in str(error.value)


@pytest.fixture
def served(archive_server: Flaky, case_file: Path, tmp_path: Path) -> Path:
    """A folder of one case whose files are on a server."""
    folder, files = tmp_path / "cases", {}
    text, rows = case_file.read_text(encoding="utf-8"), ""
    for file in case_file.parent.iterdir():
        if f'"{file.name}"' in text:
            files[f"data/{file.name}"] = content = file.read_bytes()
            digest = hashlib.sha256(content).hexdigest()
            rows += f"| `sim/{file.name}` | <{archive_server.url(f'data/{file.name}')}> | `{digest}` |\n"
            text = text.replace(f'"{file.name}"', f'"{fetch_cases.SHARED}sim/{file.name}"')
    archive_server.reset(files)
    folder.mkdir()
    (folder / "README.md").write_text(rows, encoding="utf-8")
    (folder / "sim.toml").write_text(text, encoding="utf-8")
    return folder


def test_a_case_is_fetched_once_and_runs(archive_server: Flaky, served: Path, case_file: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert fetch_cases.main(["sim", "--out", str(out)], served) == 0
    assert len(archive_server.asked) == len(archive_server.files) > 2
    expected, found = (mgsgraph.read_case(path).network for path in (case_file, out / "sim.toml"))
    assert (len(found.points), found.rays.point.size) == (len(expected.points), expected.rays.point.size)
    (out / "sim" / "network.pvl").write_bytes(b"other")
    assert fetch_cases.main(["--out", str(out)], served) == 0
    assert len(archive_server.asked) == len(archive_server.files) + 1  # the damaged one alone


def test_another_content_is_refused(
    archive_server: Flaky, served: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    archive_server.files["data/network.pvl"] += b"\n"
    assert fetch_cases.main(["--out", str(tmp_path / "out")], served) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "data/network.pvl: SHA-256" in line
    assert not list((tmp_path / "out").rglob("network.pvl*"))
    assert not (tmp_path / "out" / "sim.toml").exists()

"""What the project says of itself in files for others (versions, citation, workflows, recipe) is one and the same."""

import re
import subprocess
import sys
import tomllib
from datetime import date
from pathlib import Path
from typing import Any

import pytest
from packaging.requirements import Requirement
from packaging.version import Version

yaml = pytest.importorskip("yaml")  # dask has it
ROOT = Path(__file__).resolve().parents[1]
PROJECT: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
EXTRAS = PROJECT["optional-dependencies"]


def text_of(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


def lowest(texts: list[str]) -> dict[str, str]:
    """Lower bound of each package."""
    return {one.name: clause.version for one in map(Requirement, texts) for clause in one.specifier}


def test_every_package_has_a_lower_bound_and_no_other() -> None:
    for text in [*PROJECT["dependencies"], *(one for extra in EXTRAS.values() for one in extra)]:
        one = Requirement(text)
        assert one.name == "mgsgraph" or [clause.operator for clause in one.specifier] == [">="], text


def test_the_page_of_versions_has_every_lower_bound() -> None:
    row = r"^\| ([\w-]+) \| ([\w-]+) \| ([\d.]+) \| ([\d.]+|-) \|$"
    rows = re.findall(row, text_of("docs/versions.md"), re.MULTILINE)
    declared = lowest([*PROJECT["dependencies"], *(one for extra in EXTRAS.values() for one in extra)])
    declared.pop("mgsgraph", None)
    assert {name: bound for name, _, bound, _ in rows} == declared, "write it anew: python scripts/versions.py --page"
    for name, _, bound, newest in rows:
        assert newest == "-" or Version(newest) >= Version(bound), name


def test_all_is_what_programs_need() -> None:
    (one,) = map(Requirement, EXTRAS["all"])
    assert one.name == "mgsgraph"
    assert one.extras == set(EXTRAS) - {"all", "cuda", "test", "docs", "dev"}
    for extra in ("test", "dev"):
        named = {name for text in EXTRAS[extra] for name in Requirement(text).extras}
        assert named <= {"all", "test", "docs"}


def test_versions_and_dates_agree() -> None:
    headings = re.findall(r"^## (\S+) – (\d{4}-\d\d-\d\d)$", text_of("CHANGELOG.md"), re.MULTILINE)
    cited = yaml.safe_load(text_of("CITATION.cff"))
    assert headings[0] == (PROJECT["version"], str(cited["date-released"]))
    assert [day for _, day in headings] == sorted((str(date.fromisoformat(day)) for _, day in headings), reverse=True)
    assert cited["version"] == PROJECT["version"]
    assert cited["license"] == PROJECT["license"]
    assert [one["name"] for one in cited["authors"]] == [one["name"] for one in PROJECT["authors"]]
    recipe = text_of("recipe/recipe.yaml")
    assert f'version: "{PROJECT["version"]}"' in recipe


def test_the_bibtex_entries_are_the_citation_file_s() -> None:
    cited = yaml.safe_load(text_of("CITATION.cff"))
    entries = re.findall(r"^@\w+\{(.+?)^\}", text_of("docs/citing.md"), re.MULTILINE | re.DOTALL)
    plain = [re.sub(r"[{}\\]", "", entry) for entry in entries]
    assert len(plain) == 1 + len(cited["references"])
    for entry, one in zip(plain, (cited, *cited["references"]), strict=True):
        assert one["title"] in entry
        assert all(author.get("family-names", author.get("name", "")) in entry for author in one["authors"][:1])
        assert str(one.get("year", cited["date-released"].year)) in entry
    assert cited["version"] in plain[0]


def test_the_recipe_needs_what_the_package_needs() -> None:
    run = re.search(r"^  run:\n((?:    .*\n)+)", text_of("recipe/recipe.yaml"), re.MULTILINE)
    assert run is not None
    names = {"matplotlib": "matplotlib-base"}
    needed = re.findall(r"^    - ([\w-]+) >=([\d.]+)$", run[1], re.MULTILINE)
    declared = {names.get(name, name): bound for name, bound in lowest(PROJECT["dependencies"]).items()}
    assert {name: bound for name, bound in needed if name != "python"} == declared


def test_workflows_call_parts_that_there_are() -> None:
    parts = set(re.findall(r"^#   (\w+) ", text_of(".ci/run"), re.MULTILINE))
    jobs = yaml.safe_load(text_of(".github/workflows/checks.yml"))["jobs"]
    called = set(jobs["parts"]["strategy"]["matrix"]["part"])
    for job in jobs.values():
        called |= set(re.findall(r"\.ci/run (\w+)", " ".join(step.get("run", "") for step in job["steps"])))
    assert called <= parts
    assert {"tests", "wheel", "lowest"} <= called
    offered = {one.rpartition(" ")[2] for one in PROJECT["classifiers"] if re.search(r":: 3\.\d+$", one)}
    assert set(jobs["tests"]["strategy"]["matrix"]["python"]) == offered


@pytest.mark.program("bash")
def test_ci_refuses_parts_that_there_are_not() -> None:
    done = subprocess.run(["bash", ROOT / ".ci" / "run", "nothing"], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "lowest" in done.stderr


def test_the_core_of_the_tests_is_there() -> None:
    files = text_of(".ci/core_tests").split()
    assert files == sorted(set(files), key=lambda name: (name.count("/"), name))
    assert not [name for name in files if not (ROOT / name.partition("::")[0]).is_file()]


def test_versions_that_are_not_the_lowest_are_named() -> None:
    done = subprocess.run(
        [sys.executable, ROOT / "scripts" / "versions.py", "--lowest"], capture_output=True, text=True, check=False
    )
    from importlib.metadata import version

    bounds = lowest(PROJECT["dependencies"])
    above = [name for name, bound in bounds.items() if Version(version(name)) != Version(bound)]
    assert bool(above) == (done.returncode != 0)
    assert all(f"{name}: {version(name)} is installed" in done.stderr for name in above)

"""Versions of the packages that mgsgraph needs: the lowest it declares, and those of this environment.

    python scripts/versions.py             # as a table
    python scripts/versions.py --lowest    # and fails where an installed one is not the lowest that is declared
    python scripts/versions.py --page      # writes docs/about.md, in an environment with the newest ones

`.ci/run lowest` takes the second after `uv pip install --resolution lowest-direct`: a lowest version that no
environment can have, since another package needs more, is not true.
"""

import argparse
import sys
import tomllib
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import NamedTuple

from packaging.requirements import Requirement
from packaging.version import Version

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "about.md"
EXTRAS = ("cluster", "cuda", "fetch", "gis", "match", "moc", "studio", "tables", "test", "docs", "dev")
"""Whose packages stand in the table; others are made of these."""


class Needed(NamedTuple):
    """A package and the lowest version that is declared of it."""

    name: str
    lowest: str
    extra: str

    @property
    def here(self) -> str:
        """The installed version; empty for none."""
        try:
            return version(self.name)
        except PackageNotFoundError:
            return ""


def declared() -> list[Needed]:
    """All packages of pyproject.toml; one that several extras have, once."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    groups = {"": project["dependencies"], **project["optional-dependencies"]}
    found = dict[str, Needed]()
    for extra, texts in groups.items():
        for one in map(Requirement, texts):
            if one.name != project["name"] and one.name not in found:
                (bound,) = (clause.version for clause in one.specifier if clause.operator == ">=")
                found[one.name] = Needed(one.name, bound, extra)
    return list(found.values())


def table() -> list[str]:
    """Markdown."""
    rows = [f"| {one.name} | {one.extra or '-'} | {one.lowest} | {one.here or '-'} |" for one in declared()]
    return ["| package | extra | lowest | newest tried |", "|---|---|---|---|", *rows]


def not_lowest() -> list[str]:
    """Installed packages of another version than the lowest, in words."""
    return [
        f"{one.name}: {one.here} is installed, {one.lowest} is declared"
        for one in declared() if one.here and Version(one.here) != Version(one.lowest)
    ]  # fmt: skip


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--lowest", action="store_true", help="fail unless each is the lowest that is declared")
    options.add_argument("--page", action="store_true", help="write docs/about.md")
    given = options.parse_args()
    if given.page:
        head, _, _ = PAGE.read_text(encoding="utf-8").partition("| package |")
        PAGE.write_text(head + "\n".join(table()) + "\n", encoding="utf-8")
        return
    print("\n".join(table()))
    if given.lowest and (wrong := not_lowest()):
        sys.exit("\n".join(["Not the lowest:", *wrong]))


if __name__ == "__main__":
    main()

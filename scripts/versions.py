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
"""Extras whose packages the table has; other extras are unions of these."""


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
    needed = dict[str, Needed]()
    for extra, texts in groups.items():
        for requirement in map(Requirement, texts):
            if requirement.name != project["name"] and requirement.name not in needed:
                (bound,) = (clause.version for clause in requirement.specifier if clause.operator == ">=")
                needed[requirement.name] = Needed(requirement.name, bound, extra)
    return list(needed.values())


def table() -> list[str]:
    """Markdown."""
    rows = [f"| {p.name} | {p.extra or '-'} | {p.lowest} | {p.here or '-'} |" for p in declared()]
    return ["| package | extra | lowest | newest tried |", "|---|---|---|---|", *rows]


def not_lowest() -> list[str]:
    """Installed packages of another version than the lowest, in words."""
    return [
        f"{package.name}: {package.here} is installed, {package.lowest} is declared"
        for package in declared() if package.here and Version(package.here) != Version(package.lowest)
    ]  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--lowest", action="store_true", help="fail unless each is the lowest that is declared")
    parser.add_argument("--page", action="store_true", help="write docs/about.md")
    options = parser.parse_args()
    if options.page:
        head, _, _ = PAGE.read_text(encoding="utf-8").partition("| package |")
        PAGE.write_text(head + "\n".join(table()) + "\n", encoding="utf-8")
        return
    print("\n".join(table()))
    if options.lowest and (wrong := not_lowest()):
        sys.exit("\n".join(["Not the lowest:", *wrong]))


if __name__ == "__main__":
    main()

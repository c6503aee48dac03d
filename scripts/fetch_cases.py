"""Fetch the files of real cases (scripts/cases) from their public sources, and check them by their SHA-256.

    python scripts/fetch_cases.py [CASE ...] [--out FOLDER]

Writes FOLDER/CASE.toml beside its files. Sources and checksums are those of scripts/cases/README.md; files that are
there and whole stay. Exit status: 0 done, 2 a file that can't be fetched or is not the expected one.
"""

import argparse
import re
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import NamedTuple

from mgsgraph.errors import InputError, require
from mgsgraph.fetch.download import Remote
from mgsgraph.files.opening import read_text, sha256_of
from mgsgraph.files.writing import write_file

CASES = Path(__file__).resolve().parent / "cases"
SHARED = "../../../shared/data/"
"""Folder of all data in the case files."""
_ROW = re.compile(r"^\| `([\w.-]+)/([\w.-]+)` \| <(https?://[^> ]+)> \| `([0-9a-f]{64})` \|$", re.MULTILINE)


class Source(NamedTuple):
    """A file of the cases."""

    folder: str
    name: str
    url: str
    sha256: str

    def check(self, path: Path) -> None:
        """Raise InputError if the content differs."""
        require((digest := sha256_of(path)) == self.sha256, str(path), f"SHA-256 {digest}", self.sha256)


def sources(page: Path) -> Iterator[Source]:
    """Rows of a README's table."""
    return (Source(*row) for row in _ROW.findall(read_text(page)))


def fetch_case(case: Path, out: Path, remote: Remote) -> Path:
    """Fetch the missing files of a case; write the case file beside them."""
    text = read_text(case)
    for source in sources(case.with_name("README.md")):
        path = out / source.folder / source.name
        if f"{SHARED}{source.folder}/" in text and not (path.is_file() and sha256_of(path) == source.sha256):
            remote.download(source.url, path, partial(Source.check, source))
            print(f"- {source.folder}/{source.name}: fetched, SHA-256 as expected")
    copy = out / case.name
    write_file(copy, text.replace(SHARED, ""))
    return copy


def main(arguments: list[str] | None = None, cases: Path = CASES) -> int:
    """Exit status."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    names = sorted(path.stem for path in cases.glob("*.toml"))
    parser.add_argument("cases", nargs="*", metavar="CASE", help=f"of {', '.join(names)}; all when absent")
    parser.add_argument("--out", type=Path, default=CASES / "data", help="folder (scripts/cases/data)")
    options = parser.parse_args(arguments)
    if unknown := sorted(set(options.cases) - set(names)):
        parser.error(f"{unknown[0]}: no such case; one of {', '.join(names)}")
    try:
        remote = Remote(say=print)
        try:
            for name in options.cases or names:
                print(f"The case is {fetch_case(cases / f'{name}.toml', options.out, remote)}")
        finally:
            remote.close()
    except InputError as error:
        print(f"fetch_cases: error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())

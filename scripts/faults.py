"""Planted faults: each of tests/faults.toml is put into a copy of the checkout, where its tests must fail.

    python scripts/faults.py [NAME ...] [--jobs N] [--json OUT]

The tests run once without a fault first. Faults that change a kernel's sources (`compiles`) begin before the others: a
kernel is compiled again for each. Exit status: 0, all were caught; 1, one was not, or a test fails without any.
"""

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
FAULTS = ROOT / "tests/faults.toml"
PYTEST = ["-m", "pytest", "-q", "-x", "-n", "0", "-p", "no:cacheprovider", "--tb=line"]
LONGEST = 900.0
"""s that the tests of a fault may take."""


class Fault(NamedTuple):
    """One entry of tests/faults.toml."""

    name: str
    kind: str
    file: str
    old: str
    new: str
    tests: list[str]
    slow: bool = False
    """Whether it takes a test that is marked slow to find it."""
    compiles: bool = False
    """Whether its tests compile a kernel again."""


class Outcome(NamedTuple):
    """Result of a fault's tests: which of them failed, or how they ended."""

    caught: bool
    seconds: float
    message: str


def read_faults(names: Sequence[str] = ()) -> list[Fault]:
    """All faults, or those of some names."""
    faults = {entry["name"]: Fault(**entry) for entry in tomllib.loads(FAULTS.read_text(encoding="utf-8"))["fault"]}
    if unknown := sorted(set(names) - set(faults)):
        sys.exit(f"no fault is called {', '.join(unknown)}; there are {', '.join(faults)}")
    return [faults[name] for name in names or faults]


def tracked() -> Iterable[str]:
    """Files of the checkout that belong to it, and what Python and numba have compiled of them."""
    command = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    names = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout.split("\0")
    folders = sorted({str(Path(name).parent / "__pycache__") for name in names if name.endswith(".py")})
    compiled = [str(path.relative_to(ROOT)) for name in folders for path in (ROOT / name).glob("*") if path.is_file()]
    return (name for name in (*names, *compiled) if name and (ROOT / name).exists())


def copied(source: Path, names: Iterable[str], folder: Path) -> Path:
    """A folder's files in a new one, links as links, with their times: else kernels are compiled again. The package
    is imported by a link beside the copy, since tests take their own checkout off the path.
    """
    copy = folder / "checkout"
    for name in names:
        (copy / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(source / name, copy / name, follow_symlinks=False)
    (folder / "path").mkdir()
    (folder / "path/mgsgraph").symlink_to(copy / "mgsgraph")
    if (ROOT.parent / "shared").exists():
        (folder / "shared").symlink_to((ROOT.parent / "shared").resolve())
    return copy


def run(copy: Path, *arguments: str) -> tuple[int, str, float]:
    """Exit status, output and s of Python with a copy's package; status -1 after a timeout."""
    environment = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"}
    environment |= {"PYTHONPATH": str(copy.parent / "path"), "OPENBLAS_NUM_THREADS": "1", "COLUMNS": "200"}
    began, how = time.monotonic(), {"cwd": copy, "env": environment, "timeout": LONGEST, "check": False}
    try:
        done = subprocess.run([sys.executable, *arguments], capture_output=True, text=True, **how)
    except subprocess.TimeoutExpired:
        return -1, f"more than {LONGEST:g} s", LONGEST
    return done.returncode, done.stdout + done.stderr, time.monotonic() - began


def tried(fault: Fault, plain: Path) -> Outcome:
    """The fault in a copy of its own: caught if one of its tests fails; other errors of pytest do not count."""
    with tempfile.TemporaryDirectory(prefix="mgsgraph-fault-") as folder:
        names = [str(path.relative_to(plain)) for path in plain.rglob("*") if path.is_symlink() or path.is_file()]
        copy = copied(plain, names, Path(folder))
        path = copy / fault.file
        text = path.read_text(encoding="utf-8")
        if text.count(fault.old) != 1:
            return Outcome(False, 0.0, f"the old text occurs {text.count(fault.old)} times in {fault.file}")
        path.write_text(text.replace(fault.old, fault.new), encoding="utf-8")
        status, output, seconds = run(copy, *PYTEST, *(["-m", ""] if fault.slow else []), *fault.tests)
    failed = re.search(r"^FAILED (([^\s\[]+).*)$", output, re.MULTILINE)
    if failed is None:
        return Outcome(False, seconds, f"status {status}: {' '.join(output.split())[-200:]}")
    return Outcome(status == 1 and failed[2] in fault.tests, seconds, failed[1])


def main() -> None:
    """Run the faults that the command line names."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help="of faults; all when absent")
    parser.add_argument("--jobs", type=int, default=2, help="faults at a time")
    parser.add_argument("--json", type=Path, help="file for the outcomes")
    options = parser.parse_args()
    faults = sorted(read_faults(options.names), key=lambda fault: (not fault.compiles, not fault.slow))
    outcomes, began = dict[str, Outcome](), time.monotonic()
    with tempfile.TemporaryDirectory(prefix="mgsgraph-faults-") as folder:
        plain = copied(ROOT, tracked(), Path(folder))
        package = run(plain, "-P", "-c", "import mgsgraph; print(mgsgraph.__file__)")[1].strip()
        if not package.startswith(f"{folder}/path/"):
            sys.exit(f"Not the copy's package is imported: {package}")
        print(f"Package: {package}", flush=True)
        status, output, seconds = run(plain, *PYTEST, "-m", "", *sorted({t for fault in faults for t in fault.tests}))
        if status != 0:
            sys.exit(f"{output}\nTests fail without any fault.")
        print(f"{seconds:6.1f} s  without a fault: passed", flush=True)
        with ThreadPoolExecutor(options.jobs) as pool:
            for fault, outcome in zip(faults, pool.map(lambda f: tried(f, plain), faults), strict=True):
                outcomes[fault.name] = outcome
                verdict = "caught" if outcome.caught else "NOT caught"
                print(f"{outcome.seconds:6.1f} s  {fault.name}: {verdict} ({outcome.message})", flush=True)
        if options.json:
            record = {name: outcome._asdict() for name, outcome in outcomes.items()}
            options.json.write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")
        print(f"{time.monotonic() - began:.0f} s in all")
    print(f"{sum(outcome.caught for outcome in outcomes.values())} of {len(outcomes)} faults caught")
    sys.exit(not all(outcome.caught for outcome in outcomes.values()))


if __name__ == "__main__":
    main()

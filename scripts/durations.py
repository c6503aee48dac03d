"""Where the tests' time goes: `python scripts/durations.py JUNIT.xml [--write]` (`pytest --junitxml JUNIT.xml`).

Each test's share of the whole is held against tests/durations.json, so that a slow machine does not matter: named are
tests that have grown by more than a thousandth of the whole and a half of their own, and then the slowest twenty.
"""

import argparse
import json
import sys
from collections import Counter
from pathlib import Path
from xml.etree import ElementTree

KEPT = Path(__file__).resolve().parents[1] / "tests" / "durations.json"
LEAST = 5e-4
"""Share below which a test is not stored."""
GROWN, FACTOR = 1e-3, 1.5
"""Least growth of a test that is reported: share, and factor."""
SLOWEST = 20


def durations(path: Path) -> Counter[str]:
    """Seconds of each test (all its cases, with what sets them up) by file and name."""
    seconds = Counter[str]()
    for case in ElementTree.parse(path).iter("testcase"):
        name = case.attrib["name"].partition("[")[0]
        seconds[f"{case.attrib['classname'].replace('.', '/')}.py::{name}"] += float(case.attrib["time"])
    return seconds


def main() -> int:
    """Status 1 where a test has grown."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("junit", type=Path)
    parser.add_argument("--write", action="store_true", help="keep the shares of this run")
    options = parser.parse_args()
    seconds = durations(options.junit)
    total = seconds.total()
    shares = {name: round(took / total, 6) for name, took in seconds.most_common() if took > LEAST * total}
    stored = json.loads(KEPT.read_text(encoding="utf-8")) if KEPT.exists() else {}
    grown = [
        name for name, share in shares.items()
        if share - stored.get(name, 0.0) > GROWN and share > FACTOR * stored.get(name, 0.0)
    ]  # fmt: skip
    print(f"{len(seconds)} tests, {total:.0f} s; slowest:")
    for name, took in seconds.most_common(SLOWEST):
        print(f"  {took:6.1f} s {100.0 * took / total:5.1f} %  {name}")
    for name in grown:
        print(f"grown from {100.0 * stored.get(name, 0.0):.2f} to {100.0 * shares[name]:.2f} % of the whole: {name}")
    if options.write:
        KEPT.write_text(json.dumps(shares, indent=0) + "\n", encoding="utf-8")
    return int(bool(grown) and not options.write)


if __name__ == "__main__":
    sys.exit(main())

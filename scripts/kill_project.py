"""Kill `mgsgraph add` and `mgsgraph solve` at random moments, and look whether the project holds a state that is whole.

    python scripts/kill_project.py --moments 50 > table.md
"""

import random
import shutil
import signal
import sqlite3
import subprocess
import sys
import tempfile
import time
from collections import Counter
from contextlib import closing
from pathlib import Path

from study import at_least, command, table

from mgsgraph.project.connection import FILE
from mgsgraph.project.project import open_project
from mgsgraph.simulation.files import write_pair
from mgsgraph.simulation.pair import PairSettings, simulate_pair

MGSGRAPH = [sys.executable, "-m", "mgsgraph.cli"]


TABLES = ("image", "shared", "bundle", "bundle_image", "point", "ray", "range", "terrain", "profile")


def contents(project: Path) -> tuple[object, ...]:
    """All rows of these tables."""
    with closing(sqlite3.connect(f"{(project / FILE).resolve().as_uri()}?mode=ro", uri=True)) as file:
        return tuple(tuple(file.execute(f"SELECT * FROM {name}").fetchall()) for name in TABLES)


def state(project: Path) -> tuple[object, ...]:
    """Everything in the file but the times at which it happened, and which result folders are known."""
    with open_project(project, thorough=True) as opened:  # plays back the journal of a process that was killed
        rows = contents(project)
        history = tuple((change.verb, change.what) for change in opened.changes())
        last = opened.last_solution("batch")
        if last is not None and last.folder is not None and not (project / last.folder / "solution.json").is_file():
            raise SystemExit(f"{project}: solution {last.number} is known, and its folder isn't there")
    return rows, history


def run(project: Path, verb: list[str], seconds: float | None) -> float:
    """The command, killed after some seconds; how long it ran."""
    began = time.perf_counter()
    process = subprocess.Popen([*MGSGRAPH, *verb], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        process.wait(seconds)
    except subprocess.TimeoutExpired:
        process.send_signal(signal.SIGKILL)
        process.wait()
    return time.perf_counter() - began


def trial(before: Path, verb: list[str], moments: int, work: Path) -> Counter[str]:
    """Kill a command at random moments on copies of a project; how many copies then held which state."""
    project, found = work / "project", Counter[str]()
    shutil.copytree(before, project)
    length = run(project, verb, None)
    old, new = state(before), state(project)
    if old == new:
        raise SystemExit(f"{verb[0]} changes nothing even when nobody kills it")
    for _ in range(moments):
        shutil.rmtree(project)
        shutil.copytree(before, project)
        run(project, verb, random.uniform(0.3 * length, 1.05 * length))
        now = state(project)
        found["before" if now == old else "after" if now == new else "BETWEEN"] += 1
    shutil.rmtree(project)
    return found


def main() -> None:
    parser = command(__doc__)
    parser.add_argument("--moments", type=at_least(1), default=50, help="how often each command is killed")
    moments = parser.parse_args().moments
    with tempfile.TemporaryDirectory() as name:
        work = Path(name)
        case = write_pair(simulate_pair(PairSettings(ties=400, shots=20), seed=1), work / "pair")
        kept = work / "kept"
        run(kept, ["init", str(kept), "--case", str(case)], None)
        solve = ["solve", str(work / "project"), "--no-figures"]
        rows = {"solve": trial(kept, solve, moments, work)}
        run(kept, ["solve", str(kept), "--no-figures"], None)
        run(kept, ["remove", str(kept), "SIM/B"], None)
        ties = ["--ties", str(case.parent / "network.pvl"), "--shots", str(case.parent / "lidar.json")]
        add = ["add", str(work / "project"), f"SIM/B={case.parent / 'image_B.isd'}", *ties]
        rows["add"] = trial(kept, add, moments, work)
    counts = [[verb, *map(str, (moments, found["before"], found["after"], found["BETWEEN"]))]
              for verb, found in rows.items()]  # fmt: skip
    print("\n".join(table(("killed", "moments", "state before", "state after", "between"), counts)))
    sys.exit(1 if any(found["BETWEEN"] for found in rows.values()) else 0)


if __name__ == "__main__":
    main()

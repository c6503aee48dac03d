"""Flip single bits of what the program keeps, read it again, and look whether the damage is noticed.

Each flip is of one bit, drawn at random, of a copy: of a project's file, of results, or of records. What
reads it again must refuse it, do the work again, or come to the same result.

    python scripts/bit_flips.py --flips 2000 --commands 60 > table.md
"""

import hashlib
import os
import random
import shutil
import sqlite3
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from dataclasses import astuple, dataclass, replace
from pathlib import Path

from study import at_least, command, show, table

from mgsgraph.case.assembly import window_beside
from mgsgraph.errors import MgsgraphError
from mgsgraph.export.network_content import source_networks
from mgsgraph.fetch.store import LOCK, Lock, LockedFile
from mgsgraph.files.networks.binary import read_network, write_binary_network
from mgsgraph.files.networks.table import read_tie_points
from mgsgraph.files.opening import sha256_of
from mgsgraph.files.output.folders import EXPORT
from mgsgraph.files.output.table import write_json
from mgsgraph.files.writing import FILES, MATCH, read_record
from mgsgraph.project.campaign import RECORD as CAMPAIGN
from mgsgraph.project.campaign import open_record, run_campaign
from mgsgraph.project.connection import FILE
from mgsgraph.project.project import open_project
from mgsgraph.project.reading import comparison_with_truth
from mgsgraph.project.status import status
from mgsgraph.results.archive import ARCHIVE, pack, read_solution
from mgsgraph.results.results import RECORD, case_of
from mgsgraph.simulation.files import write_pair
from mgsgraph.simulation.pair import PairSettings, simulate_pair

MGSGRAPH = [sys.executable, "-m", "mgsgraph"]
ENDS = ("refused", "done again", "the same", "OTHER", "CRASH")
_HEAD = 100
"""bytes at the beginning of a file, and at its end, of which one flip in four is: there its structure stands."""
_AGAIN = "done again"
Reader = Callable[[Path], str]
"""What is read of a file, in text that differs where the result differs."""


@dataclass(frozen=True)
class Target:
    """Files whose bits are flipped, and what reads them again."""

    name: str
    files: tuple[Path, ...]
    read: Reader
    """Called with the folder."""
    verbs: tuple[tuple[str, ...], ...] = ()
    """Commands that read them; {} is the folder."""
    results: Path | None = None
    """Archive, below the folder, that such a command writes."""


# --- what is read


def digest(*parts: object) -> str:
    """Of anything with a text of its own; records by their bytes."""
    found = hashlib.sha256()
    for part in parts:
        found.update(part if isinstance(part, bytes) else repr(part).encode())
    return found.hexdigest()


def of_project(folder: Path) -> str:
    """Everything that a project says."""
    with open_project(folder) as project:
        store = project.store
        members = store.members()
        bundles = [pack(store.bundle(one)) for one in members]
        shared = [(name, pack(one)) for name, one in store.shared().items()]
        reduced = [(name, pack(one)) for name, one in store.reduced().items()]
        rest = project.changes(), project.settings, project.case, project.networks, project.last_solution()
        known = store.bundles_of(store.network().points.ids), project.pictures()
        seen = [store.seen_by(name) for name in store.image_names()]
        return digest(status(project), members, *bundles, shared, reduced, pack(store.network()), rest, known, seen)


def of_results(folder: Path) -> str:
    """Everything that later commands take from results."""
    solution = read_solution(folder)
    sources = source_networks(folder, (), solution.network.images[0].body)
    return digest(pack(solution), case_of(folder), repr(sources), comparison_with_truth(folder))


def of_matches(folder: Path) -> str:
    """The same of a folder of tie points."""
    ties = [read_tie_points(folder / name) for name in ("network.pvl", "network.net")]
    return digest(*map(pack, ties), window_beside(folder / "network.pvl"))


def of_campaign(folder: Path) -> str:
    """The record of a campaign; of one whose last line is gone, that its case is done again."""
    with open_record(folder) as record:
        return digest(list(record.entries.values())) if len(record.entries) == 2 else _AGAIN


def of_lock(folder: Path) -> str:
    """What a folder of fetched files has."""
    return digest(astuple(Lock.read(folder)))


# --- what is made


def made(work: Path) -> Iterator[Target]:
    """Everything whose bits are flipped."""
    site, project = work / "site", work / "project"
    run("simulate", "gusev", "--out", str(site))
    run("init", str(project), "--case", str(site / "case.toml"))
    run("solve", str(project), "--no-figures")
    run("coregister", str(project), "--no-figures")  # now all tables hold something
    solve = ("solve", "{}", "--no-figures")
    yield Target("project", (project / FILE,), of_project, (("status", "{}"), solve), Path("solutions/0003") / ARCHIVE)

    case, results = write_pair(simulate_pair(PairSettings(ties=80, shots=15), seed=1), work / "pair"), work / "results"
    run("adjust", str(case), "--out", str(results), "--no-figures")
    write_json(results / "summary.json", {"statements": ["The heights are right to 3.2 m."]})
    names = (ARCHIVE, RECORD, "summary.json")
    analyze = ("analyze", "{}", "--weak", "3")
    yield Target("results", tuple(results / name for name in names), of_results, (analyze,))

    matches = work / "matches"
    matches.mkdir()
    shutil.copy(case.parent / "network.pvl", matches)
    write_binary_network(read_network(matches / "network.pvl"), matches / "network.net")
    sums = {name: sha256_of(matches / name) for name in ("network.pvl", "network.net")}
    write_json(matches / MATCH, {"program": "mgsgraph", "settings": {"half_window": 12}, FILES: sums})
    files = tuple(matches / name for name in (MATCH, *sums))
    adjust = ("adjust", str(case), "--ties", "{}/network.pvl", "--out", "{}/out", "--no-figures")
    yield Target("matches", files, of_matches, (adjust,), Path("out") / ARCHIVE)

    cases = [case, case.with_name("other.toml")]
    shutil.copy(*cases)
    run_campaign(cases, work / "campaign")
    yield Target("campaign.jsonl", (work / "campaign" / CAMPAIGN,), of_campaign)

    fetched = work / "fetched"
    fetched.mkdir()
    file = LockedFile("https://example.org/a.img", 12, "0f" * 32, "2026-11-23T00:00:00Z", '"etag"')
    Lock(fetched, {f"images/{name}.img": file for name in "abc"}, {}, {"case.toml": "1e" * 32}).write()
    yield Target("fetch.lock", (fetched / LOCK,), of_lock)

    export = work / "export"
    run("export", str(results), "--to", "csm", "--out", str(export))
    yield Target("export.json", (export / EXPORT,), lambda folder: digest(read_record(folder / EXPORT)))


def tables_of(file: Path) -> list[str]:
    """What each page of a project's file belongs to; empty where SQLite has no table of them."""
    with closing(sqlite3.connect(file)) as connection, suppress(sqlite3.Error):
        rows = connection.execute("SELECT pageno, name FROM dbstat").fetchall()
        (count,) = connection.execute("PRAGMA page_count").fetchone()
        known = dict(rows)
        return [known.get(number, "free") for number in range(1, count + 1)]
    return []


# --- flips


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    """A command that must go well."""
    done = called(*arguments)
    if done.returncode != 0:
        raise SystemExit(f"{' '.join(arguments)}: {done.stderr.strip()}")
    return done


def called(*arguments: str) -> subprocess.CompletedProcess[str]:
    """A command."""
    return subprocess.run([*MGSGRAPH, *arguments], capture_output=True, text=True, check=False, timeout=600)


def flipped(path: Path, rng: random.Random) -> int:
    """Flip a bit of a file; the byte that it is in."""
    content = bytearray(path.read_bytes())
    ends = rng.random() < 0.25
    place = rng.randrange(len(content))
    if ends:
        place = rng.randrange(min(_HEAD, len(content))) * rng.choice((1, -1))
    content[place] ^= 1 << rng.randrange(8)
    times = path.stat()
    path.write_bytes(content)
    os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))  # a disk that rots changes no time
    return place % len(content)


def ended(read: Reader, folder: Path, right: str) -> str:
    """How the reading of a folder ends."""
    try:
        found = read(folder)
    except MgsgraphError as error:
        return "CRASH" if "\n" in str(error) else "refused"
    except Exception:  # whatever else it is, the user would see a traceback
        return "CRASH"
    return "the same" if found == right else _AGAIN if found == _AGAIN else "OTHER"


def by_command(target: Target, verb: tuple[str, ...]) -> Reader:
    """A reader that is a command; of its words and the results that it writes. Words with times in them don't count."""

    def read(folder: Path) -> str:
        done = called(*(word.replace("{}", str(folder)) for word in verb))
        if done.returncode == 2 and done.stderr.count("\n") == 1:
            raise MgsgraphError(done.stderr.strip())
        if done.returncode:
            raise RuntimeError(done.stderr)
        if target.results is None or not (folder / target.results).is_file():
            return digest(done.stdout.replace(str(folder), ""))
        solution = read_solution(folder / target.results)
        return digest(pack(replace(solution, seconds={})))

    return read


def trial(
    target: Target, folder: Path, flips: int, rng: random.Random, verb: tuple[str, ...] | None, hit: Counter[str]
) -> Counter[str]:
    """Flip bits on copies of a target; how the readings ended, and in `hit` which tables of a project were met."""
    pages = tables_of(target.files[0]) if target.name == "project" else []
    read, found = target.read if verb is None else by_command(target, verb), Counter[str]()
    copy = folder.with_name("copy")

    def afresh() -> None:
        shutil.rmtree(copy, ignore_errors=True)
        shutil.copytree(folder, copy)

    afresh()
    right = read(copy)
    afresh()
    for number in range(flips):
        path = copy / rng.choice(target.files).relative_to(folder)
        whole, where = path.read_bytes(), flipped(path, rng)
        end = ended(read, copy, right)
        found[end] += 1
        if end.isupper():
            print(f"{target.name}: {end}: {path.name}, byte {where}", file=sys.stderr)
        if pages:
            hit[pages[where * len(pages) // len(whole)]] += 1
        if verb is None and target.name != "campaign.jsonl":
            path.write_bytes(whole)
        else:  # a command writes more
            afresh()
        show(f"{target.name}: {number + 1} of {flips}")
    shutil.rmtree(copy)
    return found


def main() -> None:
    parser = command(__doc__)
    parser.add_argument("--flips", type=at_least(1), default=2000, help="how many bits in all are flipped")
    parser.add_argument("--commands", type=at_least(0), default=60, help="how many of these are read by whole commands")
    parser.add_argument("--seed", type=at_least(0), default=1)
    chosen = parser.parse_args()
    rng, rows, total = random.Random(chosen.seed), list[list[str]](), Counter[str]()
    hit = Counter[str]()
    with tempfile.TemporaryDirectory() as name:
        targets = list(made(Path(name)))
        verbs = [(target, verb) for target in targets for verb in target.verbs]
        parts = [(target, verb, chosen.commands // len(verbs)) for target, verb in verbs]
        left = chosen.flips - sum(count for *_, count in parts)
        shares = {"project": 0.4, "results": 0.25, "matches": 0.1}
        weights = [shares.get(target.name, 0.25 / 4) for target in targets]
        counts = [int(left * weight) for weight in weights]
        counts[0] += left - sum(counts)
        parts = [*((target, None, count) for target, count in zip(targets, counts, strict=True)), *parts]
        for target, verb, count in parts:
            folder = Path(name) / target.files[0].relative_to(name).parts[0]
            found = trial(target, folder, count, rng, verb, hit)
            total += found
            read = "in one process" if verb is None else f"`mgsgraph {verb[0]}`"
            rows.append([target.name, read, *(str(number) for number in (count, *(found[end] for end in ENDS)))])
    rows.append(["all", "", *(str(number) for number in (total.total(), *(total[end] for end in ENDS)))])
    print("\n".join(table(("kept", "read", "flips", *ENDS), rows)))
    if hit:
        pages = ", ".join(f"{one} {count}" for one, count in hit.most_common())
        print(f"\nPages of the project's file that were hit: {pages}.")
    sys.exit(1 if total["OTHER"] or total["CRASH"] else 0)


if __name__ == "__main__":
    main()

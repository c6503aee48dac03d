"""Kill every command that writes, at random moments, and look at what there is then, and after the next ordinary run.

    python scripts/kills.py --kills 500 > table.md

Each kill (SIGKILL, SIGTERM or SIGINT) meets a command on a fresh copy of small simulated inputs: by the clock, or as it
is about to open, rename, make or remove one of its files. What is there then has to be the state before or the state
after (of commands that write several things, each of them); and when the same command has run to its end, nothing may
lie about that an undisturbed run doesn't leave: in its folder, in the results' and in the one of temporary files.
"""

import io
import json
import mmap
import os
import random
import shutil
import signal
import sqlite3
import struct
import sys
import tempfile
import time
import tomllib
import zipfile
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager
from hashlib import sha256
from pathlib import Path
from typing import NamedTuple

from study import at_least, command, show, table

from mgsgraph.files.networks.pvl import write_pvl_network
from mgsgraph.files.networks.tie_points import control_network
from mgsgraph.files.output.folders import PROJECT
from mgsgraph.project.project import open_project
from mgsgraph.simulation.case_files import image_file, json_text, support_data
from mgsgraph.simulation.files import write_pair, write_strip, write_texts
from mgsgraph.simulation.pair import PairSettings, simulate_pair
from mgsgraph.units import MRAD

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))
import command_server
import flaky_archive
import matched
from increments import NOISE, strip
from profiles import with_profile

TEMPORARY = "tmp"
"""Folder of a trial that stands for the system's temporary files."""
TABLES = ("image", "shared", "bundle", "bundle_image", "packed", "grid", "profile")
"""Columns of a project that hold neither times nor names of machines."""
SIGNALS = (signal.SIGKILL, signal.SIGKILL, signal.SIGTERM, signal.SIGINT)
_CAUGHT = (signal.SIGTERM, signal.SIGINT)
"""Signals that the program handles, once it has started; before that they end it at once."""
_LATE = 1.1
"""Latest kill, as a share of a command's seconds."""
_WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC
_EVENTS = ("os.rename", "os.remove", "os.rmdir", "os.mkdir", "os.truncate")


class Verb(NamedTuple):
    """A command that writes."""

    name: str
    arguments: str
    """In the folder of a trial; ADDRESS is that of the archive."""
    made: str
    """Its output there, in the state before or after; half of the trials begin with an earlier one."""
    several: bool = False
    """Whether it has several outputs in sequence, each of them atomic."""
    earlier: bool = True
    """Whether it replaces an earlier output; else it starts without one."""
    share: int = 6
    """Of all kills, beside those of other commands."""


_TEXT = Path(__file__).with_suffix(".toml").read_text(encoding="utf-8")
VERBS = tuple(Verb(name, **how) for name, how in tomllib.loads(_TEXT).items())


# --- a command in a process of its own


class Ended(NamedTuple):
    """How a command ended."""

    status: int
    """Negative: by that signal."""
    seconds: float
    events: int
    """Number of files that it opened to write, renamed, made or removed."""
    text: str
    """On standard error."""


class Blow(NamedTuple):
    """When a command is killed, and how."""

    signal: int
    seconds: float | None = None
    """After its beginning."""
    event: int | None = None
    """Before that one."""


def run(arguments: list[str], work: Path, blow: Blow | None = None) -> Ended:
    """A command in the folder `work`, forked from this process, which has everything imported."""
    count, output = mmap.mmap(-1, 8), work.parent / "said"
    output.write_bytes(b"")
    environment = os.environ | {"TMPDIR": str(work / TEMPORARY), "COLUMNS": "110"}
    signal.pthread_sigmask(signal.SIG_BLOCK, _CAUGHT)
    child = os.fork()
    if child == 0:
        for number in _CAUGHT:  # as in a process that has not yet come to the program's own handlers
            signal.signal(number, signal.SIG_DFL)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, _CAUGHT)
        command_server.become(str(work), dict(environment), [os.devnull, str(output)])
        tempfile.tempdir = None
        sys.addaudithook(_counting(count, blow, str(work)))
        command_server.obey(arguments)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, _CAUGHT)
    began = time.perf_counter()
    status = _waited(child, began, blow)
    (events,) = struct.unpack("q", count[:])
    return Ended(status, time.perf_counter() - began, events, output.read_text(errors="replace"))


def _waited(child: int, began: float, blow: Blow | None) -> int:
    """The exit status of a process, which is killed at a time, if one is given."""
    struck = blow is None or blow.seconds is None
    while True:
        ended, status = os.waitpid(child, os.WNOHANG if not struck else 0)
        if ended:
            return os.waitstatus_to_exitcode(status)
        if blow is not None and blow.seconds is not None and time.perf_counter() - began > blow.seconds:
            os.kill(child, blow.signal)
            struck = True
        time.sleep(0.001)


def _counting(count: mmap.mmap, blow: Blow | None, work: str) -> Callable[[str, tuple[object, ...]], None]:
    """An audit hook that counts changes of a trial's files, and kills the process."""

    def hook(event: str, arguments: tuple[object, ...]) -> None:
        if event not in _EVENTS and event != "open":
            return
        path = os.fsdecode(arguments[0]) if isinstance(arguments[0], str | bytes | os.PathLike) else "/"
        writes = event != "open" or bool(isinstance(arguments[2], int) and arguments[2] & _WRITING)
        if not writes or (path.startswith("/") and not path.startswith(work)):
            return
        (events,) = struct.unpack("q", count[:])
        count[:] = struct.pack("q", events + 1)
        if blow is not None and blow.event == events:
            os.kill(os.getpid(), blow.signal)

    return hook


# --- what is there


def snapshot(work: Path) -> dict[str, str]:
    """All files and folders in a folder: their digests, by their paths in it."""
    digests = {}
    for path in sorted(work.rglob("*")):
        name = path.relative_to(work).as_posix()
        if path.is_symlink() or not path.is_file():
            digests[name] = "folder" if path.is_dir() else "odd"
        elif path.name == PROJECT and "unfinished" not in name:
            digests[name] = project_state(path.parent)
        else:
            digests[name] = sha256(path.read_bytes()).hexdigest()
    return digests


def project_state(project: Path) -> str:
    """All rows of a project without times, from a copy whose journal is applied."""
    with tempfile.TemporaryDirectory() as temporary:
        copy = Path(temporary) / "project"
        copy.mkdir()
        for path in project.glob(f"{PROJECT}*"):
            shutil.copy(path, copy)
        with open_project(copy) as opened:
            history = [(change.verb, change.what) for change in opened.changes()]
        with closing(sqlite3.connect(f"{(copy / PROJECT).as_uri()}?mode=ro", uri=True)) as file:
            rows = [file.execute(f"SELECT * FROM {name}").fetchall() for name in TABLES]
            rows.append(file.execute("SELECT number, kind, folder FROM solution").fetchall())
    return sha256(repr((rows, history)).encode()).hexdigest()


def sound(path: Path) -> bool:
    """Whether a file that differs from run to run (it has times in it) is whole."""
    content = path.read_bytes()
    match path.suffix:
        case ".json" | ".lock":
            return isinstance(json.loads(content), dict)
        case ".jsonl":
            return all(json.loads(line) for line in content.splitlines(keepends=True) if line.endswith(b"\n"))
        case ".npz":
            return zipfile.ZipFile(io.BytesIO(content)).testzip() is None
        case ".html":
            return content.rstrip().endswith(b"</html>")
        case _:
            return len(content) > 0


class Known(NamedTuple):
    """The states of undisturbed runs."""

    before: dict[str, str]
    after: dict[str, str]
    changing: frozenset[str]
    """Files whose content differs in every run."""
    allowed: frozenset[str]
    """All files that may exist when a run has ended."""
    seconds: float
    events: int


def judged(work: Path, files: Mapping[str, str], reference: Known, several: bool) -> str:
    """Whether the files are in the state before, after, both (for several outputs), or neither."""
    names = (set(files) | set(reference.before) | set(reference.after)) & (set(reference.before) | set(reference.after))
    is_before = {name for name in names if files.get(name) == reference.before.get(name)}
    is_after = {name for name in names if files.get(name) == reference.after.get(name)}
    is_after |= {name for name in names & reference.changing if name in files and sound(work / name)}
    if is_before == names:
        return "before"
    if is_after == names:
        return "after"
    return "each" if several and is_before | is_after == names else "BETWEEN"


# --- trials


@contextmanager
def inputs() -> Iterator[tuple[Path, str]]:
    """A folder with all inputs of the commands, and the address of the archive."""
    reading, writing = os.pipe()
    server = os.fork()
    if server == 0:
        with flaky_archive.served() as archive:
            archive.files = flaky_archive.archive_files()
            os.write(writing, archive.address.encode())
            signal.pause()
    address = os.read(reading, 200).decode()
    folder = Path(tempfile.mkdtemp(prefix="kills-"))  # no TemporaryDirectory: forks would remove it at their end
    try:
        (folder / "base").mkdir()
        _fill(folder / "base")
        yield folder / "base", address
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        os.kill(server, signal.SIGKILL)
        os.waitpid(server, 0)


def _fill(base: Path) -> None:
    (base / TEMPORARY).mkdir()
    case = write_pair(simulate_pair(PairSettings(ties=40, shots=10), seed=1), base / "pair")
    shutil.copytree(base / "pair", base / "profile")
    with_profile(base / "profile" / case.name)
    (base / "places.csv").write_text("line,sample\n100,20\n500,30\n")
    simulated = strip(4)
    write_strip(simulated, base / "strip")
    table = '\n[[passes]]\nname = "{0}"\nimages = ["{0}"]\nprior = {{}}\n'
    tables = "".join(table.format(image.name) for image in simulated.images)
    with (base / "strip" / "case.toml").open("a", encoding="utf-8") as file:
        file.write(tables)
    _site(base)
    _plan(base / "plan")
    done(base, "adjust plan/case.toml --out plan/results --no-figures")
    done(base, "adjust pair/case.toml --out result --no-figures")
    done(base, "project init project --case pair/case.toml")
    done(base, "project solve project --no-figures")
    shutil.copytree(base / "project", base / "kept")
    done(base, "project remove project SIM/B")


def _plan(folder: Path) -> None:
    """A case of four images, and one candidate image."""
    simulated = strip(5)
    write_strip(simulated.upto(4), folder)
    write_texts(folder, {image_file(simulated.images[4]): json_text(support_data(simulated.images[4]))})
    orientation = (
        f"position_sigma_m = {float(NOISE.position)!r}\nangle_sigma_mrad = {float(NOISE.angle / MRAD)!r}\n"
        f"trend = {[float(factor) for factor in NOISE.trend]}\n"
    )
    image = f'[[images]]\nname = "{simulated.images[4].name}"\nisd = "{image_file(simulated.images[4])}"\n'
    text = f"format = 1\n[orientation]\n{orientation}\n{image}"
    (folder / "candidates.toml").write_text(text, encoding="utf-8")


def _site(base: Path) -> None:
    """The small pair with pictures: with matched ties, adjusted, and without ties."""
    case = matched.write(base / "site")
    text = case.read_text(encoding="utf-8")
    head, _, rest = text.partition("[ties]")
    (case.parent / "bare.toml").write_text(head + rest[rest.index("\n[") :], encoding="utf-8")
    network = control_network(matched.matches().ties, "mgsgraph", "MARS", "pair")
    write_pvl_network(network, case.parent / "network.pvl")
    done(base, "adjust site/case.toml --out matched --no-figures")
    (base / "verdicts.csv").write_text("id,verdict\n")


def done(work: Path, line: str) -> Ended:
    """Run a command that must succeed."""
    ended = run(line.split(), work)
    if ended.status not in (0, 1) or "error" in ended.text:
        raise SystemExit(f"mgsgraph {line}: exit status {ended.status}: {ended.text}")
    return ended


def learned(line: str, base: Path, temporary: Path) -> Known | None:
    """States of undisturbed runs: the first, another from the same state, and one after the first. None where the
    first changes nothing.
    """
    work, second = fresh(base, temporary / "one"), fresh(base, temporary / "other")
    before = snapshot(work)
    ended = done(work, line)
    after = snapshot(work)
    if after == before:
        return None
    done(second, line)
    differs = frozenset(name for name, digest in snapshot(second).items() if after.get(name) != digest)
    run(line.split(), work)
    third = snapshot(work)
    return Known(before, after, differs, frozenset((*before, *after, *third)), ended.seconds, ended.events)


def fresh(base: Path, work: Path) -> Path:
    """A copy of the inputs."""
    shutil.rmtree(work, ignore_errors=True)
    shutil.copytree(base, work, symlinks=True)
    return work


class Row(NamedTuple):
    """Results of all kills of a command."""

    known: Known
    counts: Counter[str]
    wrong: list[str]


def trials(verb: Verb, kills: int, base: Path, address: str, temporary: Path, rng: random.Random) -> Row:
    """Kill a command `kills` times."""
    line = verb.arguments.replace("ADDRESS", address)
    starts = [needed_inputs(base, temporary / "without", verb)]
    if verb.earlier:
        starts.append(fresh(starts[0], temporary / "with"))
        done(starts[1], line)
        age(starts[1], verb)
    references = [reference for start in starts if (reference := learned(line, start, temporary)) is not None]
    if not references:
        raise SystemExit(f"{verb.name} changes nothing even when nobody kills it")
    counts, wrong = Counter[str](), list[str]()
    for number in range(kills):
        reference = references[number % len(references)]
        by_clock = rng.random() < 0.5 or not reference.events
        blow = Blow(rng.choice(SIGNALS), rng.uniform(0.0, _LATE * reference.seconds) if by_clock else None,
                    None if by_clock else rng.randrange(reference.events))  # fmt: skip
        work = fresh(starts[number % len(references)], temporary / "one")
        ended = run(line.split(), work, blow)
        files = snapshot(work)
        state = judged(work, files, reference, verb.several)
        counts[signal.Signals(blow.signal).name] += 1
        counts[state] += 1
        counts["left"] += bool(set(files) - set(reference.before) - set(reference.after))
        run(line.split(), work)
        behind = sorted(set(snapshot(work)) - reference.allowed)
        counts["behind"] += bool(behind)
        unbegun = ended.status == -blow.signal and not ended.events and state == "before" and not ended.text
        clean = unbegun or (ended.status in (0, 1, 130, -signal.SIGKILL) and "Traceback" not in ended.text)
        counts["unclean"] += not clean
        counts["untrue"] += state == "after" and "nothing was written" in ended.text
        if state == "BETWEEN" or behind or not clean:
            wrong.append(f"{verb.name}: {blow}: {state}; status {ended.status}; left {behind[:3]}; {ended.text[-300:]}")
    return Row(references[0], counts, wrong)


def needed_inputs(base: Path, target: Path, verb: Verb) -> Path:
    """Copy only the inputs that a command names, which is faster."""
    shutil.rmtree(target, ignore_errors=True)
    (target / TEMPORARY).mkdir(parents=True)
    for name in {word.split("=")[-1].split("/")[0] for word in verb.arguments.split()}:
        if (base / name).is_dir():
            shutil.copytree(base / name, target / name)
        elif (base / name).is_file():
            shutil.copy(base / name, target / name)
    return target


def age(work: Path, verb: Verb) -> None:
    """Make an earlier result differ from a new one of the same content: change a file's last bytes."""
    for path in [work / verb.made] if (work / verb.made).is_file() else sorted((work / verb.made).glob("*.csv"))[:1]:
        if path.suffix in (".csv", ".html", ".toml"):
            path.write_bytes(path.read_bytes() + b"\n")


def main() -> None:
    """As said above."""
    parser = command(__doc__)
    parser.add_argument("--kills", type=at_least(1), default=500, help="in all, spread over the commands")
    parser.add_argument("--seed", type=at_least(0), default=1)
    parser.add_argument("--only", nargs="*", metavar="COMMAND", help="these alone, by the table's names")
    options = parser.parse_args()
    verbs = [verb for verb in VERBS if options.only is None or verb.name in options.only]
    command_server.load()
    rows, rng = dict[str, Row](), random.Random(options.seed)
    with inputs() as (base, address):
        for number, verb in enumerate(verbs):
            kills = kills_of(options.kills, [v.share for v in verbs], number)
            show(f"{verb.name}: {kills} kills")
            if kills:
                rows[verb.name] = trials(verb, kills, base, address, base.parent, rng)
                print("\n".join([page(rows)[-2], *rows[verb.name].wrong]), file=sys.stderr, flush=True)
    show("")
    print("\n".join(page(rows)))
    sys.exit(1 if any(row.wrong for row in rows.values()) else 0)


def kills_of(total: int, shares: list[int], number: int) -> int:
    """How often one of several commands is killed."""
    ends = [round(total * sum(shares[:k]) / sum(shares)) for k in (number, number + 1)]
    return ends[1] - ends[0]


def page(rows: Mapping[str, Row]) -> list[str]:
    """The table, with a last row of sums."""
    head = ("command", "s", "kills", "KILL, TERM, INT", "before", "after", "each before or after", "between",
            "something left", "after the next run", "unclean end")  # fmt: skip
    keys = ("before", "after", "each", "BETWEEN", "left", "behind", "unclean")
    lines, total = [], Counter[str]()
    for name, row in rows.items():
        lines.append([name, f"{row.known.seconds:.1f}", *_cells(row.counts, keys)])
        total += row.counts
    return table(head, [*lines, ["all", "", *_cells(total, keys)]])


def _cells(counts: Counter[str], keys: tuple[str, ...]) -> list[str]:
    signals = [counts[kind.name] for kind in dict.fromkeys(SIGNALS)]
    return [str(sum(signals)), ", ".join(map(str, signals)), *(str(counts[key]) for key in keys)]


if __name__ == "__main__":
    main()

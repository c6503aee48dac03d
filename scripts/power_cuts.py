"""Trace every command that writes, and judge what a power cut would leave at random moments of its run.

    python scripts/power_cuts.py --cuts 100 > table.md

strace records what the command asks of the system. Of a cut the worst is assumed: content is lost that no fsync of its
file has followed, names that no fsync of their folder has; and either may have come to the disk before the other. What
takes the place of a result must therefore be on the disk before its rename, and what was there must not be taken away
before the rename is. Projects change by SQLite's own journal (synchronous = FULL), the record of a batch by checksummed
lines: their files are left out. The commands are those of kills.toml.
"""

import os
import random
import re
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

from kills import VERBS, Verb, age, fresh, inputs, needed_inputs, run
from study import at_least, command, show, table

_CALLS = (
    "openat,write,pwrite64,writev,pwritev,ftruncate,copy_file_range,sendfile,fsync,fdatasync,rename,renameat,renameat2,"
    "unlink,unlinkat,rmdir,mkdir,mkdirat,close"
)
_LINE = re.compile(r"\d+ +(\w+)\((.*)\) += (\d+)(?:<(.*)>)?$")
_RESUMED = re.compile(r"<\.\.\. \w+ resumed>(.*)")
_PATHS = re.compile(r'<([^>]*)>|"((?:[^"\\]|\\.)*)"')
_JOURNALED = re.compile(r"project\.sqlite(-journal)?|campaign\.jsonl")
_UNFINISHED = re.compile(r"\.[^/]+\.[0-9a-f]{8}\.(unfinished|replaced)(/|$)|\.part(\.json)?$")


class Event(NamedTuple):
    """A system call that changes files, or brings them to the disk."""

    call: str
    path: str
    other: str = ""
    """New name."""


class Disk:
    """Files and folders whose last changes are not on the disk yet, and what a cut would leave."""

    def __init__(self) -> None:
        self.changed = set[str]()
        self.renamed = dict[str, str]()
        """Results whose rename is not on the disk: the folder that has to be synced."""
        self.lost = ""
        """Why neither the former nor the new result is sure to be there; empty while one is."""

    def take(self, event: Event) -> None:
        """One more call."""
        call, path, parent = event.call, event.path, str(Path(event.path).parent)
        if call == "sync":
            self.changed.discard(path)
            self.renamed = {result: folder for result, folder in self.renamed.items() if folder != path}
        elif call == "write":
            self.changed |= {path}
            if not _UNFINISHED.search(path):
                self.lost = self.lost or f"{path} is written in place"
        elif call == "rename":
            if not _UNFINISHED.search(event.other):
                inside = [name for name in self.changed if name == path or name.startswith(f"{path}/")]
                self.lost = self.lost or (f"{event.other} takes its place before {inside[0]}" if inside else "")
                self.renamed[event.other] = str(Path(event.other).parent)
            moved = {name for name in self.changed if name == path or name.startswith(f"{path}/")}
            self.changed = self.changed - moved | {event.other + name[len(path) :] for name in moved}
            self.changed |= {parent, str(Path(event.other).parent)}
        else:  # remove
            if self.renamed and _UNFINISHED.search(path) and ".part" not in path:
                self.lost = self.lost or f"{path} goes before the rename of {next(iter(self.renamed))} is on the disk"
            self.changed |= {parent}
            self.changed -= {path}


def traced(arguments: list[str], work: Path, log: Path) -> list[Event]:
    """Run a command under strace; its events in the folder of the trial."""
    words = ["strace", "-f", "-y", "-qq", "-s", "0", "-e", f"trace={_CALLS}", "-e", "signal=none", "-o", str(log)]
    environment = os.environ | {"TMPDIR": str(log.parent)}
    done = subprocess.run(
        [*words, sys.executable, "-m", "mgsgraph", *arguments],
        cwd=work, env=environment, capture_output=True, text=True, check=False,
    )  # fmt: skip
    if done.returncode not in (0, 1) or "error" in done.stderr:
        raise SystemExit(f"{arguments}: {done.stderr}")
    return events(log.read_text(encoding="utf-8", errors="replace"), work)


def events(text: str, work: Path) -> list[Event]:
    """What a trace says of files below a folder."""
    found, begun = list[Event](), dict[str, str]()
    for line in text.splitlines():
        process, _, rest = line.partition(" ")
        if rest.endswith("<unfinished ...>"):  # another thread's call comes between
            begun[process] = rest.removesuffix("<unfinished ...>")
            continue
        if resumed := _RESUMED.match(rest.strip()):
            line = f"{process} {begun.pop(process, '')}{resumed[1]}"
        match = _LINE.match(line)
        if match is None:  # failed, or resumed
            continue
        call, arguments, _, opened = match.groups()
        paths = [opened_ or os.path.normpath(work / quoted) for opened_, quoted in _PATHS.findall(arguments)]
        paths = [path for path in paths if path.startswith(f"{work}/")]
        if call == "openat":
            if re.search(r"O_(TRUNC|CREAT)", arguments) and opened and opened.startswith(f"{work}/"):
                found.append(Event("write", opened))
        elif call in ("fsync", "fdatasync"):
            found += [Event("sync", path) for path in (paths or [str(work)])[:1]]
        elif call.startswith("rename") and len(paths) >= 2:
            found.append(Event("rename", *paths[-2:]))
        elif call in ("unlink", "unlinkat", "rmdir"):
            found += [Event("remove", path) for path in paths[-1:]]
        elif call not in ("close", "mkdir", "mkdirat"):
            found += [Event("write", path) for path in paths[:1]]
    return [event for event in found if not _JOURNALED.search(event.path)]


def cuts(verb: Verb, count: int, base: Path, address: str, rng: random.Random) -> tuple[int, int, str]:
    """Events of a command that replaces an earlier result, cuts that leave one of the two whole, and what else is."""
    arguments = verb.arguments.replace("ADDRESS", address).split()
    work = fresh(needed_inputs(base, base.parent / "needed", verb), base.parent / "cut").resolve()
    if verb.earlier:
        run(arguments, work)
        age(work, verb)
    seen = traced(arguments, work, base.parent / "strace.log")
    whole, wrong = 0, ""
    for moment in sorted(rng.randrange(len(seen) + 1) for _ in range(count)):
        disk = Disk()
        for event in seen[:moment]:
            disk.take(event)
        whole, wrong = whole + (not disk.lost), wrong or disk.lost
    return len(seen), whole, wrong


def main() -> None:
    """As said above."""
    parser = command(__doc__)
    parser.add_argument("--cuts", type=at_least(1), default=100, help="of each command")
    parser.add_argument("--seed", type=at_least(0), default=1)
    parser.add_argument("--only", nargs="*", metavar="COMMAND", help="these alone, by the table's names")
    options = parser.parse_args()
    rows, rng = list[list[str]](), random.Random(options.seed)
    with inputs() as (base, address):
        for verb in [verb for verb in VERBS if options.only is None or verb.name in options.only]:
            show(verb.name)
            count, whole, wrong = cuts(verb, options.cuts, base, address, rng)
            rows.append([verb.name, str(count), str(options.cuts), str(whole), wrong.replace(str(base.parent), "")])
            print(*rows[-1], sep=" | ", file=sys.stderr, flush=True)
    show("")
    print("\n".join(table(("command", "events", "cuts", "before or after", "else"), rows)))
    sys.exit(1 if any(row[-1] for row in rows) else 0)


if __name__ == "__main__":
    main()

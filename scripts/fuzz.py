"""Damage files of every kind that the program reads, and command lines; read each, and count what comes of it.

    python scripts/fuzz.py --inputs 1000000 --seconds 1500 --page docs/hostile_files.md
    python scripts/fuzz.py --reader "match file" --seconds 20 --keep /tmp/findings

Every file is read in a worker process with 2 GB of memory beyond what it has, and killed after 10 s. The same --seed
makes the same files: file 17 of a reader is the same whatever else is read. What ends badly is made as small as it
goes; --keep takes it, as files and as a findings.json for tests/fuzz. Exit status 1 if anything ended badly.
"""

import json
import os
import sys
import time
from collections.abc import Sequence
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # a fork has no other threads
os.environ.setdefault("NUMBA_NUM_THREADS", "1")
os.environ.setdefault("PROJ_DEBUG", "0")  # as the program has it where it imports rasterio
sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))  # their writers of files

from fuzz_campaign import Campaign, require_sound
from fuzz_commands import warm
from fuzz_judging import JUDGES
from fuzz_minimal import edited, minimal, outcome_apart
from fuzz_page import page
from fuzz_readers import every
from fuzz_trials import GOOD, Reader, Tally, content_of
from study import at_least, command, positive, show, status, write_text


def main() -> None:
    """Command line."""
    parser = command(__doc__)
    parser.add_argument("--reader", action="append", default=[], help="readers whose names hold this; may be repeated")
    parser.add_argument("--inputs", type=at_least(1), default=10_000_000, help="files and command lines to try")
    parser.add_argument("--seconds", type=positive, default=60.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=at_least(1), default=os.cpu_count() or 1)
    parser.add_argument("--keep", type=Path, help="folder for what ended badly")
    parser.add_argument("--page", type=Path, help="Markdown file for the tables")
    parser.add_argument("--list", action="store_true", help="name the readers and end")
    wanted = parser.parse_args()

    def job() -> int:
        readers = every(wanted.reader, JUDGES)
        if wanted.list:
            print("\n".join(f"{reader.name}, {len(reader.seed.files[reader.seed.main])} bytes" for reader in readers))
            return 0
        if any(reader.name.startswith("mgsgraph ") for reader in readers):
            warm()
        require_sound(readers)
        campaign, began = Campaign(readers, wanted.seed, wanted.jobs), time.monotonic()
        campaign.run(wanted.inputs, wanted.seconds, show)
        seconds = time.monotonic() - began
        show("")
        again = _again(readers, campaign.tallies, wanted.seed)
        for reader, tally in zip(readers, campaign.tallies, strict=True):
            _print(reader, tally)
        print(f"{campaign.inputs} files in {seconds:.0f} s", flush=True)
        if wanted.page:
            write_text(page(readers, campaign.tallies, again, seconds, wanted.seed), wanted.page)
        if wanted.keep:
            _keep(readers, campaign.tallies, wanted.seed, wanted.keep)
        return int(any(end not in GOOD for tally in campaign.tallies for end in tally.ends))

    sys.exit(status(parser.prog, job))


def _again(readers: Sequence[Reader], tallies: Sequence[Tally], seed: int) -> dict[tuple[str, str], bool]:
    """Of each reader and kind of bad end, whether the file ends badly in a process of its own, too: what a library has
    left behind, or another process on the machine, may have ended it.
    """
    found = dict[tuple[str, str], bool]()
    for reader, tally in zip(readers, tallies, strict=True):
        for number, outcome in tally.found:
            if (reader.name, outcome.key) not in found:
                apart = outcome_apart(reader, content_of(reader, seed, number)[0])
                found[reader.name, outcome.key] = apart.end not in GOOD
    return found


def _print(reader: Reader, tally: Tally) -> None:
    ends = ", ".join(f"{count} {end}" for end, count in tally.ends.items())
    print(f"{reader.name}: {tally.ends.total()} in {tally.seconds:.1f} s, slowest {tally.slowest:.2f} s: {ends}")
    for number, outcome in tally.found:
        print(f"    {number}: {outcome.end}: {outcome.key} | {outcome.words[:200]!r}")


def _keep(readers: Sequence[Reader], tallies: Sequence[Tally], seed: int, folder: Path) -> None:
    """One of each kind of what ended badly, made as small as it goes."""
    folder.mkdir(parents=True, exist_ok=True)
    kept = list[dict[str, object]]()
    for reader, tally in zip(readers, tallies, strict=True):
        for number, outcome in {outcome.key: (number, outcome) for number, outcome in tally.found}.values():
            data, kind = content_of(reader, seed, number)
            changes, sure = minimal(reader, data, outcome)
            sound = reader.seed.files[reader.seed.main]
            name = f"{reader.name}_{number}_{Path(reader.seed.main).name}".replace("/", "_").replace(" ", "_")
            (folder / name).write_bytes(edited(sound, changes) if sure else data)
            kept.append({
                "reader": reader.name, "owner": reader.owner, "end": str(outcome.end), "key": outcome.key,
                "words": outcome.words,
                "damage": kind, "file": name, "again": sure,
                "edits": [[one.start, one.stop, one.new.decode("latin-1")] for one in changes],
            })  # fmt: skip
            show(f"{len(kept)} kept")
    (folder / "findings.json").write_text(json.dumps(kept, indent=1) + "\n", encoding="utf-8")
    show("")


if __name__ == "__main__":
    main()

"""The page about hostile files: what was tried, how often, what came of it, and what a user can rely on."""

from collections import Counter
from collections.abc import Mapping, Sequence

from fuzz_trials import GOOD, MEMORY, End, Reader, Tally
from study import machine, made_with, table

_HEAD = """\
# Files from strangers

What becomes of a file that is damaged, cut short, swapped for another, or made to harm. Written by `scripts/fuzz.py`:
the prose is the same for every run, the numbers are those of the last one.

## What one can rely on

* A file that can't be used is refused in one line that names it, with exit status 2, and nothing is written. The line
  holds no character that moves a terminal's cursor or turns the direction of writing, whatever is in the file or in
  its name.
* What is no regular file (a folder, a pipe, a device, a socket) is not read. Sizes that a file states of itself are
  held against the file before memory is taken for them; nesting, digits, names and what gzip unpacks have limits.
* What is read is what the file says. A value that is no finite number is refused where the format demands one; where
  a format has gaps (posts of terrain models, shots without a range, measures without a sigma) they stay gaps.
* What the file itself or the body can contradict is held against them: counts, units, radii, ranges against places,
  addresses against lengths.

**These may come from strangers**: networks ({networks}), support data, model states, cubes and labels, tables of
shots and places, PEDR and LOLA's records, MEGDR, GeoTIFF, PNG and JPEG, verdicts, case files, SPICE kernels (read in
a process of their own, for CSPICE ends the one that it is in on some that are damaged).

## What is not promised

* *Lies that fit.* A number changed to another that could be true is taken as it stands: a flipped digit of a tie
  point is a blunder, which the adjustment may or may not find. Fetched files have checksums in `fetch.store`;
  projects, results, tiles and records have their own.
* *Malice in what the program keeps.* These checksums tell damage ([](incremental.md), `scripts/bit_flips.py`), not an
  enemy who writes them anew. Take projects and results from people whom you trust; networks, cases and data from
  anybody.
* *Libraries of others.* Kernels are read by CSPICE, rasters by GDAL, binary networks by protobuf, projects by SQLite.
  Kind, structure and sizes are looked at before they are called; what they do then is theirs.
* *Case files name other files.* Whoever runs a stranger's case lets it read the files that it names, as far as the
  system allows; it writes none but those of `--out`.
* *Time.* Large sound files take long, and a hostile one may take as long as a sound one of its size.

## What was tried

Each reader of outside files has a small sound file of its format, written by the simulator or the tests' writers, or
cut out of real data. It is damaged in one place, seldom in up to four: bits flipped, bytes overwritten, cut out, put
in and repeated, stretches blanked, ends cut; in text numbers put into other units or replaced by NaN, infinities,
1e308, nothing or 5,000 digits, names by paths, scripts and escapes, tokens swapped, lines twice or elsewhere, nesting
to 20,000 levels, dotted keys, long lines, control characters, other encodings and ends of lines; and in its
structure, checksums right: values, keys and lists of JSON, assignments of PVL, cells and columns of tables, fields of
records, members, shapes and types of NumPy archives, cells of SQLite, tags of TIFF, file records, summaries and
addresses of SPICE kernels, fields of protobuf's messages, what gzip packs, and bombs.

Each is read in a worker process with {memory:.0f} GB beyond its own and a watchdog of 10 s (60 s for commands, which
draw and adjust). Command lines get odd options and values, and files of another kind, missing ones, folders, pipes,
devices, loops of links, and names that are no text; they run as an ordinary user with a home of its own, and refusals
have to leave the folder as it was.
"""
_ENDS = """\
* *as undamaged*: the same result as of the sound file, to the last bit.
* *independent*: another result, and the one that another reading of the damaged file finds (struct, json, csv and
  NumPy by the formats' descriptions, without this program's code).
* *not judged*: accepted, with finite numbers; no other reading at hand that could say whether they are the file's. By
  kinds of damage below.
* *clear error*: one line that names the file, without control characters, below 2,000 characters.
* *other*: traceback, signal, too long, over 2 GB, a warning printed, an unclear error, or another number than the
  independent reading's.
"""
_WHY = (
    ("kind of", "another kind of file, or none: nothing is read"),
    ("mgsgraph new", "another case file, or one without that file, which is said"),
    ("mgsgraph ", "words that are right, or that change nothing"),
    ("text kernel", "other numbers of the kernel, as CSPICE takes them"),
    ("binary kernel", "other numbers of the kernel, as CSPICE takes them"),
    ("image with", "another time or name in the label"),
    ("meta-kernel", "other texts in it"),
    ("whole case", "other sigmas, choices or names; ties and laser as they are"),
    ("case file", "keys of TOML that stand elsewhere in the record"),
    ("label of", "other values of keys, which the readers of cubes judge"),
    ("line-scan label", "other values of keys: names, times, lengths of lines that can be"),
    ("line times", "other times within 1 s of the label's"),
    ("terrain", "other heights and places of a grid, still on the body"),
    ("pixels of MOC", "other pixels, or other values of keys"),
    ("picture", "other pixels; packed ones that another reader can't have"),
    ("PEDR", "fields whose other value can be: the count of shots is right"),
    ("index", "other ids, or none"),
    ("instrument kernel", "another focal length"),
    ("result's networks", "no network, which is said"),
    ("", "what the independent reading doesn't understand: two of a key, other quotation marks, comments"),
)
"""What damage comes to that is accepted and not judged, by the beginnings of readers' names."""


def page(
    readers: Sequence[Reader], tallies: Sequence[Tally], again: Mapping[tuple[str, str], bool], seconds: float,
    seed: int
) -> str:
    """All of it; `again` says of readers and bad ends whether they come again in a process of their own."""
    files = [k for k, reader in enumerate(readers) if not reader.name.startswith("mgsgraph ")]
    commands = [k for k in range(len(readers)) if k not in files]
    networks = ", ".join(
        reader.name.removeprefix("network, ") for reader in readers if reader.name.startswith("network, ")
    )
    ends = sum((tally.ends for tally in tallies), Counter[str]())
    lines = [
        _HEAD.format(memory=MEMORY / 2**30, networks=networks),
        f"In all {ends.total():,} inputs of {len(readers)} readers in {seconds / 60.0:.0f} minutes (seed {seed}): "
        f"{ends[End.REFUSED]:,} refused with a clear error, {ends[End.SAME]:,} read as if undamaged, "
        f"{ends[End.RIGHT]:,} as an independent reading has them, {ends[End.SOUND]:,} accepted and not judged, "
        f"{_others(ends):,} other.",
        "", *_table([readers[k] for k in files], [tallies[k] for k in files], "reader"), "", _ENDS,
        "## Command lines", "", *_table([readers[k] for k in commands], [tallies[k] for k in commands], "verb"), "",
        "## Accepted and not judged", "", *_unjudged(readers, tallies), "", "## Other ends", "",
        *_found(readers, tallies, again), "",
        f"{made_with()} On {machine()}.", "",
    ]  # fmt: skip
    return "\n".join(lines)


def _others(ends: Counter[str]) -> int:
    return sum(count for end, count in ends.items() if end not in GOOD)


def _table(readers: Sequence[Reader], tallies: Sequence[Tally], what: str) -> list[str]:
    head = (what, "inputs", "as undamaged", "independent", "not judged", "clear error", "other", "slowest, s")
    return table(head, [
        [reader.name, f"{tally.ends.total():,}", *(f"{tally.ends[end]:,}" for end in GOOD), f"{_others(tally.ends):,}",
         f"{tally.slowest:.2f}"]
        for reader, tally in zip(readers, tallies, strict=True)
    ])  # fmt: skip


def _unjudged(readers: Sequence[Reader], tallies: Sequence[Tally]) -> list[str]:
    """By reader the kinds of damage that were accepted most often."""
    rows = [
        [reader.name, f"{tally.unjudged.total():,}",
         "; ".join(f"{kind} {count:,}" for kind, count in _by_kind(tally.unjudged).most_common(6)), _why(reader)]
        for reader, tally in zip(readers, tallies, strict=True) if tally.unjudged
    ]  # fmt: skip
    return table(("reader", "inputs", "kinds of damage", "what they come to"), rows)


def _why(reader: Reader) -> str:
    return next(words for beginning, words in _WHY if reader.name.startswith(beginning))


def _by_kind(counts: Counter[str]) -> Counter[str]:
    found = Counter[str]()
    for kinds, count in counts.items():
        for kind in kinds.split(", "):
            found[kind] += count
    return found


def _found(
    readers: Sequence[Reader], tallies: Sequence[Tally], again: Mapping[tuple[str, str], bool]
) -> list[str]:
    rows = []
    for reader, tally in zip(readers, tallies, strict=True):
        for key, end in dict.fromkeys((outcome.key, str(outcome.end)) for _, outcome in tally.found):
            sure = "yes" if again.get((reader.name, key)) else "no"
            rows.append([reader.name, end, " ".join(key.replace("|", " ").split())[:100], sure])
    return table(("reader", "end", "where", "again, in a process of its own"), rows) if rows else ["None."]

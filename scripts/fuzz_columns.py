"""Damage files that are read by columns, and read each of them line by line, too: both must give the same, to the last
bit, or refuse it in the same line.

    python scripts/fuzz_columns.py --inputs 10000
    python scripts/fuzz_columns.py --reader ties --inputs 100000 --seed 2

The same --seed makes the same files. Exit status 1 where any two readings differ.
"""

import random
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))  # both readers

import warnings

from both_readers import Readable, by_lines, outcome, readables
from fuzz_mutations import BYTES, NUMBER, TEXT, Change, mutated
from study import at_least, command, show, status

_PIECES = (
    b" ", b"   ", b"\t", b"\n", b"\r\n", b"# a\n", b",", b'"', "é".encode(), "\xa0".encode(), b"\x1c",
    "\u2028".encode(),
)  # fmt: skip
"""What may stand about the marks between fields."""


def digits(data: bytearray, rng: random.Random) -> str:
    """Another number, or the same one in other digits."""
    found = rng.choice(list(NUMBER.finditer(data)))
    old, tail = found[0], "".join(rng.choice("0123456789") for _ in range(rng.choice((1, 3, 9, 17, 25)))).encode()
    longer = old + tail if b"." in old else old + b"." + tail
    others = (longer, longer, old + b"e0", b"-0", b"+" + old.lstrip(b"-"), old + b".", b"00" + old, old + b"e-1")
    data[found.start() : found.end()] = rng.choice(others)
    return "other digits"


def blanks(data: bytearray, rng: random.Random) -> str:
    """A piece beside a mark between fields."""
    marks = [k for k, byte in enumerate(data) if byte in b",:\n"]
    place = rng.choice(marks) + rng.randrange(2)
    data[place:place] = rng.choice(_PIECES)
    return "blanks"


def damaged(one: Readable, rng: random.Random) -> bytes:
    """A file's content after some damage."""
    changes: Sequence[Change] = BYTES if b"\0" in one.content else (*TEXT, digits, digits, blanks)
    while True:
        content, _ = mutated(one.content, changes, rng)
        try:
            return one.form(content)
        except ValueError:  # no table of which a file of another form could be made
            continue


def differing(kind: str, one: Readable, count: int, seed: int, folder: Path) -> tuple[list[int], int]:
    """Numbers of the damaged files of which both readers say other things, and how many are read after all."""
    path, read, differ = folder / one.name, 0, list[int]()
    for k in range(count):
        path.write_bytes(damaged(one, random.Random(f"{seed}:{kind}:{k}")))
        found = outcome(one.read, path)
        with by_lines():
            expected = outcome(one.read, path)
        read += not isinstance(found, str)
        if found != expected:
            differ.append(k)
            print(f"{kind}, file {k}: {str(found)[:300]} | {str(expected)[:300]}", flush=True)
    return differ, read


def main() -> None:
    """Command line."""
    parser = command(__doc__)
    parser.add_argument("--reader", default="", help="files whose kind's name holds this")
    parser.add_argument("--inputs", type=at_least(1), default=1000, help="damaged files of each kind")
    parser.add_argument("--seed", type=int, default=1)
    wanted = parser.parse_args()

    def job() -> int:
        bad = 0
        with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of numbers that are none, in readers line by line
            for kind, one in readables().items():
                if wanted.reader in kind:
                    differ, read = differing(kind, one, wanted.inputs, wanted.seed, Path(folder))
                    print(f"{kind}: {wanted.inputs} files, {read} read, {len(differ)} differ", flush=True)
                    bad += len(differ)
        show("")
        return int(bad > 0)

    sys.exit(status(parser.prog, job))


if __name__ == "__main__":
    main()

"""Damage a file at random, read it each time, and count: a clear error or a result, nothing else, in bounded memory.

    python scripts/fuzz_exchange.py mgsgraph.io.control.network_file:read_network network.net --mutations 10000

The reader takes a path. Whatever it raises but InputError ends the run with that file kept; a crash or more memory than
allowed ends the process. --label says how many of the file's first bytes hold a padded label: half of the damage is
done to its first part and half to what follows it, none to the padding.
"""

import importlib
import random
import resource
import sys
import tempfile
import time
import tracemalloc
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

from study import command

from mgsgraph.errors import InputError

HUGE = (b"\xff\xff\xff\x7f", b"\xff\xff\xff\xff", b"\xff" * 9 + b"\x01", b"99999999999", b"1e308", b"nan", b"-1")
"""Sizes and numbers that are believed at one's peril."""


def mutated(seed: bytes, label: int, rng: random.Random) -> bytes:
    """The content with one to five places overwritten, cut out or enlarged, or cut short."""
    data = bytearray(seed)
    written = len(seed[:label].rstrip(b"\0"))
    for _ in range(rng.randint(1, 5)):
        place = rng.randrange(written) if label and rng.random() < 0.5 else rng.randrange(label, len(data) + 1)
        kind = rng.randrange(6)
        if kind == 0:
            data[place : place + 1] = bytes([rng.randrange(256)])
        elif kind == 1:
            data[place : place + 1] = bytes([data[place] ^ 1 << rng.randrange(8)]) if place < len(data) else b""
        elif kind == 2:
            del data[place : place + rng.randint(1, 40)]
        elif kind == 3:
            data[place:place] = rng.randbytes(rng.randint(1, 40))
        elif kind == 4:
            change = rng.choice(HUGE)
            data[place : place + len(change)] = change
        else:
            end = place + rng.randint(1, 200)
            data[place:place] = data[place:end]
    return bytes(data[: rng.randrange(len(data))] if rng.random() < 0.05 else data)


def reader(name: str) -> Callable[[Path], Any]:
    """The function module:function."""
    module, function = name.split(":")
    found: Callable[[Path], Any] = getattr(importlib.import_module(module), function)
    return found


def campaign(read: Callable[[Path], Any], seed: Path, mutations: int, label: int, rng: random.Random) -> None:
    """Read that many damaged copies of a file, and print what came of them."""
    content, outcomes, slowest = seed.read_bytes(), Counter[str](), 0.0
    read(seed)
    tracemalloc.start()
    read(seed)
    whole = tracemalloc.get_traced_memory()[1]
    tracemalloc.reset_peak()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / seed.name
        for number in range(mutations):
            data = mutated(content, label, rng)
            path.write_bytes(data)
            start = time.perf_counter()
            try:
                read(path)
                outcomes["read"] += 1
            except InputError as error:
                outcomes["refused"] += 1
                if "\n" in str(error) or str(path) not in str(error):
                    found = f"mutation {number}: an error of many lines, or without the file: {error}"
                    raise SystemExit(found) from None
            except Exception as error:
                kept = Path(tempfile.gettempdir()) / f"fuzz_{number}_{seed.name}"
                kept.write_bytes(data)
                raise SystemExit(f"mutation {number}, kept as {kept}: {type(error).__name__}: {error}") from error
            slowest = max(slowest, time.perf_counter() - start)
    peak = tracemalloc.get_traced_memory()[1]
    resident = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"{seed.name}: {mutations} mutations: {dict(outcomes)}; slowest {slowest:.3f} s; peak of Python's memory "
          f"{peak / 1e6:.2f} MB (undamaged {whole / 1e6:.2f} MB); resident {resident:.0f} MB")


def main() -> None:
    """Command line."""
    parser = command(__doc__)
    parser.add_argument("reader", help="module:function that takes a path")
    parser.add_argument("seeds", nargs="+", type=Path, help="files that it can read")
    parser.add_argument("--mutations", type=int, default=10_000)
    parser.add_argument("--label", type=int, default=0, help="bytes of a padded label at the file's start")
    parser.add_argument("--memory", type=int, default=2048, help="address space that the process may have, MB")
    parser.add_argument("--seed", type=int, default=8)
    wanted = parser.parse_args()
    resource.setrlimit(resource.RLIMIT_AS, (wanted.memory << 20, wanted.memory << 20))
    sys.setrecursionlimit(1000)
    for seed in wanted.seeds:
        campaign(reader(wanted.reader), seed, wanted.mutations, wanted.label, random.Random(wanted.seed))


if __name__ == "__main__":
    main()

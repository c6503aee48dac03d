"""The way of one measurement from its file to the kernel: `python scripts/measurement_path.py CASE FILE OFFSET BYTES`.

Two adjustments of a case are followed up to the first sweep; in the second, bytes of one of its files are others
(hex). A function is a station where a number, a text or an array in what it returns, fills in or builds differs
between the two and was in none before: what only looks at a measurement (`require_*`), hands it on or puts it in a
record is none; one that is called again (an iteration) is named once. Printed are the files in the order of the flow;
`<<` marks a return to a room that was left before.
"""

import hashlib
import shutil
import sys
import tempfile
from collections import Counter, defaultdict
from pathlib import Path
from typing import Any

import numpy as np

import mgsgraph
from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.case.reading import read_case

ROOT = Path(mgsgraph.__file__).resolve().parents[1]
END = "sweep_all"
Station = tuple[str, str, set[str]]
"""File, function, digests of the values in its result."""


class Arrived(BaseException):
    """The measurement is in the kernel."""


def digests(value: Any, depth: int = 0) -> set[str]:
    """Of the numbers, texts and arrays in a value, its parts and its fields."""
    if depth > 9 or value is None or callable(value):
        return set()
    if hasattr(value, "tobytes") and str(getattr(value, "dtype", "")) != "object":
        return {hashlib.md5(value.tobytes()).hexdigest()}
    if isinstance(value, bool | int | float | str | bytes):
        return {hashlib.md5(repr(value).encode()).hexdigest()}
    if hasattr(value, "tolist"):
        parts = value.tolist()
    elif isinstance(value, dict):
        parts = [*value, *value.values()]
    elif isinstance(value, list | tuple | set | frozenset):
        parts = value
    else:
        names = getattr(value, "__dict__", None) or dict.fromkeys(getattr(value, "__slots__", ()))
        parts = [getattr(value, name, None) for name in names]
    return set[str]().union(*(digests(part, depth + 1) for part in parts))


def stations(case: Path) -> list[Station]:
    """Functions that return new values, in the order of their ends, up to the first sweep."""
    passed: list[Station] = []
    begun: list[tuple[Any, list[str]]] = []

    def inputs(frame: Any) -> list[Any]:
        code = frame.f_code
        return [frame.f_locals.get(name) for name in code.co_varnames[: code.co_argcount + code.co_kwonlyargcount]]

    def follow(frame: Any, event: str, result: Any) -> None:
        code = frame.f_code
        if not code.co_filename.startswith(str(ROOT)) or code.co_name.startswith("<"):
            return
        place = str(Path(code.co_filename).relative_to(ROOT)), code.co_name
        if event == "call" and code.co_name == END:
            passed.append((*place, digests(inputs(frame))))
            raise Arrived
        if event == "call":
            begun.append((frame, [digests(value) if hasattr(value, "tobytes") else set() for value in inputs(frame)]))
        elif event == "return" and begun and begun[-1][0] is frame:
            values, (_, before) = inputs(frame), begun.pop()
            new = set() if any(result is value for value in values) else digests(result)
            new = new.union(*(digests(value) - old for value, old in zip(values, before, strict=True) if old))
            new |= digests(values[0]) if code.co_name in {"__init__", "__post_init__"} else set()
            if not any(caller.f_code.co_name.startswith("require_") for caller, _ in begun):
                passed.append((*place, new))

    sys.setprofile(follow)
    try:
        read = read_case(case)
        adjust_network(read.network, read.settings, read.name)
    except Arrived:
        pass
    finally:
        sys.setprofile(None)
    return passed


def room(file: str) -> str:
    return "/".join(Path(file).parts[:2])


np.empty = np.zeros  # uninitialized memory is no measurement


def main(case: Path, file: str, offset: int, content: bytes) -> None:
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "case"
        shutil.copytree(case.parent, copy)
        stations(copy / case.name)  # imports and caches shall not differ
        plain = stations(copy / case.name)
        changed = bytearray((copy / file).read_bytes())
        changed[offset : offset + len(content)] = content
        (copy / file).write_bytes(changed)
        altered = stations(copy / case.name)
    unchanged, times = defaultdict[tuple[str, str, int], set[str]](set), Counter[tuple[str, str]]()
    for *station, digests_found in altered:
        unchanged[*station, times[*station]] = digests_found
        times[*station] += 1
    times.clear()
    reported, rooms, stays = set[str](), [""], list[tuple[str, list[str]]]()
    for place, function, digests_found in plain:
        new = digests_found - unchanged[place, function, times[place, function]] - reported
        times[place, function] += 1
        if not new or any((place, function) == (stay, name) for stay, names in stays for name in names):
            reported |= new
            continue
        reported |= new
        if not stays or stays[-1][0] != place:
            stays.append((place, []))
        stays[-1][1].append(function)
    returns = 0
    for place, functions in stays:
        back = room(place) != rooms[-1] and room(place) in rooms
        returns += back
        rooms.append(room(place))
        print("<<" if back else "  ", place, ", ".join(dict.fromkeys(functions)))
    print(f"{len({place for place, _ in stays})} files, {len(stays)} stays, {returns} returns to a room left before")


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2], int(sys.argv[3]), bytes.fromhex(sys.argv[4]))

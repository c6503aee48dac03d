"""The way of one measurement from its file to the kernel: `python scripts/measurement_path.py CASE FILE OFFSET BYTES`.

Two adjustments of a case are followed up to the first sweep; in the second, bytes of one of its files are others
(hex). A function is a station where what it returns, fills in or builds differs between the two, and was not there
before: what only looks at a measurement, or hands it on, is none. Printed are the files in the order of the
flow; `<<` marks a return to a room that was left before.
"""

import hashlib
import shutil
import sys
import tempfile
from pathlib import Path
from typing import Any

import mgsgraph
from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.case.reading import read_case

ROOT = Path(mgsgraph.__file__).resolve().parents[1]
END = "sweep_all"
Station = tuple[str, str, str]
"""File, function, digest of what it made."""


class Arrived(BaseException):
    """The measurement is in the kernel."""


def digest(value: Any, depth: int = 0) -> str:
    """Of the numbers and texts in a value, its parts and its fields; empty where there are none."""
    if depth > 9 or value is None or callable(value):
        return ""
    if hasattr(value, "tobytes"):
        objects = str(getattr(value, "dtype", "")) == "object"
        content = digest(value.tolist(), depth + 1).encode() if objects else value.tobytes()
    elif isinstance(value, bool | int | float | str | bytes):
        content = repr(value).encode()
    elif isinstance(value, dict | list | tuple | set | frozenset):
        parts = value.items() if isinstance(value, dict) else value
        content = "".join(digest(part, depth + 1) for part in parts).encode()
    else:
        names = getattr(value, "__dict__", None) or dict.fromkeys(getattr(value, "__slots__", ()))
        content = "".join(digest(getattr(value, name, None), depth + 1) for name in names).encode()
    return hashlib.md5(content).hexdigest() if content else ""


def stations(case: Path) -> list[Station]:
    """What makes something new, in the order in which it ends, up to the first sweep."""
    found: list[Station] = []
    begun: list[tuple[Any, list[str]]] = []

    def given(frame: Any) -> list[Any]:
        code = frame.f_code
        return [frame.f_locals.get(name) for name in code.co_varnames[: code.co_argcount + code.co_kwonlyargcount]]

    def follow(frame: Any, event: str, result: Any) -> None:
        code = frame.f_code
        if not code.co_filename.startswith(str(ROOT)) or code.co_name.startswith("<"):
            return
        place = str(Path(code.co_filename).relative_to(ROOT)), code.co_name
        if event == "call" and code.co_name == END:
            found.append((*place, digest(given(frame))))
            raise Arrived
        if event == "call":
            begun.append((frame, [digest(value) if hasattr(value, "tobytes") else "" for value in given(frame)]))
        elif event == "return" and begun and begun[-1][0] is frame:
            values, (_, before) = given(frame), begun.pop()
            made = [] if any(result is value for value in values) else [digest(result)]
            made += [digest(value) for value, old in zip(values, before, strict=True) if old and digest(value) != old]
            made += [digest(values[0])] if code.co_name in {"__init__", "__post_init__"} else []
            found.append((*place, "".join(made)))

    sys.setprofile(follow)
    try:
        read = read_case(case)
        adjust_network(read.network, read.settings, read.name)
    except Arrived:
        pass
    finally:
        sys.setprofile(None)
    return found


def room(file: str) -> str:
    return "/".join(Path(file).parts[:2])


def main(case: Path, file: str, offset: int, content: bytes) -> None:
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "case"
        shutil.copytree(case.parent, copy)
        stations(copy / case.name)  # what is imported or kept for later is not to differ
        one = stations(copy / case.name)
        changed = bytearray((copy / file).read_bytes())
        changed[offset : offset + len(content)] = content
        (copy / file).write_bytes(changed)
        other = stations(copy / case.name)
    seen, rooms, stays = set[str](), [""], list[tuple[str, list[str]]]()
    for (place, function, made), (*there, differs) in zip(one, other, strict=True):
        assert there == [place, function]
        if made == differs or made in seen:
            continue
        seen.add(made)
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

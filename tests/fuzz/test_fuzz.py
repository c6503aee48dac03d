"""What fuzzing (scripts/fuzz.py) once found, as edits of sound files: each is refused in one clear line, or read.
Each is read in a process of its own. An edit is the bytes from one place to another and what takes their place, as runs
of hexadecimal digits and how often they stand there.
"""

import io
import json
import os
import sys
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from mgsgraph.errors import InputError, MgsgraphError

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"
if not SCRIPTS.is_dir():
    pytest.skip("scripts are not here", allow_module_level=True)
sys.path.append(str(SCRIPTS))

from fuzz import GOOD, End, hunt, judged  # noqa: E402
from fuzz_edits import FORMS, edited  # noqa: E402
from fuzz_readers import every  # noqa: E402
from fuzz_seeds import Reader, Seed  # noqa: E402

FINDINGS: list[dict[str, Any]] = json.loads(Path(__file__).with_name("findings.json").read_text(encoding="utf-8"))
pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of forks beside the threads of pytest-xdist


@cache
def reader(name: str) -> tuple[Reader, bytes]:
    """One reader and its sound file."""
    found = next(one for one in every([name]) if one.name == name)
    seed = found.seed()
    return found._replace(seed=lambda: seed), seed.files[seed.main]


def _marks(finding: dict[str, Any]) -> list[Any]:
    """Sound files that take seconds to make: a site with its kernels, results, projects and exports of a pair."""
    beginnings = ("mgsgraph ", "project", "result", "campaign", "text kernel", "binary kernel", "meta-kernel")
    return [pytest.mark.slow] if finding["reader"].startswith(beginnings) else []


@pytest.mark.parametrize(
    "finding", [pytest.param(one, id=f"{one['reader']}: {one['key']}", marks=_marks(one)) for one in FINDINGS]
)
def test_what_was_found_once_ends_well(finding: dict[str, Any]) -> None:
    given, data = reader(finding["reader"])
    for start, stop, runs in reversed(finding["edits"]):
        data = data[:start] + b"".join(bytes.fromhex(piece) * times for piece, times in runs) + data[stop:]
    outcome = judged(given, data)
    assert outcome.end in GOOD, outcome
    if finding["reader"] == "picture, PNG" and outcome.read:  # once other pixels than the file's
        pixels = np.asarray(Image.open(io.BytesIO(data)))
        assert outcome.read["#"] == (pixels.shape, pixels.dtype.str, pixels.tobytes())


# --- the fuzzer itself


def reading(read: Any, content: bytes = b"sound", **more: Any) -> Reader:
    """A reader made up here."""
    return Reader("made up", read, lambda: Seed({"a.txt": content}, "a.txt"), "text", **more)


def planted(path: Path) -> object:
    """Does all that a reader mustn't."""
    content = path.read_bytes()
    match content[:1]:
        case b"d":
            os.kill(os.getpid(), 11)
        case b"e":
            os._exit(0)
        case b"l":
            while True:
                pass
        case b"m":
            return bytes(3 << 30)
        case b"p":
            os.write(2, b"library says hello\n")
        case b"w":
            return float(np.float64(1e308) * 10.0)
        case b"v":
            raise ValueError("a v")
        case b"n":
            raise MgsgraphError("no name of a file here")
        case b"b":
            raise MgsgraphError(f"{path}: a bell \x07")
        case b"h":
            path.with_name("half").write_bytes(content)
            raise InputError(str(path), "an h")
        case b"r":
            raise InputError(str(path), "an r")
        case b"i":
            return {"number": float("inf")}
    return content


@pytest.mark.parametrize(
    ("content", "end"),
    [
        ("d", End.SIGNAL), ("e", End.SIGNAL), ("l", End.HANG), ("m", End.MEMORY), ("p", End.PRINTED),
        ("w", End.PRINTED), ("v", End.RAISED), ("n", End.UNCLEAR), ("b", End.UNCLEAR), ("h", End.WRITTEN),
        ("r", End.REFUSED), ("i", End.WRONG), ("sound", End.READ), ("soun", End.READ),
    ],
)  # fmt: skip
def test_every_end_is_told(content: str, end: End) -> None:
    assert judged(reading(planted, patience=1.0), content.encode()).end is end
    if content == "soun":
        assert judged(reading(planted, same=True), content.encode()).end is End.WRONG


@pytest.mark.parametrize("end", [End.RAISED, pytest.param(End.PRINTED, marks=pytest.mark.slow)])
def test_what_is_planted_is_found_and_made_small(end: End) -> None:
    """One digit alone is left of the damage. A process for every file: some seconds where processors are shared."""

    def read(path: Path) -> None:
        if b"0" in path.read_bytes():
            if end is End.RAISED:
                raise ValueError("a zero is odd")
            print("a zero is odd")

    sound = b"key = 1\nother = 2\n"
    ends, finding = hunt(reading(read, sound), 60.0)
    assert finding is not None
    assert ends[end]
    assert finding["end"] == end
    ((start, stop, ((new, _),)),) = finding["edits"]
    assert bytes.fromhex(new) == b"0"
    assert stop - start <= len("other")


@given(st.data())
@pytest.mark.parametrize("form", sorted(set(FORMS) - {"words"}))
def test_damage_of_every_form_is_bytes_and_other_than_the_file(form: str, data: st.DataObject) -> None:
    sound = b'{"a": [1.5, 2, {"b": "c"}]}\nkey = 1, 2\n'
    assert isinstance(data.draw(edited(sound, form)), bytes)

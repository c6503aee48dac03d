"""What the campaign of scripts/fuzz.py once found, as edits of sound files: each is refused in one clear line, or read
as it should be. Each is read in a process of its own, as the campaign does. An edit is the bytes from one place to
another and what takes their place, as runs of hexadecimal digits and how often they stand there.
"""

import json
import os
import random
import struct
import subprocess
import sys
import zlib
from functools import cache
from pathlib import Path
from typing import Any

import pytest

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"
if not SCRIPTS.is_dir():
    pytest.skip("scripts are not here", allow_module_level=True)
sys.path.append(str(SCRIPTS))

from fuzz_judging import JUDGES  # noqa: E402
from fuzz_minimal import Edit, edited, edits, minimal, outcome_apart  # noqa: E402
from fuzz_readers import every  # noqa: E402
from fuzz_trials import GOOD, End, Reader, content_of  # noqa: E402

FINDINGS: list[dict[str, Any]] = json.loads(Path(__file__).with_name("findings.json").read_text(encoding="utf-8"))
pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of forks beside the threads of pytest-xdist


@cache
def reader(name: str) -> Reader:
    """One reader and its seed."""
    return next(one for one in every([name], JUDGES) if one.name == name)


def _marks(finding: dict[str, Any]) -> list[Any]:
    """Sound files that take seconds to make: a site with its kernels, results, projects and exports of a pair."""
    beginnings = ("mgsgraph ", "project", "result", "campaign", "text kernel", "binary kernel",
    "meta-kernel")
    return [pytest.mark.slow] if finding["reader"].startswith(beginnings) else []


@pytest.mark.parametrize(
    "finding", [pytest.param(one, id=f"{one['reader']}: {one['key']}", marks=_marks(one)) for one in FINDINGS]
)
def test_what_was_found_once_ends_well(finding: dict[str, Any]) -> None:
    given = reader(finding["reader"])
    sound = given.seed.files[given.seed.main]
    changes = [
        Edit(start, stop, b"".join(bytes.fromhex(piece) * times for piece, times in runs))
        for start, stop, runs in finding["edits"]
    ]
    outcome = outcome_apart(given, edited(sound, changes))
    assert outcome.end in GOOD, outcome


# --- the campaign itself


def reading(read: Any, content: bytes = b"sound", **more: Any) -> Reader:
    """A reader made up here."""
    from fuzz_mutations import TEXT
    from fuzz_trials import Seed

    return Reader("made up", read, Seed({"a.txt": content}, "a.txt"), TEXT, **more)


def _dies(path: Path) -> bytes:
    content = path.read_bytes()
    if b"x" in content:
        os.kill(os.getpid(), 11)
    return content


def _takes_memory(path: Path) -> bytes:
    return bytes(3 << 30) if b"x" in path.read_bytes() else b""


def _warns(path: Path) -> bytes:
    import numpy as np

    return np.float64(1e308 * (b"x" in path.read_bytes())).__mul__(10.0).tobytes()


def _prints(path: Path) -> bytes:
    content = path.read_bytes()
    if b"x" in content:
        os.write(2, b"library says hello\n")
    return content


def _raises(path: Path) -> bytes:
    from mgsgraph.errors import MgsgraphError

    content = path.read_bytes()
    if b"x" in content:
        raise KeyError("x")
    if b"y" in content:
        raise MgsgraphError("no name of a file here")
    if b"z" in content:
        raise MgsgraphError(f"{path}: a bell \x07")
    if b"m" in content:
        raise MgsgraphError(f"{path}: a clear error")
    return content


@pytest.mark.parametrize(
    ("read", "content", "end"),
    [
        (_dies, b"x", End.SIGNAL), (_takes_memory, b"x", End.MEMORY), (_warns, b"x", End.PRINTED), (_prints, b"x",
        End.PRINTED),
        (_raises, b"x", End.RAISED), (_raises, b"y", End.UNCLEAR), (_raises, b"z", End.UNCLEAR), (_raises, b"m",
        End.REFUSED),
        (_raises, b"sound", End.SAME), (_raises, b"soun", End.SOUND),
    ],
)  # fmt: skip
def test_every_end_is_told(read: Any, content: bytes, end: End) -> None:
    assert outcome_apart(reading(read), content).end is end


def test_a_reader_that_hangs_is_ended() -> None:
    def hangs(path: Path) -> None:
        while b"x" in path.read_bytes():
            pass

    found = outcome_apart(reading(hangs, patience=-1.5), b"x")
    assert found.end is End.HANG


def test_another_number_than_the_file_has_is_wrong() -> None:
    def read(path: Path) -> float:
        return 2.0 * float(path.read_bytes())

    def judge(data: bytes, found: float) -> list[tuple[str, float, float]]:
        return [("number", found, float(data))]

    assert outcome_apart(reading(read, b"1.5", judge=judge), b"2.5").end is End.WRONG
    assert outcome_apart(reading(read, b"1.5"), b"2.5").end is End.SOUND
    assert outcome_apart(reading(read, b"1.5"), b"nan").end is End.WRONG


def test_damage_is_the_same_for_the_same_number() -> None:
    given = reading(_raises, b"key = 1\nother = 2\n" * 20)
    made = [content_of(given, 3, number) for number in range(200)]
    assert made == [content_of(given, 3, number) for number in range(200)]
    assert len({content for content, _ in made}) > 150
    assert made[0][0] == given.seed.files["a.txt"]


def test_edits_lead_from_one_content_to_the_other() -> None:
    rng = random.Random(1)
    for _ in range(50):
        one = rng.randbytes(60)
        other = bytearray(one)
        del other[rng.randrange(60)]
        other[rng.randrange(50)] = 7
        assert edited(one, edits(one, bytes(other))) == bytes(other)


def test_what_ends_badly_is_made_small() -> None:
    given = reading(_raises, b"sound as a bell of iron")
    data = b"?!sound as a xbell of 12345 ironing"
    outcome = outcome_apart(given, data)
    changes, again = minimal(given, data, outcome)
    assert again
    assert [one.new for one in changes] == [b"x"]


@pytest.mark.slow
def test_a_campaign_counts_and_writes_its_page(tmp_path: Path) -> None:
    """Two workers over two readers; the numbers add up, and the same seed makes the same files."""
    page, kept = tmp_path / "page.md", tmp_path / "kept"
    words = ["--reader", "verdicts", "--reader", "table of places", "--inputs", "600", "--seconds", "60"]
    done = subprocess.run(
        [sys.executable, SCRIPTS / "fuzz.py", *words, "--jobs", "2", "--page", page, "--keep", kept],
        capture_output=True, text=True, timeout=280, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    rows = [line.split(" | ") for line in page.read_text(encoding="utf-8").splitlines() if line.startswith("| ")]
    counts = {row[0][2:]: row[1:7] for row in rows if len(row) == 8}
    for name in ("verdicts", "table of places"):
        inputs, *ends = (int(one.replace(",", "")) for one in counts[name])
        assert inputs == sum(ends) > 100
    assert json.loads((kept / "findings.json").read_text(encoding="utf-8")) == []


@pytest.mark.parametrize("name", ["match file", "lidar JSON", "table of places", "verdicts", "LOLA's records"])
def test_independent_readings_agree_on_sound_files_and_see_lies(name: str, tmp_path: Path) -> None:
    """Of a value scaled in the file, the reading of the sound one is no longer right."""
    given = reader(name)
    path = tmp_path / given.seed.main
    for other, content in given.seed.files.items():
        (tmp_path / other).write_bytes(content)
    sound = path.read_bytes()
    found = given.read(path)
    assert given.judge is not None
    pairs = list(given.judge(sound, found) or ())
    assert pairs
    from fuzz_trials import _agree

    assert all(_agree(read, wanted) for _, read, wanted in pairs)
    lies = {
        "match file": sound[:16] + struct.pack("<f", 99.0) + sound[20:], "lidar JSON": sound.replace(b'"range": ',
        b'"range": 1'),
        "table of places": sound.replace(b"p0,10", b"p0,11"), "verdicts": sound.replace(b"accept", b"reject", 1),
        "LOLA's records": sound[:40] + struct.pack("<i", 26_000_000) + sound[44:],
    }  # fmt: skip
    assert not all(_agree(read, wanted) for _, read, wanted in given.judge(lies[name], found) or ())


def test_structures_stay_whole() -> None:
    """Archives, databases and checksums are sound after damage to what is in them."""
    import io
    import sqlite3
    import zipfile

    import fuzz_structures
    from fuzz_addresses import png
    from fuzz_seeds import small_npz

    rng, base = random.Random(4), sqlite3.connect(":memory:")
    base.execute("CREATE TABLE one (a, b)")
    base.execute("INSERT INTO one VALUES (1, 'text')")
    base.commit()
    whole = base.serialize()
    head = b"\x89PNG\r\n\x1a\n" + struct.pack(">I4s2I5B", 13, b"IHDR", 5, 4, 8, 0, 0, 0, 0)
    for _ in range(40):
        data = bytearray(small_npz())
        fuzz_structures.npz(data, rng)
        assert zipfile.ZipFile(io.BytesIO(data)).testzip() is None
        data = bytearray(whole)
        fuzz_structures.sqlite(data, rng)
        other = sqlite3.connect(":memory:")
        other.deserialize(bytes(data))
        assert other.execute("PRAGMA integrity_check").fetchone() == ("ok",)
        other.close()
        data = bytearray(head + struct.pack(">I", zlib.crc32(head[12:])) + bytes(20))
        if "head" in png(data, rng):
            assert struct.unpack_from(">I", data, 29)[0] == zlib.crc32(data[12:29])
    base.close()

"""Command lines with odd words: values, missing and repeated words, files of another kind, and what is no file at all.

Every line is run by a fork of its own as an ordinary user, in a folder that is made anew; exit status 2 has to be one
line on standard error and a folder as it was.
"""

import contextlib
import ctypes
import json
import os
import random
import shutil
import signal
import struct
import sys
import tempfile
import threading
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache, partial
from pathlib import Path
from typing import NoReturn

import fuzz_seeds as seeds
from click import ClickException
from fuzz_kinds import CSV, JSON, NPZ, PVL, SQLITE, TOML, Row
from fuzz_mutations import Change
from fuzz_trials import End, Ended, Outcome, Seed, skeleton

from mgsgraph.errors import MgsgraphError

_NOBODY = 65534
_WORDS = "words.json"
_FOLDER = "run"
_PAIR = ("case.toml", "image_A.isd", "image_B.isd", "network.pvl", "lidar.json")
_RESULT = ("result/solution.npz", "result/solution.json")
_PROJECT = ("project/project.sqlite",)
_LINES: dict[str, tuple[str, tuple[str, ...]]] = {
    "add": ("half SIM/B=image_B.isd --ties network.pvl --shots lidar.json --dry-run", ("half/project.sqlite",)),
    "adjust": ("case.toml --out out --no-figures", ()),
    "analyze": ("result --weak 2 --components --out out", _RESULT),
    "campaign": ("case.toml --out out --no-figures", ()),
    "check": ("case.toml", ()),
    "convert": ("network.pvl out.net --to net --thin 5 --case case.toml", ()),
    "export": ("result --to isis --out out --scaled", _RESULT),
    "fetch": ("M04/02852 --out fetched", ("fetched/fetch.lock",)),
    "help": ("case images", ()),
    "init": ("out --case case.toml --name x", ()),
    "new": ("image_A.isd image_B.isd network.pvl lidar.json --out out.toml --name x", ()),
    "plan": ("result candidates.toml --out out", (*_RESULT, "candidates.toml")),
    "project": ("case.toml SIM/A --points places.csv --into image --height 10 --out out.csv", ("places.csv",)),
    "remove": ("project SIM/B", _PROJECT),
    "report": ("result --out out.html", _RESULT),
    "review": ("case.toml --out out.net --verdicts verdicts.csv", ("verdicts.csv",)),
    "shots": ("shots.csv --case case.toml --margin 5 --out out.csv", ("shots.csv",)),
    "solve": ("project --no-figures", _PROJECT),
    "status": ("project", _PROJECT),
    "coregister": ("case.toml --out out", ()),
    "dem": ("result --out out --post 50", _RESULT),
    "nodes": ("case.toml --out out", ()),
    "match": ("case.toml --out out --no-figures", ()),
    "register": ("case.toml --out out", ()),
}
"""A line for each verb, and the files that it needs besides those of the pair. The last five are refused: the pair has
no pixels, no strips and no profile of an altimeter.
"""
_PLACES = b"".join(b"p%d,%d,%d,3390000.5\n" % (k, k, k) for k in range(4))
_SHARE = 0.5
_SLOW = 60.0
"""s that a command may take which draws, adjusts or looks at all files of a folder."""
_VALUES = (
    "", "nan", "inf", "-inf", "1e308", "-1", "0", "1e-320", "9" * 400, "0x10", "1_000", "1,5", "text", "\x1b[31m",
    "\udcff\udcfe", "\u202e",
    "a" * 5000, "--out", "-", "--", "-1e9", "true", "SIM/A", "A,B", "SIM/A,SIM/B", "local:99999999", "tcp://:1",
    "100%", "[", "*", "\n", "2e9",
)  # fmt: skip
_PATHS = (
    "missing", "folder", "pipe", "zero", "full", "loop", "", ".", "..", "a\nb", "\x1b[2Jname", "\udcff\udcfe.toml",
    "n" * 300, "folder/deep/er",
    "empty", "broken.isd", "broken.toml", "~", "case.toml/x", "image_A.isd", "network.pvl", "lidar.json",
    "case.toml", "result", "project",
    "places.csv", "verdicts.csv", "/proc/self/mem", "zero/x", "dangling", "socket",
)  # fmt: skip


def of_commands() -> Iterator[Row]:
    """Every verb with odd words, and some with damaged files."""
    for verb, (line, more) in _LINES.items():
        seed = partial(_seed, verb, line, more)
        yield Row(f"mgsgraph {verb}", "Lead", _words(seed), seed, words_of(verb), patience=_SLOW, share=_SHARE)
    damaged: tuple[tuple[str, str, Sequence[Change]], ...] = (
        ("check", "case.toml", TOML), ("adjust", "network.pvl", PVL), ("adjust", "lidar.json", JSON),
        ("check", "image_A.isd", JSON),
        ("status", "project/project.sqlite", SQLITE), ("solve", "project/project.sqlite", SQLITE),
        ("report", "result/solution.npz", NPZ), ("export", "result/solution.json", JSON), ("shots", "shots.csv", CSV),
        ("project", "places.csv", CSV), ("review", "verdicts.csv", CSV), ("new", "network.pvl", PVL),
    )  # fmt: skip
    for verb, name, changes in damaged:
        line, more = _LINES[verb]
        seed = partial(_seed, verb, line, more)
        yield Row(
            f"mgsgraph {verb}, damaged {Path(name).name}",
            "Lead",
            _damaged(seed, name, [verb, *line.split()]),
            partial(_renamed, seed, name),
            changes,
            patience=_SLOW,
            share=_SHARE,
        )


def _seed(verb: str, line: str, more: tuple[str, ...]) -> Seed:
    own = {
        "places.csv": b"id,longitude_deg,latitude_deg,radius_m\n" + _PLACES,
        "fetched/fetch.lock": b'{"format": 1, "files": {}, "images": {}, "written": {}}',
        "candidates.toml": b'format = 1\n[[control]]\nname = "far"\nlongitude_deg = 0.0\nlatitude_deg = 0.0\n'
        b"radius_m = 3.39e6\n",
        "verdicts.csv": b"id,verdict,note\nTIE00001,reject,bad\n", "shots.csv": seeds.profile_csv().encode(),
    }  # fmt: skip
    folder = seeds.worked_folder() if more else seeds.pair_folder()
    files = {name: own[name] if name in own else (folder / name).read_bytes() for name in (*_PAIR, *more)}
    return Seed({_WORDS: json.dumps([verb, *line.split()]).encode()} | files, _WORDS)


def _renamed(seed: Callable[[], Seed], name: str) -> Seed:
    return Seed({Path(name).name: seed().files[name]}, Path(name).name)


# --- odd words


def words_of(verb: str) -> list[Change]:
    """Changes of a line of this verb."""
    from mgsgraph.cli import group

    command = group.get_command(None, verb)  # type: ignore[arg-type]
    assert command is not None
    options = [
        (max(one.opts, key=len), getattr(one, "is_flag", False))
        for one in command.params
        if one.opts[0].startswith("-")
    ]

    def change(data: bytearray, rng: random.Random) -> str:
        words: list[str] = json.loads(data)
        if len(words) < 2:
            return "nothing more"
        kind, k = rng.randrange(8), rng.randrange(1, len(words))
        if kind <= 1 and options:
            name, flag = rng.choice(options)
            words += [name] if flag else [name, rng.choice((*_VALUES, *_PATHS))]
        elif kind <= 3:
            words[k] = rng.choice(_PATHS)
        elif kind == 4:
            words[k] = rng.choice(_VALUES)
        elif kind == 5:
            del words[k]
        elif kind == 6:
            words.insert(k, words[k])
        else:
            words[k : k + 1] = [words[k] + rng.choice(("\0", "\x1b[1m", "\udcff", "/", "=", " ", "x" * 2000))]
        data[:] = json.dumps([word for word in words if "\0" not in word]).encode()
        return (
            "an option more",
            "an option more",
            "another path",
            "another path",
            "another value",
            "a word left out",
            "a word twice",
            "a longer word",
        )[kind]

    return [change]


# --- running


def warm() -> None:
    """Run each line once in this process, so that its forks have all imported and compiled."""
    from mgsgraph.cli import group

    before, folder = Path.cwd(), Path(tempfile.mkdtemp(prefix="fuzz_warm."))
    null = open(os.devnull, "w")  # noqa: SIM115  # what was drawn may be flushed at the process's end
    try:
        for verb, (line, more) in _LINES.items():
            _prepare(folder / verb, _seed(verb, line, more).files)
            os.chdir(folder / verb)
            with (
                contextlib.redirect_stdout(null),
                contextlib.redirect_stderr(null),
                contextlib.suppress(MgsgraphError, ClickException),
            ):
                group([verb, *line.split()], standalone_mode=False)
    finally:
        os.chdir(before)
        shutil.rmtree(folder, ignore_errors=True)


def _words(seed: Callable[[], Seed]) -> Callable[[Path], object]:
    files = cache(lambda: seed().files)
    return lambda path: _run(json.loads(path.read_bytes()), files(), path.parent / _FOLDER)


def _damaged(seed: Callable[[], Seed], name: str, words: list[str]) -> Callable[[Path], object]:
    files = cache(lambda: seed().files)
    return lambda path: _run(words, {**files(), name: path.read_bytes()}, path.parent / _FOLDER)


def _run(words: list[str], files: Mapping[str, bytes], folder: Path) -> object:
    """Exit status and names of the files that are there afterwards; raises `Ended` for a bad end."""
    _prepare(folder, files)
    before = _listing(folder)
    streams = [os.memfd_create(name) for name in ("out", "err")]
    child = os.fork()
    if child == 0:
        try:
            _become(folder, streams)
            _obey(words)
        finally:
            os._exit(99)
    status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    out, err = (os.pread(one, 1 << 16, 0).decode(errors="replace") for one in streams)
    for one in streams:
        os.close(one)
    _judge(status, out, err, before, _listing(folder))
    return status, sorted(_listing(folder))


def _judge(status: int, out: str, err: str, before: dict[str, int], after: dict[str, int]) -> None:
    lines = [line for line in err.splitlines() if line.strip()]
    if status < 0:
        raise Ended(Outcome(End.SIGNAL, f"{signal.Signals(-status).name}: {skeleton(err)}", err[-300:]))
    if "Traceback" in err:
        places = [line.strip() for line in lines if "/mgsgraph/" in line and line.strip().startswith("File")]
        place = places[-1].split("/mgsgraph/")[-1] if places else "?"
        raise Ended(Outcome(End.RAISED, f"{lines[-1].split(':')[0][:60]} at {place}", lines[-1][:300]))
    if status not in (0, 1, 2, 130):
        raise Ended(Outcome(End.UNCLEAR, f"exit {status}", err[:300]))
    if status == 2:
        odd = [mark for mark in err if not mark.isprintable() and mark not in "\n\t\r"]
        if len(lines) != 1 or odd or len(err) > 4000:
            wrong = f"{len(lines)} lines" if len(lines) != 1 else f"the character {odd[0]!a}" if odd else "a long line"
            raise Ended(Outcome(End.UNCLEAR, f"exit 2, {wrong}: {skeleton(err)}", ascii(err)[:300]))
        if left := sorted(set(after.items()) ^ set(before.items())):
            raise Ended(
                Outcome(End.WRONG, f"exit 2, and another folder: {skeleton(left[0][0])}", f"{left[:3]}; {err[:200]}")
            )
        raise Ended(Outcome(End.REFUSED, "", err[:300]))
    if any("Warning" in line for line in lines):
        raise Ended(Outcome(End.PRINTED, skeleton(err), err[:300]))
    if "nan" in out.lower().split() and "nan" not in out.split("\n")[0].split():
        raise Ended(Outcome(End.PRINTED, f"nan: {skeleton(out)}", out[:300]))


def _prepare(folder: Path, files: Mapping[str, bytes]) -> None:
    """A folder with the files, and with what is no file."""
    shutil.rmtree(folder, ignore_errors=True)
    (folder / "folder").mkdir(parents=True)
    folder.with_name("home").mkdir(exist_ok=True)
    for name, content in files.items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_bytes(content)
    os.mkfifo(folder / "pipe")
    for name, target in (("zero", "/dev/zero"), ("full", "/dev/full"), ("loop", "loop"), ("dangling", "nowhere/x")):
        (folder / name).symlink_to(target)
    (folder / "empty").touch()
    (folder / "broken.isd").write_bytes(files["image_A.isd"][:3000])
    (folder / "broken.toml").write_bytes(b"[" * 3000)
    if os.geteuid() == 0:
        for path in (folder, folder.with_name("home"), *folder.rglob("*")):
            os.chown(path, _NOBODY, _NOBODY, follow_symlinks=False)


def _listing(folder: Path) -> dict[str, int]:
    """Files by name with their sizes; what SQLite keeps beside a database is left out."""
    return {
        str(path.relative_to(folder)): path.lstat().st_size if path.is_file() and not path.is_symlink() else -1
        for path in folder.rglob("*") if not path.name.endswith(("-wal", "-shm", "-journal"))
    }  # fmt: skip


def _become(folder: Path, streams: Sequence[int]) -> None:
    """An ordinary user in that folder, whose process ends with the one that began it."""
    ctypes.CDLL(None).prctl(1, signal.SIGKILL)
    os.chdir(folder)
    os.environ["HOME"] = str(folder.with_name("home"))
    for number, stream in enumerate((os.open(os.devnull, os.O_RDONLY), *streams)):
        os.dup2(stream, number)
    sys.stdout = os.fdopen(1, "w", closefd=False)
    sys.stderr = os.fdopen(2, "w", closefd=False, buffering=1, errors="backslashreplace")
    if os.geteuid() == 0:
        _give_up_rights()


def _give_up_rights() -> None:
    """Of the superuser's rights leave that to read alone: the interpreter may lie where others can't look."""
    libc, keep = ctypes.CDLL(None, use_errno=True), 8
    libc.prctl(keep, 1)
    os.setgroups([])
    os.setgid(_NOBODY)
    os.setuid(_NOBODY)
    read = 1 << 2  # CAP_DAC_READ_SEARCH
    head, rights = struct.pack("Ii", 0x20080522, 0), struct.pack("6I", read, read, 0, 0, 0, 0)
    if libc.capset(head, rights):
        raise OSError(ctypes.get_errno(), "capset")


def _obey(words: list[str]) -> NoReturn:
    """The command, and the end of its process, as `tests/command_server.py` has it."""
    import warnings

    from mgsgraph.cli import main

    warnings.resetwarnings()
    warnings.simplefilter("default")
    sys.argv, status = ["mgsgraph", *words], 1
    signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        main()
    except SystemExit as left:
        status = int(left.code or 0)
    except BaseException:
        traceback.print_exc()
    threading._shutdown()  # type: ignore[attr-defined]  # waits for threads, as an interpreter does at its end
    sys.stdout.flush()
    os._exit(status)

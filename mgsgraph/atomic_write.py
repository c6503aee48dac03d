"""What is made beside its place: held while its process lives, put in place in one step, swept where a kill left it.

`.NAME.HEX.unfinished` becomes NAME once all of it is on the disk; what was there before is kept until the new NAME is
on the disk, too (fsync of files and folders before and after the rename). Its process holds a lock (flock) on it, which
the system lets go with the process, however that ends: what can be locked is a leftover, and the next command that
writes into the same folder takes it away. Where the file system knows no exchange of two folders, NAME steps aside as
`.NAME.HEX.replaced`; one whose new folder never took its place goes back. A lock may be known to one host alone (NFS,
Lustre, folders shared with containers): HEX begins with four digits of the host's name, and only that host sweeps it.
Links and files of other users are left alone. Where folders can't be locked (NFS), nothing is swept.
"""

import ctypes
import errno
import os
import platform
import re
import secrets
import shutil
import stat
import sys
import tempfile
import time
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path

from mgsgraph.errors import InputError

_NAME = re.compile(r"\.(?P<name>.+)\.(?P<host>[0-9a-f]{4})[0-9a-f]{4}\.(?P<state>unfinished|replaced)", re.DOTALL)
_HOST = f"{zlib.crc32(os.fsencode(platform.node())) % (1 << 16):04x}"
_EXCHANGE = 2
"""RENAME_EXCHANGE of Linux (renameat2)."""
_HERE = -100
"""AT_FDCWD: paths are as the process sees them."""
_UNKNOWN = (errno.ENOSYS, errno.EINVAL, errno.ENOTSUP, errno.EOPNOTSUPP)
"""Errors of a system or a file system that knows no exchange."""
_PRIVATE = 0o700
_ATTEMPTS, _MOMENT = 100, 0.005
"""How often something new is made where a sweep comes between its making and its lock, and s until then."""


def beside(path: Path) -> Path:
    """A name in the same folder under which something is made before it takes its place."""
    return path.with_name(f".{path.name}.{_HOST}{secrets.token_hex(2)}.unfinished")


def is_aside(name: str) -> bool:
    """Whether a name is one of `beside`."""
    found = _NAME.fullmatch(name)
    return found is not None and found["state"] == "unfinished"


@contextmanager
def made_beside(path: Path, folder: bool = False, mode: int = 0o777) -> Iterator[Path]:
    """A new file (or folder) beside `path`, ours as long as this lasts, and gone at its end unless it has been renamed.

    A folder has these permissions, as far as the process's mask lets them. The folder that it is in is made where
    there is none, and what killed processes have left there is put right first. OSError where it can't be made.
    """
    place, descriptor = beside(path), -1
    sweep(path.parent)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        descriptor = _made(place, folder, mode)
        yield place
    finally:
        _remove(place)
        if descriptor >= 0:
            os.close(descriptor)


@contextmanager
def scratch() -> Iterator[Path]:
    """A folder for what nobody shall keep, where the system has such; one of a killed process goes with the next."""
    with made_beside(Path(tempfile.gettempdir()) / "mgsgraph", folder=True, mode=_PRIVATE) as place:
        yield place


def put_file(new: Path, target: Path) -> None:
    """Let a file made by `made_beside` take its place in one step. In a folder that is itself unfinished, the folder
    brings it to the disk.
    """
    whole = not any(map(is_aside, target.parts[:-1]))
    if whole:
        _to_disk(new)
    new.replace(target)
    if whole:
        _to_disk(target.parent)


def put_in_place(new: Path, target: Path) -> None:
    """Let a folder made by `made_beside` take its place in one step; an earlier one is at `new` then."""
    for folder, _, files in os.walk(new, topdown=False):
        for name in files:
            _to_disk(Path(folder, name))
        _to_disk(Path(folder))
    earlier = _renamed(new, target)
    _to_disk(target.parent)
    if earlier:
        shutil.rmtree(earlier, ignore_errors=True)


def _to_disk(path: Path) -> None:
    """Bring a file, or the names in a folder, to the disk. OSError where that fails; a system that can't do so with
    folders (Windows, some network disks) is left as it is.
    """
    descriptor = -1
    try:
        descriptor = os.open(path, os.O_RDONLY)
        os.fsync(descriptor)
    except OSError as error:
        if not path.is_dir() or error.errno in (errno.EIO, errno.ENOSPC, errno.EDQUOT):
            raise
    finally:
        if descriptor >= 0:
            os.close(descriptor)


def _renamed(new: Path, target: Path) -> Path | None:
    """Let one folder take the place of another, which is returned where it has stepped aside.

    Without such a step the earlier one is renamed first, comes back should the second rename fail, and is taken back by
    `sweep` should the process end between the two.
    """
    if not target.exists():
        new.rename(target)
    elif not _exchanged(new, target):
        old = new.with_suffix(".replaced")
        target.rename(old)
        try:
            new.rename(target)
        except BaseException:
            old.rename(target)
            raise
        return old
    return None


def resolved(path: str | Path, remedy: str) -> Path:
    """The absolute path that links lead to; InputError where they lead to each other."""
    try:
        return Path(os.path.realpath(path, strict=True))
    except OSError as error:
        if error.errno == errno.ELOOP:
            raise InputError(str(path), "a link that leads to itself", remedy=remedy) from None
    return Path(os.path.realpath(path))  # of what is not there yet


# --- what kills have left


def sweep(folder: Path) -> None:
    """Put right what killed processes have left in a folder: bring back what had stepped aside, take the rest away.
    What a living process or another host makes is left alone, and all that isn't ours.
    """
    if sys.platform == "win32" or any(is_aside(part) for part in folder.parts):  # that goes, or comes, as a whole
        return
    with suppress(OSError):  # no such folder yet, or none of ours
        found = [name for name in os.listdir(folder) if (ours := _NAME.fullmatch(name)) and ours["host"] == _HOST]
        for name in sorted(found):  # of one token, what was replaced comes before what was unfinished
            _put_right(folder / name)


def _put_right(path: Path) -> None:
    name = _NAME.fullmatch(path.name)
    assert name is not None
    if name["state"] == "unfinished":
        with _left(path) as left:
            if left:
                _remove(path)
        return
    new, target = path.with_suffix(".unfinished"), path.with_name(name["name"])
    if not os.path.lexists(new):  # has taken its place
        _take(path)
        return
    with _left(new) as left:
        if left and not os.path.lexists(target):
            path.rename(target)
        elif left:
            _take(path)


def _take(path: Path) -> None:
    with _left(path) as left:
        if left:
            _remove(path)


@contextmanager
def _left(path: Path) -> Iterator[bool]:
    """Whether something is a leftover of ours; held until the end of this where it is."""
    descriptor = -1
    try:
        about = path.lstat()
        ours = about.st_uid == os.geteuid() and (stat.S_ISREG(about.st_mode) or stat.S_ISDIR(about.st_mode))
        if ours:
            descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
        yield ours and lock(descriptor, required=True)
    except OSError:
        yield False
    finally:
        if descriptor >= 0:
            os.close(descriptor)


def lock(descriptor: int, required: bool = False) -> bool:
    """Lock what is open, as long as it is, without waiting: False where another process has. Where the system can't:
    True unless the lock is `required`.
    """
    if sys.platform == "win32":
        return not required
    import fcntl

    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return not required
    return True


def _made(place: Path, folder: bool, mode: int) -> int:
    """A new file or folder, opened and locked; made anew where a sweep came between."""
    for attempt in range(_ATTEMPTS):
        try:
            if folder:
                place.mkdir(mode)
            if folder and sys.platform == "win32":  # opens no folders
                return -1
            how = os.O_RDONLY | os.O_DIRECTORY if folder else os.O_RDWR | os.O_CREAT | os.O_EXCL
            descriptor = os.open(place, how | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_CLOEXEC", 0), 0o666)
        except (FileNotFoundError, FileExistsError):
            if attempt == _ATTEMPTS - 1 or not place.parent.is_dir():
                raise
            time.sleep(_MOMENT)
            continue
        if lock(descriptor) and _is_there(place, descriptor):
            return descriptor
        os.close(descriptor)
    raise OSError(errno.EEXIST, os.strerror(errno.EEXIST), str(place))


def _is_there(place: Path, descriptor: int) -> bool:
    try:
        return os.path.samestat(place.lstat(), os.fstat(descriptor))
    except OSError:
        return False


def _remove(place: Path) -> None:
    """Whatever is there, as far as it can be removed."""
    with suppress(OSError):
        if stat.S_ISDIR(place.lstat().st_mode):
            shutil.rmtree(place, ignore_errors=True)
        else:
            place.unlink()


# --- the exchange


def _exchanged(one: Path, other: Path) -> bool:
    """Exchange two folders in one step; False where the system or the file system can't. OSError for all else."""
    call = _exchange()
    if call is None:
        return False
    here, paths = ctypes.c_int(_HERE), [ctypes.c_char_p(os.fsencode(path)) for path in (one, other)]
    if not call(here, paths[0], here, paths[1], ctypes.c_uint(_EXCHANGE)):
        return True
    failed = ctypes.get_errno()
    if failed in _UNKNOWN:
        return False
    raise OSError(failed, os.strerror(failed), str(other))


@cache
def _exchange() -> Callable[..., int] | None:
    """Linux' call; None where there is none."""
    return getattr(ctypes.CDLL(None, use_errno=True), "renameat2", None) if sys.platform == "linux" else None

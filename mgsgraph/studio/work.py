"""Long work on a project: solving, aligning, matching, adding. One job at a time; each runs the command of that name in
a process of its own, which may be ended at any time: the project then is as it was.
"""

import os
import re
import signal
import subprocess
import sys
import termios
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryFile
from threading import Lock, Thread
from typing import Any

import numpy as np

from mgsgraph.errors import InputError, require
from mgsgraph.files.networks.pvl import write_pvl_network
from mgsgraph.files.networks.table import read_tie_points
from mgsgraph.files.networks.tie_points import control_network
from mgsgraph.geometry.body import geodetic, target_name
from mgsgraph.geometry.records import Array
from mgsgraph.matching.settings import MatchSettings
from mgsgraph.project.project import open_project
from mgsgraph.studio.opened import Opened

_IMAGES, _NETWORKS = (".json", ".isd", ".img", ".lbl", ".cub", ".toml"), (".net", ".pvl", ".csv", ".parquet")
"""Endings of files that may be added."""
_MOST_FILES, _LINES, _LONGEST, _MOST_CELLS = 200, 12, 4000, 4000
"""Files of the folder that are listed; lines of an output that are shown; characters of it; cells of a match."""
_CONTROL = re.compile(r"\x1b\[[0-9;]*[A-Za-z]")
_BAR = re.compile(r":?\s*(\|.*|\d*it \[.*)$")
"""Of a line of progress all but its words and its share."""
_TERMINAL = 'exec "$@" <"$0"'
"""Of the shell, which opens the terminal: from then on that of its session. When the studio ends, even by a kill, the
system closes the studio's side and ends the session."""
_Command = Callable[[], list[str]]
"""Gives the words of a command when its turn comes."""


class Job:
    """Commands, run one after the other until one fails."""

    def __init__(self, title: str, *commands: _Command) -> None:
        self.title, self.state, self._commands, self._lock = title, "running", commands, Lock()
        self._stage, self._lines, self._begun, self._ended = "", list[str](), time.monotonic(), 0.0
        self._process: subprocess.Popen[bytes] | None = None
        self._cancelled = False

    @property
    def record(self) -> dict[str, Any]:
        """State, stage, seconds, and the first lines of the output, or the last ones of errors, as JSON."""
        seconds = (self._ended or time.monotonic()) - self._begun
        lines = self._lines[:_LINES] if self.state == "done" else self._lines[-3:]
        return {"title": self.title, "state": self.state, "stage": self._stage, "seconds": seconds, "lines": lines}

    def run(self) -> None:
        """Run the commands."""
        done = False
        try:
            done = all(self._run(command()) for command in self._commands)
        except (OSError, InputError) as error:
            self._lines.append(str(error))
        finally:
            self._ended = time.monotonic()
            self.state = "done" if done else "cancelled" if self._cancelled else "failed"

    def cancel(self) -> None:
        """End the process and all that it has started."""
        with self._lock, suppress(ProcessLookupError):
            self._cancelled = True
            if self._process is not None and self._process.poll() is None:
                os.killpg(self._process.pid, signal.SIGTERM)

    def _run(self, words: list[str]) -> bool:
        """Run a command; whether it has done its work (an invalid solution is stored, too: status 1)."""
        with TemporaryFile() as printed:
            with self._lock:
                if self._cancelled:
                    return False
                terminal, side = os.openpty()
                termios.tcsetwinsize(side, (24, 100))  # else no progress is printed
                command = ["/bin/sh", "-c", _TERMINAL, os.ttyname(side), sys.executable, "-m", "mgsgraph", *words]
                self._process = subprocess.Popen(command, stdout=printed, stderr=side, start_new_session=True)
            os.close(side)
            self._lines, said = [], ""
            with suppress(OSError):  # so a terminal ends that nobody writes to any more
                while data := os.read(terminal, 4096):
                    said = (said + _CONTROL.sub("", data.decode(errors="replace")))[-_LONGEST:]
                    self._lines = [line for text in re.split("[\r\n]", said) if (line := text.strip())]
                    self._stage = _BAR.sub("", self._lines[-1]).strip() if self._lines else ""
            os.close(terminal)
            done = self._process.wait() in (0, 1) and "Traceback" not in said
            printed.seek(0)
            self._lines = printed.read().decode(errors="replace").splitlines() if done else self._lines
        return done


class Work:
    """The jobs of a studio; files that may be added are in `folder`."""

    def __init__(self, opened: Opened, folder: Path | None = None) -> None:
        self._opened, self._folder, self._lock, self._files = opened, folder, Lock(), list[Path]()
        self.job: Job | None = None
        """The present or the last one."""

    @property
    def record(self) -> dict[str, Any] | None:
        """The present or the last job, as JSON; None where there was none."""
        return None if self.job is None else self.job.record

    def require_free(self) -> None:
        """InputError while a job runs."""
        if self.job is not None and self.job.state == "running":
            raise InputError("studio", f"a job changes the project: {self.job.title}", remedy="wait, or cancel it")

    def files(self) -> list[dict[str, Any]]:
        """Files that may be added, by numbers that they keep, as JSON."""
        with self._lock:
            found = [path for path in sorted(self._folder.iterdir()) if path.is_file()] if self._folder else []
            fitting = [path for path in found if path.suffix.lower() in (*_IMAGES, *_NETWORKS)]
            self._files = list(dict.fromkeys([*self._files, *fitting]))[:_MOST_FILES]
            return [{"name": path.name, "is_image": path.suffix.lower() in _IMAGES} for path in self._files]

    def start(self, kind: str, numbers: Any = None, box: Array | None = None) -> dict[str, Any]:
        """Begin a job (solve, align, match or add); its record.

        Parameters
        ----------
        kind : str
        numbers : list of int, optional
            Files to add.
        box : (4,), optional
            m on the map, x and y, low and high, in which tie points are to be found.

        Raises
        ------
        InputError
            No project; another job runs; an unknown kind, no such file.
        """
        project = str(self._opened.path.resolve())
        jobs: dict[str, Callable[[], Job]] = {
            "solve": lambda: Job("Solve", lambda: ["project", "solve", project, "--no-figures"]),
            "align": lambda: Job("Align", lambda: ["align", project, "--no-figures"]),
            "match": lambda: self._match(Path(project), box),
            "add": lambda: self._add(project, numbers),
        }
        require(kind in jobs, "work, kind", repr(kind)[:60], f"one of {', '.join(jobs)}")
        require(self._opened.kind == "project", str(self._opened.path), f"a {self._opened.kind}", "a project")
        with self._lock:
            self.require_free()
            self.job = job = jobs[kind]()
            Thread(target=job.run, daemon=True).start()
        return job.record

    def _add(self, project: str, numbers: Any) -> Job:
        known = isinstance(numbers, list) and numbers and all(k in range(len(self._files)) for k in numbers)
        require(bool(known), "work, files", repr(numbers)[:60], "numbers of files of the list")
        words = ["project", "add", project]
        for file in (self._files[int(k)].resolve() for k in dict.fromkeys(numbers)):
            words += [str(file)] if file.suffix.lower() in _IMAGES else ["--ties", str(file)]
        return Job("Add", lambda: words)

    def _match(self, path: Path, box: Array | None) -> Job:
        """Find the tie points that a project waits for; or more of them, all or those in a box on the map."""
        with open_project(path) as project:
            waits, case, number = not project.store.members(), project.case, len(project.changes()) + 1
        if waits or case is None:
            return Job("Match", lambda: ["match", str(path), "--no-figures"])
        cells, made = float(MatchSettings().cells), path / f"matches-{number}"
        if box is not None:  # as many in the box as else in the whole
            whole = np.ptp(np.concatenate(self._opened.footprints()), axis=0).prod()
            cells *= float(np.clip(whole / (box[2:] - box[:2]).prod(), 1.0, _MOST_CELLS / cells))
        words = ["match", str(case), "--out", str(made), "--no-figures", "--cells", f"{cells:.0f}"]
        return Job("Match", lambda: words, lambda: ["project", "add", str(path), "--ties", str(self._found(made, box))])

    def _found(self, made: Path, box: Array | None) -> Path:
        """File of the tie points of a match: all, or those in a box on the map, by their first measures."""
        network, block = made / "network.pvl", self._opened.block()
        if box is None:
            return network
        ties = read_tie_points(network)
        first = np.unique(ties.measure_point, return_index=True)[1]
        height = geodetic(self._opened.centre[None], block.images[0].body)[0, 2]
        images, places = np.array(ties.measure_image[first]), np.full((first.size, 3), np.nan)
        for name in np.unique(images).tolist():
            j, rows = block.network.image_number(name), np.flatnonzero(images == name)
            lines, samples = ties.measures[first[rows]].T
            places[rows] = block.images[j].image_to_ground(lines, samples, height, block.corrections[j])[0]
        plane = self._opened.map_places(places)
        chosen = np.flatnonzero(np.all((plane >= box[:2]) & (plane <= box[2:]), axis=1))
        require(chosen.size > 0, "match", "no tie point in the map's window", "a larger one, or more texture")
        kept = control_network(ties.chosen(chosen), "mgsgraph", target_name(block.images[0].body))
        write_pvl_network(kept, found := network.with_name("window.pvl"))
        return found

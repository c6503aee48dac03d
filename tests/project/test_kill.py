"""A process that is killed while it changes a project leaves the state before its change, or the one after."""

import os
import signal
import time
import warnings
from itertools import count
from pathlib import Path

import numpy as np
import pytest
from projects import change, differences, digest, interrupted

from mgsgraph.adjustment.incremental.state import InMemory
from mgsgraph.project.project import Project, open_project
from mgsgraph.project.settings import ProjectSettings

_MOMENTS = 10


def change_for_ever(folder: Path) -> None:
    """What the process does that will be killed: one change after the other, numbered by the history."""
    while True:
        with open_project(folder, write=True) as project:
            number = len(project.changes())
            change(project.store, number)
            project.record("change", str(number), {})


def killed(folder: Path, after: float) -> None:
    """Have a process change the project, and kill it after some seconds."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # Python warns of threads that might hold a lock; none does
        child = os.fork()
    if child == 0:
        try:
            change_for_ever(folder)
        finally:
            os._exit(1)
    time.sleep(after)
    os.kill(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    assert os.WIFSIGNALED(status), "it should have gone on until it was killed"


@pytest.mark.skipif(not hasattr(os, "fork"), reason="kills a process of its own")
def test_killed_at_any_moment_it_holds_the_state_before_or_after(tmp_path: Path) -> None:
    folder, replayed, done = tmp_path / "project", InMemory(), 0
    with Project.create(folder, "killed", ProjectSettings()):
        pass
    change(InMemory(), 0)  # the network that all changes deal with is made once
    began = time.perf_counter()
    with open_project(folder, write=True) as project:
        change(project.store, 0)
        project.record("change", "0", {})
    took = time.perf_counter() - began
    rng = np.random.default_rng()  # moments are random by nature: the clock decides in any case
    for number in count():
        if number >= _MOMENTS and done > 1:
            break
        assert number < 10 * _MOMENTS
        killed(folder, float(rng.uniform(0.1, 6.0)) * took)
        with open_project(folder) as project:
            now = len(project.changes())
            if now == done:  # others may have come to share the machine
                took *= 1.5
            for earlier in range(done, now):
                change(replayed, earlier)
            done = now
            assert differences(replayed, project.store) == []


def test_a_journal_left_over_is_played_back_by_a_reader(tmp_path: Path) -> None:
    folder = tmp_path / "project"
    with Project.create(folder, "cut", ProjectSettings()) as project:
        change(project.store, 9)
    before, after = interrupted(folder, tmp_path / "copy")
    assert (tmp_path / "copy" / "project.sqlite-journal").stat().st_size > 0
    assert before != after
    for path, expected in ((tmp_path / "copy", before), (folder, after)):
        with open_project(path) as project:
            assert digest(project.store) == expected

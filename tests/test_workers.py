"""Forks of this process: threads of the kernel in them."""

import sys

import pytest

from mgsgraph.kernel import sweep
from mgsgraph.workers import read_apart


@pytest.mark.skipif(sys.platform != "linux", reason="forks are sound on Linux alone")
def test_threads_of_the_kernel_are_made_anew_in_a_fork() -> None:
    """Those of this process don't come along: a fork that waited for them would wait for ever."""
    assert sweep._threads(2).submit(lambda: 1).result() == 1
    assert read_apart(lambda: sweep._threads(2).submit(lambda: 2).result(60.0), "here", "threads", "none") == 2

"""Workers, local and elsewhere: found or refused with their reason, tasks that outlive them, nothing left behind."""

import logging
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from outside import refuses

from mgsgraph.adjustment.cluster import connection
from mgsgraph.adjustment.cluster.connection import Connection, Lost, open_cluster
from mgsgraph.adjustment.cluster.workers import cores, parse_cluster, require_visible_file, threads_of_each
from mgsgraph.errors import InputError, SolverError

distributed = pytest.importorskip("distributed", reason="dask.distributed is not installed (the extra `cluster`)")
dask = pytest.importorskip("dask")


# --- the place


@given(st.integers(1, 1024))
def test_workers_of_our_own(count: int) -> None:
    place = parse_cluster(f"local:{count}")
    assert place.local
    assert place.workers == count
    assert threads_of_each(count) == 1 or count * threads_of_each(count) <= cores()


@given(
    st.sampled_from(["tcp", "tls"]), st.sampled_from(["127.0.0.1", "node-3.cluster", "[::1]"]), st.integers(1, 65535)
)
def test_a_scheduler_elsewhere(protocol: str, host: str, port: int) -> None:
    place = parse_cluster(f"{protocol}://{host}:{port}", insecure=protocol == "tcp")
    assert not place.local
    assert place.address == f"{protocol}://{host}:{port}"


def test_a_scheduler_without_tls_is_refused() -> None:
    with pytest.raises(InputError) as told:
        parse_cluster("tcp://host:8786")
    assert str(told.value) == (
        "--cluster tcp://host:8786: a connection without certificates; expected tls://host:8786, or --insecure; "
        "start scheduler and workers with certificates (docs/cluster.md)"
    )


@pytest.mark.parametrize(
    "text",
    ["", "local:0", "local:x", "local:99999", "127.0.0.1:8786", "tls://host:70000", "tls://host:8786/x"],
)
def test_other_places_are_refused(text: str) -> None:
    refuses(r"^--cluster .*expected .*(local:N|1 to)", parse_cluster, text)


def test_numba_num_threads_is_shared_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_NUM_THREADS", "12")
    assert [threads_of_each(count) for count in (1, 2, 5, 12, 40)] == [12, 6, 2, 1, 1]
    assert parse_cluster("local").workers == 12


# --- workers of our own


@pytest.fixture(scope="module")
def two() -> Iterator[Connection]:
    with open_cluster("local:2") as cluster:
        yield cluster


def test_results_belong_to_their_items(two: Connection) -> None:
    items = list(range(-5, 6))
    assert dict(two.each(abs, items)) == dict(enumerate(map(abs, items)))
    assert not list(two.each(abs, []))


def test_a_task_that_fails_is_told_and_the_others_go_on(two: Connection) -> None:
    results = dict(two.each(int, ["1", "x", "3"]))
    assert results[0] == 1
    assert results[2] == 3
    assert isinstance(results[1], Lost)
    assert "ValueError" in results[1].message
    assert "'x'" in results[1].message


@pytest.mark.slow
def test_a_killed_worker_loses_nothing(two: Connection) -> None:
    before = {worker.process for worker in two.workers}
    victim = min(before)
    killing = threading.Timer(0.5, os.kill, (victim, signal.SIGKILL))
    killing.start()
    results = dict(two.each(time.sleep, [1.0, 1.01, 1.02, 1.03]))
    killing.join()
    assert results == dict.fromkeys(range(4))
    assert victim not in {worker.process for worker in two.workers}


@pytest.mark.slow
def test_a_task_that_brings_workers_down_is_lost(two: Connection) -> None:
    (lost,) = dict(two.each(os._exit, [7])).values()
    assert isinstance(lost, Lost)
    assert "4 workers that tried it died (memory limit" in lost.message
    assert dict(two.each(abs, [-1, -2])) == {0: 1, 1: 2}


@pytest.mark.slow
def test_a_memory_limit_that_is_exceeded_is_named_with_its_figures(two: Connection) -> None:
    two.require_memory(1e6, "a partition of 10 points", "")
    needed = 4.0 * distributed.system.MEMORY_LIMIT
    with pytest.raises(
        InputError, match=r"worker tls://.* memory limit of .* GB.* at least .* GB for a part.*; more"
    ) as told:
        two.require_memory(needed, "a partition of 10 points", "more partitions")
    assert f"{needed / 1e9:.2f} GB" in str(told.value)


def test_files_that_workers_see_and_do_not(two: Connection, tmp_path: Path) -> None:
    path = tmp_path / "record"
    path.write_text("here", encoding="utf-8")
    two.require_visible_file(path)
    for answer in ("No such file or directory", "0" * 64):
        with pytest.raises(InputError, match=r"worker tcp://far: it does not see .*record"):
            require_visible_file(_Far(answer), path, "--cluster tcp://far", 0.0)


class _Far:
    """A client whose one worker sees other files."""

    def __init__(self, answer: str) -> None:
        self._answer = answer

    def run(self, *_: object, **__: object) -> dict[str, str]:
        return {"tcp://far": self._answer}


@pytest.mark.slow
def test_nothing_is_left_behind() -> None:
    environment, handlers = dict(os.environ), {h: h.level for h in logging.getLogger("distributed").handlers}
    with open_cluster("local:1") as cluster:
        processes = [worker.process for worker in cluster.workers]
        os.environ["OF_THE_USERS_OWN"] = "kept"
    assert os.environ.pop("OF_THE_USERS_OWN") == "kept"
    assert dict(os.environ) == environment
    assert {h: h.level for h in logging.getLogger("distributed").handlers} == handlers
    assert not [process for process in processes if Path(f"/proc/{process}").exists()]


def test_too_many_workers_for_the_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(distributed.system, "MEMORY_LIMIT", int(1e9))
    with (
        pytest.raises(InputError, match=r"local:4: 0\.25 GB of memory for each of 4 workers; .*local:2"),
        open_cluster("local:4"),
    ):
        pass


def test_one_task_at_a_time_in_a_process() -> None:
    running, most = [0], [0]

    def task(_: int) -> None:
        running[0] += 1
        most[0] = max(most[0], running[0])
        time.sleep(0.02)
        running[0] -= 1

    threads = [threading.Thread(target=connection._by_itself, args=(task, k)) for k in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert most == [1]


# --- a scheduler elsewhere

_WORKER = """
import importlib.metadata, sys
{disguise}
from distributed.cli.dask_worker import main
sys.argv = ["dask worker", {address!r}, "--no-nanny", "--nthreads", "2", "--no-dashboard", "--memory-limit", {memory!r},
            "--host", "127.0.0.1", "--local-directory", {folder!r}]
main()
"""
_OLDER = """
true_version = importlib.metadata.version
importlib.metadata.version = lambda name: "0.0.1" if name == "mgsgraph" else true_version(name)
"""


class _Elsewhere:
    """A scheduler in a process of its own, and workers."""

    def __init__(self, folder: Path, environment: dict[str, str]) -> None:
        self.processes: list[subprocess.Popen[bytes]] = []
        self._folder, file, self._environment = folder, folder / "scheduler.json", os.environ | environment
        self.start("-m", "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard",
                   "--scheduler-file", str(file))  # fmt: skip
        deadline = time.monotonic() + 60.0
        while not (file.exists() and file.read_text(encoding="utf-8").endswith("}")) and time.monotonic() < deadline:
            time.sleep(0.1)
        import json

        self.address = str(json.loads(file.read_text(encoding="utf-8"))["address"])

    def start(self, *arguments: str) -> subprocess.Popen[bytes]:
        quiet = subprocess.DEVNULL
        process = subprocess.Popen(
            [sys.executable, *arguments], stdout=quiet, stderr=quiet, cwd=self._folder, env=self._environment
        )
        self.processes.append(process)
        return process

    def worker(self, disguise: str = "", memory: str = "2GB") -> subprocess.Popen[bytes]:
        values = {"disguise": disguise, "address": self.address, "memory": memory, "folder": str(self._folder)}
        return self.start("-c", _WORKER.format(**values))


@contextmanager
def elsewhere(folder: Path, **environment: str) -> Iterator[_Elsewhere]:
    there = _Elsewhere(folder, environment)
    try:
        yield there
    finally:
        for process in reversed(there.processes):
            process.kill()
            process.wait()


def refusal(address: str, timeout: float = 20.0) -> str:
    """What is said of a cluster that can't be used."""
    with pytest.raises(InputError) as told, open_cluster(address, timeout, insecure=True):
        pass
    assert "\n" not in str(told.value)
    return str(told.value)


def certificate(folder: Path) -> dict[str, str]:
    """Settings of dask by which everyone has the same new certificate."""
    made, pem = distributed.Security.temporary(), folder / "both.pem"
    pem.write_text(made.tls_client_key + made.tls_client_cert, encoding="ascii")
    names = ["ca-file", *(f"{role}.cert" for role in ("client", "scheduler", "worker"))]
    return dict.fromkeys((f"distributed.comm.tls.{name}" for name in names), str(pem))


@pytest.mark.slow
@pytest.mark.parametrize("secure", [True, False])
def test_workers_elsewhere(secure: bool, tmp_path: Path) -> None:
    settings = certificate(tmp_path) | {"distributed.comm.require-encryption": "True"} if secure else {}
    environment = {f"DASK_{name.upper().replace('.', '__').replace('-', '_')}": settings[name] for name in settings}
    with elsewhere(tmp_path, **environment) as there, dask.config.set(settings):
        assert there.address.startswith("tls://" if secure else "tcp://")
        there.worker()
        with open_cluster(there.address, 30.0, insecure=not secure) as cluster:
            assert dict(cluster.each(abs, [-1, 2, -3])) == {0: 1, 1: 2, 2: 3}
            assert [worker.memory_limit for worker in cluster.workers] == [2_000_000_000]
        assert all(process.poll() is None for process in there.processes)  # not ours to stop


@pytest.mark.slow
@pytest.mark.parametrize(
    ("disguise", "memory", "said"),
    [
        (_OLDER, "2GB", "mgsgraph 0.0.1; expected mgsgraph"),
        ("", "0.25GB", "memory limit of 0.25 GB; expected at least 0.40 GB for the program alone"),
    ],
)
def test_a_worker_that_is_not_fit_is_named(disguise: str, memory: str, said: str, tmp_path: Path) -> None:
    with elsewhere(tmp_path) as there:
        there.worker(disguise, memory)
        message = refusal(there.address)
        assert message.startswith(f"--cluster {there.address}, worker tcp://127.0.0.1:")
        assert said in message


@pytest.mark.slow
def test_a_scheduler_without_workers(tmp_path: Path) -> None:
    with elsewhere(tmp_path) as there:
        assert f"a scheduler without workers; start some (dask worker {there.address})" in refusal(there.address, 1.0)


def test_certificates_that_are_missing_or_no_good(tmp_path: Path) -> None:
    expected = "expected ca-file, client.cert and client.key, PEM files; name them in dask's configuration"
    assert f"no certificates for tls (none is named); {expected}" in refusal("tls://127.0.0.1:9", 0.5)
    settings = certificate(tmp_path)
    for content, said in (("no certificate", "SSL"), (None, "No such file")):
        bad = tmp_path / "bad.pem"
        bad.write_text(content) if content else bad.unlink()
        with dask.config.set(settings | {"distributed.comm.tls.client.cert": str(bad)}):
            message = refusal("tls://127.0.0.1:9", 0.5)
        assert said in message
        assert expected in message


def test_nobody_there() -> None:
    began = time.monotonic()
    assert refusal("tcp://127.0.0.1:9", 0.5).startswith(
        "--cluster tcp://127.0.0.1:9: no scheduler answers there within 0.5 s"
    )
    assert time.monotonic() - began < 20.0  # dask itself would wait for 30 s


@pytest.mark.slow
@pytest.mark.parametrize(("which", "said"), [(0, "the scheduler has gone"), (1, "no worker is left")])
def test_a_cluster_that_goes_is_told(which: int, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connection, "_RETURN", 2.0)
    with elsewhere(tmp_path) as there:
        there.worker()
        with open_cluster(there.address, 20.0, insecure=True) as cluster:
            over: list[Any] = []

            def work() -> None:
                for result in cluster.each(time.sleep, [0.1, 30.0]):
                    over.append(result)
                    there.processes[which].kill()

            with pytest.raises(SolverError, match=said):
                work()
            assert over == [(0, None)]

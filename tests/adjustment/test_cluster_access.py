"""Another account of the machine gets nothing from the ports and files of a cluster of our own."""

import contextlib
import json
import os
import stat
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
NOBODY = 65534
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() != 0, reason="only root may become another user"),
]
pytest.importorskip("distributed", reason="dask.distributed is not installed (the extra `cluster`)")

_OURS = """
import sys
from mgsgraph import open_cluster
if __name__ == "__main__":
    with open_cluster("local:2") as cluster:
        assert dict(cluster.each(abs, [-1, -2])) == {0: 1, 1: 2}
        print("open", flush=True)
        sys.stdin.readline()
        assert dict(cluster.each(abs, [-1, -2])) == {0: 1, 1: 2}
"""
_OPEN_TO_ALL = """
import sys, distributed
if __name__ == "__main__":
    with distributed.LocalCluster(n_workers=1, dashboard_address="127.0.0.1:0"):
        print("open", flush=True)
        sys.stdin.readline()
"""
_STRANGER = """
import asyncio, json, os, socket, ssl, sys, tempfile, time
import distributed
from distributed.core import rpc
from distributed.protocol.pickle import dumps

ports, folder, user, mark = json.loads(sys.argv[1])
got = []  # what any port gave

def evil(name):
    import os
    with open(name, "a") as file:
        file.write(str(os.getuid()))

def ask(port, what, secure):
    try:
        with socket.create_connection(("127.0.0.1", port), timeout=2) as plain:
            if secure:
                context = ssl.create_default_context()
                context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
                plain = context.wrap_socket(plain)
            plain.settimeout(2)
            if what:
                plain.sendall(what)
            answer = plain.recv(1000)
            if answer and not (answer[:2] == b"\\x15\\x03" and len(answer) == 7):  # TLS: no, and nothing else
                got.append(("bytes", port, repr(what), repr(answer)))
    except OSError:
        pass

def securities():
    own = distributed.Security.temporary()
    yield "tcp", None
    yield "tls", own  # a certificate of the same name, signed by itself
    with tempfile.TemporaryDirectory() as place:
        for port in ports:  # that of the server, which everyone may see, believed
            try:
                seen = ssl.get_server_certificate(("127.0.0.1", port), timeout=2)
            except OSError:
                continue
            yield "tls", distributed.Security(
                require_encryption=True, tls_ca_file=seen, tls_client_cert=own.tls_client_cert,
                tls_client_key=own.tls_client_key)
            break

class Bare(distributed.Security):  # TLS without a certificate
    __slots__ = ()
    def get_connection_args(self, role):
        context = ssl.create_default_context()
        context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
        return {"ssl_context": context, "require_encryption": True, "extra_conn_args": {}}

async def one(port, protocol, security, call):
    try:
        await asyncio.wait_for(call(f"{protocol}://127.0.0.1:{port}", security), 6)
    except BaseException:
        pass

async def client(address, security):
    async with distributed.Client(address, security=security, asynchronous=True, timeout=3, set_as_default=False) as c:
        got.append(("client", address, str(await c.scheduler.identity())[:200]))
        await c.run_on_scheduler(evil, mark)
        await c.run(evil, mark)

async def direct(address, security):
    arguments = (security or distributed.Security()).get_connection_args("client")
    async with rpc(address, connection_args=arguments, timeout=3) as there:
        got.append(("rpc", address, str(await there.identity())[:200]))
        await there.run(function=dumps(evil), args=dumps((mark,)), kwargs=dumps({}))

async def calls():
    kinds = [*securities(), ("tls", Bare(require_encryption=True))]
    await asyncio.gather(*(one(port, *kind, call) for port in ports for kind in kinds for call in (client, direct)))

def attack():
    for port in ports:
        for secure in (False, True):
            for page in ("health", "metrics", "info/main/workers.html", "json/counts.json", "status", "sitemap.json"):
                ask(port, f"GET /{page} HTTP/1.1\\r\\nHost: localhost\\r\\n\\r\\n".encode(), secure)
            ask(port, b"", secure)
            ask(port, bytes(64), secure)
    asyncio.run(calls())
    for path, folders, names in os.walk(folder):
        for name in names:
            try:
                with open(os.path.join(path, name), "rb") as file:
                    got.append(("file", file.name))
            except OSError:
                pass
        for name in folders:
            if os.access(os.path.join(path, name), os.W_OK):
                got.append(("folder", os.path.join(path, name)))

async def rehearse():  # whatever is imported by the way, while Python's own library can be read
    how = {"n_workers": 1, "processes": False, "dashboard_address": None, "asynchronous": True}
    async with distributed.LocalCluster(protocol="tls", security=True, **how) as cluster:
        await client(cluster.scheduler_address, cluster.security)
        await direct(cluster.scheduler_address, cluster.security)
    assert [kind for kind, *_ in got] == ["client", "rpc"]

if user:
    name, mark = mark, os.devnull
    asyncio.run(rehearse())
    mark = name
    got.clear()
    os.setgroups([])
    os.setresgid(user, user, user)
    os.setresuid(user, user, user)
attack()
print(json.dumps([str(found) for found in got]), flush=True)
os._exit(0)
"""


@contextlib.contextmanager
def running(program: str, folder: Path) -> Iterator[int]:
    """Number of a process that has a cluster open, and temporary files in a folder."""
    (folder / "program.py").write_text(program, encoding="utf-8")
    (folder / "program.py").chmod(0o600)
    environment = os.environ | {"TMPDIR": str(folder), "PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path[1:]])}
    process = subprocess.Popen(
        [sys.executable, str(folder / "program.py")], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        env=environment,
    )  # fmt: skip
    assert process.stdin is not None
    assert process.stdout is not None
    try:
        assert process.stdout.readline() == "open\n"
        yield process.pid
        process.communicate("\n", timeout=60)
        assert process.returncode == 0
    finally:
        process.kill()
        process.wait()


def family(process: int) -> list[int]:
    """A process and all that it has begun."""
    children = [
        int(word)
        for task in Path(f"/proc/{process}/task").iterdir()
        for word in (task / "children").read_text().split()
    ]
    return [process, *(one for child in children for one in family(child))]


def sockets(processes: list[int]) -> set[str]:
    """Inodes of their sockets."""
    links = [os.readlink(link) for one in processes for link in Path(f"/proc/{one}/fd").iterdir() if link.is_symlink()]
    return {link[8:-1] for link in links if link.startswith("socket:[")}


def listening(processes: list[int]) -> tuple[list[int], list[str]]:
    """TCP ports, and sockets of files or names, at which they listen."""
    own = sockets(processes)
    tcp = [line.split() for name in ("tcp", "tcp6") for line in Path(f"/proc/net/{name}").read_text().splitlines()[1:]]
    ports = [int(line[1].rpartition(":")[2], 16) for line in tcp if line[3] == "0A" and line[9] in own]
    unix = [line.split() for line in Path("/proc/net/unix").read_text().splitlines()[1:]]
    return ports, [str(line) for line in unix if line[6] in own and int(line[3], 16) & 0x10000]


def stranger(ports: list[int], folder: Path, mark: Path) -> list[str]:
    """What another account gets."""
    order = json.dumps([ports, str(folder), NOBODY, str(mark)])
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", _STRANGER, order], capture_output=True, text=True,
        timeout=300, cwd="/", env=os.environ | {"TMPDIR": str(mark.parent), "HOME": str(mark.parent)},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return list(json.loads(done.stdout.splitlines()[-1]))


@pytest.fixture
def folder() -> Iterator[Path]:
    """A temporary folder like the system's, into which everyone may look."""
    with tempfile.TemporaryDirectory() as name:
        Path(name).chmod(0o755)
        yield Path(name)


@pytest.fixture
def open_to_all() -> Iterator[Path]:
    with tempfile.TemporaryDirectory() as name:
        Path(name).chmod(0o777)
        yield Path(name)


def test_another_account_gets_nothing(folder: Path, open_to_all: Path) -> None:
    mark = open_to_all / "mark"
    with running(_OURS, folder) as process:
        ports, names = listening(family(process))
        assert len(ports) == 5  # the scheduler, two workers, and who watches each
        assert names == []
        (private,) = (path for path in folder.iterdir() if path.name != "program.py")
        assert stat.S_IMODE(private.stat().st_mode) == 0o700
        assert stat.S_IMODE((private / "cluster.pem").stat().st_mode) == 0o600
        assert stranger(ports, folder, mark) == []
        assert not mark.exists()
    assert [path.name for path in folder.iterdir()] == ["program.py"]


def test_the_same_account_gets_all_of_a_cluster_without_certificates(folder: Path, open_to_all: Path) -> None:
    """So that the stranger of the test before is known to try what works."""
    mark = open_to_all / "mark"
    with running(_OPEN_TO_ALL, folder) as process:
        got = stranger(listening(family(process))[0], folder, mark)
        assert mark.read_text().count("0") >= 3  # user 0's: by the scheduler, its workers and who watches them
    for kind in ("bytes", "client", "rpc", "file"):
        assert any(one.startswith(f"('{kind}'") for one in got), kind

"""A process in which the libraries are imported and the kernel is loaded: it forks one for every command (`commands`).

Orders come in as lines of JSON, exit statuses go out. What a child begins with is what a fresh process has after
its imports; from then on it is a process like any other.
"""

import atexit
import json
import os
import signal
import sys
import tempfile
import threading
from importlib import import_module
from pathlib import Path
from typing import NoReturn

IMPORTED = (
    "mgsgraph.cli", "mgsgraph.simulation.demo.demonstration", "mgsgraph.results.page", "mgsgraph.results.figures",
    "mgsgraph.project.project", "mgsgraph.planning.plan", "scipy.stats", "pandas", "rasterio",
)  # fmt: skip
"""Libraries, too, that commands import where they need them: two seconds of each that writes results."""
MOST = 300
"""s that a command may take."""


def load() -> None:
    """What takes a fresh process its first seconds."""
    for name in IMPORTED:
        import_module(name)
    from mgsgraph.case.reading import adjust, read_case
    from mgsgraph.simulation.files import write_pair
    from mgsgraph.simulation.pair import PairSettings, simulate_pair

    with tempfile.TemporaryDirectory() as folder:
        adjust(read_case(write_pair(simulate_pair(PairSettings(ties=20, shots=8), seed=1), Path(folder))))


def become(folder: str, environment: dict[str, str], streams: list[str]) -> None:
    """Take the caller's folder and environment; nothing to read, and files to write to."""
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(environment)
    for number, path in enumerate((os.devnull, *streams)):
        opened = os.open(path, os.O_RDWR)
        os.dup2(opened, number)
        os.close(opened)
    signal.alarm(MOST)


def obey(arguments: list[str]) -> NoReturn:
    """The command, and the end of its process; not the interpreter's own, which would touch all that was imported."""
    from mgsgraph.cli import main

    sys.argv, status = ["mgsgraph", *arguments], 1
    try:
        main()
    except SystemExit as left:
        status = int(left.code or 0)
    except BaseException:
        sys.excepthook(*sys.exc_info())
    threading._shutdown()  # type: ignore[attr-defined]  # waits for threads, as an interpreter does at its end
    atexit._run_exitfuncs()
    sys.stdout.flush()
    os._exit(status)


def serve() -> None:
    """Fork for every order."""
    for line in sys.stdin:
        order = json.loads(line)
        child = os.fork()
        if child == 0:
            become(order["folder"], order["environment"], order["streams"])
            obey(order["arguments"])
        print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)


if __name__ == "__main__":
    load()
    print("ready", flush=True)
    serve()
    os._exit(0)

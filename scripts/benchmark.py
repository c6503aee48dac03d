"""How fast, and how large: this program measured, each part a command of its own.

    python scripts/benchmark.py speed [S M L XL Kaguya] [--peer PEER_CERES] [--repeat 5] [--json OUT] [--markdown OUT]
    python scripts/benchmark.py speed L XL --peer PEER_CERES --gate    # against baseline.json; exit status 1 if worse
    python scripts/benchmark.py speed --problem FILE.bin --json OUT    # one file, once
    python scripts/benchmark.py archive --work WORK [block kaguya dense ctx]   # from files to results, archives
    python scripts/benchmark.py project [10 100 498] [--ties 2000]     # commands: add, status, solve
    python scripts/benchmark.py analysis [L] [--queries 20]            # what it costs to ask an adjustment
    python scripts/benchmark.py COMMAND --help                         # all options

Each fills its page in docs, or writes it where --out says (`speed`: --markdown). Exit status: 0 done, 1 a limit
missed or not converged, 2 bad input, 130 interrupted.
"""

import inspect
import sys
from importlib import import_module

from study import command

COMMANDS = {"speed": "benchmark_speed", "archive": "benchmark_costs", "project": "benchmark_costs",
            "analysis": "benchmark_costs"}  # fmt: skip


def main() -> int:
    name, *arguments = sys.argv[1:] or [""]
    if name not in COMMANDS:
        parser = command(__doc__, "benchmark")
        parser.add_argument("command", choices=COMMANDS)
        parser.parse_args([name, *arguments])
    module = import_module(COMMANDS[name])  # not before its --threads count
    run = getattr(module, name)
    return int(run(command(inspect.getdoc(run), f"benchmark {name}"), arguments))


if __name__ == "__main__":
    sys.exit(main())

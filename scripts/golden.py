"""Compare golden results with what the program computes now; with --write make them anew, on purpose."""

import argparse
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
sys.modules.pop("golden", None)  # this file has that name, too
import golden  # noqa: E402


def main() -> int:
    """Exit status 1 if results differ and none is written."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", choices=[[], *golden.GOLDEN], help="all when absent")
    parser.add_argument("--write", action="store_true", help="replace the golden results")
    options, differ = parser.parse_args(), False
    for name in options.names or golden.GOLDEN:
        start = time.perf_counter()
        with tempfile.TemporaryDirectory() as folder:
            result = golden.computed(name, Path(folder))
        print(f"{name}: {time.perf_counter() - start:.1f} s", flush=True)
        if (golden.RESULTS / f"{name}.json").exists():
            differ |= show(golden.stored(name), result)
        if options.write:
            golden.write(name, result)
    return int(differ and not options.write)


def show(before: golden.Result, result: golden.Result) -> bool:
    """Print the largest difference of each kind, and all beyond the tolerances; True if there is one."""
    worst, kind = golden.differences(before, result, golden.tolerances()), before | result
    for quantity in golden.TOLERANCES:
        name = max((name for name in worst if kind[name][0] == quantity), key=worst.__getitem__, default="")
        if worst.get(name):
            print(f"  {quantity}: {worst[name]:.2g} tolerances at most, {name}")
    beyond = [name for name, off in worst.items() if off > 1.0]
    for name in beyond:
        was, now = (str(results.get(name, "absent"))[:60] for results in (before, result))
        print(f"  CHANGED by {worst[name]:.3g} tolerances: {name}: {was} -> {now}")
    return bool(beyond)


if __name__ == "__main__":
    sys.exit(main())

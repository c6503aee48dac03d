"""The GPU kernels' code, compiled without a GPU: registers, spills and shared memory of each, as a Markdown table.

`python scripts/gpu_code.py [--capability 9.0]` needs numba-cuda, its compiler (pip install "mgsgraph[cuda]", or a CUDA
toolkit that CUDA_HOME names) and `ptxas` of a toolkit. Exit status: 0, 1 a kernel spills, 3 something is missing. The
simulator (NUMBA_ENABLE_CUDASIM) takes much that a compiler refuses: this is the other half of the check.
"""

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

MISSING = 3


@dataclass(frozen=True)
class Code:
    """A compiled kernel."""

    name: str
    seconds: float
    """s, to compile it."""
    registers: int
    stack: int
    """Bytes of local memory."""
    spilled: int
    """Bytes stored because registers are full."""
    shared: int
    """Bytes."""

    def blocks(self, threads: int, shared: int = 233_472) -> int:
        """Blocks of so many threads that a multiprocessor of the H100 holds at a time."""
        by_registers = 65_536 // (threads * 8 * -(-self.registers // 8))
        return min(by_registers, 2048 // threads, shared // (self.shared + 1024))


def signatures() -> dict[str, tuple[Any, Any]]:
    """Each kernel and the types of its arguments, as `kernel.cuda.partition` launches it."""
    from numba import types

    from mgsgraph.kernel.cuda import coupling, covariance, solving
    from mgsgraph.kernel.cuda.tables import Tables
    from mgsgraph.kernel.rows import Model

    def array(kind: Any, dimensions: int) -> Any:
        return types.Array(kind, dimensions, "C")

    f1, f2, f3 = (array(types.float64, k) for k in (1, 2, 3))
    i1, i2, s1, s2 = array(types.int64, 1), array(types.int64, 2), array(types.int32, 1), array(types.int32, 2)
    b1, yes = array(types.int8, 1), types.boolean
    tables = types.NamedTuple([i2, i2, s2, f2, s2, i1, s1, s1, f2, f1], Tables)
    model = types.NamedTuple([types.int64] * 3 + [types.float64], Model)
    return {
        "solve": (solving.solve, (tables, model, f1, f2, b1, f1, f2, f2, yes, f2, b1, f1, f2)),
        "sum_costs": (solving.sum_costs, (tables, f1, f1)),
        "couple": (coupling.couple, (tables, model, f1, f2, b1, f1, b1, f2, f1)),
        "add_up": (coupling.add_up, (tables, s2, i1, f1, f1, f1)),
        "cover": (covariance.cover, (tables, b1, b1, f2, f1, f1, f2, f3)),
        "judge": (covariance.judge, (tables, model, f1, f2, b1, f1, b1, f2, f1, f1, f2, f3)),
        "residuals": (coupling.residuals, (tables, model, f1, f2, b1, f1, f2, f2)),
        "clear": (coupling.clear, (f1,)),
    }


def without_a_device(capability: tuple[int, int]) -> None:
    """Let numba-cuda compile device functions without a device that tells its capability."""
    from numba.cuda import dispatcher

    dispatcher.get_current_device = lambda: SimpleNamespace(compute_capability=capability)


def compiled(name: str, kernel: Any, arguments: Any, capability: tuple[int, int], folder: Path) -> Code:
    """Compile a kernel down to the machine's instructions."""
    from numba import cuda, types

    begin = time.perf_counter()
    text, _ = cuda.compile_ptx(kernel.py_func, types.void(*arguments), cc=capability)
    seconds = time.perf_counter() - begin
    source = folder / f"{name}.ptx"
    source.write_text(text, encoding="ascii")
    architecture = f"-arch=sm_{capability[0]}{capability[1]}"
    command = ["ptxas", "-v", architecture, str(source), "-o", str(folder / "code")]
    output = subprocess.run(command, capture_output=True, text=True, check=True).stderr

    def number(pattern: str) -> int:
        return sum(int(match) for match in re.findall(pattern, output))

    return Code(
        name, seconds, number(r"Used (\d+) registers"), number(r"(\d+) bytes stack frame"),
        number(r"(\d+) bytes spill stores"), number(r"(\d+) bytes smem"),
    )  # fmt: skip


def missing() -> str:
    """What is missing; empty where nothing is."""
    try:
        import numba_cuda  # noqa: F401
        from numba.cuda.cudadrv import nvrtc, nvvm

        nvvm.NVVM()
        nvrtc.get_supported_ccs()
    except Exception as error:
        return f"numba-cuda and its compiler: {' '.join(str(error).split())[:200]}"
    return "" if shutil.which("ptxas") else "ptxas"


def main() -> int:
    """Compile all of them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--capability", default="9.0", help="of the device: 8.0 A100, 9.0 H100, 8.9 L4")
    major, minor = (int(part) for part in parser.parse_args().capability.split("."))
    os.environ.pop("NUMBA_ENABLE_CUDASIM", None)
    toolkit = Path(shutil.which("nvcc") or "").resolve().parents[1:2]
    for folder in (*toolkit, Path("/usr/local/cuda")):
        if (folder / "nvvm").exists():
            os.environ.setdefault("CUDA_HOME", str(folder))
    if what := missing():
        print(f"missing: {what}", file=sys.stderr)
        return MISSING
    from mgsgraph.kernel.cuda.device import THREADS

    without_a_device((major, minor))
    print("| kernel | s to compile | registers | blocks per multiprocessor | stack (B) | spilled (B) | shared (B) |")
    print("|---|---|---|---|---|---|---|")
    bad = 0
    with tempfile.TemporaryDirectory() as folder:
        for name, (kernel, arguments) in signatures().items():
            code = compiled(name, kernel, arguments, (major, minor), Path(folder))
            bad += code.spilled > 0
            print(
                f"| {name} | {code.seconds:.1f} | {code.registers} | {code.blocks(THREADS)} | {code.stack} | "
                f"{code.spilled} | {code.shared} |"
            )
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())

"""The GPU's kernels: run by numba's CUDA simulator, the same answers as the CPU's; compiled, code without spills."""

import subprocess
import sys
from pathlib import Path

import pytest
import simulated_gpu

pytest.importorskip("numba_cuda", reason="numba-cuda is not installed (the extra `cuda`)")

BOUNDS = {
    "residuals": 1e-9, "misfits": 1e-9, "states": 0.0, "rejected": 0.0, "said": 0.0, "places": 1e-8, "sigma0": 1e-9,
}  # fmt: skip
"""Largest differences as a share of the largest number, in place of 1e-10. A residual of a pixel is what is left of
coordinates of 3,400 km: their rounding is a share of 1e-10 of it; where an optimiser stops is settled to 1e-8 sigmas,
which moves sigma0 of a robust fit in the first order (the cost alone is stationary there).
"""


def assert_near(found: dict[str, float]) -> None:
    far = {name: value for name, value in found.items() if not value <= BOUNDS.get(name.split(",")[0], 1e-10)}
    assert not far


@pytest.mark.parametrize("name", simulated_gpu.QUICK)
def test_the_simulated_device_gives_the_cpus_answers(name: str) -> None:
    """All in one process, some 10 s: the simulator runs each of the device's threads as Python."""
    assert_near(simulated_gpu.differences(*simulated_gpu.QUICK)[name])


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in simulated_gpu.CASES if name not in simulated_gpu.QUICK])
def test_the_simulated_device_gives_the_cpus_answers_whatever_the_network(name: str) -> None:
    assert_near(simulated_gpu.differences(name)[name])


@pytest.mark.program("ptxas", by_ci=False)
def test_the_compiler_takes_the_kernels_and_keeps_them_in_registers() -> None:
    """The simulator takes what a compiler refuses."""
    program = Path(__file__).resolve().parents[2] / "scripts" / "gpu_code.py"
    done = subprocess.run([sys.executable, program], capture_output=True, text=True, check=False)
    if done.returncode == 3:
        pytest.skip(f"NVIDIA's compiler is not here ({done.stderr.strip()})")
    assert done.returncode == 0, done.stdout + done.stderr
    kernels = {line.split("|")[1].strip() for line in done.stdout.splitlines()[2:]}
    assert kernels > {"solve", "couple", "add_up", "cover", "judge"}

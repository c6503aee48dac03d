"""The C++ peer on a problem file: its variants, and its figures in our words."""

import json
import os
import subprocess
from pathlib import Path
from typing import Any

from mgsgraph.errors import InputError

VARIANTS = {
    "plain": ("--cost", "auto", "--layout", "plain", "--radius", "1e4"),
    "analytic": ("--cost", "analytic", "--layout", "fused", "--radius", "1e16"),
    "custom": ("--solver", "custom_gn", "--cov", "schur"),
}
"""Ceres as one writes it first; Ceres at its best here (README of the peer); hand-written Gauss-Newton in C++, which
computes all point covariances as well."""
TOLERANCE = ("--ftol", "1e-10")
"""Relative change of the cost at which it stops; ours is the same."""
_KEYS = {
    "t_solve": "seconds_solve", "iterations": "iterations", "final_cost": "cost_final", "maxrss_mb": "peak_memory_mb",
    "initial_cost": "cost_initial", "t_load": "seconds_read", "t_build": "seconds_network",
}  # fmt: skip
_REMEDY = "build it with the peer's build.sh"


def require_peer(program: Path) -> None:
    """Raise InputError unless the peer's program can be run."""
    if not program.is_file():
        raise InputError(str(program), "no such file", "the peer's program peer_ceres", _REMEDY)
    if not os.access(program, os.X_OK):
        raise InputError(str(program), "not executable", "the peer's program peer_ceres", _REMEDY)


def run_peer(program: Path, problem: Path, variant: str, threads: int) -> dict[str, Any]:
    """Figures of one run; InputError when the program fails or says something else than the peer's line of JSON."""
    command = [str(program), str(problem), *VARIANTS[variant], *TOLERANCE, "--threads", str(threads)]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False, errors="replace")
    except OSError as error:
        raise InputError(str(program), f"can't be run ({error.strerror or error})", remedy=_REMEDY) from None
    try:
        said = json.loads(done.stdout)
        figures: dict[str, Any] = {ours: float(said[theirs]) for theirs, ours in _KEYS.items()}
    except (ValueError, KeyError, TypeError):
        last = (done.stderr.strip() or done.stdout.strip() or "nothing").splitlines()[-1][:200]
        found = f"exit status {done.returncode}, saying {last!r}"
        raise InputError(f"{program}, {variant}", found, "one line of JSON with its figures", _REMEDY) from None
    figures["converged"] = said.get("termination") == "CONVERGENCE"
    if "cov_schur_t" in said:
        figures["seconds_covariance"] = float(said["cov_schur_t"])
    return figures

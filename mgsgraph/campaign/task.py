"""One case of a campaign, wherever it runs: read, adjusted, and its products written as `mgsgraph adjust` would."""

import dataclasses
import math
import os
import socket
import time
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

from mgsgraph.campaign.entry import Entry, Wishes
from mgsgraph.campaign.inputs import checksums
from mgsgraph.case.reading import adjust, read_case
from mgsgraph.errors import MgsgraphError
from mgsgraph.output.folders import require_replaceable
from mgsgraph.reports.results import write_results


@dataclass(frozen=True, slots=True)
class Order:
    """A case to be done."""

    case: Path
    """Its file, absolute: the same on all machines."""
    name: str
    """What the record calls it."""
    out: Path
    """Folder of the campaign's results, absolute."""
    folder: str
    """Name of the folder in it for this case."""
    wishes: Wishes
    """What overrules the case file."""
    base: Path
    """Working directory, from which SPICE looks for what a meta-kernel lists."""


def run_case(order: Order) -> Entry:
    """Do a case; whatever goes wrong is told in the entry."""
    if order.base.is_dir():
        os.chdir(order.base)  # that of a worker elsewhere is another
    began, sums = time.perf_counter(), checksums(order.case)
    try:
        told = _adjusted(order)
    except MgsgraphError as error:
        told = {"message": str(error)}
    except MemoryError:
        told = {"message": "out of memory; give the machine more or leave images out"}
    except Exception as error:  # one case must not end the others
        told = {"message": f"unforeseen {type(error).__name__}: {error}; `mgsgraph adjust` shows where"}
    return _entry(order, sums, time.perf_counter() - began, told)


def _adjusted(order: Order) -> dict[str, Any]:
    """Read, adjust and write; the figures that the record keeps."""
    target = order.out / order.folder
    require_replaceable(target)
    case = read_case(order.case, laser=order.wishes.laser)
    solution = adjust(dataclasses.replace(case, settings=order.wishes.over(case.settings)))
    write_results(solution, target, figures=order.wishes.figures)
    return {
        "status": "done" if solution.converged else "not converged",
        "message": solution.message,
        "converged": solution.converged,
        "sigma0": solution.sigma0 if math.isfinite(solution.sigma0) else None,
        "cost": solution.cost_final,
        "iterations": solution.iterations,
    }


def failed(order: Order, message: str) -> Entry:
    """Entry of a case whose worker has not come back."""
    return _entry(order, checksums(order.case), 0.0, {"message": message})


def _entry(order: Order, sums: dict[str, str | None], seconds: float, told: dict[str, Any]) -> Entry:
    missing: dict[str, Any] = {"status": "failed", "converged": False, "sigma0": None, "cost": None, "iterations": None}
    told = missing | told
    told["message"] = " ".join(told["message"].split())
    if told["status"] == "failed" and (order.out / order.folder).exists():
        told["message"] += f" (what is in {order.folder} is from before)"
    return Entry(
        case=order.name,
        folder=order.folder,
        seconds=round(seconds, 3),
        checksums=sums,
        wishes=order.wishes,
        version=version("mgsgraph"),
        machine=socket.gethostname(),
        finished=datetime.now(UTC).isoformat(timespec="seconds"),
        **told,
    )

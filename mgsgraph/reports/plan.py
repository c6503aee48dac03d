"""A plan in words, as a table for the terminal, and as files: plan.csv, plan.json and a figure."""

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mgsgraph.adjustment.planning.plan import Judged, Plan
from mgsgraph.adjustment.planning.targets import Sigmas
from mgsgraph.output.csv_json import plain, quoted, write_csv
from mgsgraph.output.folders import PLAN, PROGRAM, fresh_folder
from mgsgraph.units import KM
from mgsgraph.wording import many, short

_NAME, _KIND = 28, 13
"""Letters of these columns."""
_WIDTHS = (8, 8, 8, 8, 8, 7, 9, 8, 6)
"""Letters of the others."""
_SHOWN = 30
"""Rows of the ranking that are printed; the files have all."""


def plan_table(plan: Plan) -> str:
    """The ranking, and what is chosen step by step: sigma of the targets before and after, the latter eastward,
    northward and upward, too.
    """
    shown = plan.ranking[:_SHOWN]
    lines = ["Each by itself", _head(), *(_row(k + 1, one) for k, one in enumerate(shown))]
    if len(plan.ranking) > len(shown):
        lines.append(f"... and {len(plan.ranking) - len(shown)} more")
    if plan.chosen:
        lines += ["", "Chosen one after the other", _head(), *(_row(k + 1, one) for k, one in enumerate(plan.chosen))]
    return "\n".join(lines)


def _head() -> str:
    titles = ("before", "after", "east", "north", "up", "drop", "gain", "measures", "images")
    units = ("m", "m", "m", "m", "m", "%", "bits", "", "")
    lines = (
        " ".join(f"{word:>{width}}" for word, width in zip(words, _WIDTHS, strict=True)) for words in (titles, units)
    )
    first, second = lines
    blank = " " * (4 + 1 + _NAME + 1 + _KIND + 1)
    return f"{'':>4} {'candidate':<{_NAME}} {'kind':<{_KIND}} {first}\n{blank}{second}".rstrip()


def _row(number: int, one: Judged) -> str:
    name = f"{number:>4} {short(one.name, _NAME):<{_NAME}} {one.kind:<{_KIND}} "
    if one.reason:
        return f"{name}worthless: {one.reason}"
    values = (one.before.total, one.after.total, one.after.east, one.after.north, one.after.up)
    texts = [f"{value:.4g}" for value in values]
    texts += [f"{100.0 * one.drop:.3g}", f"{one.bits:.3f}", str(one.measures), str(len(one.images))]
    return name + " ".join(f"{text:>{width}}" for text, width in zip(texts, _WIDTHS, strict=True))


def statements(plan: Plan) -> list[str]:
    """What the plan says, in sentences."""
    what = "mean sigma" if plan.criterion == "mean" else "largest sigma"
    found = [f"Targets: {plan.targets.words()}; their {what} is {plan.now.total:.4g} m now ({_local(plan.now)})."]
    if not plan.chosen:
        return [*found, "None of the candidates is worth anything: each row above says why."]
    names = ", ".join(one.name for one in plan.chosen)
    measures = sum(one.measures for one in plan.chosen)
    found.append(
        f"Chosen: {names}; the {what} falls to {plan.after.total:.4g} m ({_local(plan.after)}), by "
        f"{100.0 * plan.drop:.3g}%, with {many(measures, 'measure')} and {plan.bits:.3f} bits gained on the unknowns "
        "that exist already."
    )
    if plan.plain is not None and len(plan.chosen) > 1:
        found.append(_against_plain(plan, plan.plain))
    return found


def _against_plain(plan: Plan, plain_choice: Judged) -> str:
    count = len(plan.chosen)
    if {one.name for one in plan.chosen} == set(plain_choice.name.split(" + ")):
        return f"The first {count} of the ranking are the same ones."
    gain = 100.0 * (1.0 - plan.after.total / plain_choice.after.total)
    better = f"{abs(gain):.2g}% {'lower' if gain >= 0.0 else 'HIGHER'}"
    return (
        f"The first {count} of the ranking ({plain_choice.name}) would leave {plain_choice.after.total:.4g} m and gain "
        f"{plain_choice.bits:.3f} bits: what was chosen in sight of one another leaves a sigma that is {better}."
    )


def _local(sigmas: Sigmas) -> str:
    return f"east {sigmas.east:.3g}, north {sigmas.north:.3g}, up {sigmas.up:.3g} m"


def write_plan(plan: Plan, folder: str | Path, figures: bool = True) -> list[str]:
    """Write a plan to a folder that appears whole or not at all; the names of the files.

    Raises
    ------
    InputError
        If the folder holds anything but an earlier plan, or can't be written.
    """
    with fresh_folder(folder, PLAN) as aside:
        text = json.dumps(plan_json(plan), indent=1, allow_nan=False, ensure_ascii=False)
        (aside / PLAN).write_text(text + "\n", encoding="utf-8", newline="\n")
        _csv(plan, aside / "plan.csv")
        names = [PLAN, "plan.csv"]
        if figures:
            from mgsgraph.figures.plan import write_plan_figure  # matplotlib takes its time

            names += write_plan_figure(plan, aside)
    return names


def plan_json(plan: Plan) -> dict[str, Any]:
    """All that the plan says; lengths in m, areas in km^2."""
    return {
        "program": PROGRAM,
        "name": plan.name,
        "targets": list(plan.targets.wanted),
        "targets_number": len(plan.targets),
        "criterion": plan.criterion,
        "now": _sigmas_json(plan.now),
        "ranking": [_judged_json(one) for one in plan.ranking],
        "chosen": [_judged_json(one) for one in plan.chosen],
        "after_all_chosen": _sigmas_json(plan.after),
        "bits_of_all_chosen": plan.bits,
        "first_of_the_ranking_together": None if plan.plain is None else _judged_json(plan.plain),
    }


def _sigmas_json(one: Sigmas) -> dict[str, Any]:
    return {
        "sigma_m": one.total, "east_m": one.east, "north_m": one.north, "up_m": one.up, "worst_target": one.worst,
    }  # fmt: skip


def _judged_json(one: Judged) -> dict[str, Any]:
    found = {
        "name": one.name, "kind": one.kind, "before": _sigmas_json(one.before), "after": _sigmas_json(one.after),
        "drop_percent": 100.0 * one.drop, "bits": one.bits, "image_measures": one.rays, "ranges": one.ranges,
        "images": list(one.images), "overlap_km2": one.overlap / KM**2, "reason": one.reason or None,
    }  # fmt: skip
    cleaned: dict[str, Any] = plain(found)
    return cleaned


def _csv(plan: Plan, path: Path) -> None:
    """One row per candidate and list (ranking, chosen), in order."""
    lists: Sequence[tuple[str, Sequence[Judged]]] = (
        ("ranking", plan.ranking), ("chosen", plan.chosen), ("first of ranking", [plan.plain] if plan.plain else []),
    )  # fmt: skip
    rows = [(which, k + 1, one) for which, some in lists for k, one in enumerate(some)]
    text: dict[str, Sequence[str]] = {
        "list": [which for which, _, _ in rows],
        "rank": [str(k) for _, k, _ in rows],
        "candidate": [quoted(one.name) for _, _, one in rows],
        "kind": [one.kind for _, _, one in rows],
        "reason": [quoted(one.reason) for _, _, one in rows],
    }
    table = np.array([_numbers(one) for _, _, one in rows], dtype=np.float64)
    names = [
        "sigma_before_m", "sigma_after_m", "east_before_m", "east_after_m", "north_before_m", "north_after_m",
        "up_before_m", "up_after_m", "drop_percent", "bits", "image_measures", "ranges", "images", "overlap_km2",
    ]  # fmt: skip
    write_csv(path, text, dict(zip(names, table.T, strict=True)))


def _numbers(one: Judged) -> list[float]:
    before, after = one.before, one.after
    sigmas = [
        before.total, after.total, before.east, after.east, before.north, after.north, before.up, after.up,
    ]  # fmt: skip
    area = one.overlap / KM**2 if math.isfinite(one.overlap) else math.nan
    return [*sigmas, 100.0 * one.drop, one.bits, one.rays, one.ranges, len(one.images), area]

"""A plan in words, as a table for the terminal, and as files: plan.csv, plan.json and a figure."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from mgsgraph.files.output.table import Table, numbers
from mgsgraph.planning.plan import Evaluation, Plan, Sigmas
from mgsgraph.results.section import Section, record_of, table_of
from mgsgraph.text import many
from mgsgraph.units import KM


def plan_section(plan: Plan) -> Section:
    """The ranking, and what is chosen step by step: sigmas of the targets before and after."""
    table = judged_table({"ranking": plan.ranking, "chosen": plan.chosen})
    ends = np.cumsum([0, len(plan.ranking), len(plan.chosen)])
    shown = [
        replace(table.take(np.arange(first, last)), title=title)
        for first, last, title in zip(ends, ends[1:], ("Each by itself", "Chosen one after the other"), strict=False)
    ]

    return Section("plan", "", statements(plan), shown, plan_json(plan), [table])


def judged_table(lists: Mapping[str, Sequence[Evaluation]]) -> Table:
    """One row per candidate and list that it is of, in their order: what it would do to the sigmas of the targets."""
    judged = [one for some in lists.values() for one in some]
    ranks = [k + 1 for some in lists.values() for k in range(len(some))]
    before, after = [one.before for one in judged], [one.after for one in judged]
    return table_of("plan", {
        "list": [name for name, some in lists.items() for _ in some], "rank": np.array(ranks, dtype=np.int64),
        "sigma_before": numbers(before, "total"), "sigma_after": numbers(after, "total"),
        **{f"{way}_{when}": numbers(sigmas, way)
           for way in ("east", "north", "up") for when, sigmas in (("before", before), ("after", after))},
        "images": np.array([float(len(one.images)) for one in judged]),
    }, judged, instead={
        k: ("sigma_before", f"worthless: {one.reason}") for k, one in enumerate(judged) if one.reason
    })  # fmt: skip


def statements(plan: Plan) -> list[str]:
    """What the plan says, in sentences."""
    what = "mean sigma" if plan.criterion == "mean" else "largest sigma"
    found = [f"Targets: {plan.targets.words}; their {what} is {plan.now.total:.4g} m now ({_local(plan.now)})."]
    if not plan.chosen:
        return [*found, "None of the candidates is worth anything: each row above says why."]
    names, measures = ", ".join(one.name for one in plan.chosen), sum(one.measures for one in plan.chosen)
    found.append(
        f"Chosen: {names}; the {what} falls to {plan.after.total:.4g} m ({_local(plan.after)}), by "
        f"{100.0 * plan.drop:.3g}%, with {many(measures, 'measure')} and {plan.bits:.3f} bits gained on the unknowns "
        "that exist already."
    )
    return found


def _local(sigmas: Sigmas) -> str:
    return f"east {sigmas.east:.3g}, north {sigmas.north:.3g}, up {sigmas.up:.3g} m"


def plan_json(plan: Plan) -> dict[str, Any]:
    """All that the plan says; lengths in m, areas in km^2."""
    return {
        "name": plan.name,
        "targets": list(plan.targets.wanted),
        "targets_number": len(plan.targets),
        "criterion": plan.criterion,
        "now": _sigmas_json(plan.now),
        "ranking": [_judged_json(one) for one in plan.ranking],
        "chosen": [_judged_json(one) for one in plan.chosen],
        "after_all_chosen": _sigmas_json(plan.after),
        "bits_of_all_chosen": plan.bits,
    }


def _sigmas_json(one: Sigmas) -> dict[str, Any]:
    return record_of("plan_sigmas", one)  # fmt: skip


def _judged_json(one: Evaluation) -> dict[str, Any]:
    return {
        "name": one.name, "kind": one.kind, "before": _sigmas_json(one.before), "after": _sigmas_json(one.after),
        "drop_percent": 100.0 * one.drop, "bits": one.bits, "image_measures": one.rays, "ranges": one.ranges,
        "images": list(one.images), "overlap_km2": one.overlap / KM**2, "reason": one.reason or None,
    }  # fmt: skip

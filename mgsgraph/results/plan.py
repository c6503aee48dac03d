"""A plan as sentences, as a table for the terminal, and as files: plan.csv, plan.json and a figure."""

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
    table = evaluations_table({"ranking": plan.ranking, "chosen": plan.chosen})
    ends = np.cumsum([0, len(plan.ranking), len(plan.chosen)])
    shown = [
        replace(table.take(np.arange(first, last)), title=title)
        for first, last, title in zip(ends, ends[1:], ("Each by itself", "Chosen one after the other"), strict=False)
    ]

    return Section("plan", "", statements(plan), shown, plan_json(plan), [table])


def evaluations_table(lists: Mapping[str, Sequence[Evaluation]]) -> Table:
    """One row per candidate and list that it is of, in their order: what it would do to the sigmas of the targets."""
    evaluations = [evaluation for group in lists.values() for evaluation in group]
    ranks = [k + 1 for group in lists.values() for k in range(len(group))]
    before, after = [evaluation.before for evaluation in evaluations], [evaluation.after for evaluation in evaluations]
    return table_of("plan", {
        "list": [name for name, group in lists.items() for _ in group], "rank": np.array(ranks, dtype=np.int64),
        "sigma_before": numbers(before, "total"), "sigma_after": numbers(after, "total"),
        **{f"{axis}_{when}": numbers(sigmas, axis)
           for axis in ("east", "north", "up") for when, sigmas in (("before", before), ("after", after))},
        "images": np.array([float(len(evaluation.images)) for evaluation in evaluations]),
    }, evaluations, instead={
        k: ("sigma_before", f"no gain: {evaluation.reason}") for k, evaluation in enumerate(evaluations)
        if evaluation.reason
    })  # fmt: skip


def statements(plan: Plan) -> list[str]:
    """The plan in sentences."""
    quantity = "mean sigma" if plan.criterion == "mean" else "largest sigma"
    sentences = [f"Targets: {plan.targets.words}; their {quantity} is {plan.now.total:.4g} m now "
                 f"({_sigmas_text(plan.now)})."]
    if not plan.chosen:
        return [*sentences, "No candidate improves the targets: each row above states the reason."]
    names, measures = ", ".join(evaluation.name for evaluation in plan.chosen), sum(evaluation.measures
                                                                                    for evaluation in plan.chosen)
    sentences.append(
        f"Chosen: {names}; the {quantity} falls to {plan.after.total:.4g} m ({_sigmas_text(plan.after)}), by "
        f"{100.0 * plan.drop:.3g}%, with {many(measures, 'measure')} and {plan.bits:.3f} bits gained on the unknowns "
        "that exist already."
    )
    return sentences


def _sigmas_text(sigmas: Sigmas) -> str:
    return f"east {sigmas.east:.3g}, north {sigmas.north:.3g}, up {sigmas.up:.3g} m"


def plan_json(plan: Plan) -> dict[str, Any]:
    """The plan as a record; lengths in m, areas in km^2."""
    return {
        "name": plan.name,
        "targets": list(plan.targets.wanted),
        "targets_number": len(plan.targets),
        "criterion": plan.criterion,
        "now": _sigmas_json(plan.now),
        "ranking": [_evaluation_json(evaluation) for evaluation in plan.ranking],
        "chosen": [_evaluation_json(evaluation) for evaluation in plan.chosen],
        "after_all_chosen": _sigmas_json(plan.after),
        "bits_of_all_chosen": plan.bits,
    }


def _sigmas_json(sigmas: Sigmas) -> dict[str, Any]:
    return record_of("plan_sigmas", sigmas)  # fmt: skip


def _evaluation_json(evaluation: Evaluation) -> dict[str, Any]:
    return {
        "name": evaluation.name, "kind": evaluation.kind, "before": _sigmas_json(evaluation.before),
        "after": _sigmas_json(evaluation.after),
        "drop_percent": 100.0 * evaluation.drop, "bits": evaluation.bits, "image_measures": evaluation.rays,
        "ranges": evaluation.ranges,
        "images": list(evaluation.images), "overlap_km2": evaluation.overlap / KM**2, "reason": evaluation.reason
        or None,
    }  # fmt: skip

"""A choice of the spacing of orientation images in words, and as files: nodes.json and spacings.csv."""

import math

import numpy as np

from mgsgraph.analysis.spacing import Choice
from mgsgraph.errors import InputError
from mgsgraph.files.output.table import Table
from mgsgraph.results.section import Section, table_of
from mgsgraph.text import many


def seconds_of(text: str) -> list[float]:
    """Spacings, s, as people write them: 4,8,16."""
    try:
        found = [float(one) for one in text.split(",")]
    except ValueError:
        found = []
    if not found or not all(math.isfinite(one) and one > 0.0 for one in found):
        raise InputError("spacings", repr(text), "positive numbers of seconds with commas between them, as 4,8,16")
    return found


def candidates_table(choice: Choice) -> Table:
    """One row per candidate spacing."""
    several = choice.candidates
    state = ["chosen" if k == choice.chosen else "best" if k == choice.best else "" for k in range(len(several))]
    refused = [one.refused for one in several]
    return table_of("spacings", {
        "standing": ["refused" if why else state for why, state in zip(refused, state, strict=True)],
        "reason": refused, "rms_error": np.asarray(choice.rms_errors),
        "worse": np.asarray(choice.worse), "worse_error": np.asarray(choice.worse_errors), "mark": state,
    }, several, instead={k: ("longest", f" refused: {why}") for k, why in enumerate(refused) if why})  # fmt: skip


def node_statements(choice: Choice) -> list[str]:
    """What was found, in sentences."""
    chosen, best = choice.candidates[choice.chosen], choice.candidates[choice.best]
    found = [
        f"{many(chosen.squares.size, 'ray')} held out, one of a point each, are predicted best by nodes every "
        f"{best.spacing:g} s. Chosen: {chosen.spacing:g} s, {many(chosen.nodes, 'node')}, the coarsest within one "
        "standard error of the best."
    ]
    good = [one for one in choice.candidates if not one.refused]
    if chosen is good[0] or chosen is good[-1]:
        end, other = ("closest", "closer") if chosen is good[0] else ("widest", "wider")
        found.append(f"That is the {end} candidate that could be adjusted: a {other} one may be better.")
    for count, why in (
        (choice.rejected, f"rejected as blunders, with nodes every {good[0].spacing:g} s, took part with no candidate"),
        (choice.blunders, "held out that no candidate can predict (blunders) don't count"),
        (choice.unjudged, "held out have no prediction (no other rays place their points) and don't count"),
    ):
        found += [f"{many(count, 'ray')} {why}."] if count else []
    return found


def nodes_section(choice: Choice, name: str) -> Section:
    """Candidates and what was found."""
    candidates, best = candidates_table(choice), choice.candidates[choice.best]
    record = {
        "name": name,
        "rays_held_out": best.squares.size,
        "blunders_held_out": choice.blunders,
        "unjudged_held_out": choice.unjudged,
        "rays_rejected": choice.rejected,
        "closest_s": next(one.spacing for one in choice.candidates if not one.refused),
        "candidates": candidates.drop("standing").records(),
        "best_s": best.spacing,
        "chosen_s": choice.spacing,
    }
    return Section("nodes", "", node_statements(choice), [candidates], record, [candidates])

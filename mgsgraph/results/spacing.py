"""A choice of the spacing of orientation images as sentences and files: nodes.json and spacings.csv."""

import math

import numpy as np

from mgsgraph.analysis.spacing import Choice
from mgsgraph.errors import InputError
from mgsgraph.files.output.table import Table
from mgsgraph.results.section import Section, table_of
from mgsgraph.text import many


def seconds_of(text: str) -> list[float]:
    """Spacings in s from a user's text such as 4,8,16."""
    try:
        seconds = [float(part) for part in text.split(",")]
    except ValueError:
        seconds = []
    if not seconds or not all(math.isfinite(spacing) and spacing > 0.0 for spacing in seconds):
        raise InputError("spacings", repr(text), "positive numbers of seconds with commas between them, as 4,8,16")
    return seconds


def candidates_table(choice: Choice) -> Table:
    """One row per candidate spacing."""
    candidates = choice.candidates
    state = ["chosen" if k == choice.chosen else "best" if k == choice.best else "" for k in range(len(candidates))]
    reasons = [candidate.refused for candidate in candidates]
    return table_of("spacings", {
        "standing": ["refused" if reason else state for reason, state in zip(reasons, state, strict=True)],
        "reason": reasons, "rms_error": np.asarray(choice.rms_errors),
        "worse": np.asarray(choice.worse), "worse_error": np.asarray(choice.worse_errors), "mark": state,
    }, candidates, instead={k: ("longest", f" refused: {reason}") for k, reason in enumerate(reasons) if reason})


def node_statements(choice: Choice) -> list[str]:
    """The choice in sentences."""
    chosen, best = choice.candidates[choice.chosen], choice.candidates[choice.best]
    sentences = [
        f"{many(chosen.squared_errors.size, 'ray')} held out, one of a point each, are predicted best by nodes every "
        f"{best.spacing:g} s. Chosen: {chosen.spacing:g} s, {many(chosen.nodes, 'node')}, the coarsest within one "
        "standard error of the best."
    ]
    adjusted = [candidate for candidate in choice.candidates if not candidate.refused]
    if chosen is adjusted[0] or chosen is adjusted[-1]:
        end, further = ("closest", "closer") if chosen is adjusted[0] else ("widest", "wider")
        sentences.append(f"That is the {end} candidate that could be adjusted: a {further} one may be better.")
    for count, reason in (
        (choice.rejected,
         f"rejected as blunders, with nodes every {adjusted[0].spacing:g} s, took part with no candidate"),
        (choice.blunders, "held out that no candidate can predict (blunders) don't count"),
        (choice.unjudged, "held out have no prediction (no other rays place their points) and don't count"),
    ):
        sentences += [f"{many(count, 'ray')} {reason}."] if count else []
    return sentences


def nodes_section(choice: Choice, name: str) -> Section:
    """Candidates and the choice among them."""
    candidates, best = candidates_table(choice), choice.candidates[choice.best]
    record = {
        "name": name, "rays_held_out": best.squared_errors.size, "blunders_held_out": choice.blunders,
        "unjudged_held_out": choice.unjudged, "rays_rejected": choice.rejected,
        "closest_s": next(candidate.spacing for candidate in choice.candidates if not candidate.refused),
        "candidates": candidates.drop("standing").records(), "best_s": best.spacing, "chosen_s": choice.spacing,
    }
    return Section("nodes", "", node_statements(choice), [candidates], record, [candidates])

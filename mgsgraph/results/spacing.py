"""A study of orientation images in words, and as files: nodes.json, CSV files of all numbers, and figures."""

import math
from pathlib import Path
from typing import Any

import numpy as np

from mgsgraph.analysis.spacing.choice import Choice
from mgsgraph.analysis.spacing.corrections import AXES
from mgsgraph.analysis.spacing.spectrum import FALSE_ALARMS
from mgsgraph.analysis.spacing.study import NodeStudy
from mgsgraph.errors import InputError
from mgsgraph.files.output.csv_json import picked
from mgsgraph.files.output.folders import NODES
from mgsgraph.files.output.table import Column, Table, numbers
from mgsgraph.geometry.records import Array
from mgsgraph.results.section import Section, drawn, write_sections
from mgsgraph.text import many, some
from mgsgraph.units import ARCSEC, MGON

_CONTRADICTED = 3.0
"""Times the prior's sigma that a vibration may have before the prior counts as wrong."""


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
    nodes, refused = [one.nodes for one in several], [one.refused for one in several]
    return Table("spacings", "Misfits of rays held out, in their sigmas for known orientation (worse: than the best)", (
        Column("standing", ["refused" if why else state for why, state in zip(refused, state, strict=True)]),
        Column("reason", refused, json="refused"),
        Column("spacing", numbers(several, "spacing"), "s", text=">9g"),
        Column("nodes", np.array(nodes, dtype=np.float64), text=">6.0f"),
        Column("longest", numbers(several, "longest"), "s", "largest interval", text=">8.4g",
               json="longest_interval_s"),
        Column("rms", numbers(several, "rms"), text=">8.4f"),
        Column("rms_error", np.asarray(choice.rms_errors), label="+-", text=">7.4f"),
        Column("median", numbers(several, "median"), text=">8.4f"),
        Column("median_error", numbers(several, "median_error"), label="+-", text=">7.4f"),
        Column("worse", np.asarray(choice.worse), text=">9.4f", json="worse_than_best"),
        Column("worse_error", np.asarray(choice.worse_errors), label="+-", text=">8.4f"),
        Column("sigma0", numbers(several, "sigma0"), text=">8.4f"),
        Column("mark", state, label="", text="<", files=False),
    ), instead={k: ("longest", f" refused: {why}") for k, why in enumerate(refused) if why})  # fmt: skip


def node_statements(study: NodeStudy) -> list[str]:
    """What was found, in sentences."""
    choice = study.choice
    chosen, best = choice.candidates[choice.chosen], choice.candidates[choice.best]
    good = [one.spacing for one in choice.candidates if not one.refused]
    found = [
        f"{many(chosen.squares.size, 'ray')} held out, one of a point each, are predicted best by nodes every "
        f"{best.spacing:g} s. Chosen: {chosen.spacing:g} s, {many(chosen.nodes, 'node')}, the coarsest within one "
        "standard error of the best."
    ]
    if chosen.spacing in (good[0], good[-1]):
        end = "closest" if chosen.spacing == good[0] else "widest"
        found.append(f"That is the {end} candidate that could be adjusted; one beyond it may be better.")
    if choice.rejected or choice.blunders or choice.unjudged:
        found.append(
            f"Not counted: {many(choice.rejected, 'ray')} rejected as blunders with nodes every "
            f"{choice.candidates[choice.closest].spacing:g} s, {choice.blunders} held out that no candidate predicts, "
            f"{choice.unjudged} held out whose points no other rays place."
        )
    scatter = choice.scatter
    found.append(
        f"Rays of one line within a moment scatter {scatter.factor:.3f} +- {scatter.error:.3f} times their stated "
        f"sigmas{', WHICH ARE WRONG: correct them' if scatter.contradicts else ''}; noise in spectra is taken as that."
        if math.isfinite(scatter.error) else
        "There are too few rays to tell how much they scatter: their stated sigmas are used."
    )  # fmt: skip
    for one in study.strips:
        for known, spectrum in zip(one.corrections.known.tolist(), one.spectra, strict=True):
            most = max((peak.amplitude for peak in spectrum.vibrations), default=0.0)
            if most > _CONTRADICTED * known:
                found.append(f"{spectrum.strip}, {spectrum.axis}: a vibration's amplitude is {most / known:.3g} times "
                             "what the prior expects of departures: give it a wider sigma.")  # fmt: skip
    quiet = [one.corrections.strip for one in study.strips if not any(spectrum.vibrations for spectrum in one.spectra)]
    if quiet:
        found.append(f"No vibration found in {some(quiet, len(quiet))} beyond noise ({100.0 * FALSE_ALARMS:g} % false "
                     "alarms per axis) and what the prior expects.")  # fmt: skip
    if study.densified is not None:
        first, last = study.densified.rounds[0], study.densified.rounds[-1]
        found.append(f"Where residuals asked for closer nodes: {sum(first.nodes)} became {sum(last.nodes)}, sigma0 "
                     f"{first.sigma0:.4f} became {last.sigma0:.4f}. {study.densified.message}")  # fmt: skip
    return found


def nodes_section(study: NodeStudy) -> Section:
    """Candidates and what was found."""
    candidates = candidates_table(study.choice)

    peaks = peaks_table(study)
    seen = [k for k, row in enumerate(peaks.records()) if row["beyond_prior"] and row["echo_of"] is None]
    csv = [candidates, _course_table(study), *([_spectra_table(study)] if study.strips else [])]
    return Section("nodes", "", node_statements(study),
                   [candidates, peaks.take(np.array(seen, dtype=np.int64))], nodes_json(study), csv,
                   sheets=drawn("mgsgraph.results.figures.spacing.node_sheets", study))


def write_nodes(study: NodeStudy, folder: str | Path, figures: bool = True) -> list[str]:
    """Write a study to a folder that appears whole or not at all; the names of the files.

    Raises
    ------
    InputError
        If the folder holds anything but an earlier study of nodes, or can't be written.
    """
    section = nodes_section(study)
    return write_sections([section], section.numbers, folder, NODES, figures)


def nodes_json(study: NodeStudy) -> dict[str, Any]:
    """The record: choice, vibrations, closer nodes; s, Hz, m and rad."""
    choice, densified = study.choice, study.densified
    return {
        "name": study.name,
        "rays_held_out": choice.candidates[choice.best].squares.size,
        "blunders_held_out": choice.blunders,
        "unjudged_held_out": choice.unjudged,
        "rays_rejected": choice.rejected,
        "closest_s": choice.candidates[choice.closest].spacing,
        "ray_scatter": {
            "factor": choice.scatter.factor, "error": choice.scatter.error, "redundancy": choice.scatter.freedom,
            "contradicts_stated": choice.scatter.contradicts,
        },
        "candidates": candidates_table(choice).drop("standing").records(),
        "best_s": choice.candidates[choice.best].spacing,
        "chosen_s": choice.spacing,
        "peaks": peaks_table(study).records(),
        "closer": None if densified is None else {
            "message": densified.message,
            "rounds": [
                {"nodes": one.nodes, "sigma0": one.sigma0, "asked": one.asked, "granted": one.granted,
                 "refused": one.refused, "ray_scatter": one.factor} for one in densified.rounds
            ],
            "times_et_s": {
                strip.name: strip.nodes.epoch + strip.nodes.times for strip in densified.network.passes
            },
        },
    }  # fmt: skip


def peaks_table(study: NodeStudy) -> Table:
    """One row per peak above noise; vibrations are those that the prior doesn't expect, and no echo of others."""
    every = [(spectrum, peak) for one in study.strips for spectrum in one.spectra for peak in spectrum.peaks]
    spectra, peaks = [spectrum for spectrum, _ in every], [peak for _, peak in every]
    units, shown = [one.unit for one in spectra], [1.0 if one.unit == "m" else ARCSEC for one in spectra]
    return Table("peaks", "Vibrations (nodes tell frequencies up to the highest; faster ones appear folded)", (
        Column("strip", [one.strip for one in spectra], text="<16"),
        Column("axis", [one.axis for one in spectra], text="<16"),
        Column("frequency", numbers(peaks, "frequency"), "hz", text=">9.4g"),
        Column("highest", numbers(spectra, "nyquist"), "hz", text=">9.3g", files=False),
        Column("amplitude", numbers(peaks, "amplitude"), units),
        Column("sigma", numbers(peaks, "sigma"), units),
        Column("shown", numbers(peaks, "amplitude") / shown, label="amplitude", text=">9.3g", files=False),
        Column("shown_sigma", numbers(peaks, "sigma") / shown, label="sigma", text=">8.2g", files=False),
        Column("unit", ["m" if unit == "m" else "arcsec" for unit in units], text="<6", files=False),
        Column("chi_square", numbers(peaks, "test")),
        Column("probability", numbers(peaks, "probability"), label="p (noise)", text=">9.1g"),
        Column("beyond_prior", np.array([one.beyond_prior for one in peaks], dtype=bool)),
        Column("echo_of", [one.echo_of for one in peaks]),
    ))  # fmt: skip


def _course_table(study: NodeStudy) -> Table:
    """Corrections of all strips at the nodes of the spacing chosen."""
    found = study.corrections
    values, sigmas = (np.concatenate([getattr(one, name) for one in found]) for name in ("values", "sigmas"))
    stems = [(axis.replace(" position", "").replace("-", "_"), "m" if k < 3 else "mgon") for k, axis in enumerate(AXES)]
    return Table("course", "Corrections along the strips", (
        Column("strip", [one.strip for one in found for _ in range(one.times.size)]),
        Column("node", np.concatenate([np.arange(1, one.times.size + 1) for one in found])),
        Column("time_et", np.concatenate([one.epoch + one.times for one in found]), "s", "TDB past J2000"),
        *(
            Column(f"{stem}{part}", of[:, k], unit)
            for k, (stem, unit) in enumerate(stems) for part, of in (("", values), ("_sigma", sigmas))
        ),
    ))  # fmt: skip


def _spectra_table(study: NodeStudy) -> Table:
    """One row per frequency of each axis of each strip; amplitudes in `unit`."""
    every = [spectrum for one in study.strips for spectrum in one.spectra]
    rows = np.repeat(np.arange(len(every)), [one.frequencies.size for one in every])
    units = ["m" if one.unit == "m" else "mgon" for one in every]
    scale = np.where(np.isin(units, "m"), 1.0, MGON)[rows]

    def of(name: str) -> Array:
        return np.concatenate([getattr(one, name) for one in every])

    return Table("spectra", "Spectra", (
        Column("strip", picked([one.strip for one in every], rows)),
        Column("axis", picked([one.axis for one in every], rows)),
        Column("unit", picked(units, rows)),
        Column("above_level", of("amplitudes") > of("level")),
        Column("frequency", of("frequencies"), "hz"),
        *(Column(name.removesuffix("s"), of(name) / scale) for name in ("amplitudes", "floor", "level", "wander")),
    ))  # fmt: skip

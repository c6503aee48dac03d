"""Sections of an analysis: reliability, weak directions, residual tests, intervals; as text, JSON, tables, figures."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.components import Components, components, iterated_components
from mgsgraph.analysis.likelihood import LEVELS, Profile, linearity_of
from mgsgraph.analysis.measures import Levels, MeasureKind
from mgsgraph.analysis.posterior import Posterior
from mgsgraph.analysis.reliability import Reliability, Suspect, reliability, suspects
from mgsgraph.analysis.residual_spectrum import ResidualVibrations, residual_vibrations
from mgsgraph.analysis.residual_tests import ResidualStatistics, residual_statistics
from mgsgraph.analysis.separability import inseparable
from mgsgraph.analysis.unexplained import Unexplained, unexplained
from mgsgraph.analysis.verdict import verdict
from mgsgraph.analysis.weak import weakest
from mgsgraph.errors import InputError, require
from mgsgraph.files.output.folders import ANALYSIS
from mgsgraph.files.output.table import Column, Table, numbers, picked
from mgsgraph.geometry.records import Index, joined_rows
from mgsgraph.names import grouped
from mgsgraph.results.answers import Questions, curve_section, raster_section, replies
from mgsgraph.results.ground import leave_out_section
from mgsgraph.results.section import Section, record_of, sheets_by, table_of, write_sections
from mgsgraph.results.verdict import headline, linearity_section, reason_sentences, tested_sentences
from mgsgraph.text import NAMED, many, some
from mgsgraph.units import ARCSEC

_KINDS = ("image coordinate", "range", "a-priori place", "height", "stereo height", "prior", "crossover")
_MOST_INSEPARABLE = 6
"""Measures of a group that are printed; analysis.json has all."""


def reliability_section(tests: Reliability, max_groups: int) -> Section:
    """Redundancy and tests of all measurements, and the `most` suspicious ones with those inseparable from them."""
    suspected = suspects(tests, max_groups)
    groups_over = sum(suspect.over for suspect in suspected)
    uncontrolled = [tests.name(int(k)) for k in tests.uncontrolled[:NAMED]]
    sentences = [
        f"{len(tests)} measurements, redundancy {tests.degrees_of_freedom:.1f}; tests by Baarda: alpha "
        f"{tests.levels.alpha:g}, power {tests.levels.power:g}, critical value {tests.critical:.3g}, found at "
        f"{tests.levels.shift:.3g} sigmas.",
        f"{many(tests.suspected.size, 'test')} over the critical value (expected of {len(tests)} good measurements: "
        f"{tests.levels.alpha * len(tests):.1f}), {many(groups_over, 'inseparable group')}.",
        f"{many(tests.uncontrolled.size, 'measurement')} without control"
        + (f": {some(uncontrolled, tests.uncontrolled.size)}." if uncontrolled else "."),
    ]
    record = {
        **record_of("reliability", tests), "measures": len(tests), "redundancy": tests.degrees_of_freedom,
        "over": int(tests.suspected.size), "uncontrolled": int(tests.uncontrolled.size),
        "suspects": [
            {"w": suspect.test, "over": suspect.over, "measures": [tests.name(int(k)) for k in suspect.measures]}
            for suspect in suspected
        ],
    }  # fmt: skip
    table = reliability_table(tests)
    return Section("reliability", sentences=sentences, tables=[suspects_table(tests, suspected)], numbers=record,
                   csv=[table])


def suspects_table(tests: Reliability, suspected: Sequence[Suspect]) -> Table:
    """Rows of `reliability_table` by suspicion; measures that are inseparable from one stand below it."""
    groups = [suspect.measures[:_MOST_INSEPARABLE] for suspect in suspected]
    marks = ["OVER" if suspect.over else "" for suspect in suspected]
    names = [
        f"{'= ' if k else ''}{tests.name(int(measure))} {mark if not k else ''}"
        for mark, group in zip(marks, groups, strict=True) for k, measure in enumerate(group)
    ]
    table = reliability_table(tests, joined_rows(groups))
    named = Column("name", names, label="measurement (=: inseparable from the one above)", text="<", gap=2)
    return replace(table, columns=(*table.columns, named))


def outliers_section(tests: Reliability) -> Section:
    """A row per image: its measurements, those left out, tests over the critical value, and the largest one,
    by which they are sorted.
    """
    network, measures = tests.at.network, tests.measures
    rays = np.flatnonzero(measures.kind == MeasureKind.RAY)
    image_of, abs_test = measures.image[rays], np.nan_to_num(np.abs(measures.test[rays]))
    image_count, ray_counts = len(network.images), np.bincount(network.rays.image, minlength=len(network.images))
    order = np.lexsort((abs_test, image_of))
    last_of_image = np.flatnonzero(np.diff(image_of[order], append=-1))
    largest, largest_point = np.zeros(image_count), [""] * image_count
    for k in order[last_of_image].tolist():
        largest[image_of[k]], largest_point[image_of[k]] = abs_test[k], network.points.ids[measures.point[rays[k]]]
    table = table_of("outliers", {
        "image": network.image_names, "measurements": ray_counts,
        "left_out": ray_counts - np.bincount(image_of, minlength=image_count) // 2,
        "over": np.bincount(image_of[abs_test > tests.critical], minlength=image_count),
        "expected": tests.levels.alpha * np.bincount(image_of, minlength=image_count), "largest": largest,
        "point": largest_point,
    }).take(np.argsort(-largest, kind="stable"))  # fmt: skip
    return Section("outliers", tables=[table], numbers=table.records(), csv=[table])


def reliability_table(tests: Reliability, rows: Index | None = None) -> Table:
    """One row per scalar measure, or per those with indices `rows`, the largest test first; units in `unit`."""
    measures, order = tests.measures, tests.order(len(tests)) if rows is None else rows
    points = [*tests.at.network.points.ids, ""]  # the last one is that of row -1
    images = [*tests.at.network.image_names, ""]

    def finite(values: np.ndarray) -> np.ndarray:
        return np.where(np.isfinite(values), values, np.nan)[order]

    return table_of("reliability", {
        "measure": tests.names(order), "kind": picked(_KINDS, measures.kind[order]),
        "point": picked(points, measures.point[order]), "image": picked(images, measures.image[order]),
        "unit": tests.units(order), "w": finite(measures.test), "residual": finite(measures.residual),
        "sigma": finite(measures.sigma), "redundancy": finite(measures.redundancy),
        "minimal_detectable_blunder": finite(measures.detectable), "effect": finite(measures.effect),
        "external": finite(measures.external), "joint_test": finite(measures.joint),
        "joint_dimensions": finite(measures.dimensions),
    })  # fmt: skip


@dataclass(frozen=True, slots=True)
class AnalysisRequest:
    """What an analysis computes."""

    questions: Questions = field(default_factory=Questions)
    """Covariance queries."""
    curves: tuple[str, ...] = ()
    """Images along whose lines sigmas are wanted."""
    raster: tuple[str, ...] | None = None
    """Images over whose overlap sigmas are wanted, empty for all; None for no raster."""
    cell: float | None = None
    """m, side of the raster's cells."""
    sigma: float = 1.0
    """px, of the measures of the raster's points."""
    unexplained: bool = False
    """Tests of the residuals against time, sample, slope, height and neighbours."""
    consistency: bool = False
    """Variance components, statistics of residuals; linearity."""
    likelihood: tuple[str, ...] = ()
    """Images, shifts and shared unknowns whose intervals by the likelihood are wanted."""
    iterated: bool = False
    """Variance components by repeated adjustment."""
    suspects: int = 0
    """Rows of the table by suspicion; 0 for no reliability."""
    weak: int = 0
    """Number of least-constrained directions that are listed."""
    outliers: bool = False
    """A row per image of its largest tests."""
    levels: Levels = field(default_factory=Levels)
    """Significance level and power of the tests."""
    leave_out: bool = False
    """Control points, each left out in turn."""

    def __post_init__(self) -> None:
        for what, value in (("--sigma-px", self.sigma), ("--post", 1.0 if self.cell is None else self.cell)):
            require(np.isfinite(value) and value > 0.0, what, f"{value}", "a positive number")


_MOST_LINES = 9
"""Lines of the verdict that are printed without details."""
_MOST_EFFECTS = 2
"""Effects, and vibrations, that are printed without details."""


def brief(solution: Solution) -> list[str]:
    """The verdict and what is significant, in at most ten lines."""
    assessment = verdict(solution)
    sentences = [*reason_sentences(assessment.reasons), *tested_sentences(assessment, solution, 1)]
    if assessment.groups:
        effects = unexplained(solution)
        sentences += effects.sentences[:_MOST_EFFECTS]
        try:
            vibrations = residual_vibrations(solution).vibrations[:_MOST_EFFECTS]
        except InputError:  # too few rays
            vibrations = ()
        sentences += [vibration.sentence for vibration in vibrations]
    return [headline(solution), *(f"- {sentence}" for sentence in sentences[:_MOST_LINES])]


def require_used(option: str, is_given: bool, has_effect: bool, missing: str) -> None:
    """Raise InputError for an option that would do nothing."""
    require(not is_given or has_effect, option, f"no {missing}", "both", "add it, or leave the option out")


def analysis_sections(posterior: Posterior, request: AnalysisRequest, name: str) -> Iterator[Section]:
    """Sections in the order in which they are read, each when it is ready.

    Raises InputError where something asked about isn't in the solution.
    """
    if request.questions:
        answers = list(replies(posterior, request.questions))
        sentences = [sentence for section in answers for sentence in section.sentences]
        yield Section("answers", sentences=sentences, numbers=[section.numbers for section in answers])
    for image in dict.fromkeys(request.curves):
        yield curve_section(posterior, image)
    if request.raster is not None:
        yield raster_section(posterior, request.raster, request.cell, request.sigma)
    if request.unexplained:
        yield unexplained_section(posterior, name)
        yield vibrations_section(posterior, name)
    if request.consistency:
        yield _consistency_section(posterior, name)
        yield linearity_section(linearity_of(posterior.linearised))
    if request.likelihood:
        yield likelihood_section(posterior, request.likelihood)
    if request.iterated:
        yield _iterated_section(posterior)
    if request.suspects or request.outliers:
        tests = reliability(posterior.linearised, request.levels)
        if request.suspects:
            yield reliability_section(tests, request.suspects)
        if request.outliers:
            yield outliers_section(tests)
    if request.leave_out:
        yield leave_out_section(posterior.linearised)
    if request.weak:
        yield _weak_section(posterior, request.weak)
        if posterior.network.passes:
            yield _separability_section(posterior)


def write_analysis(name: str, sections: Iterable[Section], folder: Path, figures: bool = True) -> list[str]:
    """Write analysis.json and the sections' tables and figures to a folder, atomically.

    Raises
    ------
    InputError
        If the folder holds anything else than an earlier analysis, or can't be written.
    """
    sections = list(sections)
    record = grouped((section.name, section.numbers) for section in sections)
    return write_sections(sections, {"format": 1, "name": name, **record}, folder, ANALYSIS, figures)


def _consistency_section(posterior: Posterior, name: str) -> Section:
    linearised, fit = posterior.linearised, posterior.linearised.fit()
    if fit.degrees_of_freedom < 1:
        counts = f"{fit.observations} rows for {fit.unknowns} unknowns"
        sentence = f"No redundancy ({counts}): the sigmas cannot be checked."
        return Section("consistency", sentences=[sentence], numbers={"degrees_of_freedom": fit.degrees_of_freedom})
    factors, statistics = components(linearised), residual_statistics(linearised)
    residuals = residuals_table(statistics)
    record = {"components": _components_record(factors), "residuals": residuals.records()}
    return Section(
        "consistency", "Stated sigmas against residuals", factors.sentences, [residuals],
        record, [components_table(factors)],
        sheets=sheets_by("mgsgraph.results.figures.analysis.quantile_sheet", statistics, name),
    )  # fmt: skip


def residuals_table(statistics: Sequence[ResidualStatistics]) -> Table:
    """One row per group of normalised residuals: how they are distributed."""
    beyond, p_values = numbers(statistics, "beyond").reshape(-1, 3), numbers(statistics, "p_value")
    marks = ["" if group.consistent is not False else " inconsistent" for group in statistics]
    return table_of("residuals", {"beyond_1_2_3_sigma": beyond, "p": p_values, "odd": marks}, statistics)


def _components_record(factors: Components) -> dict[str, Any]:
    return {
        "exact": factors.exact, "groups": components_table(factors).drop("foerstner").records(),
        "correlation_of_squared_factors": factors.correlation,
    }  # fmt: skip


def components_table(factors: Components, name: str = "components") -> Table:
    """One row per group of measures: by what factor its sigmas are wrong."""
    groups, interval = factors.groups, np.array([group.interval() for group in factors.groups]).reshape(-1, 2)
    return table_of("components", {
        "judgement": [str(group.judgement) for group in groups],
        "estimator": ["foerstner" if group.negative else "helmert" for group in groups], "factor_{}_99": interval,
    }, groups, name=name)  # fmt: skip


def _iterated_section(posterior: Posterior) -> Section:
    iteration = iterated_components(posterior.network, posterior.linearised.settings)
    record = {
        "converged": iteration.converged, "passes": len(iteration.history), **_components_record(iteration.components),
        "sigma0": iteration.solution.sigma0,
    }  # fmt: skip
    return Section(
        "iterated", "Scaled and adjusted again, until all factors were one", iteration.sentences, numbers=record,
        csv=[components_table(iteration.components, "components_iterated")],
    )  # fmt: skip


def _weak_section(posterior: Posterior, count: int) -> Section:
    if posterior.linearised.joint.columns == 0:
        return Section("weak", sentences=["All orientation was held: it has no unconstrained directions."], numbers=[])
    directions = weakest(posterior.linearised.layout, posterior.linearised.joint, count)
    record = [
        {
            **record_of("weak_direction", direction),
            "parts": [
                {
                    "of": part.axis.owner, "axis": str(part.axis), "share": part.share,
                    f"amount_{part.axis.unit}": part.amount,
                }
                for part in direction.parts
            ],
        }
        for direction in directions
    ]  # fmt: skip
    title = "Least-constrained directions (posterior / prior sigma)"
    return Section("weak", title, [direction.sentence for direction in directions], numbers=record)


def _separability_section(posterior: Posterior) -> Section:
    """Mountings, attitude and position of passes that are inseparable."""
    linearised = posterior.linearised
    combinations = inseparable(posterior.network, linearised.joint, linearised.settings.angles)
    remark = "Position and attitude of passes, and what their images share, are separable (no correlation above 0.95)."
    record = [
        {
            "quantities": [{**record_of("quantity", part), "coefficient": float(coefficient)}
                           for part, coefficient in zip(combination.quantities, combination.coefficients, strict=True)],
            "correlation": combination.correlation, "determined": combination.mixture, "sigma": combination.sigma,
            "unit": combination.quantities[0].unit,
        }
        for combination in combinations
    ]  # fmt: skip
    sentences = [combination.sentence[0].upper() + combination.sentence[1:] for combination in combinations]
    return Section("separability", sentences=sentences or [remark], numbers=record)


# --- intervals by the likelihood


def likelihood_section(posterior: Posterior, names: Sequence[str]) -> Section:
    """Intervals of the numbers of images, shifts and shared unknowns by the likelihood."""
    table = likelihood_table([profile for name in dict.fromkeys(names)
                              for profile in posterior.likelihood.profiles(name)])
    remarks = ["Only within the lowest of several minima."] if posterior.linearised.mixed else []
    return Section("likelihood", sentences=remarks, tables=[table], numbers=table.records(), csv=[table])


def likelihood_table(profiles: Sequence[Profile]) -> Table:
    """One row per unknown."""
    units = ["arcsec" if profile.unit == "rad" else profile.unit for profile in profiles]
    scale = np.array([1.0 / ARCSEC if profile.unit == "rad" else 1.0 for profile in profiles])
    intervals = np.array([profile.intervals for profile in profiles]).reshape(-1, len(LEVELS), 2) * scale[:, None, None]
    bounds = {
        f"{bound}_{100.0 * level:.0f}": intervals[:, k, side]
        for k, level in enumerate(LEVELS) for side, bound in enumerate(("low", "high"))
    }  # fmt: skip
    value, sigma = numbers(profiles, "value") * scale, numbers(profiles, "sigma") * scale
    return table_of("likelihood", {"unit": units, "value": value, "sigma": sigma, **bounds}, profiles)


# --- what residuals show


def unexplained_section(posterior: Posterior, name: str) -> Section:
    """The tests of the residuals."""
    tested = unexplained(posterior.linearised)

    table, sentences = unexplained_table(tested), tested.sentences
    record = {"level": tested.level, "tests": tested.tests, "sentences": sentences, "effects": table.records()}
    return Section("unexplained", sentences=sentences, numbers=record, csv=[table],
                   sheets=sheets_by("mgsgraph.results.figures.analysis.unexplained_sheets", tested, name))  # fmt: skip


def unexplained_table(tested: Unexplained) -> Table:
    """One row per named effect, then one for the clearest test of each place and kind of rows."""
    effects = [*tested.effects, *tested.others]
    named = len(tested.effects)
    return table_of("unexplained", {
        "kind": [str(effect.kind) for effect in effects],
        "named": ["yes" if k < named else "" for k in range(len(effects))],
        "or": ["; ".join(effect.alternatives) for effect in effects],
    }, effects)  # fmt: skip


def vibrations_section(posterior: Posterior, name: str) -> Section:
    """What residuals of all images show; a sentence where there are too few rays."""
    try:
        tested = residual_vibrations(posterior.linearised)
    except InputError as error:
        sentence = f"Not tested for vibrations: {error}."
        return Section("vibrations", sentences=[sentence], numbers={"sentences": [str(error)]})

    table = vibrations_table(tested)
    spectra = [
        {
            "image": spectrum.image, "turn": spectrum.turn, "share_shown": spectrum.share,
            "named_from_px": spectrum.limit,
            "highest_frequency_hz": float(spectrum.frequencies[-1]),
        }
        for spectrum in tested.spectra
    ]  # fmt: skip
    record = {"sentences": tested.sentences, "vibrations": table.records(), "spectra": spectra}
    return Section("vibrations", sentences=tested.sentences, numbers=record, csv=[table],
                   sheets=sheets_by("mgsgraph.results.figures.analysis.vibrations_sheet", tested, name))  # fmt: skip


def vibrations_table(tested: ResidualVibrations) -> Table:
    """One row per vibration, clearest first."""
    vibrations = tested.vibrations
    return table_of("vibrations", {"or": ["; ".join(vibration.alternatives) for vibration in vibrations]}, vibrations)

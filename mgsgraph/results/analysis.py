"""What the covariance knows, section by section: text for the terminal, records for analysis.json, tables, figures."""

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
from mgsgraph.errors import InputError
from mgsgraph.files.output.folders import ANALYSIS
from mgsgraph.files.output.table import Column, Table, numbers, picked
from mgsgraph.geometry.records import Index
from mgsgraph.results.answers import Questions, answered, curve_section, raster_section
from mgsgraph.results.section import Section, drawn, record_of, table_of, write_sections
from mgsgraph.results.verdict import headline, linearity_section, reason_sentences, tested_sentences
from mgsgraph.text import NAMED, many, some
from mgsgraph.units import ARCSEC

_KINDS = ("image coordinate", "range", "a-priori place", "height", "stereo height", "prior", "crossover")
_MOST_ALIKE = 6
"""Measures of a group that are printed; analysis.json has all."""


def reliability_section(found: Reliability, most: int) -> Section:
    """Redundancy and tests of all measurements, and the `most` suspicious ones with those inseparable from them."""
    worst = suspects(found, most)
    over = sum(one.over for one in worst)
    loose = [found.name(int(k)) for k in found.uncontrolled[:NAMED]]
    said = [
        f"{len(found)} measurements, redundancy {found.degrees_of_freedom:.1f}; tests by Baarda: alpha "
        f"{found.levels.alpha:g}, power {found.levels.power:g}, critical value {found.critical:.3g}, found at "
        f"{found.levels.shift:.3g} sigmas.",
        f"{many(found.suspected.size, 'test')} over the critical value (expected of {len(found)} good measurements: "
        f"{found.levels.alpha * len(found):.1f}), {many(over, 'inseparable group')}.",
        f"{many(found.uncontrolled.size, 'measurement')} without control"
        + (f": {some(loose, found.uncontrolled.size)}." if loose else "."),
    ]
    record = {
        **record_of("reliability", found), "measures": len(found), "redundancy": found.degrees_of_freedom,
        "over": int(found.suspected.size), "uncontrolled": int(found.uncontrolled.size),
        "suspects": [
            {"w": one.test, "over": one.over, "measures": [found.name(int(k)) for k in one.measures]} for one in worst
        ],
    }  # fmt: skip
    table = reliability_table(found)
    return Section("reliability", sentences=said, tables=[suspects_table(found, worst)], numbers=record, csv=[table])


def suspects_table(found: Reliability, worst: Sequence[Suspect]) -> Table:
    """Rows of `reliability_table` by suspicion; measures that are inseparable from one stand below it."""
    groups = [one.measures[:_MOST_ALIKE] for one in worst]
    marks = ["OVER" if one.over else "" for one in worst]
    names = [
        f"{'= ' if k else ''}{found.name(int(measure))} {mark if not k else ''}"
        for mark, group in zip(marks, groups, strict=True) for k, measure in enumerate(group)
    ]
    table = reliability_table(found, np.concatenate([np.zeros(0, dtype=np.int64), *groups]))
    named = Column("name", names, label="measurement (=: inseparable from the one above)", text="<", gap=2)
    return replace(table, columns=(*table.columns, named))


def outliers_section(found: Reliability) -> Section:
    """A row per image: its measurements, those left out, tests over the critical value, and the largest one,
    by which they are sorted.
    """
    network, table = found.at.network, found.measures
    rays = np.flatnonzero(table.kind == MeasureKind.RAY)
    image, size = table.image[rays], np.nan_to_num(np.abs(table.test[rays]))
    every, total = len(network.images), np.bincount(network.rays.image, minlength=len(network.images))
    order = np.lexsort((size, image))
    last = np.flatnonzero(np.diff(image[order], append=-1))
    largest, worst = np.zeros(every), [""] * every
    for k in order[last].tolist():
        largest[image[k]], worst[image[k]] = size[k], network.points.ids[table.point[rays[k]]]
    shown = table_of("outliers", {
        "image": [one.name for one in network.images], "measurements": total,
        "left_out": total - np.bincount(image, minlength=every) // 2,
        "over": np.bincount(image[size > found.critical], minlength=every),
        "expected": found.levels.alpha * np.bincount(image, minlength=every), "largest": largest, "point": worst,
    }).take(np.argsort(-largest, kind="stable"))  # fmt: skip
    return Section("outliers", tables=[shown], numbers=shown.records(), csv=[shown])


def reliability_table(found: Reliability, rows: Index | None = None) -> Table:
    """One row per scalar measure, or per those with indices `rows`, the largest test first; units in `unit`."""
    table, order = found.measures, found.order(len(found)) if rows is None else rows
    points = [*found.at.network.points.ids, ""]  # the last one is that of row -1
    images = [*(image.name for image in found.at.network.images), ""]

    def known(values: np.ndarray) -> np.ndarray:
        return np.where(np.isfinite(values), values, np.nan)[order]

    return table_of("reliability", {
        "measure": found.names(order), "kind": picked(_KINDS, table.kind[order]),
        "point": picked(points, table.point[order]), "image": picked(images, table.image[order]),
        "unit": found.units(order), "w": known(table.test), "residual": known(table.residual),
        "sigma": known(table.sigma), "redundancy": known(table.redundancy),
        "minimal_detectable_blunder": known(table.detectable), "effect": known(table.effect),
        "external": known(table.external), "joint_test": known(table.joint),
        "joint_dimensions": known(table.dimensions),
    })  # fmt: skip


@dataclass(frozen=True, slots=True)
class Wanted:
    """What an analysis is to hold."""

    questions: Questions = field(default_factory=Questions)
    """Asked of the posterior."""
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
    """Variance components by adjusting again and again."""
    suspects: int = 0
    """Rows of the table by suspicion; 0 for no reliability."""
    weak: int = 0
    """Weak directions to be named."""
    outliers: bool = False
    """A row per image of its largest tests."""
    levels: Levels = field(default_factory=Levels)
    """Sizes of tests."""

    def __post_init__(self) -> None:
        for what, value in (("--sigma-px", self.sigma), ("--post", 1.0 if self.cell is None else self.cell)):
            if not (np.isfinite(value) and value > 0.0):
                raise InputError(what, f"{value}", "a positive number")


_MOST_LINES = 9
"""Of the verdict."""
_MOST_EFFECTS = 2
"""Effects, and vibrations, that are told without details."""


def brief(solution: Solution) -> list[str]:
    """The verdict and what is significant, in at most ten lines."""
    found = verdict(solution)
    said = [*reason_sentences(found.reasons), *tested_sentences(found, solution, 1)]
    if found.groups:
        effects = unexplained(solution)
        said += effects.sentences[:_MOST_EFFECTS]
        try:
            shown = residual_vibrations(solution).vibrations[:_MOST_EFFECTS]
        except InputError:  # too few rays
            shown = ()
        said += [one.sentence for one in shown]
    return [headline(solution), *(f"- {one}" for one in said[:_MOST_LINES])]


def require_used(option: str, given: bool, useful: bool, wanted: str) -> None:
    """Raise InputError for an option that would do nothing."""
    if given and not useful:
        raise InputError(option, f"no {wanted}", "both", "add it, or leave the option out")


def analysed(posterior: Posterior, wanted: Wanted, name: str) -> Iterator[Section]:
    """Sections in the order in which they are read, each when it is ready.

    Raises InputError where something asked about isn't in the solution.
    """
    if wanted.questions:
        found = list(answered(posterior, wanted.questions))
        said = [sentence for one in found for sentence in one.sentences]
        yield Section("answers", sentences=said, numbers=[one.numbers for one in found])
    for image in dict.fromkeys(wanted.curves):
        yield curve_section(posterior, image)
    if wanted.raster is not None:
        yield raster_section(posterior, wanted.raster, wanted.cell, wanted.sigma)
    if wanted.unexplained:
        yield unexplained_section(posterior, name)
        yield vibrations_section(posterior, name)
    if wanted.consistency:
        yield _consistency(posterior, name)
        yield linearity_section(linearity_of(posterior.linearised))
    if wanted.likelihood:
        yield likelihood_section(posterior, wanted.likelihood)
    if wanted.iterated:
        yield _iterated(posterior)
    if wanted.suspects or wanted.outliers:
        measures = reliability(posterior.linearised, wanted.levels)
        if wanted.suspects:
            yield reliability_section(measures, wanted.suspects)
        if wanted.outliers:
            yield outliers_section(measures)
    if wanted.weak:
        yield _weak(posterior, wanted.weak)
        if posterior.network.passes:
            yield _separability(posterior)


def write_analysis(name: str, sections: Iterable[Section], folder: Path, figures: bool = True) -> list[str]:
    """Write analysis.json and the sections' tables and figures to a folder that appears whole or not at all.

    Raises
    ------
    InputError
        If the folder holds anything else than an earlier analysis, or can't be written.
    """
    record, sections = dict[str, Any](), list(sections)
    for section in sections:
        record.setdefault(section.name, []).append(section.numbers)
    return write_sections(sections, {"format": 1, "name": name, **record}, folder, ANALYSIS, figures)


def _consistency(posterior: Posterior, name: str) -> Section:
    at, fit = posterior.linearised, posterior.linearised.fit()
    if fit.degrees_of_freedom < 1:
        counts = f"{fit.observations} rows for {fit.unknowns} unknowns"
        text = f"No redundancy ({counts}): nothing tells whether the sigmas are realistic."
        return Section("consistency", sentences=[text], numbers={"degrees_of_freedom": fit.degrees_of_freedom})
    found, statistics = components(at), residual_statistics(at)
    residuals = residuals_table(statistics)
    record = {"components": _components_record(found), "residuals": residuals.records()}
    return Section(
        "consistency", "Stated sigmas against residuals", found.sentences, [residuals],
        record, [components_table(found)],
        sheets=drawn("mgsgraph.results.figures.analysis.quantile_sheet", statistics, name),
    )  # fmt: skip


def residuals_table(statistics: Sequence[ResidualStatistics]) -> Table:
    """One row per group of normalised residuals: how they are distributed."""
    beyond, p = numbers(statistics, "beyond").reshape(-1, 3), numbers(statistics, "p_value")
    odd = ["" if one.as_promised is not False else " inconsistent" for one in statistics]
    return table_of("residuals", {
        "beyond_1_2_3_sigma": beyond, "p": p, "odd": odd,
    }, statistics)  # fmt: skip


def _components_record(found: Components) -> dict[str, Any]:
    return {
        "exact": found.exact, "groups": components_table(found).drop("foerstner").records(),
        "correlation_of_squared_factors": found.correlation,
    }  # fmt: skip


def components_table(found: Components, name: str = "components") -> Table:
    """One row per group of measures: by what factor its sigmas are wrong."""
    groups, interval = found.groups, np.array([one.interval() for one in found.groups]).reshape(-1, 2)
    return table_of("components", {
        "judgement": [str(one.judgement) for one in groups],
        "estimator": ["foerstner" if one.negative else "helmert" for one in groups], "factor_{}_99": interval,
    }, groups, name=name)  # fmt: skip


def _iterated(posterior: Posterior) -> Section:
    found = iterated_components(posterior.network, posterior.linearised.settings)
    record = {
        "converged": found.converged, "passes": len(found.history), **_components_record(found.components),
        "sigma0": found.solution.sigma0,
    }  # fmt: skip
    return Section(
        "iterated", "Scaled and adjusted again, until all factors were one", found.sentences, numbers=record,
        csv=[components_table(found.components, "components_iterated")],
    )  # fmt: skip


def _weak(posterior: Posterior, count: int) -> Section:
    if posterior.linearised.joint.columns == 0:
        return Section("weak", sentences=["All orientation was held: it has no unconstrained directions."], numbers=[])
    found = weakest(posterior.linearised.layout, posterior.linearised.joint, count)
    record = [
        {
            **record_of("weak_direction", one),
            "parts": [
                {
                    "of": part.axis.owner, "axis": str(part.axis), "share": part.share,
                    f"amount_{part.axis.unit}": part.amount,
                }
                for part in one.parts
            ],
        }
        for one in found
    ]  # fmt: skip
    title = "Least-constrained directions (posterior / prior sigma)"
    return Section("weak", title, [one.sentence for one in found], numbers=record)


def _separability(posterior: Posterior) -> Section:
    """Mountings, attitude and position of passes that are inseparable."""
    linearised = posterior.linearised
    found = inseparable(posterior.network, linearised.joint, linearised.settings.angles)
    none = "Position and attitude of passes, and what their images share, are separable (no correlation above 0.95)."
    record = [
        {
            "quantities": [{**record_of("quantity", part),
                            "coefficient": float(c)} for part, c in zip(one.quantities, one.coefficients, strict=True)],
            "correlation": one.correlation, "determined": one.mixture, "sigma": one.sigma,
            "unit": one.quantities[0].unit,
        }
        for one in found
    ]  # fmt: skip
    said = [one.sentence[0].upper() + one.sentence[1:] for one in found]
    return Section("separability", sentences=said or [none], numbers=record)


# --- intervals by the likelihood


def likelihood_section(posterior: Posterior, names: Sequence[str]) -> Section:
    """Intervals of the numbers of images, shifts and shared unknowns by the likelihood."""
    table = likelihood_table([one for name in dict.fromkeys(names) for one in posterior.likelihood.profiles(name)])
    mixed = ["Only within the lowest of several minima."] if posterior.linearised.mixed else []
    return Section("likelihood", sentences=mixed, tables=[table], numbers=table.records(), csv=[table])


def likelihood_table(profiles: Sequence[Profile]) -> Table:
    """One row per unknown."""
    units = ["arcsec" if one.unit == "rad" else one.unit for one in profiles]
    scale = np.array([1.0 / ARCSEC if one.unit == "rad" else 1.0 for one in profiles])
    intervals = np.array([one.intervals for one in profiles]).reshape(-1, len(LEVELS), 2) * scale[:, None, None]
    ends = {
        f"{end}_{100.0 * level:.0f}": intervals[:, k, side]
        for k, level in enumerate(LEVELS) for side, end in enumerate(("low", "high"))
    }  # fmt: skip
    value, sigma = numbers(profiles, "value") * scale, numbers(profiles, "sigma") * scale
    return table_of("likelihood", {"unit": units, "value": value, "sigma": sigma, **ends}, profiles)


# --- what residuals show


def unexplained_section(posterior: Posterior, name: str) -> Section:
    """The tests of the residuals."""
    found = unexplained(posterior.linearised)

    table, said = unexplained_table(found), found.sentences
    record = {"level": found.level, "tests": found.tests, "words": said, "effects": table.records()}
    return Section("unexplained", sentences=said, numbers=record, csv=[table],
                   sheets=drawn("mgsgraph.results.figures.analysis.unexplained_sheets", found, name))  # fmt: skip


def unexplained_table(found: Unexplained) -> Table:
    """One row per named effect, then one for the clearest test of each place and kind of rows."""
    every = [*found.effects, *found.others]
    named = len(found.effects)
    return table_of("unexplained", {
        "kind": [str(one.kind) for one in every], "named": ["yes" if k < named else "" for k in range(len(every))],
        "or": ["; ".join(one.alternatives) for one in every],
    }, every)  # fmt: skip


def vibrations_section(posterior: Posterior, name: str) -> Section:
    """What residuals of all images show; a sentence where there are too few rays."""
    try:
        found = residual_vibrations(posterior.linearised)
    except InputError as error:
        said = f"Not tested for vibrations: {error}."
        return Section("vibrations", sentences=[said], numbers={"words": [str(error)]})

    table = vibrations_table(found)
    seen = [
        {
            "image": one.image, "turn": one.turn, "share_shown": one.share, "named_from_px": one.limit,
            "highest_frequency_hz": float(one.frequencies[-1]),
        }
        for one in found.spectra
    ]  # fmt: skip
    record = {"words": found.sentences, "vibrations": table.records(), "spectra": seen}
    return Section("vibrations", sentences=found.sentences, numbers=record, csv=[table],
                   sheets=drawn("mgsgraph.results.figures.analysis.vibrations_sheet", found, name))  # fmt: skip


def vibrations_table(found: ResidualVibrations) -> Table:
    """One row per vibration, clearest first."""
    every = found.vibrations
    return table_of("vibrations", {
        "or": ["; ".join(one.alternatives) for one in every],
    }, every)  # fmt: skip

"""Results of matching as sentences and files: networks, a table with every covariance, a record and a figure."""

from pathlib import Path
from typing import Any

import numpy as np

from mgsgraph.files.networks.binary import write_binary_network
from mgsgraph.files.networks.pvl import write_pvl_network
from mgsgraph.files.networks.tie_points import control_network
from mgsgraph.files.opening import sha256_of
from mgsgraph.files.output.folders import MATCH, PROGRAM, fresh_folder
from mgsgraph.files.output.table import Table, picked, plain, write_json
from mgsgraph.files.writing import FILES
from mgsgraph.geometry.body import target_name
from mgsgraph.matching.match import Matches, match_scene
from mgsgraph.matching.scene import Scene
from mgsgraph.matching.settings import MatchSettings
from mgsgraph.results.section import Section, record_of, sheets_by, table_of
from mgsgraph.text import many, span, two
from mgsgraph.units import ISIS_OFFSET
from mgsgraph.workers import Progress, no_progress

FORMAT = 1
"""Version of match.json's layout."""
_IMPLAUSIBLE = 3.0
"""A-priori sigmas of an orientation beyond which a correction is marked."""


def match_into(
    name: str, scene: Scene, out: Path, settings: MatchSettings, workers: int | None = None, figures: bool = True,
    progress: Progress = no_progress,
) -> Matches:
    """Match a scene and write the results to a folder, atomically; an earlier result of matching is replaced.

    `name` is that of the case, `workers` the number of tiles at a time; without `figures` only tables and networks are
    written.

    Examples
    --------
    >>> name, scene = mgsgraph.read_scene("gusev/case.toml")
    >>> settings = mgsgraph.MatchSettings(cells=20, features=1000)
    >>> matches = mgsgraph.match_into(name, scene, Path("matches"), settings, figures=False)
    >>> print(matches)
    Matches(58 points in 24 of 24 cells)
    """
    matches = match_scene(scene, settings, workers, progress)
    write_matches(matches, scene, name, settings, out, figures)
    return matches


def write_matches(
    matches: Matches, scene: Scene, name: str, settings: MatchSettings, folder: str | Path, figures: bool = True
) -> list[str]:
    """Write networks, table, record and figure; the names of the files."""
    with fresh_folder(folder, MATCH) as temporary:
        network = control_network(matches.ties, "mgsgraph", target_name(scene.ground.body), name)
        write_pvl_network(network, temporary / "network.pvl")
        write_binary_network(network, temporary / "network.net")
        digests = {file: sha256_of(temporary / file) for file in ("network.pvl", "network.net")}
        write_json(temporary / MATCH, _record(matches, scene, name, settings) | {FILES: digests})
        sheets = sheets_by("mgsgraph.results.figures.matches.matches_sheet", matches, scene, name)
        section = Section("match", csv=[matches_table(matches)], sheets=sheets)
        return [MATCH, *digests, *section.write(temporary, figures)]


def matches_table(matches: Matches) -> Table:
    """One row per measure."""
    ties, covariances = matches.ties, matches.covariances
    return table_of("matches", {
        "id": picked(ties.ids, ties.measure_point), "image": ties.measure_image, "reference": matches.reference,
        "isis_{}": ties.measures + ISIS_OFFSET, "sigma_{}": ties.measure_sigmas,
        "against_reference_{}": covariances[:, [0, 0, 1], [0, 1, 1]], "correlation": matches.correlation,
        "coplanarity": matches.misfit,
    })  # fmt: skip


def _record(matches: Matches, scene: Scene, name: str, settings: MatchSettings) -> dict[str, Any]:
    names = [picture.image.name for picture in scene.pictures]
    return {
        "program": PROGRAM,
        "format": FORMAT,
        "name": name,
        "images": names,
        "settings": {key: getattr(settings, key) for key in settings.__dataclass_fields__},
        "points": len(matches.ties.ids),
        "measures": len(matches.ties.measure_image),
        "ground_grid_m": matches.step,
        "cell_m": matches.cell,
        "cells_with_matches": matches.cells[0],
        "cells": matches.cells[1],
        "losses": matches.losses._asdict(),
        "orientations": [
            plain({
                "images": [names[agreement.first], names[agreement.second]],
                **record_of("agreed_orientation", agreement),
            })
            for agreement in matches.agreements
        ],
        "refused": list(matches.refused),
        "statements": match_statements(matches, scene),
    }


def match_statements(matches: Matches, scene: Scene) -> list[str]:
    """Results in sentences."""
    ties, names, counts = matches.ties, [picture.image.name for picture in scene.pictures], matches.losses
    rays = np.bincount(ties.measure_point)
    sigmas = np.sqrt(np.linalg.eigvalsh(matches.covariances[~matches.reference])[:, 1])
    misfit = np.abs(matches.misfit[~matches.reference])
    filled, cell_count = matches.cells
    sentences = list[str]()
    for agreement in matches.agreements:
        ratio = agreement.moved / agreement.expected  # NaN where nothing was stated
        caution = f", {ratio:.0f} A-PRIORI SIGMAS: check it" if ratio > _IMPLAUSIBLE else ""
        sentences.append(
            f"{names[agreement.first]} and {names[agreement.second]}: {agreement.agreed} of {agreement.candidates} "
            f"coarse matches agree; they move the second image by {agreement.moved:.0f} m on the ground{caution}."
        )
    return [
        f"{many(len(rays), 'tie point')} in {span(rays)} images each, in {filled} of {cell_count} cells of "
        f"{matches.cell:.3g} m ({100.0 * filled / max(cell_count, 1):.0f} %) of the common ground.",
        f"Sigma of a match (largest axis): median {two(np.median(sigmas))} px, 95 % below "
        f"{two(np.quantile(sigmas, 0.95))} px; coplanarity: median {two(np.median(misfit))} m on the ground.",
        *(f"Not matched: {reason}" for reason in matches.refused), *matches.cautions,
        f"Feature pairs: {counts.linked}, tried {counts.tried}, measured {counts.measured}, similar and sharp "
        f"{counts.similar}, same when matched back {counts.returned}, coplanar {counts.coplanar}, height as neighbors "
        f"{counts.steady}.", *sentences,
    ]  # fmt: skip

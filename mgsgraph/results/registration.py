"""Tables of a registration, and all that is written of it: one JSON record, one row per shot and image, one row per
footprint that two images see.

Lines and samples in the files are counted as ISIS does, the first pixel's centre at (1, 1).
"""

import math
from pathlib import Path
from typing import Any

import numpy as np

from mgsgraph.files.output.folders import REGISTRATION, fresh_folder
from mgsgraph.files.output.table import Table
from mgsgraph.geometry.body import planetocentric
from mgsgraph.geometry.records import Array
from mgsgraph.network.footprints import Misregistration
from mgsgraph.registration.case import CaseRegistration, ProfileRegistration
from mgsgraph.results.section import Section, table_of, write_sections_into
from mgsgraph.text import listed, many, root_mean_square
from mgsgraph.units import DEG, ISIS_OFFSET

FORMAT = 1
"""Version of registration.json's layout."""

_COUNTING = "lines and samples are counted as ISIS does: the centre of the first pixel is (1, 1)"


def write_registration(registration: CaseRegistration, folder: str | Path, figures: bool = True) -> list[str]:
    """Write tables and figures to a folder, atomically; returns the names of the files.

    Parameters
    ----------
    registration : CaseRegistration
        As `register_case` made it.
    folder : path
        Absent, empty, or an earlier registration, which is replaced.
    figures : bool
        False leaves the figures out.

    Raises
    ------
    InputError
        If the folder holds anything else, or can't be written, or an image's pixels can't be read.
    """
    with fresh_folder(folder, REGISTRATION) as temporary:
        return write_registration_into(registration, temporary, figures)


def write_registration_into(registration: CaseRegistration, folder: Path, figures: bool = True) -> list[str]:
    """Write tables and figures into a folder that exists, file by file."""
    section = registration_section(registration)
    names = write_sections_into([section], section.numbers, folder, REGISTRATION)
    if not figures:
        return names
    from mgsgraph.results.figures.registration import (
        write_registration_figures,  # only those who draw wait for matplotlib
    )

    return names + write_registration_figures(registration, folder)


def registration_section(registration: CaseRegistration) -> Section:
    """Where shots fall, and by how much images contradict each other about them, before and after."""
    sentences = [*(_shots_sentence(profile) for profile in registration.before), *registration.warnings]
    record = {
        "format": FORMAT,
        "name": registration.name,
        "images": [
            {"name": image.name, "lines": image.lines, "samples": image.samples} for image in registration.images
        ],
        "orientations": {
            state: [_profile_json(profile) for profile in profiles] for state, profiles in registration.states()
        },
        "counting": _COUNTING,
        "statements": sentences,
    }
    csv = [registration_table(registration), discrepancy_table(registration)]
    return Section("registration", "", sentences, [_agreement_table(registration)], record, csv)


def _shots_sentence(profile: ProfileRegistration) -> str:
    """How many shots fall in each image."""
    footprints = profile.footprints
    counts = [
        f"{int(inside.sum())} fall in {image.name}{' (taken at the same time)' if np.any(same_time) else ''}"
        for image, inside, same_time in zip(footprints.images, footprints.inside, footprints.simultaneous, strict=True)
        if np.any(inside | same_time)
    ]
    shots = f"{many(footprints.shots.times.size, 'shot')} of {profile.name}"
    return f"Of {shots}, {listed(counts)}." if counts else f"None of {shots} falls in an image."


def _listed_discrepancies(registration: CaseRegistration) -> list[tuple[str, ProfileRegistration, Misregistration]]:
    return [
        (state, profile, pair)
        for state, profiles in registration.states() for profile in profiles for pair in profile.discrepancies
    ]  # fmt: skip


def _agreement_table(registration: CaseRegistration) -> Table:
    """One row per orientation, profile and pair of images: mean and rms of their contradiction on the ground."""
    discrepancies = _listed_discrepancies(registration)
    records, axes = [discrepancy_json(pair) for _, _, pair in discrepancies], ("along", "across")

    def of(unit: str, figure: str) -> Array:
        return np.array([[row[f"{axis}_{unit}"][figure] for axis in axes] for row in records]).reshape(-1, 2)

    return table_of("agreement", {
        "orientation": [state for state, _, _ in discrepancies],
        "profile": [profile.name for _, profile, _ in discrepancies],
        "image": [row["image"] for row in records], "against": [row["against"] for row in records],
        "footprints": np.array([row["footprints"] for row in records], dtype=np.int64),
        "mean_{}": of("m", "mean"), "rms_{} m": of("m", "rms"), "σ_{}": of("m", "mean_sigma"),
        "rms_{} px": of("px", "rms"),
    })  # fmt: skip


def _profile_json(profile: ProfileRegistration) -> dict[str, Any]:
    footprints = profile.footprints
    return {
        "profile": profile.name,
        "source": footprints.shots.source,
        "shots": footprints.shots.times.size,
        "spacing_m": footprints.shots.spacing,
        "images": [
            {
                "image": image.name,
                "simultaneous": bool(np.any(footprints.simultaneous[j])),
                "inside": int(footprints.inside[j].sum()),
            }
            for j, image in enumerate(footprints.images)
        ],
        "discrepancies": [discrepancy_json(pair) for pair in profile.discrepancies],
    }


def discrepancy_json(pair: Misregistration) -> dict[str, Any]:
    """A misregistration with its sigmas, in pixels, metres and line spacings."""
    record: dict[str, Any] = {"image": pair.image, "against": pair.against, "footprints": pair.shots.size}
    for unit, values, sigmas in (
        ("px", pair.pixels, pair.pixel_sigmas), ("m", pair.metres, pair.metre_sigmas),
        ("spacings", pair.spacings, pair.metre_sigmas / pair.spacing),
    ):
        for k, direction in enumerate(("along", "across")):
            column, has_footprints = values[:, k], pair.shots.size > 0
            record[f"{direction}_{unit}"] = {
                "mean": column.mean() if has_footprints else math.nan,
                "rms": root_mean_square(column),
                "lowest": column.min() if has_footprints else math.nan,
                "highest": column.max() if has_footprints else math.nan,
                "mean_sigma": sigmas[:, k].mean() if has_footprints else math.nan,
            }
    return record


def registration_table(registration: CaseRegistration) -> Table:
    """One row per shot and image: where it falls; unknown where unseen."""
    rows = [(p, j) for p in range(len(registration.before)) for j in range(len(registration.images))]
    crossed = [registration.before[p].footprints for p, _ in rows]
    sizes = [profile.shots.times.size for profile in crossed]
    longitude, latitude, radius = planetocentric(np.concatenate([profile.shots.footprints for profile in crossed])).T

    def of_state(profiles: tuple[ProfileRegistration, ...], name: str) -> np.ndarray:
        return np.concatenate([getattr(profiles[p].footprints, name)[j] for p, j in rows])

    def repeated(names: list[str]) -> list[str]:
        return [name for name, n in zip(names, sizes, strict=True) for _ in range(n)]

    places = {
        f"{state}_isis_{{}}": of_state(profiles, "places") + ISIS_OFFSET for state, profiles in registration.states()
    }
    return table_of("registration", {
        "profile": repeated([registration.before[p].name for p, _ in rows]),
        "number": np.concatenate([np.arange(1, n + 1) for n in sizes]),
        "shot": [shot for profile in crossed for shot in profile.shots.ids],
        "image": repeated([registration.images[j].name for _, j in rows]),
        "simultaneous": of_state(registration.before, "simultaneous"),
        **{f"{state}_inside": of_state(profiles, "inside") for state, profiles in registration.states()},
        "time_et": np.concatenate([profile.shots.times for profile in crossed]), "lon": longitude / DEG % 360.0,
        "lat": latitude, "radius": radius,
        "height_above_areoid": radius - np.concatenate([profile.shots.areoid_radii for profile in crossed]), **places,
    })  # fmt: skip


def discrepancy_table(registration: CaseRegistration) -> Table:
    """One row per orientation, pair of images and footprint that both see: by how much they contradict."""
    labelled = _listed_discrepancies(registration)
    pairs = [pair for _, _, pair in labelled]
    rows = [
        (state, profile.name, k + 1, profile.footprints.shots.ids[k], pair.image, pair.against)
        for state, profile, pair in labelled for k in pair.shots.tolist()
    ]  # fmt: skip
    keys = ("orientation", "profile", "number", "shot", "image", "against")
    texts = {key: [row[k] for row in rows] for k, key in enumerate(keys)}

    def joined(name: str) -> Array:
        return np.concatenate([np.zeros((0, 2)), *(getattr(pair, name) for pair in pairs)])

    metres, sigmas = joined("metres"), joined("metre_sigmas")
    spacing = np.concatenate([np.zeros((0, 1)), *(np.full((pair.shots.size, 1), pair.spacing) for pair in pairs)])
    return table_of("discrepancy", texts | {
        "number": np.array(texts["number"], dtype=np.int64),
        "isis_line": np.concatenate([np.zeros(0), *(pair.lines for pair in pairs)]) + ISIS_OFFSET,
        "{} px": joined("pixels"), "sigma_{} px": joined("pixel_sigmas"), "{} m": metres, "sigma_{} m": sigmas,
        "{} spacings": metres / spacing, "sigma_{} spacings": sigmas / spacing,
    })  # fmt: skip

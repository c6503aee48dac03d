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
    """Write tables and figures to a folder that appears whole or not at all; returns the names of the files.

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
    with fresh_folder(folder, REGISTRATION) as aside:
        return write_registration_into(registration, aside, figures)


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
    said = [*(_falls(profile) for profile in registration.before), *registration.warnings]
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
        "statements": said,
    }
    csv = [registration_table(registration), discrepancy_table(registration)]
    return Section("registration", "", said, [_agreement_table(registration)], record, csv)


def _falls(profile: ProfileRegistration) -> str:
    """How many shots fall in each image."""
    found = profile.found
    seeing = [
        f"{int(inside.sum())} fall in {image.name}{' (taken at the same time)' if np.any(same) else ''}"
        for image, inside, same in zip(found.images, found.inside, found.simultaneous, strict=True)
        if np.any(inside | same)
    ]
    shots = f"{many(found.shots.times.size, 'shot')} of {profile.name}"
    return f"Of {shots}, {listed(seeing)}." if seeing else f"None of {shots} falls in an image."


def _discrepancies(registration: CaseRegistration) -> list[tuple[str, ProfileRegistration, Misregistration]]:
    return [
        (state, profile, one)
        for state, profiles in registration.states() for profile in profiles for one in profile.discrepancies
    ]  # fmt: skip


def _agreement_table(registration: CaseRegistration) -> Table:
    """One row per orientation, profile and pair of images: mean and rms of their contradiction on the ground."""
    every = _discrepancies(registration)
    found, ways = [discrepancy_json(one) for _, _, one in every], ("along", "across")

    def of(unit: str, figure: str) -> Array:
        return np.array([[row[f"{way}_{unit}"][figure] for way in ways] for row in found]).reshape(-1, 2)

    return table_of("agreement", {
        "orientation": [state for state, _, _ in every], "profile": [profile.name for _, profile, _ in every],
        "image": [row["image"] for row in found], "against": [row["against"] for row in found],
        "footprints": np.array([row["footprints"] for row in found], dtype=np.int64),
        "mean_{}": of("m", "mean"), "rms_{} m": of("m", "rms"), "σ_{}": of("m", "mean_sigma"),
        "rms_{} px": of("px", "rms"),
    })  # fmt: skip


def _profile_json(profile: ProfileRegistration) -> dict[str, Any]:
    found = profile.found
    return {
        "profile": profile.name,
        "source": found.shots.source,
        "shots": found.shots.times.size,
        "spacing_m": found.shots.spacing,
        "images": [
            {
                "image": image.name,
                "simultaneous": bool(np.any(found.simultaneous[j])),
                "inside": int(found.inside[j].sum()),
            }
            for j, image in enumerate(found.images)
        ],
        "discrepancies": [discrepancy_json(one) for one in profile.discrepancies],
    }


def discrepancy_json(one: Misregistration) -> dict[str, Any]:
    """A misregistration with its sigmas, in pixels, metres and line spacings."""
    record: dict[str, Any] = {"image": one.image, "against": one.against, "footprints": one.shots.size}
    for unit, values, sigmas in (
        ("px", one.pixels, one.pixel_sigmas), ("m", one.metres, one.metre_sigmas),
        ("spacings", one.spacings, one.metre_sigmas / one.spacing),
    ):
        for k, way in enumerate(("along", "across")):
            column, seen = values[:, k], one.shots.size > 0
            record[f"{way}_{unit}"] = {
                "mean": column.mean() if seen else math.nan,
                "rms": root_mean_square(column),
                "lowest": column.min() if seen else math.nan,
                "highest": column.max() if seen else math.nan,
                "mean_sigma": sigmas[:, k].mean() if seen else math.nan,
            }
    return record


def registration_table(registration: CaseRegistration) -> Table:
    """One row per shot and image: where it falls; unknown where unseen."""
    rows = [(p, j) for p in range(len(registration.before)) for j in range(len(registration.images))]
    found = [registration.before[p].found for p, _ in rows]
    sizes = [one.shots.times.size for one in found]
    longitude, latitude, radius = planetocentric(np.concatenate([one.shots.footprints for one in found])).T

    def of_state(profiles: tuple[ProfileRegistration, ...], name: str) -> np.ndarray:
        return np.concatenate([getattr(profiles[p].found, name)[j] for p, j in rows])

    def repeated(names: list[str]) -> list[str]:
        return [name for name, n in zip(names, sizes, strict=True) for _ in range(n)]

    places = {
        f"{state}_isis_{{}}": of_state(profiles, "places") + ISIS_OFFSET for state, profiles in registration.states()
    }
    return table_of("registration", {
        "profile": repeated([registration.before[p].name for p, _ in rows]),
        "number": np.concatenate([np.arange(1, n + 1) for n in sizes]),
        "shot": [shot for one in found for shot in one.shots.ids],
        "image": repeated([registration.images[j].name for _, j in rows]),
        "simultaneous": of_state(registration.before, "simultaneous"),
        **{f"{state}_inside": of_state(profiles, "inside") for state, profiles in registration.states()},
        "time_et": np.concatenate([one.shots.times for one in found]), "lon": longitude / DEG % 360.0,
        "lat": latitude, "radius": radius,
        "height_above_areoid": radius - np.concatenate([one.shots.areoid_radii for one in found]), **places,
    })  # fmt: skip


def discrepancy_table(registration: CaseRegistration) -> Table:
    """One row per orientation, pair of images and footprint that both see: by how much they contradict."""
    found = _discrepancies(registration)
    each = [one for _, _, one in found]
    rows = [
        (state, profile.name, k + 1, profile.found.shots.ids[k], one.image, one.against)
        for state, profile, one in found for k in one.shots.tolist()
    ]  # fmt: skip
    keys = ("orientation", "profile", "number", "shot", "image", "against")
    words = {key: [row[k] for row in rows] for k, key in enumerate(keys)}

    def joined(name: str) -> Array:
        return np.concatenate([np.zeros((0, 2)), *(getattr(one, name) for one in each)])

    metres, sigmas = joined("metres"), joined("metre_sigmas")
    spacing = np.concatenate([np.zeros((0, 1)), *(np.full((one.shots.size, 1), one.spacing) for one in each)])
    return table_of("discrepancy", words | {
        "number": np.array(words["number"], dtype=np.int64),
        "isis_line": np.concatenate([np.zeros(0), *(one.lines for one in each)]) + ISIS_OFFSET,
        "{} px": joined("pixels"), "sigma_{} px": joined("pixel_sigmas"), "{} m": metres, "sigma_{} m": sigmas,
        "{} spacings": metres / spacing, "sigma_{} spacings": sigmas / spacing,
    })  # fmt: skip

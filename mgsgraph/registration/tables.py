"""Tables of a registration, and all that is written of it: one JSON record, one row per shot and image, one row per
footprint that two images see.

Lines and samples in the files are counted as ISIS does, the first pixel's centre at (1, 1).
"""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from mgsgraph.geometry.body import planetocentric
from mgsgraph.geometry.records import Array
from mgsgraph.output.csv_json import columns, plain, quoted, truths, write_csv
from mgsgraph.output.folders import PROGRAM, REGISTRATION, fresh_folder
from mgsgraph.registration.case import (
    CaseRegistration,
    ProfileRegistration,
    five_steps_difference,
    registration_statements,
    root_mean_square,
)
from mgsgraph.registration.footprints import Misregistration
from mgsgraph.units import DEG

FORMAT = 1
"""Version of registration.json's layout."""

_ISIS = 0.5
"""pixels from our count of lines and samples to that of ISIS."""
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
    """The same into a folder that exists, file by file."""
    text = json.dumps(registration_json(registration), indent=1, allow_nan=False, ensure_ascii=False)
    (folder / REGISTRATION).write_text(text + "\n", encoding="utf-8", newline="\n")
    registration_csv(registration, folder / "registration.csv")
    discrepancy_csv(registration, folder / "discrepancy.csv")
    names = [REGISTRATION, "registration.csv", "discrepancy.csv"]
    if not figures:
        return names
    from mgsgraph.figures import write_registration_figures  # only those who draw wait for matplotlib

    return names + write_registration_figures(registration, folder)


def registration_json(registration: CaseRegistration) -> dict[str, Any]:
    """All figures of a registration, as plain values for strict JSON: what isn't a number is None."""
    record: dict[str, Any] = plain({
        "program": PROGRAM,
        "format": FORMAT,
        "name": registration.name,
        "images": [
            {"name": image.name, "lines": image.lines, "samples": image.samples} for image in registration.images
        ],
        "orientations": {
            state: [_profile_json(profile) for profile in profiles] for state, profiles in registration.states()
        },
        "counting": _COUNTING,
        "statements": registration_statements(registration),
    })
    return record


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
                **dict(zip(
                    ("five_steps_largest_line_px", "five_steps_largest_sample_px"),
                    five_steps_difference(found, j), strict=True,
                )),
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


def registration_csv(registration: CaseRegistration, path: Path) -> None:
    """Write one row per shot and image: where it falls by Newton's method and by the five steps; empty where unseen."""
    text: dict[str, list[str]] = {name: [] for name in ("profile", "number", "shot", "image", "simultaneous")}
    numbers: list[dict[str, Array]] = []
    states = list(registration.states())
    for state, _ in states:
        text[f"{state}_inside"] = []
    for p, profile in enumerate(registration.before):
        shots, n = profile.found.shots, profile.found.shots.times.size
        ground = _ground_columns(profile)
        for j, image in enumerate(registration.images):
            text["profile"] += [quoted(profile.name)] * n
            text["number"] += [str(k + 1) for k in range(n)]
            text["shot"] += list(shots.ids)
            text["image"] += [quoted(image.name)] * n
            text["simultaneous"] += truths(profile.found.simultaneous[j])
            row = dict(ground)
            for state, profiles in states:
                found = profiles[p].found
                text[f"{state}_inside"] += truths(found.inside[j])
                for method, places in (("", found.places[j]), ("five_steps_", found.linear[j])):
                    row |= columns([f"{state}_{method}isis_{one}" for one in ("line", "sample")], places + _ISIS)
            numbers.append(row)
    write_csv(path, text, {name: np.concatenate([row[name] for row in numbers]) for name in numbers[0]})


def _ground_columns(profile: ProfileRegistration) -> dict[str, Array]:
    """Archived footprints of a profile."""
    shots = profile.found.shots
    longitude, latitude, radius = planetocentric(shots.footprints).T
    return {
        "time_et_s": shots.times,
        "lon_deg": longitude / DEG % 360.0,
        "lat_deg": latitude / DEG,
        "radius_m": radius,
        "height_above_areoid_m": radius - shots.areoid_radii,
    }


def discrepancy_csv(registration: CaseRegistration, path: Path) -> None:
    """Write one row per orientation, pair of images and footprint that both see: by how much they contradict."""
    text: dict[str, list[str]] = {
        name: [] for name in ("orientation", "profile", "number", "shot", "image", "against")
    }
    numbers: list[dict[str, Array]] = [_discrepancy_columns(None)]
    for state, profiles in registration.states():
        for profile in profiles:
            names = profile.found.shots.ids
            for one in profile.discrepancies:
                n = one.shots.size
                text["orientation"] += [state] * n
                text["profile"] += [quoted(profile.name)] * n
                text["number"] += [str(k + 1) for k in one.shots.tolist()]
                text["shot"] += [names[k] for k in one.shots.tolist()]
                text["image"] += [quoted(one.image)] * n
                text["against"] += [quoted(one.against)] * n
                numbers.append(_discrepancy_columns(one))
    write_csv(path, text, {name: np.concatenate([row[name] for row in numbers]) for name in numbers[0]})


def _discrepancy_columns(one: Misregistration | None) -> dict[str, Array]:
    """Columns of a discrepancy; of none, empty ones."""
    nothing = np.zeros((0, 2))
    pixels, pixel_sigmas, metres, metre_sigmas, lines, spacing = (
        (nothing, nothing, nothing, nothing, np.zeros(0), math.nan) if one is None else
        (one.pixels, one.pixel_sigmas, one.metres, one.metre_sigmas, one.lines, one.spacing)
    )
    return {
        "isis_line": lines + _ISIS,
        **columns(["along_px", "across_px"], pixels),
        **columns(["sigma_along_px", "sigma_across_px"], pixel_sigmas),
        **columns(["along_m", "across_m"], metres),
        **columns(["sigma_along_m", "sigma_across_m"], metre_sigmas),
        **columns(["along_spacings", "across_spacings"], metres / spacing),
        **columns(["sigma_along_spacings", "sigma_across_spacings"], metre_sigmas / spacing),
    }

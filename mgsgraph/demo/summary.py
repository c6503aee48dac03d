"""What a demo has shown: in plain words, and as summary.json. Sigmas are predicted ones, for sigma0 = 1."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mgsgraph.adjustment.solution import Solution, orientation_profile
from mgsgraph.analysis.statistics import PLACES
from mgsgraph.case.reading import Case
from mgsgraph.demo.demonstration import DRAWING, INPUTS, Demonstration, demonstrate, demonstrate_pair, true_points
from mgsgraph.demo.simulate import PAIR
from mgsgraph.demo.truth import AgainstTruth, BeforeAfter, pair_statements, point_errors, point_statements
from mgsgraph.geometry import rotation
from mgsgraph.geometry.records import Array
from mgsgraph.geometry.trajectory import Pose
from mgsgraph.network import PointClass
from mgsgraph.output.csv_json import plain, write_json
from mgsgraph.output.folders import PROGRAM
from mgsgraph.registration.footprints import Misregistration
from mgsgraph.registration.tables import discrepancy_json, write_registration_into
from mgsgraph.reports.results import write_into
from mgsgraph.simulation.site import SimulatedImage, SimulationOptions
from mgsgraph.simulation.terrain import grid_shift
from mgsgraph.stages import Stages
from mgsgraph.units import ARCMIN, ARCSEC
from mgsgraph.wording import listed, many, root_mean_square

SUMMARY = "summary.json"
"""File of the demo's figures."""
FORMAT = 1
"""Version of its layout."""
MOST_SIGMAS = 3.5
"""Predicted sigmas within which every point should be."""


def write_demo(
    site: str,
    folder: Path,
    seed: int,
    options: SimulationOptions,
    adjusting: Callable[[Case], Solution],
    stages: Stages,
    figures: bool = True,
) -> tuple[Solution, list[str]]:
    """Run the demo of a study site, or of the pair, with all products in a folder that exists: inputs in a folder of
    their own, tables, figures and summary.json. Returns the solution and the closing words.
    """
    inputs = folder / INPUTS
    if site == PAIR:
        pair, solution = demonstrate_pair(inputs, seed, adjusting, stages)
        with stages.stage(DRAWING):
            write_into(solution, folder, figures)
        return solution, pair_statements(solution, pair)
    demo = demonstrate(site, inputs, seed, options, adjusting, stages)
    with stages.stage(DRAWING):
        write_into(demo.solution, folder, figures)
        write_registration_into(demo.registration, folder, figures)
    record = summary_json(demo)
    write_json(folder / SUMMARY, record)
    return demo.solution, record["statements"]


# --- words


def demo_statements(demo: Demonstration) -> list[str]:
    """Sentences with figures and units: what was put in, what was wrong before, what is right now, and what is not."""
    found = [pair for pair in demo.discrepancies if pair.before.shots.size and pair.after.shots.size]
    truth = demo.truth
    return [
        *(_put_in(image) for image in demo.simulated.images),
        f"Put in: the terrain grid lies {np.hypot(*grid_shift(demo.simulated.terrain)):.0f} m beside the ground, as a "
        "whole.",
        *([_before(found), _after(found)] if found else []),
        *([_agreement(truth.between)] if truth.between else []),
        *(_of_image(image.name, truth) for image in demo.solution.network.images),
        *_shifts(demo),
        *point_statements(demo.solution, true_points(demo)),
        *([_in_short(truth)] if truth.between else []),
    ]


def _put_in(image: SimulatedImage) -> str:
    """The errors that the simulation gave to an image's kernels and to its profile."""
    errors = image.errors
    parts = [f"a position {np.linalg.norm(errors.position):.0f} m off"]
    if errors.attitude_time_bias:
        parts.append(f"attitude time tags {errors.attitude_time_bias:.2f} s off")
    for name, (constant, slope) in (("pitch", errors.pitch), ("roll", errors.roll), ("yaw", errors.yaw)):
        if constant or slope:
            trend = f" {slope / ARCMIN:+.0f}' u along the image" if slope else ""
            parts.append(f"{name} {constant / ARCMIN:+.0f}'{trend}")
    parts.append(f"attitude noise of {errors.noise / ARCSEC:.0f}\" rms")
    return (
        f"Put in: the kernels of {image.true.name} have {listed(parts)}; all footprints of its profile "
        f"{image.settings.profile} lie {np.hypot(*image.profile.shift):.0f} m beside their place."
    )


def _before(pairs: Sequence[BeforeAfter]) -> str:
    found = [pair.before for pair in pairs]
    along = _pooled(found, "metres")[:, 0]
    return (
        f"Before: the two images contradicted each other about {_footprints(found)}. Along the flight they were "
        f"{root_mean_square(along):.0f} m apart ({_pixels(found, 0)} pixels of {found[0].image}, "
        f"{root_mean_square(_pooled(found, 'spacings')[:, 0]):.2f} MOLA spacings; rms), between {along.min():+.0f} and "
        f"{along.max():+.0f} m; across it {_metres(found, 1)} m."
    )


def _after(pairs: Sequence[BeforeAfter]) -> str:
    found = [pair.after for pair in pairs]
    known = _pooled(found, "metre_sigmas").mean(axis=0)
    return (
        f"After: along the flight they are {_metres(found, 0)} m apart ({_pixels(found, 0)} pixels, rms), across it "
        f"{_metres(found, 1)} m, where relief between the tie points alone would make {_digits(known[1])} m."
    )


def _agreement(pairs: Sequence[BeforeAfter]) -> str:
    """How far the images agree at the true ground points, where no relief disturbs."""
    before, after = [pair.before for pair in pairs], [pair.after for pair in pairs]
    predicted = _pooled(after, "pixel_sigmas").mean(axis=0)
    return (
        f"Truth, between the images, at the true ground of {_footprints(after)}: before {_pixels(before, 0)} pixels "
        f"along and {_pixels(before, 1)} across the flight, after {_pixels(after, 0)} and {_pixels(after, 1)} (rms; "
        f"predicted {predicted[0]:.2g} and {predicted[1]:.2g}). {_sigmas_off(pairs)}"
    )


def _of_image(name: str, truth: AgainstTruth) -> str:
    """What the orientation of one image is off, by itself and with the footprints' own errors."""
    pairs = [pair for pair in truth.orientation if pair.after.image == name]
    shots = [pair for pair in truth.footprints if pair.after.image == name]
    if not pairs:
        return f"Truth, {name}: it sees no footprint."
    before, after = [pair.before for pair in pairs], [pair.after for pair in pairs]
    predicted = _pooled(after, "metre_sigmas").mean(axis=0)
    return (
        f"Truth, {name} by itself: its orientation misplaced the ground by {_mean(before, 0)} m along and "
        f"{_mean(before, 1)} m across the flight, and now does by {_mean(after, 0)} and {_mean(after, 1)} m (mean; "
        f"predicted sigma {predicted[0]:.0f} and {predicted[1]:.0f} m: what both images share, tie points don't see). "
        f"{_sigmas_off(pairs)} With their own errors, footprints fell {_mean([one.before for one in shots], 0)} and "
        f"{_mean([one.before for one in shots], 1)} m beside their place in it, and now fall "
        f"{_mean([one.after for one in shots], 0)} and {_mean([one.after for one in shots], 1)} m beside it."
    )


def _in_short(truth: AgainstTruth) -> str:
    before, after = ([getattr(pair, name) for pair in truth.between] for name in ("before", "after"))
    states = ([getattr(pair, name) for pair in truth.orientation] for name in ("before", "after"))
    was, now = (np.linalg.norm(_pooled(found, "metres").mean(axis=0)) for found in states)
    sigma = np.linalg.norm(_pooled([pair.after for pair in truth.orientation], "metre_sigmas").mean(axis=0))
    return (
        f"In short: along the flight the images now agree to {_pixels(after, 0)} instead of {_pixels(before, 0)} "
        f"pixels. On the average of both they lie {now:.0f} m from their true place on Mars (before {was:.0f} m; "
        f"predicted sigma {sigma:.0f} m)."
    )


def _sigmas_off(pairs: Sequence[BeforeAfter]) -> str:
    along, across = largest_sigmas_off(pairs)
    verdict = f"Every point is within {MOST_SIGMAS} predicted sigmas"
    if max(along, across) > MOST_SIGMAS:
        verdict = f"NOT every point is within {MOST_SIGMAS} predicted sigmas: the stated sigmas are too small"
    return f"{verdict} (largest {along:.1f} along, {across:.1f} across)."


def largest_sigmas_off(pairs: Sequence[BeforeAfter]) -> tuple[float, float]:
    """Largest error along and across the flight, in predicted sigmas."""
    along, across = np.concatenate([np.abs(pair.sigmas_off) for pair in pairs]).max(axis=0).tolist()
    return along, across


def _shifts(demo: Demonstration) -> list[str]:
    return [
        f"Truth, {name}: it has to move by {true[0]:+.0f} m east and {true[1]:+.0f} m north; "
        f"found {found[0]:+.0f} and {found[1]:+.0f} m, predicted sigma {sigma[0]:.0f} and {sigma[1]:.0f} m."
        for name, true, found, sigma in _shift_truths(demo)
    ]


def _shift_truths(demo: Demonstration) -> list[tuple[str, Array, Array, Array]]:
    """Name, true and found shift and its sigma, each (2,) m east and north, of profiles and terrain model.

    A shift is what is to be added to the archived places to get the true ones.
    """
    solution = demo.solution
    true = {image.settings.profile: -np.asarray(image.profile.shift) for image in demo.simulated.images}
    true["terrain model"] = -np.asarray(grid_shift(demo.simulated.terrain))
    return [
        (name, true[name], solution.shifts[p], np.sqrt(np.diagonal(solution.shift_covariance(p))))
        for p, name in enumerate(solution.network.shift_names)
    ]


def _footprints(found: Sequence[Misregistration]) -> str:
    return many(sum(one.shots.size for one in found), "MOLA footprint")


def _pooled(found: Sequence[Misregistration], name: str) -> Array:
    """One of the (k, 2) arrays of several profiles as one."""
    return np.concatenate([getattr(one, name) for one in found])


def _pixels(found: Sequence[Misregistration], way: int) -> str:
    return _digits(root_mean_square(_pooled(found, "pixels")[:, way]))


def _metres(found: Sequence[Misregistration], way: int) -> str:
    return _digits(root_mean_square(_pooled(found, "metres")[:, way]))


def _mean(found: Sequence[Misregistration], way: int) -> str:
    return f"{_pooled(found, 'metres')[:, way].mean():+.0f}"


def _digits(value: float) -> str:
    """As many decimals as a size needs."""
    return f"{value:.{0 if value >= 100.0 else 1 if value >= 1.0 else 2}f}"


# --- summary.json


def summary_json(demo: Demonstration) -> dict[str, Any]:
    """All figures of a demo, as plain values for strict JSON."""
    solution, truth = demo.solution, demo.truth
    record: dict[str, Any] = plain({
        "program": PROGRAM,
        "format": FORMAT,
        "site": demo.simulated.settings.name,
        "seed": demo.simulated.seed,
        "converged": solution.converged,
        "sigma0": solution.sigma0,
        "between_images": [_before_after(pair) for pair in demo.discrepancies],
        "truth": {
            "counting": "projected minus true places; along and across the flight; sigmas are predicted ones",
            "between_images": [_before_after(pair) for pair in truth.between],
            "orientation": [_before_after(pair) for pair in truth.orientation],
            "footprints": [_before_after(pair) for pair in truth.footprints],
        },
        "orientation": [_orientation(demo, j) for j in range(len(solution.network.images))],
        "terrain_shift_east_north_m": grid_shift(demo.simulated.terrain),
        "shifts": [
            {"name": name, "true_east_north_m": true, "found_east_north_m": found, "sigma_m": sigma,
             "sigmas_off": (found - true) / sigma}
            for name, true, found, sigma in _shift_truths(demo)
        ],
        "points": {
            one.name.lower(): dict(zip(("rms_before_m", "rms_after_m", "nees_per_freedom"), errors, strict=True))
            for one in (PointClass.TIE, PointClass.LASER)
            if (errors := point_errors(solution, true_points(demo), one))
        },
        "seconds": demo.stages.seconds,
        "statements": demo_statements(demo),
    })
    return record


def _before_after(pair: BeforeAfter) -> dict[str, Any]:
    record: dict[str, Any] = {
        "profile": pair.profile,
        "before": discrepancy_json(pair.before),
        "after": discrepancy_json(pair.after),
    }
    if pair.after.shots.size and np.all(pair.after.pixel_sigmas > 0.0):
        record |= dict(zip(("largest_sigmas_along", "largest_sigmas_across"), largest_sigmas_off([pair]), strict=True))
    return record


def _orientation(demo: Demonstration, j: int) -> dict[str, Any]:
    """Corrections of one image over the papers' 31 places, and what is left of its errors, in predicted sigmas."""
    solution = demo.solution
    image, profile = solution.network.images[j], orientation_profile(solution, j, PLACES)
    true = demo.simulated.images[j].true.pose(profile.lines)
    before, after = image.pose(profile.lines), image.pose(profile.lines, solution.correction(j))
    left, turned = after.position - true.position, _turn(after, true)
    return {
        "image": image.name,
        "correction_mean_m": (profile.position_after - profile.position_before).mean(axis=0),
        "correction_mean_arcsec": profile.rotation.mean(axis=0) / ARCSEC,
        "sigma_mean_m": profile.position_sigma.mean(axis=0),
        "sigma_mean_arcsec": profile.rotation_sigma.mean(axis=0) / ARCSEC,
        "error_before_mean_m": (before.position - true.position).mean(axis=0),
        "error_before_mean_arcsec": _turn(before, true).mean(axis=0) / ARCSEC,
        "error_after_mean_m": left.mean(axis=0),
        "error_after_mean_arcsec": turned.mean(axis=0) / ARCSEC,
        "largest_sigmas_position": np.abs(left / profile.position_sigma).max(axis=0),
        "largest_sigmas_rotation": np.abs(turned / profile.rotation_sigma).max(axis=0),
    }


def _turn(pose: Pose, true: Pose) -> Array:
    """(n, 3) rad about the camera's axes, by which the camera is turned from its true attitude."""
    return -rotation.logarithm(pose.matrix @ np.swapaxes(true.matrix, 1, 2))

"""Do laser and images agree after registration by relief, as its sigmas say? Simulated sites against their truth.

Each draw is a simulated site, whose errors have the sigmas that its case states: rendered images in the mission's
formats are read, matched densely, and the profiles registered (`registration.relief`).

    python scripts/relief.py [--cases gusev ...] [--seeds 20] [--first 1] [--processes N] [--keep FILE] [--out FILE]
"""

import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from study import Blocks, Draw, cases, joint_degrees, names_of, nees_cell, number, refusals, run, seeds_of, table

from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.posterior import Posterior
from mgsgraph.case.reading import read_case
from mgsgraph.errors import InputError
from mgsgraph.geometry.body import east_north
from mgsgraph.geometry.intersection import intersect_rays
from mgsgraph.geometry.records import Array
from mgsgraph.network import PointClass
from mgsgraph.registration.relief import ReliefRegistration, register_by_relief
from mgsgraph.simulation.files import write_site
from mgsgraph.simulation.site import SimulatedSite, simulate_site
from mgsgraph.simulation.sites import SITE_NAMES, site_settings
from mgsgraph.text import root_mean_square as rms

CASES = (*SITE_NAMES, *(f"{name}, no terrain" for name in SITE_NAMES))
"""Sites, with terrain models by cells or without any."""
HEAD = (
    "site", "draws", "captured", "before, m", "after, m", "shifts", "ties before, m", "ties after, m", "times better",
    "ties' mean", "seconds",
)  # fmt: skip
_CAPTURED = 50.0
"""m, largest misplacement at the right minimum."""


def one_draw(case: str, seed: int) -> Draw:
    """Simulate, read, register, judge."""
    begin, (name, _, without) = time.perf_counter(), case.partition(", ")
    site = simulate_site(site_settings(name), seed)
    with tempfile.TemporaryDirectory() as folder:
        try:
            read = read_case(write_site(site, Path(folder)))
        except InputError as error:
            return {"refused": str(error)}
        network = replace(read.network, surface=None) if without else read.network
        registration = register_by_relief(replace(read, network=network))
    return _judged(site, registration) | {"seconds": time.perf_counter() - begin}


def _judged(site: SimulatedSite, registration: ReliefRegistration) -> Draw:
    """Misplacements (p, 2) in m, found minus true, before and after; of p profiles' shifts and of the ties' mean error
    in the plane the normalised squares, of two degrees of freedom; rms errors of the ties in m, before and after.
    """
    without, solution = registration.before, registration.solution
    profiles = [profile for profile in registration.profiles if not profile.of_posts]
    ties = solution.network.points.classes == PointClass.TIE
    names = [solution.network.points.ids[i] for i in np.flatnonzero(ties)]
    positions = dict(zip(site.ties.ids, site.true_ties, strict=True))
    truth = np.array([positions[name] for name in names])
    errors = [without.places[without.network.points.classes == PointClass.TIE] - truth, solution.places[ties] - truth]
    axes = east_north(truth.mean(axis=0)[None])[0]
    shifts = {image.settings.profile: -image.profile.shift for image in site.images}
    true, adjusted = (np.array(part) for part in ([shifts[p.name] for p in profiles], [p.shift for p in profiles]))
    old, new = (surface_errors(site, [profile.name for profile in profiles], part) for part in (without, solution))
    before = np.array([profile.before.misplacement for profile in profiles]) - (true + old)
    after = adjusted - (true + new)
    nees = [
        float(error @ np.linalg.solve(profile.covariance, error))
        for profile, error in zip(profiles, adjusted - true, strict=True)
    ]
    variables = [len(solution.coefficients) + solution.network.shift_number(profile.name) for profile in profiles]
    plane = np.einsum("ak,nkl,bl->nab", axes, solution.covariances[ties], axes).mean(axis=0)
    of_ties = errors[1].mean(axis=0) @ axes.T
    mean = float(of_ties @ np.linalg.solve(plane, of_ties))
    return {
        "degrees": joint_degrees(solution.joint_covariance.of(variables), 2),
        "before": [error.tolist() if np.all(np.isfinite(error)) else None for error in before],
        "after": after.tolist(), "shifts": nees, "mean": mean,
        "ties": [rms(np.linalg.norm(error, axis=1)) for error in errors],
    }  # fmt: skip


def surface_errors(site: SimulatedSite, names: list[str], solution: Solution) -> Array:
    """(p, 2) m east and north by which the stereo surface is misplaced at each profile: where the rays of the shots'
    true pixels meet with the adjusted orientation, minus the true ground.
    """
    posterior, errors = Posterior.of(solution), []
    for name in names:
        (profile,) = (image.profile for image in site.images if image.settings.profile == name)
        size = np.array([[image.true.lines, image.true.samples] for image in site.images])
        inside = np.all((profile.true_pixels > 0.0) & (profile.true_pixels < size), axis=(1, 2))
        rays = [
            posterior.image(j).sightlines(*profile.true_pixels[inside, j].T, posterior.correction(j)) for j in (0, 1)
        ]
        origins, directions = (np.concatenate(part) for part in zip(*rays, strict=True))
        count = int(inside.sum())
        met, _, _ = intersect_rays(origins, directions, np.tile(np.arange(count), 2), count)
        truth = profile.true_footprints[inside]
        errors.append(np.einsum("nki,ni->nk", east_north(truth), met - truth).mean(axis=0))
    return np.array(errors)


def _row(site: str, draws: list[Draw]) -> list[str]:
    before, after = (np.array([e for draw in draws for e in draw[name] if e]) for name in ("before", "after"))
    ties = rms(np.array([draw["ties"] for draw in draws])[:, 0]), rms(np.array([draw["ties"] for draw in draws])[:, 1])
    captured = np.linalg.norm(after, axis=1) < _CAPTURED
    return [
        site, str(len(draws)), f"{int(captured.sum())} of {captured.size}", number(rms(before)), number(rms(after)),
        nees_cell([0.5 * float(np.mean(draw["shifts"])) for draw in draws], [draw["degrees"] for draw in draws]),
        number(ties[0]), number(ties[1]), number(ties[0] / ties[1]),
        nees_cell([0.5 * draw["mean"] for draw in draws], 2),
        number(float(np.mean([draw["seconds"] for draw in draws]))),
    ]  # fmt: skip


def judge(draws: list[Draw]) -> Blocks:
    """The table."""
    return {"relief": [*table(HEAD, [_row(case, cases(draws, case)) for case in names_of(draws)]), "", refusals(draws)]}


if __name__ == "__main__":
    sys.exit(run(seeds_of(__doc__, CASES, 20, "evidence_terrain.md#relief"), one_draw, judge))

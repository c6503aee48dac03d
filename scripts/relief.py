"""Do laser and images agree after registration by relief, as its sigmas say? Simulated sites against their truth.

Each draw is a simulated site, whose errors have the sigmas that its case states: rendered images in the mission's
formats are read, matched densely, and the profiles registered (`registration.relief`).

    python scripts/relief.py [--sites gusev,eos,isidis] [--seeds 20] [--first 1] [--no-terrain] [--keep FILE]
        [--page docs/relief.md]

With --keep each draw is noted in FILE as soon as it is done, and not done again. Exit status: 0 done, 2 bad input.
"""

import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from study import Draw, at_least, cases, chi_square_band, command, draws, machine, number, refusals, table, write_page

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

WORDS = """# Registration by relief against truth

Made by `scripts/relief.py` ({machine}), seeds {first} to {last}: simulated sites whose errors have the sigmas that
their cases state, rendered images, own dense matches, {terrain}. *after*: misplacement of a profile against the
stereo surface, found minus true, rms of both axes over all profiles and draws; *captured*: profiles for which it is
below {captured:g} m; *before*: the same of the first search, where it ties the profile. *shifts*: NEES of the
profiles' shifts per axis. *ties*: rms error of the tie points' positions without and with the rows, and the NEES of
their mean position in the plane. 99 % bands in brackets (the profiles of a draw share the orientation: they are not
independent).
"""
HEAD = (
    "site", "draws", "captured", "before, m", "after, m", "shifts", "ties before, m", "ties after, m", "times better",
    "ties' mean", "seconds",
)  # fmt: skip
_CAPTURED = 50.0
"""m, misplacement after which the right minimum was found."""


def main(arguments: list[str] | None = None) -> int:
    """Exit status."""
    parser = command(__doc__)
    parser.add_argument("--sites", default=",".join(SITE_NAMES), help="with commas between")
    parser.add_argument("--seeds", type=at_least(1), default=20, help="draws of each site")
    parser.add_argument("--first", type=at_least(1), default=1, help="first seed")
    parser.add_argument("--no-terrain", action="store_true", help="leave out the case's terrain model")
    parser.add_argument("--keep", type=Path, metavar="FILE", help="note draws here, and go on where it ended")
    parser.add_argument("--page", type=Path, help="file to write the table to")
    given = parser.parse_args(arguments)
    sites, seeds = given.sites.split(","), range(given.first, given.first + given.seeds)

    def make() -> str:
        every = draws(sites, seeds, lambda site, seed: _drawn(site, seed, not given.no_terrain), given.keep)
        words = WORDS.format(
            machine=machine(), first=seeds[0], last=seeds[-1], captured=_CAPTURED,
            terrain="no terrain model" if given.no_terrain else "terrain models by cells",
        )
        rows = [_row(site, cases(every, site)) for site in sites]
        return "\n".join([words, *table(HEAD, rows), "", refusals(every), ""])

    return write_page(parser, given.page, make)


def _drawn(name: str, seed: int, terrain: bool) -> Draw:
    begin = time.perf_counter()
    site = simulate_site(site_settings(name), seed)
    with tempfile.TemporaryDirectory() as folder:
        try:
            case = read_case(write_site(site, Path(folder)))
        except InputError as error:
            return {"refused": str(error)}
        found = register_by_relief(case if terrain else replace(case, network=replace(case.network, surface=None)))
    return _judged(site, found) | {"seconds": time.perf_counter() - begin}


def _judged(site: SimulatedSite, found: ReliefRegistration) -> Draw:
    """Misplacements (p, 2) in m, found minus true, before and after; of p profiles' shifts and of the ties' mean error
    in the plane the normalised squares, of two degrees of freedom; rms errors of the ties in m, before and after.
    """
    without, solution = found.before, found.solution
    profiles = [one for one in found.profiles if not one.of_posts]
    ties = solution.network.points.classes == PointClass.TIE
    names = [solution.network.points.ids[i] for i in np.flatnonzero(ties)]
    known = dict(zip(site.ties.ids, site.true_ties, strict=True))
    truth = np.array([known[name] for name in names])
    errors = [without.places[without.network.points.classes == PointClass.TIE] - truth, solution.places[ties] - truth]
    ways = east_north(truth.mean(axis=0)[None])[0]
    shifts = {image.settings.profile: -image.profile.shift for image in site.images}
    true, adjusted = (np.array(part) for part in ([shifts[one.name] for one in profiles], [p.shift for p in profiles]))
    old, new = (surface_errors(site, [one.name for one in profiles], part) for part in (without, solution))
    before = np.array([one.before.misplacement for one in profiles]) - (true + old)
    after = adjusted - (true + new)
    nees = [
        float(error @ np.linalg.solve(one.covariance, error))
        for one, error in zip(profiles, adjusted - true, strict=True)
    ]
    plane = np.einsum("ak,nkl,bl->nab", ways, solution.covariances[ties], ways).mean(axis=0)
    of_ties = errors[1].mean(axis=0) @ ways.T
    mean = float(of_ties @ np.linalg.solve(plane, of_ties))
    return {
        "before": [one.tolist() if np.all(np.isfinite(one)) else None for one in before],
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
        seen = np.all((profile.true_pixels > 0.0) & (profile.true_pixels < size), axis=(1, 2))
        rays = [
            posterior.image(j).sightlines(*profile.true_pixels[seen, j].T, posterior.correction(j)) for j in (0, 1)
        ]
        origins, directions = (np.concatenate(part) for part in zip(*rays, strict=True))
        count = int(seen.sum())
        met, _, _ = intersect_rays(origins, directions, np.tile(np.arange(count), 2), count)
        truth = profile.true_footprints[seen]
        errors.append(np.einsum("nki,ni->nk", east_north(truth), met - truth).mean(axis=0))
    return np.array(errors)


def _row(site: str, mine: list[Draw]) -> list[str]:
    before, after = (np.array([one for draw in mine for one in draw[name] if one]) for name in ("before", "after"))
    nees = np.concatenate([draw["shifts"] for draw in mine])
    ties = rms(np.array([draw["ties"] for draw in mine])[:, 0]), rms(np.array([draw["ties"] for draw in mine])[:, 1])
    captured = np.linalg.norm(after, axis=1) < _CAPTURED
    return [
        site, str(len(mine)), f"{int(captured.sum())} of {captured.size}", number(rms(before)), number(rms(after)),
        _within(nees.sum(), 2 * len(nees)), number(ties[0]), number(ties[1]), number(ties[0] / ties[1]),
        _within(sum(draw["mean"] for draw in mine), 2 * len(mine)),
        number(float(np.mean([draw["seconds"] for draw in mine]))),
    ]  # fmt: skip


def _within(squares: float, degrees: int) -> str:
    low, high = chi_square_band(degrees)
    return f"{squares / degrees:.2f} ({low:.2f} .. {high:.2f})"


if __name__ == "__main__":
    sys.exit(main())

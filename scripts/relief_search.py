"""Does registration by relief find the right place from 1.5 km off, is it silent on plains, and how long does it take?

Simulated sites in the mission's formats, with dense matches of the true ground in place of pictures: adjusted, then
registered (`registration.relief`): from profiles displaced by 1.5 km in 24 directions; on planted plains of 2 m relief;
and with up to 100,000 shots over one pair.

    python scripts/relief_search.py [--sites eos,gusev,isidis] [--seeds 4] [--plains 12] [--first 1] [--keep FILE]
        [--page docs/relief_search.md]

With --keep each draw is noted in FILE as soon as it is done, and not done again. Exit status: 0 done, 2 bad input.
"""

import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from cells import NOISE, shown
from relief import surface_errors
from scipy.ndimage import gaussian_filter
from study import at_least, command, kept, machine, note, number, show, table, write_page

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.solution import Solution
from mgsgraph.analysis.posterior import Posterior
from mgsgraph.case.reading import Case, read_case
from mgsgraph.geometry.body import east_north, planetocentric
from mgsgraph.geometry.records import Array
from mgsgraph.registration.minima import ReliefRegistration, ReliefSettings
from mgsgraph.registration.relief import registered
from mgsgraph.registration.relief_surfaces import AveragedPair, Cells, cells_of
from mgsgraph.simulation.files import write_site
from mgsgraph.simulation.ground import PeriodicSurface, add_craters, fractal, make_terrain
from mgsgraph.simulation.site import SimulatedSite, SimulationOptions, simulate_site
from mgsgraph.simulation.sites import SITE_NAMES, site_settings
from mgsgraph.units import DEG
from mgsgraph.workers import Progress, no_progress

OFF, DIRECTIONS, REACH = 1500.0, 24, 2000.0
"""m, by which profiles are displaced, in so many directions; m, up to which shifts are searched then."""
RIGHT = 50.0
"""m from the true place, up to which a minimum is the right one."""
NEAR = 13.8
"""chi-square of two degrees of freedom (99.9 %) up to which a place is the true one, however wide its minimum."""
RELIEF = 2.0
"""m rms, of the planted plains."""
SHOTS = (1.0, 3.0)
"""m, noise of the ranges and heights on them."""
LOADS = ((40, 4_000), (40, 100_000))
"""Profiles, and shots of all."""
SITE = "gusev"
"""Whose flights see the plains and the many shots."""
WORDS = """# Search by relief: capture, plains, time

Made by `scripts/relief_search.py` ({machine}), seeds from {first} on: simulated sites whose errors have the sigmas that
their cases state, dense matches of the true ground with noise of {noise:g} pixels; adjusted, then registered by relief,
terrain models by cells.

## From {off:g} m off
All profiles of a site displaced by {off:g} m, in {directions} directions, `--reach {reach:g}`. *right*: profiles that
end within {right:g} m of their true place on the stereo surface; *clear*: those for which one minimum is said to be the
only one; *clear, wrong*: of these, farther off than {right:g} m and outside the 99.9 % ellipse of what is stated.
*off*: rms distance of the right ones.

{capture}

## Planted plains
{relief:g} m rms of relief under two profiles of {site}, of several kinds; *shots*: noise of ranges and heights, m, as
the case states. *tied*: a few minima hold all the weight; *clear*: one does; *clear, wrong*: as above; *NEES*: mean
square per axis, of the clear ones' errors by the covariance of their minimum, and of all adjusted shifts by their own.
*sigma*: median of the stated sigma of the profiles' shifts east and north, m, of those that are clear and of the
others; it was 100 m before.

{plains}

## Time
Processor seconds, of all threads together, beside the matching: profiles across one pair of images ({site}), *read*
from files, *adjusted* without relief, matches *averaged* to surfaces, profiles *searched* (in all rounds), *adjusted
again* with one row per shot. The terrain model and the site's own two profiles take part.

{times}
"""


def main(arguments: list[str] | None = None) -> int:
    """Exit status."""
    parser = command(__doc__)
    parser.add_argument("--sites", default=",".join(SITE_NAMES), help="with commas between")
    parser.add_argument("--seeds", type=at_least(1), default=4, help="draws of each site")
    parser.add_argument("--plains", type=at_least(1), default=12, help="draws of each kind of plain")
    parser.add_argument("--first", type=at_least(1), default=1, help="first seed")
    parser.add_argument("--keep", type=Path, metavar="FILE", help="note draws here, and go on where it ended")
    parser.add_argument("--page", type=Path, help="file to write the tables to")
    given = parser.parse_args(arguments)
    sites = [site_settings(name) for name in given.sites.split(",")]

    def make() -> str:
        found = kept(given.keep)

        def drawn(names: list[str], count: int, draw: Callable[[str, int], dict[str, Any]]) -> list[dict[str, Any]]:
            keys = [(name, given.first + k) for name in names for k in range(count)]
            for key in keys:
                if key not in found:
                    show("{}, seed {}".format(*key))
                    found[key] = {"site": key[0], "seed": key[1]} | draw(*key)
                    note(given.keep, found[key])
            return [found[key] for key in keys]

        captured = drawn([site.name for site in sites], given.seeds, captures)
        plains = drawn([f"{kind}, {sigma:g} m" for kind in KINDS for sigma in SHOTS], given.plains, plain)
        times = drawn([f"{profiles}, {shots}" for profiles, shots in LOADS], 1, timed)
        return WORDS.format(
            machine=machine(), first=given.first, noise=NOISE, off=OFF, directions=DIRECTIONS, reach=REACH,
            right=RIGHT, relief=RELIEF, site=SITE, capture="\n".join(capture_table(captured)),
            plains="\n".join(plain_table(plains)), times="\n".join(time_table(times)),
        )  # fmt: skip

    return write_page(parser, given.page, make)


class Prepared(NamedTuple):
    """A case, ready to be registered."""

    case: Case
    before: Solution
    """Adjusted by ties and ranges."""
    models: tuple[Cells, ...]
    """Its terrain models by cells."""
    footprints: list[float]
    """m, of the profiles."""
    surfaces: list[AveragedPair]
    """Of matches of the true ground."""
    seconds: list[float]
    """Of one processor, for reading, adjusting and averaging."""

    def registered(
        self, reach: float = 1500.0, off: Array | None = None, progress: Progress = no_progress
    ) -> ReliefRegistration:
        """By shifts of up to `reach` m; of profiles `off` (2,) m from where they were adjusted to."""
        start, count = self.before, len(self.footprints)
        if off is not None:
            shifts = np.concatenate([start.shifts[:count] + off, start.shifts[count:]])
            start = replace(start, shifts=shifts)
        settings = ReliefSettings(reach=reach)
        return registered(start, self.footprints, self.models, self.surfaces, settings, self.case.settings, progress)


def prepared(site: SimulatedSite, more: str = "") -> Prepared:
    """The case of a site, with `more` in it."""
    with tempfile.TemporaryDirectory() as folder:
        path = write_site(site, Path(folder))
        path.write_text(path.read_text(encoding="utf-8") + more, encoding="utf-8")
        clock = [time.process_time()]
        case = read_case(path)
    clock.append(time.process_time())
    before = adjust_network(case.network, case.settings, case.name)
    clock.append(time.process_time())
    rng = np.random.default_rng([site.seed, SITE_NAMES.index(site.settings.name), 7])
    posterior = Posterior.of(before)
    models = cells_of(case.terrain, posterior, ReliefSettings())
    footprints, surfaces = shown(case, site, posterior, models, rng)
    clock.append(time.process_time())
    return Prepared(case, before, models, footprints, surfaces, np.diff(clock).tolist())


# --- from far off


def captures(name: str, seed: int) -> dict[str, Any]:
    """Errors (m), whether clear, and whether wrong, of each profile from each direction."""
    site = simulate_site(name, seed, SimulationOptions(pictures=False))
    made, profiles = prepared(site), []
    for angle in 2.0 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS:
        off = OFF * np.array([np.cos(angle), np.sin(angle)])
        profiles += judged(site, made.registered(REACH, off))
    return {"profiles": profiles}


def judged(site: SimulatedSite, found: ReliefRegistration) -> list[dict[str, Any]]:
    """Of each profile how far it is from its true place on the surface (m), what is said of it and is it wrong."""
    profiles = [one for one in found.profiles if not one.of_posts]
    names = [one.name for one in profiles]
    shifts = {image.settings.profile: -image.profile.shift for image in site.images}
    result = []
    for one, surface in zip(profiles, surface_errors(site, names, found.solution), strict=True):
        cost, whole = one.after.cost, one.shift - shifts[one.name]
        error = whole - surface
        off, square = float(np.linalg.norm(error)), 0.0
        if cost.clear:
            error += one.after.misplacement  # what is said to be left of it
            square = float(error @ np.linalg.solve(one.after.misplacement_covariance, error))
        result.append({
            "off": off, "tied": cost.tied, "clear": cost.clear, "wrong": off > RIGHT and square > NEAR,
            "square": square, "shift": float(whole @ np.linalg.solve(one.covariance, whole)),
            "sigma": float(np.sqrt(np.diag(one.covariance).mean())),
        })  # fmt: skip
    return result


def capture_table(draws: list[dict[str, Any]]) -> list[str]:
    """By site."""
    rows = []
    for name in dict.fromkeys(draw["site"] for draw in draws):
        mine = [draw for draw in draws if draw["site"] == name]
        every = [one for draw in mine for one in draw["profiles"]]
        right = [one["off"] for one in every if one["off"] < RIGHT]
        rows.append([
            name, str(len(mine)), str(len(every)), f"{len(right)} ({100.0 * len(right) / len(every):.1f} %)",
            *(str(sum(one[what] for one in every)) for what in ("clear", "wrong")),
            number(float(np.sqrt(np.mean(np.square(right)))) if right else np.nan),
        ])  # fmt: skip
    return table(("site", "seeds", "profiles", "right", "clear", "clear, wrong", "off, m"), rows)


# --- plains


def _fractal(hurst: float) -> Callable[[np.random.Generator], Array]:
    return lambda rng: fractal(_SHAPE, hurst, rng).astype(np.float64)


def _craters(rng: np.random.Generator) -> Array:
    field = np.zeros(_SHAPE, dtype=np.float32)
    add_craters(field, _STEP, 0.5, (80.0, 600.0), rng)
    return field.astype(np.float64)


def _hummocks(rng: np.random.Generator) -> Array:
    return np.asarray(gaussian_filter(rng.standard_normal(_SHAPE), 300.0 / _STEP, mode="wrap"))


_SHAPE, _STEP = (4096, 1024), 16.0
"""Coefficients of the plains' relief, as of the sites', and m between them."""
KINDS: dict[str, Callable[[np.random.Generator], Array]] = {
    "level": lambda _: np.zeros(_SHAPE),
    "rough (Hurst exponent 0.1)": _fractal(0.1),
    "fractal (0.5)": _fractal(0.5),
    "rolling (0.9)": _fractal(0.9),
    "hummocks, 300 m": _hummocks,
    "craters of 80 to 600 m": _craters,
}
"""Relief of a plain."""


def plain(name: str, seed: int) -> dict[str, Any]:
    """What is said of both profiles."""
    kind, noise = name.rsplit(", ", 1)[0], float(name.rsplit(", ", 1)[1].split()[0])
    relief = KINDS[kind](np.random.default_rng([seed, list(KINDS).index(kind)]))
    relief *= RELIEF / max(float(np.std(relief)), 1e-12)
    nothing = PeriodicSurface(_STEP, np.zeros((1, 1), dtype=np.float32))
    surface = PeriodicSurface(_STEP, relief.astype(np.float32))
    terrain = replace(make_terrain(SITE, 1), seed=seed, relief=surface, detail=nothing)
    options = SimulationOptions(pictures=False, range_noise=noise, height_noise=noise)
    site = simulate_site(SITE, seed, options, terrain)
    return {"profiles": judged(site, prepared(site).registered())}


def plain_table(draws: list[dict[str, Any]]) -> list[str]:
    """By kind and noise of the shots."""
    rows = []
    for name in dict.fromkeys(draw["site"] for draw in draws):
        every = [one for draw in draws if draw["site"] == name for one in draw["profiles"]]
        sigmas = [[one["sigma"] for one in every if one["clear"] is clear] for clear in (True, False)]
        squares = [[one["square"] for one in every if one["clear"]], [one["shift"] for one in every]]
        rows.append([
            *name.rsplit(", ", 1), str(len(every)),
            *(str(sum(one[what] for one in every)) for what in ("tied", "clear", "wrong")),
            *(number(0.5 * float(np.mean(part)) if part else np.nan) for part in squares),
            *(number(float(np.median(part)) if part else np.nan) for part in sigmas),
        ])  # fmt: skip
    what = "tied", "clear", "clear, wrong", "NEES, clear", "NEES, shifts", "sigma, clear", "sigma, others"
    return table(("relief", "shots", "profiles", *what), rows)


# --- time


def timed(name: str, seed: int) -> dict[str, Any]:
    """Seconds of one processor by stage."""
    profiles, shots = (int(part) for part in name.split(", "))
    site = simulate_site(SITE, seed, SimulationOptions(pictures=False))
    with tempfile.TemporaryDirectory() as folder:
        cloud = Path(folder) / "cloud.csv"
        cloud.write_text("\n".join(across(site, profiles, shots)) + "\n", encoding="utf-8")
        sigmas = "sigma_m = [5.0, 1.0]\nshift_sigma_m = [100.0, 100.0, 10.0]\nfootprint_m = 168.0\n"
        made = prepared(site, f'\n[[altimetry]]\nfile = "{cloud}"\n{sigmas}')
    searching = list[float]()

    def progress(what: str, done: int, most: int) -> None:
        if what == "search" and done in (0, most):
            searching.append(time.process_time())

    begin = time.process_time()
    found = made.registered(progress=progress)
    whole, search = time.process_time() - begin, float(np.sum(np.diff(searching)[::2]))
    stereo = found.solution.network.stereo
    clear = sum(one.after.cost.clear for one in found.profiles)
    return {
        "seconds": [*made.seconds, search, whole - search], "clear": clear, "of": len(found.profiles),
        "shots": int(np.sum(stereo.surface >= 0)) if stereo else 0,
    }  # fmt: skip


def across(site: SimulatedSite, profiles: int, shots: int) -> Iterator[str]:
    """Lines of a table of shots, with errors as stated, along lines across what the first image shows."""
    image, rng = site.images[0].true, np.random.default_rng([site.seed, 5])
    yield "longitude_deg,latitude_deg,radius_m,profile"
    for p in range(profiles):
        ends = rng.uniform([[0.0, 0.0], [0.9, 0.0]], [[0.1, 1.0], [1.0, 1.0]]) * [image.lines, image.samples]
        share = np.linspace(0.0, 1.0, shots // profiles)[:, None]
        points = site.terrain.intersect(*image.sightlines(*(ends[0] + share * (ends[1] - ends[0])).T))
        points -= np.einsum("k,nkj->nj", rng.normal(0.0, 100.0, 2), east_north(points))
        lon, lat, radius = planetocentric(points).T
        radius += rng.normal(0.0, 10.0) + rng.normal(0.0, 1.0, radius.size)
        for row in zip(lon / DEG, lat / DEG, radius, strict=True):
            yield "{:.9f},{:.9f},{:.3f},{}".format(*row, p)


def time_table(draws: list[dict[str, Any]]) -> list[str]:
    """By load."""
    head = "profiles", "shots on the surface", "clear"
    stages = "read", "adjusted", "averaged", "searched", "adjusted again", "all"
    rows = []
    for draw in draws:
        seconds = [*draw["seconds"], sum(draw["seconds"])]
        rows.append([*(str(draw[what]) for what in ("of", "shots", "clear")), *map(number, seconds)])
    return table((*head, *stages), rows)


if __name__ == "__main__":
    sys.exit(main())

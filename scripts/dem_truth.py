"""Are terrain models as good as their sigmas say? Simulated sites against their true ground, and against laser shots.

Each site is simulated with rendered pictures and written in the mission's formats; every third laser shot is kept out
as a check point. Its images are matched (`mgsgraph match`), adjusted with these matches, and made into a terrain model
(`mgsgraph dem`), as a user would by the commands.

    python scripts/dem_truth.py [--sites gusev,eos,isidis] [--seeds 2] [--out FOLDER]

Writes dem_truth.md to the folder, docs by default. Exit status: 0 done, 2 bad input.
"""

import resource
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from study import DOCS, at_least, command, machine, number, show, table, write_page

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.case.reading import read_case
from mgsgraph.case.scene import read_scene
from mgsgraph.geometry.body import planetocentric
from mgsgraph.geometry.records import Array
from mgsgraph.matching.settings import MatchSettings
from mgsgraph.registration.dem.checking import check_figures
from mgsgraph.registration.dem.model import Dem
from mgsgraph.results.matching import match_into
from mgsgraph.results.terrain_model import make_dem
from mgsgraph.simulation.files import write_site
from mgsgraph.simulation.site import SimulatedSite, simulate_site
from mgsgraph.simulation.sites import SITE_NAMES
from mgsgraph.text import root_mean_square as rms

PAGE = "dem_truth.md"
CHECK_EVERY = 3
_ROUNDS = 5
"""Of moving a model to where it fits the truth best."""
WORDS = """# Terrain models against truth

Made by `scripts/dem_truth.py` ({machine}): `simulate`, `match`, `adjust`, `dem`; images of up to 10,112 x 1,024 pixels
with noise of 1.5 grey values, every third laser shot kept out as a check point. *error*: height of the model minus the
true ground's at the same place, rms over all posts; *by sigma*: rms of errors over their stated sigmas (1: as stated);
*fine*: the errors without what a horizontal shift of the model and a quadratic surface take of them, by the sigma of
matching alone. What these take is the orientation's: one draw of it. *beyond 3*: posts beyond three sigmas. *shots*:
laser shots that took no part, and their differences by what is stated of them. *seconds*: of the terrain model alone,
all products; memory is the whole run's.
"""
HEAD = (
    "site", "seed", "posts", "matched", "sigma, m", "of matching", "of orientation", "error, m", "mean", "by sigma",
    "fine by sigma", "beyond 3", "shots", "rms, m", "by sigma", "seconds",
)  # fmt: skip


class HeightErrors(NamedTuple):
    """Errors of a terrain model's heights."""

    rms: float
    mean: float
    by_sigma: float
    fine: float
    beyond: float


def main() -> int:
    """Entry point."""
    parser = command(__doc__)
    parser.add_argument("--sites", default=",".join(SITE_NAMES), help=f"some of {','.join(SITE_NAMES)}")
    parser.add_argument("--seeds", type=at_least(1), default=2)
    parser.add_argument("--out", type=Path, default=DOCS)
    chosen = parser.parse_args()

    def page() -> str:
        rows = list[tuple[str, ...]]()
        for site in chosen.sites.split(","):
            for seed in range(1, chosen.seeds + 1):
                show(f"{site}, seed {seed} of {chosen.seeds}")
                rows.append(one(site, seed))
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
        return "\n".join([WORDS.format(machine=machine()), *table(HEAD, rows), "", f"Peak memory: {peak:.2f} GiB.", ""])

    return write_page(parser, chosen.out / PAGE, page)


def one(name: str, seed: int) -> tuple[str, ...]:
    """A line of the table: simulate, match, adjust, make a terrain model, compare."""
    site = simulate_site(name, seed)
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        case = write_site(site, folder / "site")
        text = case.read_text(encoding="utf-8").replace("[[shots]]", f"[[shots]]\ncheck_every = {CHECK_EVERY}")
        case.write_text(text, encoding="utf-8")
        match_into(*read_scene(case), folder / "matches", MatchSettings(), figures=False)
        read = read_case(case, ties=folder / "matches" / "network.pvl")
        solution = adjust_network(read.network, read.settings, read.name)
        begun = time.perf_counter()
        dem = make_dem(solution, case, folder / "dem")
        seconds = time.perf_counter() - begun
    errors, shots = of_heights(dem, site), check_figures(dem.checks, np.ones(len(dem.checks), dtype=bool))
    matched, posts = (sum(getattr(one, name) for one in dem.pairs) for name in ("matched", "posts"))
    sigmas = (np.nanmedian(band) for band in (dem.model.sigmas, dem.model.matching, dem.model.orientation))
    return (
        name, str(seed), str(int(np.isfinite(dem.heights).sum())), f"{100.0 * matched / posts:.1f} %",
        *(number(float(sigma)) for sigma in sigmas), number(errors.rms), number(errors.mean), number(errors.by_sigma),
        number(errors.fine), f"{100.0 * errors.beyond:.2f} %", str(len(dem.checks)), number(shots["rms_m"]),
        number(shots["rms_by_sigma"]), number(seconds),
    )  # fmt: skip


def of_heights(dem: Dem, site: SimulatedSite) -> HeightErrors:
    """Against the true ground under the posts."""
    there = np.isfinite(dem.model.heights)
    posts, heights = dem.model.map.posts()[there.ravel()], dem.model.heights[there]
    off = heights - truth(dem, site, posts)
    sigmas, matching = dem.model.sigmas[there], dem.model.matching[there]
    fine = without_orientation(dem, site, posts, heights)
    return HeightErrors(
        rms(off), float(off.mean()), rms(off / sigmas), rms(fine / matching), float(np.mean(np.abs(off / sigmas) > 3.0))
    )


def truth(dem: Dem, site: SimulatedSite, plane: Array) -> Array:
    """(n,) m above the map's sphere, of the true ground at places (n, 2) of the map."""
    grid = dem.model.map
    places = planetocentric(grid.points(plane, np.zeros(len(plane))))
    return np.asarray(site.terrain.ground_radius(places[:, 0], places[:, 1]) - grid.radius)


def without_orientation(dem: Dem, site: SimulatedSite, posts: Array, heights: Array) -> Array:
    """(n,) m, errors that a horizontal shift of the model, quadratic along it, and a quadratic surface leave."""
    slopes = np.nan_to_num(dem.model.slopes[np.isfinite(dem.model.heights)])
    x, y = ((posts - posts.mean(axis=0)) / np.ptp(posts, axis=0)).T
    powers = np.column_stack([np.ones_like(y), y, y * y])
    surface = np.column_stack([powers, x, x * y, x * x])
    return laid_on(partial(truth, dem, site), lambda _: slopes, posts, heights, powers, surface)[2]


def laid_on(
    truth: Callable[[Array], Array], slopes: Callable[[Array], Array], plane: Array, heights: Array, shift: Array,
    surface: Array,
) -> tuple[Array, Array, Array]:
    """Lay heights (n,) in m at positions (n, 2) in m on the true ground, by least squares.

    `truth` gives heights (n,) and `slopes` (n, 2) at positions; `shift` (n, s) and `surface` (n, k) are the columns of
    a horizontal and of a vertical displacement. Returns the coefficients (s, 2) and (k,) of both, and the errors (n,)
    in m that they leave.
    """
    moved, level, off = np.zeros((shift.shape[1], 2)), np.zeros(surface.shape[1]), heights
    for _ in range(_ROUNDS):
        there = plane - shift @ moved
        off = heights - truth(there)
        design = np.column_stack([surface, *(-shift * slope[:, None] for slope in slopes(there).T)])
        level, more = np.split(np.linalg.lstsq(design, off)[0], [surface.shape[1]])
        moved = moved + more.reshape(2, -1).T
    return moved, level, off - surface @ level


if __name__ == "__main__":
    sys.exit(main())

"""Verbs that make the input of adjustments: simulated sites, files of archives, tie points; and terrain models."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from mgsgraph.cli.options import (
    CASE,
    DETAILS,
    NO_FIGURES,
    PATH,
    TWO_IMAGES,
    WORKERS,
    details,
    elapsed,
    folder_for,
    items,
    out_option,
    print_brief,
    print_ended,
    print_sentences,
    print_solution,
    require_two,
)
from mgsgraph.errors import command_line

if TYPE_CHECKING:
    from mgsgraph.matching.settings import MatchSettings

_SEED = click.option(
    "--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Seed of everything drawn."
)
_ATTITUDE_TIME_BIAS = click.option(
    "--attitude-time-bias", type=float, help="Seconds by which the nadir image's CK is off, beside what is drawn."
)


@contextmanager
def _resumable() -> Iterator[None]:
    """On an interrupt, print that the downloaded files are kept, and exit with 130."""
    try:
        yield
    except KeyboardInterrupt:
        click.echo("mgsgraph: interrupted; what has come is kept, the same command goes on", err=True)
        raise click.exceptions.Exit(130) from None


@click.command()
@click.argument("site", default="gusev")
@click.option(
    "--out", type=PATH, default=Path("mgsgraph-demo"), show_default=True,
    help="Folder for inputs and results; made anew.",
)  # fmt: skip
@_SEED
@_ATTITUDE_TIME_BIAS
@click.option("--no-relief", is_flag=True, help="Leave the registration by relief out, which takes most of the time.")
@NO_FIGURES
@DETAILS
@click.pass_context
def demo(
    ctx: click.Context, site: str, out: Path, seed: int, attitude_time_bias: float | None, no_relief: bool,
    no_figures: bool,
) -> None:
    """Simulate SITE (eos, gusev, isidis; or pair: small and synthetic), write it in the formats of the mission's
    archive, read it back, adjust it with its tie points and laser ranges, and register laser and images by relief.

    Its errors are drawn from the sigmas that its case states. Five lines compare the result with the simulated truth;
    --details adds all tables. Registration by relief needs OpenCV (extra "match"), and is left out without it.
    Exit status: 0 valid or suspect, 1 invalid (results are written), 2 bad input.
    """
    from mgsgraph.adjustment.adjust import compile_sweep_beside
    from mgsgraph.adjustment.solution import Solution
    from mgsgraph.analysis.verdict import is_valid
    from mgsgraph.case.reading import Case
    from mgsgraph.case.reading import adjust as run
    from mgsgraph.cli.progress import iteration_bar, stage_bar
    from mgsgraph.files.output.folders import DEMO, fresh_folder
    from mgsgraph.results.verdict import state_of
    from mgsgraph.simulation.demo.demonstration import DEMONSTRATED, STAGES, simulation_options
    from mgsgraph.simulation.demo.summary import write_demo

    def adjusting(case: Case) -> Solution:
        with iteration_bar() as bar:
            return run(case, bar)

    options = simulation_options(site, attitude_time_bias, known=DEMONSTRATED)
    compile_sweep_beside()
    with fresh_folder(out, DEMO) as folder, stage_bar(len(STAGES)) as stages:
        solution, tables, sentences = write_demo(
            site, folder, seed, options, adjusting, stages, not no_figures, not no_relief
        )
    if details():
        print_solution(solution)
        sentences = [*tables, *sentences]
    click.echo("\n".join(sentences))
    click.echo(f"Verdict: {state_of(solution)} ({elapsed():.0f} s). All of it: {command_line('report', out)}")
    ctx.exit(0 if is_valid(solution) else 1)


@click.command()
@click.argument("site")
@click.option("--out", type=PATH, help="Folder for the files; absent or empty.  [default: SITE-simulate]")
@_SEED
@_ATTITUDE_TIME_BIAS
@click.option("--no-pictures", is_flag=True, help="Uniform grey images, which are enough for geometry.")
@click.option(
    "--kind", metavar="NAME", help="Of an archive: kaguya, ctx, moc, region, dense or block.  [default: kaguya]"
)
@click.option(
    "--images", type=int,
    help="Number of images: of a strip, 2 to 500  [default: 40]; of an archive  [default: as its kind has].",
)
@click.option(
    "--ties", type=int,
    help="Of a strip: new tie points with each further image  [default: 2000]; of an archive: all of them, about.",
)  # fmt: skip
@click.option("--steps", is_flag=True, help="Of a strip: write what each image adds to those before it, too.")
def simulate(site: str, out: Path | None, no_pictures: bool, **options: Any) -> None:
    """Simulate SITE and write its files to a folder.

    SITE is eos, gusev or isidis; pair: two images, small and synthetic; strip: overlapping pairs along one ground
    track; three-sites: the three study sites and a bridge image that connects them, in one case; archive: as many
    images as are adjusted as a whole, with a binary network.

    Archives, of any number of images and ties: kaguya (3,361 images and 240,000 ties by default), a block of Kaguya's
    two terrain cameras; ctx (70,000 and 2.4 million), CTX about the whole globe; moc (97,000 and 1.5 million), MOC's
    narrow angle in clusters; region (1,000 and 60,000), such clusters in a region, each image with a MOLA profile;
    dense (20,000 and 12 million) and block (500 and a million), the terrain cameras again.

    case.toml in it is what `mgsgraph adjust`, `mgsgraph footprints` and `mgsgraph align` take; truth.json says what
    they should find. Errors are drawn from the sigmas that case.toml states; an attitude time bias, which it doesn't
    know of, comes on top: 0.95 s move the nadir image by the 325 m of the papers' text.
    """
    from mgsgraph.cli.progress import stage_bar
    from mgsgraph.files.output.folders import fresh_folder
    from mgsgraph.simulation.demo.demonstration import simulated_files, simulation

    out = out or Path(f"{site}-simulate")
    with stage_bar(2) as stages:
        functions = simulation(site, pictures=not no_pictures, progress=stages.detail, **options)
        with fresh_folder(out, "truth.json") as temporary:
            _, path = simulated_files(*functions, temporary, stages)
    click.echo(f"The case is {out / path.name}; the truth lies beside it in truth.json")


@click.command()
@click.argument("images", nargs=-1, metavar="IMAGE...")
@click.option(
    "--out", type=PATH, default=Path("mgsgraph-fetch"), show_default=True,
    help="Folder to fetch into; an earlier one is added to.",
)  # fmt: skip
@click.option(
    "--terrain", type=click.Choice(["4", "16", "128", "none"]), default="16", show_default=True,
    help="MOLA's grids, pixels per degree: 4 (4 MB), 16 (66 MB), 128 (260 MB for each tile).",
)  # fmt: skip
@click.option("--camera", type=click.Choice(["moc", "ctx", "lroc"]), help="All its images in --box, in place of ids.")
@click.option("--list", "listed", is_flag=True, help="Only print the ids of the images in --box.")
@click.option(
    "--altimeter", type=click.Choice(["mola", "lola"]), help="No images: an altimeter's shots in --box (ODE)."
)
@click.option(
    "--box", type=(float, float, float, float), metavar="W E S N",
    help="Degrees: longitudes east, planetocentric latitudes.",
)  # fmt: skip
@click.option("--volume", "volumes", multiple=True, metavar="mgsc_NNNN", help="Where the images are; may be repeated.")
@click.option(
    "--mirror", metavar="URL|FILE", envvar="MGSGRAPH_MIRRORS",
    help="All archives below one address (URL/images/, URL/kernels/ ...), or a TOML file with single ones' addresses.",
)  # fmt: skip
def fetch(
    images: tuple[str, ...], out: Path, terrain: str, camera: str | None, listed: bool, altimeter: str | None,
    box: tuple[float, float, float, float] | None, volumes: tuple[str, ...], mirror: str | None,
) -> None:
    """Fetch all that the adjustment of images needs, by their ids, and write a case file: of MOC's narrow angle
    (E02/00665, e0200665), CTX (B10_013341_1010_XN_79S172W), LROC NAC (M103595705LE) or HRSC (h5270_0000_ir2), those of
    one mission in a folder, with their kernels and the laser shots about them. Or those of a region, by --camera and
    --box: of MOC those with their middle in it, of CTX and LROC those whose footprints meet it.

    What has come is locked by size and SHA-256: the same command again brings only what is missing or differs, and an
    interrupted download goes on where it was. Exit status: 0, 2 for bad input or an archive that can't give what is
    needed, 130 interrupted.
    """
    if (box is None) != (camera is None and altimeter is None) or (camera and altimeter) or (box and images):
        raise click.UsageError("--box goes with one of --camera and --altimeter, without ids")
    if listed and camera is None:
        raise click.UsageError("--list goes with --camera and --box")
    from mgsgraph.cli.progress import counting_bar, passing_word
    from mgsgraph.fetch.folder import fetch_images, fetch_shots, find_images
    from mgsgraph.fetch.needs import Archives
    from mgsgraph.text import many

    archives = Archives.chosen(mirror)
    if altimeter is not None and box is not None:
        with _resumable(), counting_bar("fetching", "B") as show:
            table = fetch_shots(altimeter, box, out, archives=archives, progress=show, say=passing_word)
        click.echo(f"The shots are in {table}")
        return
    if camera is not None and box is not None:
        with _resumable(), counting_bar("looking through indices", "B") as show:
            images = find_images(camera, box, out, archives=archives, volumes=volumes, progress=show, say=passing_word)
        click.echo("\n".join(images) if listed else f"{many(len(images), 'image')} in the box")
        if listed:
            return
    with _resumable(), counting_bar("fetching", "B") as show:
        fetched = fetch_images(
            images, out, terrain=terrain, archives=archives, volumes=volumes, progress=show, say=passing_word
        )
    print_sentences(*fetched.sentences)
    click.echo(f"The case is {fetched.case}")
    if commands := fetched.commands():
        click.echo("Next:")
        for command in commands:
            click.echo(f"  {command}")
    else:
        click.echo("Next: fetch an image that overlaps it, into the same folder")


@click.command()
@click.argument("case", type=PATH, metavar="CASE|PROJECT")
@out_option("match", " A project has its own.")
@click.option("--step", type=float, metavar="M", help="Pixel of the common ground grid; default: the coarsest image's.")
@click.option(
    "--search", type=float, metavar="M",
    help="By how much the nominal orientations may contradict each other on the ground; default: 3 a-priori sigmas.",
)  # fmt: skip
@click.option("--height", type=float, metavar="M", help="Of the ground above the ellipsoid, without a terrain model.")
@click.option("--height-sigma", type=float, metavar="M", help="By how much the ground may be higher or lower.")
@click.option("--cells", type=int, default=250, show_default=True, help="Approximate number of cells per overlap.")
@click.option("--per-cell", type=int, default=2, show_default=True, help="Matches kept in each cell.")
@WORKERS
@NO_FIGURES
@DETAILS
def match(
    case: Path, out: Path | None, height: float | None, height_sigma: float | None, workers: int | None,
    no_figures: bool, **options: Any,
) -> None:
    """Find tie points in the overlapping images of CASE, whose own ties are not looked at.

    The images of PROJECT wait for tie points: they go into it, with all that its case names besides.

    Images are resampled to one ground grid on the terrain, features matched where orientation and heights say, and
    every match measured by least squares in the images themselves, with its covariance. Use the result with
    `mgsgraph adjust CASE --ties OUT/network.pvl`.
    """
    from mgsgraph.errors import require
    from mgsgraph.files.output.folders import PROJECT
    from mgsgraph.matching.settings import MatchSettings
    from mgsgraph.project.changes import take_ties, waiting_case
    from mgsgraph.project.project import open_project

    settings = MatchSettings(**options)
    project: Path | None = None
    if (case / PROJECT).is_file():
        if out is not None:
            raise click.UsageError("--out is for a case: a project keeps its tie points itself")
        with open_project(project := case) as opened:
            case, out = waiting_case(opened), opened.matches
    require(not case.is_dir(), str(case), "neither a case file nor a project", "one of the two", "check the path")
    out = folder_for(out, case, "match")
    _match(case, out, settings, height, height_sigma, workers, not no_figures)
    if project is not None:
        with open_project(project, write=True) as opened:
            description = take_ties(opened, out / "network.pvl")
        click.echo(f"{project}: {description}; nothing is adjusted yet")
        click.echo(f"Next: {command_line('project', 'solve', project)}")


def _match(
    case: Path, out: Path, settings: "MatchSettings", height: float | None, height_sigma: float | None,
    workers: int | None, figures: bool,
) -> None:
    """Match the images of a case; write and print the results."""
    from mgsgraph.case.scene import read_scene
    from mgsgraph.cli.progress import counting_bars
    from mgsgraph.files.output.folders import MATCH, require_replaceable
    from mgsgraph.results.matching import match_into, match_statements

    require_replaceable(out, MATCH)
    name, scene = read_scene(case, height, height_sigma)
    with counting_bars() as show:
        matches = match_into(name, scene, out, settings, workers, figures, show)
    print_brief(*items(match_statements(matches, scene)), more=3)
    print_ended(f"The network is {out / 'network.pvl'}")


@click.command()
@click.argument("solution", type=PATH, metavar="RESULT|PROJECT")
@CASE
@out_option("dem")
@click.option("--post", type=float, metavar="M", help="Between posts of the terrain model; default: as the matches.")
@click.option("--spacing", type=float, metavar="M", help="Between matches; default: five pixels of the ground grid.")
@click.option(
    "--heights", type=click.Choice(["sphere", "areoid"]), default="sphere", show_default=True,
    help="Reference surface of the heights.",
)
@click.option(
    "--shots", type=PATH, multiple=True, metavar="FILE", help="More laser shots to check by; may be repeated.",
)
@click.option("--ortho-pixel", type=float, metavar="M", help="Pixel of the ortho image; default: the image's own.")
@TWO_IMAGES
@WORKERS
@NO_FIGURES
@DETAILS
def dem(
    solution: Path, of_case: Path | None, out: Path | None, post: float | None, spacing: float | None, heights: str,
    shots: tuple[Path, ...], ortho_pixel: float | None, images: tuple[str, ...], workers: int | None, no_figures: bool,
) -> None:
    """Match the images of RESULT (of `mgsgraph adjust`) or PROJECT densely and write a terrain model.

    OUT then holds dem.tif (height, sigma, its parts by matching and by orientation, number of points), ortho.tif (an
    image laid on it), ortho_sigma.tif (sigmas of positions in it), dem.json, shots.csv (heights against laser shots
    that took no part in the adjustment) and a figure.
    """
    from typing import cast

    from mgsgraph.cli.progress import counting_bars
    from mgsgraph.project.reading import case_with_results, read_posterior
    from mgsgraph.registration.dem.model import DemSettings, Heights
    from mgsgraph.results.terrain_model import dem_section, make_dem

    settings = DemSettings(post, spacing, cast(Heights, heights), ortho_pixel, require_two(images), shots)
    _, posterior, warning = read_posterior(solution)
    out, case = folder_for(out, solution, "dem"), case_with_results(solution, of_case).case
    with counting_bars() as show:
        model = make_dem(posterior, case, out, settings, workers, not no_figures, show)
    print_sentences(warning)
    print_brief(dem_section(model).text(None))
    print_ended(f"The terrain model is {out / 'dem.tif'}")

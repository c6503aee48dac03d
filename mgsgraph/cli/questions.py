"""Verbs for covariance queries of an adjustment, planning and the report."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from mgsgraph.cli.options import (
    CASE,
    DETAILS,
    NO_FIGURES,
    PATH,
    TIES,
    details,
    print_brief,
    print_ended,
    print_sentences,
)

if TYPE_CHECKING:
    from mgsgraph.results.section import Section

_ROWS_OF_RELIABILITY = 10
"""Rows of the table of reliability without a question."""
_WEAK_DIRECTIONS = 5  # printed without a question
_PARAMETERS = ("correlations", "probability", "images", "post", "sigma_px", "alpha", "power")
"""Parameters that refine a question and are no question themselves."""


@click.command()
@click.argument("adjusted", type=PATH, metavar="RESULT|PROJECT|CASE")
@click.option("--point", "points", multiple=True, metavar="NAME", help="Sigmas and error ellipsoid of a ground point.")
@click.option(
    "--pair", "pairs", multiple=True, type=(str, str), metavar="NAME NAME",
    help="Two ground points: is their height difference real?",
)  # fmt: skip
@click.option(
    "--pose", "poses", multiple=True, type=(str, float), metavar="IMAGE LINE", help="Orientation of an image at a line."
)
@click.option(
    "--projection", "projections", multiple=True, type=(str, str), metavar="NAME IMAGE",
    help="Where a ground point falls in an image.",
)  # fmt: skip
@click.option(
    "--pixel", "pixels", multiple=True, type=(str, float, float), metavar="IMAGE LINE SAMPLE",
    help="Measures of a new point, two or more: its place and sigmas. The first pixel's centre is at 0.5 (ISIS: 1).",
)  # fmt: skip
@click.option("--correlations", is_flag=True, help="Correlations between everything that was asked about.")
@click.option("--probability", type=float, help="Of error ellipsoids (--point, --pixel); 0.95 when absent.")
@click.option("--curve", "curves", multiple=True, metavar="IMAGE", help="Sigmas along an image's lines.")
@click.option("--raster", is_flag=True, help="Sigmas of new points over the images' overlap, a GeoTIFF in --out.")
@click.option("--image", "images", multiple=True, metavar="IMAGE", help="Images of the raster, two or more; else all.")
@click.option("--post", type=float, metavar="M", help="Between posts of the raster.")
@click.option("--sigma-px", type=float, help="Of the measures of new points (--pixel, --raster); 1 when absent.")
@click.option("--unexplained", is_flag=True, help="What the adjustment can't explain, by name, with the term to add.")
@click.option("--components", is_flag=True, help="Are the sigmas consistent? Variance components.")
@click.option("--iterate", is_flag=True, help="Variance components until they converge: adjusts again and again.")
@click.option(
    "--reliability", type=click.IntRange(1), metavar="N", help="Redundancy and tests of all measures, N worst shown."
)
@click.option("--alpha", type=float, help="Baarda's level, share of false alarms; 0.001 when absent.")
@click.option("--power", type=float, help="Share of minimal detectable blunders that are found; 0.8 when absent.")
@click.option(
    "--likelihood", multiple=True, metavar="NAME",
    help="Intervals of an image's, shift's or shared unknown's numbers by the likelihood, without linear propagation.",
)  # fmt: skip
@click.option("--weak", type=click.IntRange(1), metavar="N", help="N least-constrained directions, in words.")
@click.option("--outliers", is_flag=True, help="A row per image: its measurements, rejected ones, and largest tests.")
@click.option(
    "--leave-out", is_flag=True, help="Each ground control point against an adjustment without its coordinates."
)
@click.option(
    "--nodes", is_flag=False, flag_value="4,8,16,32", metavar="[S,S,...]",
    help="Choose the spacing of the orientation images of [[passes]], in seconds; 4,8,16,32 when absent.",
)  # fmt: skip
@click.option("--hold-out", type=float, help="Of --nodes: share of points with three rays or more; 0.2 when absent.")
@click.option("--seed", type=click.IntRange(0), help="Of --nodes: of the rays held out; 0 when absent.")
@TIES
@DETAILS
@click.option("--out", type=PATH, help="Folder for analysis.json (nodes.json), tables and figures; made anew.")
@NO_FIGURES
def analyze(
    adjusted: Path, out: Path | None, no_figures: bool, nodes: str | None, hold_out: float | None, seed: int | None,
    ties: Path | None, **options: Any,
) -> None:  # fmt: skip
    """Query the covariance of RESULT (of `mgsgraph adjust`) or PROJECT; with --nodes, the node spacing of CASE.

    Without a question: the verdict of all tests in at most ten lines, and what is significant; with --details the
    tables, too. Sigmas are for sigma0 = 1, as the a-priori sigmas imply. Nothing of what is asked is changed.

    --nodes adjusts CASE (with [[passes]]), or that of RESULT, with orientation images at several spacings, without one
    ray of some of its points, and chooses the coarsest that predicts these no worse than the best one.

    Exit status: 0, also where tests fail; 2 bad input.
    """
    from mgsgraph.analysis.measures import Levels
    from mgsgraph.analysis.posterior import Pixel
    from mgsgraph.cli.progress import stage
    from mgsgraph.files.output.folders import ANALYSIS, require_replaceable
    from mgsgraph.project.reading import read_adjusted, read_posterior
    from mgsgraph.results.analysis import AnalysisRequest, analysis_sections, brief, require_used, write_analysis
    from mgsgraph.results.answers import Questions

    if nodes is not None:
        if any(options.values()) or no_figures:
            raise click.UsageError("--nodes goes with --hold-out, --seed, --ties and --out alone")
        _choose_spacing(adjusted, nodes, 0.2 if hold_out is None else hold_out, seed or 0, out, ties)
        return
    require_used("--hold-out, --seed, --ties", (hold_out, seed, ties) != (None, None, None), False, "--nodes")
    if out is not None:
        require_replaceable(out, ANALYSIS)
    no_question = not any(value for name, value in options.items() if name not in _PARAMETERS)
    full = no_question and (details() or out is not None)
    points, pixels, raster = options["points"], options["pixels"], options["raster"]
    about = {name: options[name] for name in ("points", "pairs", "poses", "projections")}
    is_given = {name: options[name] is not None for name in ("post", "probability", "sigma_px", "alpha", "power")}
    for option, stated, useful, needed in (
        ("--image, --post", options["images"] or is_given["post"], raster, "--raster"),
        ("--raster", raster, out, "--out FOLDER, for the GeoTIFF"),
        ("--correlations", options["correlations"], any(about.values()) or pixels, "question (--point, --pose, ...)"),
        ("--probability", is_given["probability"], points or pixels, "--point or --pixel"),
        ("--sigma-px", is_given["sigma_px"], pixels or raster, "--pixel or --raster"),
        ("--alpha, --power", is_given["alpha"] or is_given["power"], full or options["reliability"], "--reliability"),
        ("--no-figures", no_figures, out, "--out FOLDER"),
    ):  # fmt: skip
        require_used(option, bool(stated), bool(useful), needed)
    sigma = options["sigma_px"] if is_given["sigma_px"] else 1.0
    probability = options["probability"] if is_given["probability"] else 0.95
    measures = tuple(Pixel(image, line, sample, sigma) for image, line, sample in pixels)
    questions = Questions(**about, pixels=measures, correlations=options["correlations"], probability=probability)
    levels = Levels(*(options[name] if is_given[name] else usual for name, usual in (("alpha", 0.001), ("power", 0.8))))
    request = AnalysisRequest(
        questions, options["curves"], options["images"] if raster else None, options["post"], sigma,
        options["unexplained"] or full, options["components"] or options["iterate"] or full, options["likelihood"],
        options["iterate"], options["reliability"] or (_ROWS_OF_RELIABILITY if full else 0),
        options["weak"] or (_WEAK_DIRECTIONS if full else 0), options["outliers"] or full, levels, options["leave_out"],
    )  # fmt: skip
    brief_only = no_question and not details()
    if brief_only:
        solution, changed = read_adjusted(adjusted)
        print_brief(*brief(solution), more=2)
        print_sentences(changed)
        if out is None:
            return
    with stage("analyzing"):
        name, posterior, warning = read_posterior(adjusted)
        sections = list(analysis_sections(posterior, request, name))
        if out is not None:
            write_analysis(name, sections, out, figures=not no_figures)  # before printing: the reader of a pipe may end
    print_sentences(warning)
    for section in () if brief_only else sections:
        print_brief(section.text(None), more=1 - 4 * (options["reliability"] or options["weak"] or 0))  # rows of each
    if out is not None:
        click.echo(f"The analysis is in {out}")


def _choose_spacing(
    source: Path, spacings: str, hold_out: float, seed: int, out: Path | None, ties: Path | None
) -> None:
    from mgsgraph.analysis.spacing import choose_spacing
    from mgsgraph.case.reading import read_case
    from mgsgraph.cli.progress import counting_bar
    from mgsgraph.files.output.folders import NODES, require_replaceable
    from mgsgraph.project.reading import case_with_results
    from mgsgraph.results.spacing import nodes_section, seconds_of

    seconds = seconds_of(spacings)
    if out is not None:
        require_replaceable(out, NODES)
    results = case_with_results(source)
    case = read_case(results.case, ties=ties or results.ties)
    with counting_bar("adjusting", "step") as bar:
        choice = choose_spacing(case.network, case.settings, seconds, hold_out, seed, progress=bar)
    _show(nodes_section(choice, case.name), out, NODES, "study")


@click.command()
@click.argument("adjusted", type=PATH, metavar="RESULT|PROJECT")
@click.argument("candidates", type=PATH)
@click.option("--choose", type=click.IntRange(1), default=3, show_default=True, help="How many to choose at the most.")
@click.option(
    "--target", "targets", multiple=True, default=("ties",), show_default=True, metavar="ties|all|NAME",
    help="Whose sigmas count: tie points, all points, or points and images by name; may be repeated.",
)  # fmt: skip
@click.option(
    "--criterion", type=click.Choice(["mean", "worst"]), default="mean", show_default=True,
    help="Whether the targets' mean sigma counts, or the largest one.",
)  # fmt: skip
@click.option("--out", type=PATH, help="Folder for plan.csv and plan.json; made anew.")
@DETAILS
def plan(
    adjusted: Path, candidates: Path, choose: int, targets: tuple[str, ...], criterion: str, out: Path | None
) -> None:
    """Rank the images, laser profiles and control points of CANDIDATES (a TOML file, see docs/plan.md) by what they
    would do to the sigmas of RESULT (of `mgsgraph adjust`) or PROJECT, before anything is measured; and choose some,
    each in sight of those before it.

    Exit status: 0, also where nothing is worth anything; 2 bad input.
    """
    from mgsgraph.cli.progress import counting_bar
    from mgsgraph.files.output.folders import PLAN, require_replaceable
    from mgsgraph.planning.candidates_file import read_candidates
    from mgsgraph.planning.plan import plan as make
    from mgsgraph.project.reading import read_state
    from mgsgraph.results.plan import plan_section

    if out is not None:
        require_replaceable(out, PLAN)
    name, state, warning = read_state(adjusted)
    print_sentences(warning)
    with counting_bar("planning measures", "candidate") as bar:
        candidates_read = read_candidates(candidates, state, bar)
    with counting_bar("judging", "candidate") as bar:
        ranking = make(state, candidates_read, choose, targets, "mean" if criterion == "mean" else "worst", name, bar)
    _show(plan_section(ranking), out, PLAN, "plan")


def _show(section: "Section", out: Path | None, record: str, label: str, figures: bool = True, more: int = 0) -> None:
    """Write a section to a folder, if given, and print it."""
    from mgsgraph.results.section import write_sections

    if out is not None:
        write_sections([section], section.numbers, out, record, figures)
    print_brief(section.text(None), more=more + (out is not None))
    if out is not None:
        click.echo(f"The {label} is in {out}")


@click.command()
@click.argument("result", type=PATH, metavar="RESULT|PROJECT")
@click.option("--compare", type=PATH, metavar="EARLIER", help="Results or project to compare with.")
@CASE
@TIES
@click.option(
    "--out", type=PATH, default=Path("report.html"), show_default=True,
    help="HTML file; replaced. With --compare also a folder, made anew: comparison.json, tables, a map of differences.",
)  # fmt: skip
@NO_FIGURES
@DETAILS
def report(
    result: Path, compare: Path | None, of_case: Path | None, ties: Path | None, out: Path, no_figures: bool
) -> None:
    """Write one HTML file about RESULT (of `mgsgraph adjust`) or PROJECT: summary, maps, figures, tables.

    The page holds everything that it shows and asks nothing of the network. It says from which files it was made, with
    their checksums. Laser footprints are shown on the images of the case: a demo's and a project's are found, others
    are given by --case.

    With --compare it says how RESULT differs from EARLIER: settings, input, what moved by how many sigmas, what is
    better known. Each is a folder of results (also one of a project's solutions/NNNN), or a project: its last batch
    solution. Differences are RESULT minus EARLIER. With a folder as --out that is all.
    """
    from mgsgraph.case.reading import read_case
    from mgsgraph.cli.progress import stage
    from mgsgraph.files.output.folders import COMPARISON, require_replaceable
    from mgsgraph.project.reading import comparison_with_truth, results_of
    from mgsgraph.results.analysis import require_used
    from mgsgraph.results.archive import read_solution
    from mgsgraph.results.comparison import compare as compared
    from mgsgraph.results.page import require_page, write_report

    folder = None if compare is None or out.suffix else out
    require_used("--no-figures", no_figures, folder is not None, "--compare with --out FOLDER")
    if folder is None:
        require_page(out)
    else:
        require_replaceable(out, COMPARISON)
    results, earlier = results_of(result), None if compare is None else results_of(compare)
    case, own_ties = (of_case, None) if of_case is not None else (results.case, results.ties)
    if ties is not None and case is None:
        raise click.UsageError("--ties is for a case: give --case, too")
    adjusted, reference = read_solution(results.folder), None if earlier is None else read_solution(earlier.folder)
    print_sentences(results.warning, "" if earlier is None else earlier.warning)
    if earlier is not None and reference is not None:
        click.echo(f"A: {earlier.folder} ({reference.name})\nB: {results.folder} ({adjusted.name})")
        _show(compared(adjusted, reference, ("A", "B")).section, folder, COMPARISON, "comparison", not no_figures, 3)
    if folder is not None:
        return
    with stage("tables and figures"):
        case_read = None if case is None else read_case(case, ties=ties or own_ties)
        if case_read is not None:
            case_read.require_images_of(adjusted)
        inputs = _inputs([results.folder, None if earlier is None else earlier.folder], case, ties or own_ties)
        write_report(adjusted, out, case_read, reference, inputs, comparison_with_truth(results.folder))
    print_ended(f"The page is {out}")


def _inputs(solutions: list[Path | None], case: Path | None, ties: Path | None) -> dict[str, str | None]:
    """Checksums of the solutions' archives, of the case, and of all files that it names."""
    from mgsgraph.files.opening import sha256_of
    from mgsgraph.project.campaign import checksums
    from mgsgraph.results.archive import ARCHIVE

    archives = [path / ARCHIVE if path.is_dir() else path for path in solutions if path is not None]
    checksums_of_results = {str(path): sha256_of(path) for path in [*archives, *([] if ties is None else [ties])]}
    return checksums_of_results | ({} if case is None else checksums(case))

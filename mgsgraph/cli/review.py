"""`mgsgraph review`: a page on which a person reviews matches, and what becomes of the verdicts."""

from pathlib import Path

import click

_PATH = click.Path(path_type=Path)
_PAGES = (".html", ".htm")
_NETWORKS = (".pvl", ".net", ".csv")


@click.command(short_help="Make a page to review tie points on; take rejected ones out of a network.")
@click.argument("case", type=_PATH)
@click.option("--out", type=_PATH, required=True, help="Page (.html), or with --verdicts a network (.pvl, .net, .csv).")
@click.option("--ties", type=_PATH, help="Network to review, in place of the case's own.")
@click.option("--worst", type=click.IntRange(1), help="How many points to show.  [default: 300]")
@click.option("--points", metavar="ID,ID,...", help="Points to show, in place of the worst.")
@click.option("--solution", type=_PATH, help="Results of `mgsgraph adjust` with these points: show their residuals.")
@click.option("--verdicts", type=_PATH, help="CSV that the page has saved: to act upon, or to begin a page with.")
def review(
    case: Path, out: Path, ties: Path | None, worst: int | None, points: str | None, solution: Path | None,
    verdicts: Path | None,
) -> None:  # fmt: skip
    """Show the images of CASE around its tie points, so that a person can accept or reject each of them.

    The page is one file that any browser shows; it saves verdicts as CSV. With --verdicts and a network as --out, the
    network is written with Ignore = True at rejected points, and nothing else changed. Nothing overwrites the network
    that was reviewed.
    """
    from mgsgraph.errors import InputError

    if out.suffix.lower() in _PAGES:
        if worst is not None and points is not None:
            raise click.UsageError("--worst and --points can't both be given")
        _write_page(case, out, ties, worst, points, solution, verdicts)
    elif out.suffix.lower() in _NETWORKS:
        if verdicts is None:
            raise click.UsageError(f"{out} is a network; it is written by --verdicts, a page has the ending .html")
        if given := [name for name, value in (("worst", worst), ("points", points), ("solution", solution)) if value]:
            raise click.UsageError(f"--{given[0]} is for a page, and {out} is a network")
        _write_network(case, out, ties, verdicts)
    else:
        raise InputError(str(out), f"the ending {out.suffix!r}", "a page (.html) or a network (.pvl, .net, .csv)")


def _write_page(
    case: Path, out: Path, ties: Path | None, worst: int | None, points: str | None, solution: Path | None,
    verdicts: Path | None,
) -> None:  # fmt: skip
    from mgsgraph.case.reading import read_case
    from mgsgraph.cli.progress import counting_bar
    from mgsgraph.reports.archive import read_solution
    from mgsgraph.review.page import write_review
    from mgsgraph.review.selection import WORST, review_case
    from mgsgraph.review.verdicts import read_verdicts, reviewed_network

    if ties is None:
        reviewed_network(case)  # of several, none could be written without the rejected points
    earlier = None if verdicts is None else read_verdicts(verdicts)
    adjusted = None if solution is None else read_solution(solution)
    wanted = () if points is None else tuple(point.strip() for point in points.split(","))
    read = read_case(case, ties=ties)
    with counting_bar("comparing chips", "measure") as bar:
        made = review_case(read, adjusted, worst=worst or WORST, points=wanted, verdicts=earlier, progress=bar)
    write_review(made, out, earlier)
    click.echo(f"- {made.choice}.")
    click.echo(f"The page is {out}")


def _write_network(case: Path, out: Path, ties: Path | None, verdicts: Path) -> None:
    from mgsgraph.export.exchange_setting import case_setting
    from mgsgraph.review.verdicts import read_verdicts, reviewed_network, write_kept

    network = reviewed_network(case) if ties is None else ties
    setting = case_setting(case) if network.suffix.lower() == ".csv" else None
    ignored, total = write_kept(network, read_verdicts(verdicts), out, setting)
    click.echo(f"- {ignored} of {total} points of {network} are ignored now.")
    click.echo(f"The network is {out}")

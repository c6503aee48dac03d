"""`mgsgraph report`: a page about an adjustment, to be read, printed and passed on."""

from pathlib import Path

import click

_PATH = click.Path(path_type=Path)


@click.command(short_help="Write a page about an adjustment, one HTML file.")
@click.argument("solution", type=_PATH)
@click.option("--compare", type=_PATH, metavar="OTHER", help="Results of an earlier adjustment, to compare with.")
@click.option(
    "--case", type=_PATH,
    help="Case that was adjusted: show laser footprints on its images. A demo's and a project's are found.",
)
@click.option("--ties", type=_PATH, metavar="NETWORK", help="Tie points in place of those that the case names.")
@click.option("--out", type=_PATH, default=Path("report.html"), show_default=True, help="HTML file; replaced.")
def report(solution: Path, compare: Path | None, case: Path | None, ties: Path | None, out: Path) -> None:
    """Write one HTML file about SOLUTION (results of `mgsgraph adjust`, or a project): summary, maps, figures, tables.

    The page holds everything that it shows and asks nothing of the network. It says from which files it was made, with
    their checksums.
    """
    from mgsgraph.case.reading import read_case
    from mgsgraph.project.reading import results_of
    from mgsgraph.reports.archive import read_solution
    from mgsgraph.reports.page import require_page, write_report

    require_page(out)
    solution, own_case, own_ties, warning = results_of(solution)
    compare = None if compare is None else results_of(compare).folder
    adjusted, earlier = read_solution(solution), None if compare is None else read_solution(compare)
    if case is None and own_case is not None:
        case, ties = own_case, ties or own_ties
    if ties is not None and case is None:
        raise click.UsageError("--ties is for a case: give --case, too")
    read = None if case is None else read_case(case, ties=ties)
    write_report(adjusted, out, read, earlier, _inputs([solution, compare], case, ties))
    if warning:
        click.echo(f"- {warning}")
    click.echo(f"The page is {out}")


def _inputs(solutions: list[Path | None], case: Path | None, ties: Path | None) -> dict[str, str | None]:
    """Checksums of the solutions' archives, of the case, and of every file that it names."""
    from mgsgraph.campaign.inputs import checksums
    from mgsgraph.io.files import sha256_of
    from mgsgraph.reports.archive import ARCHIVE

    given = [path / ARCHIVE if path.is_dir() else path for path in solutions if path is not None]
    own = {str(path): sha256_of(path) for path in [*given, *([] if ties is None else [ties])]}
    return own | ({} if case is None else checksums(case))

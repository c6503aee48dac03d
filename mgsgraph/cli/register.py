"""`mgsgraph register`: laser profiles in images, before an adjustment and after it."""

from pathlib import Path

import click


@click.command(short_help="Register laser profiles with images.")
@click.argument("case", type=click.Path(path_type=Path))
@click.option("--out", type=click.Path(path_type=Path), required=True, help="Folder for the results; made anew.")
@click.option(
    "--solution", type=click.Path(path_type=Path), help="Results of `mgsgraph adjust` CASE: register after it as well."
)
@click.option(
    "--ties", type=click.Path(path_type=Path), metavar="NETWORK", help="Tie points in place of those that CASE names."
)
@click.option("--no-figures", is_flag=True, help="Write tables only.")
def register(case: Path, out: Path, solution: Path | None, ties: Path | None, no_figures: bool) -> None:
    """Project the footprints of CASE's laser profiles into its images, and compare the images at them.

    Writes registration.json, registration.csv (each shot in each image), discrepancy.csv (by how much two images
    contradict each other about each footprint) and figures with numbered footprints.
    """
    from mgsgraph.case.reading import read_case
    from mgsgraph.output.folders import REGISTRATION, require_replaceable
    from mgsgraph.registration.case import register_case, registration_statements
    from mgsgraph.registration.tables import write_registration
    from mgsgraph.reports.archive import read_solution

    require_replaceable(out, REGISTRATION)
    adjusted = None if solution is None else read_solution(solution)
    registration = register_case(read_case(case, ties=ties), adjusted)
    write_registration(registration, out, figures=not no_figures)
    for sentence in registration_statements(registration):
        click.echo(f"- {sentence}")
    click.echo(f"Results are in {out}")

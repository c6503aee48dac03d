"""`mgsgraph dem`: a terrain model from an adjustment and its images."""

from pathlib import Path

import click

_PATH = click.Path(path_type=Path)


@click.command(short_help="Make a terrain model with sigmas and an ortho image from adjusted images.")
@click.argument("solution", type=_PATH)
@click.option("--case", type=_PATH, help="Case that was adjusted, for its pixels. A demo's is found.")
@click.option("--out", type=_PATH, required=True, help="Folder for the results; made anew.")
@click.option("--post", type=float, metavar="M", help="Between posts of the terrain model; as the matches'.")
@click.option("--spacing", type=float, metavar="M", help="Between matches; five pixels of the ground grid.")
@click.option(
    "--heights", type=click.Choice(["sphere", "areoid"]), default="sphere", show_default=True, help="Above what."
)
@click.option(
    "--mola", type=_PATH, multiple=True, metavar="FILE", help="More laser shots to check by; repeatable."
)
@click.option("--ortho-pixel", type=float, metavar="M", help="Pixel of the ortho image; as the image's own.")
@click.option("--pair", metavar="A,B", help="Names of the two images to take; all that overlap when absent.")
@click.option("--workers", type=click.IntRange(1), help="Threads; one per processor when absent.")
@click.option("--no-figures", is_flag=True, help="Write rasters and tables only.")
def dem(
    solution: Path, case: Path | None, out: Path, post: float | None, spacing: float | None, heights: str,
    mola: tuple[Path, ...], ortho_pixel: float | None, pair: str | None, workers: int | None, no_figures: bool,
) -> None:
    """Match the images of SOLUTION (results of `mgsgraph adjust`, or a project) densely and write a terrain model.

    OUT then holds dem.tif (height, sigma, its parts by matching and by orientation, number of points), ortho.tif (an
    image laid on it), dem.json, shots.csv (heights against laser shots that took no part in the adjustment) and a
    figure.
    """
    from typing import cast

    from mgsgraph.cli.progress import counting_bars
    from mgsgraph.dem.dem import make_dem
    from mgsgraph.dem.files import dem_statements
    from mgsgraph.dem.model import DemSettings, Heights
    from mgsgraph.project.reading import read_posterior, results_of

    images = () if pair is None else tuple(name.strip() for name in pair.split(","))
    if pair is not None and (len(images) != 2 or len({*images, ""}) != 3):
        raise click.UsageError(f"--pair {pair}: two different names, with a comma between them")
    settings = DemSettings(post, spacing, cast(Heights, heights), ortho_pixel, images, mola)
    _, posterior, warning = read_posterior(solution)
    case = case or results_of(solution).case
    if case is None:
        raise click.UsageError("the pixels are the case's: give it by --case")
    with counting_bars() as show:
        made = make_dem(posterior, case, out, settings, workers, not no_figures, show)
    for sentence in [*([warning] if warning else []), *dem_statements(made)]:
        click.echo(f"- {sentence}")
    click.echo(f"The terrain model is {out / 'dem.tif'}")

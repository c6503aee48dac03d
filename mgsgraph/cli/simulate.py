"""`mgsgraph simulate`: files of a study site in the formats of the mission's archive, or of a campaign."""

from pathlib import Path

import click


@click.command(short_help="Simulate a study site, or a campaign.")
@click.argument("site")
@click.option("--out", type=click.Path(path_type=Path), required=True, help="Folder for the files; absent or empty.")
@click.option("--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Seed of everything drawn.")
@click.option("--attitude-time-bias", type=float, help="Seconds by which the nadir image's CK is off, instead of 0.7.")
@click.option("--no-pictures", is_flag=True, help="Images of one grey, which is enough for geometry.")
@click.option("--images", type=int, help="Of a strip: number of images, 2 to 500.  [default: 40]")
@click.option("--ties", type=int, help="Of a strip: new tie points with each further image.  [default: 2000]")
@click.option("--steps", is_flag=True, help="Of a strip: write what each image adds to those before it, too.")
def simulate(
    site: str,
    out: Path,
    seed: int,
    attitude_time_bias: float | None,
    no_pictures: bool,
    images: int | None,
    ties: int | None,
    steps: bool,
) -> None:
    """Simulate SITE and write its files to a folder.

    SITE is eos, gusev or isidis; pair: two images, small and synthetic; strip: overlapping pairs along one ground
    track; three-sites: the three study sites and a bridge image that holds them together, in one case.

    case.toml in it is what `mgsgraph adjust` and `mgsgraph register` take; truth.json says what they should find. An
    attitude time bias of 0.95 s makes the 325 m of the papers' text at Gusev.
    """
    from mgsgraph.cli.stages import stage_bar
    from mgsgraph.demo.simulate import simulation_options, strip_settings, write_simulation

    options = simulation_options(site, attitude_time_bias, not no_pictures)
    strip = strip_settings(site, images, ties, steps)
    with stage_bar(2) as stages:
        case = write_simulation(site, out, seed, options, strip, steps, stages)
    click.echo(f"The case is {case}; the truth lies beside it in truth.json")

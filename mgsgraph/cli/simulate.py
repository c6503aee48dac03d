"""`mgsgraph simulate`: files of a study site, in the formats of the mission's archive."""

from pathlib import Path

import click


@click.command(short_help="Simulate a study site.")
@click.argument("site")
@click.option("--out", type=click.Path(path_type=Path), required=True, help="Folder for the files; absent or empty.")
@click.option("--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Seed of everything drawn.")
@click.option("--attitude-time-bias", type=float, help="Seconds by which the nadir image's CK is off, instead of 0.7.")
@click.option("--no-pictures", is_flag=True, help="Images of one grey, which is enough for geometry.")
def simulate(site: str, out: Path, seed: int, attitude_time_bias: float | None, no_pictures: bool) -> None:
    """Simulate SITE (eos, gusev, isidis, or pair: small and synthetic) and write its files to a folder.

    case.toml in it is what `mgsgraph adjust` and `mgsgraph register` take; truth.json says what they should find. An
    attitude time bias of 0.95 s makes the 325 m of the papers' text at Gusev.
    """
    from mgsgraph.cli.stages import stage_bar
    from mgsgraph.products.demo import site_options, write_simulation

    options = site_options(site, attitude_time_bias, not no_pictures)
    with stage_bar(2) as stages:
        case = write_simulation(site, out, seed, options, stages)
    click.echo(f"The case is {case}; the truth lies beside it in truth.json")

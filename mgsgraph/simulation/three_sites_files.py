"""The three-site campaign as files: each site's own in a folder of its name, and one case over all of them."""

from pathlib import Path

from mgsgraph.simulation.files import image_file, json_text, network_text, support_data, write_texts
from mgsgraph.simulation.site_files import SHIFT, image_tables, profile_tables, write_site
from mgsgraph.simulation.three_sites import BRIDGE_PRIOR, SimulatedThreeSites
from mgsgraph.units import MRAD


def write_three_sites(simulated: SimulatedThreeSites, folder: Path) -> Path:
    """Write the campaign, its case file and its truth; returns the path of ``case.toml``.

    In ``eos``, ``gusev`` and ``isidis`` are the sites' files with cases of their own, which serve alone, too. The case
    over all leaves their terrain models out: it can have one grid, and no grid holds three sites.

    Parameters
    ----------
    simulated : SimulatedThreeSites
        As simulated.
    folder : Path
        Made when absent; files of the same names in it are replaced.

    Raises
    ------
    InputError
        If the folder can't be written.
    """
    for site in simulated.sites:
        write_site(site, folder / site.settings.name)
    truth = {
        "seed": simulated.seed,
        "sites": {site.settings.name: f"{site.settings.name}/truth.json" for site in simulated.sites},
        "coefficients": {simulated.bridge.name: simulated.true_bridge.coefficients.tolist()},
        "ties": dict(zip(simulated.ties.ids, simulated.true_ties.tolist(), strict=True)),
    }
    write_texts(folder, {
        image_file(simulated.bridge): json_text(support_data(simulated.bridge)),
        "network.pvl": network_text(simulated.ties, "three_sites", "Simulated sites and a bridge image"),
        "truth.json": json_text(truth),
        "case.toml": _case(simulated),
    })
    return folder / "case.toml"


def _case(simulated: SimulatedThreeSites) -> str:
    text = ["format = 1", 'name = "Eos, Gusev, Isidis and a bridge"']
    for site in simulated.sites:
        settings = site.settings
        text += image_tables(site, settings.angle_sigmas, settings.trend, f"{settings.name}/")
    bridge, prior = simulated.bridge, BRIDGE_PRIOR
    text += [
        "",
        "[[images]]",
        f'name = "{bridge.name}"',
        f'isd = "{image_file(bridge)}"',
        f"orientation = {{ position_sigma_m = {prior.position!r}, angle_sigma_mrad = {prior.angle / MRAD!r}, "
        f"trend = {list(prior.trend)} }}",
        "",
        "[ties]",
        'network = "network.pvl"',
    ]
    for site in simulated.sites:
        text += profile_tables(site, SHIFT, folder=f"{site.settings.name}/")
    return "\n".join([*text, ""])

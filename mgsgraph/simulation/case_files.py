"""The case files (case.toml) of what is simulated: which files there are, and the sigmas that an adjustment assumes."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import OrientationPrior
from mgsgraph.simulation.isis_files import image_file
from mgsgraph.simulation.mgs_files import grid_file, moc_file, pedr_file
from mgsgraph.simulation.observations import NoiseSettings
from mgsgraph.simulation.site import SimulatedSite
from mgsgraph.simulation.sites import SHIFT_SIGMA, SiteSettings
from mgsgraph.simulation.three_sites import BRIDGE_PRIOR, SimulatedThreeSites
from mgsgraph.simulation.world import World
from mgsgraph.units import ARCMIN, MRAD

_PAPERS_SIGMAS: dict[str, float] = {"range_sigma_m": 10.0, "ground_sigma_m": 10.0}
"""m, a-priori sigmas of ranges and footprints that Yoon & Shan (2005) take: ten times what is drawn."""
_IMAGE_SIGMA: dict[str, float] = {"eos": 40.0, "gusev": 22.0, "isidis": 30.0}
"""pixels, sigma of back-projected footprints with which the papers' Table 5 balances their residuals of ties
(`scripts/papers_balance.py`, which at Eos gives each image and coordinate its own); the text has "approximately 30"."""
_TREND, _EOS_TREND = (1.0, 0.02, 0.002), (1.0, 1.0, 1.0)
"""Factors of the orientation's sigmas for each power of u, which the papers leave open. RMSE of the refined positions
about their mean (Table 2) times sqrt(3), over 100 or 200 m: 0.007 to 0.04 at Gusev and Isidis, 3.8 in the right
image of Eos."""

Value = str | float | Sequence["str | float"] | dict[str, "Value"]
"""Of a key in a case file."""
Tables = list[str]
"""Lines of a case file."""


def campaign_case(name: str, images: Sequence[PushbroomImage], noise: NoiseSettings, world: World) -> str:
    """Case of simulated images beside network.pvl and lidar.json, with the sigmas of the simulation."""
    lines = [line for image in images for line in _table("[[images]]", name=image.name, isd=image_file(image))]
    lines += _table("[orientation]", degree=noise.prior.degree, **_orientation(noise))
    lines += _ties(world, noise.tie)
    lines += _table(
        "[laser]", file="lidar.json", image_sigma_px=float(noise.shot_image), range_sigma_m=float(noise.range),
        ground_sigma_m=float(noise.ground),
    )  # fmt: skip
    return _case(name, lines + _orbit(world))


def site_case(simulated: SimulatedSite) -> str:
    """The rigorous case: footprints with their profile's unknown shift, ties on the terrain model. All sigmas are those
    of which the errors are drawn.
    """
    settings, grid = simulated.settings, simulated.grid
    world, sigma = simulated.options.world, simulated.options.tie_noise
    lines = _images(simulated, settings) + _ties(world, sigma) + _profiles(simulated, "", **_drawn_sigmas(simulated))
    radius, topography = (f"{grid_file(simulated, kind)}.lbl" for kind in ("r", "t"))
    sigmas = {"vertical_sigma_m": grid.vertical_sigma or 0.0, "planimetric_sigma_m": grid.planimetric_sigma or 0.0}
    lines += _table("[terrain]", radius=radius, topography=topography, **sigmas)
    return _case(settings.title, lines + _orbit(world))


def papers_case(simulated: SimulatedSite) -> str:
    """The observations and weights of Yoon & Shan (2005), for reproduction: back-projected footprints, no shifts."""
    settings = simulated.settings
    trend = _EOS_TREND if settings.name == "eos" else _TREND
    lines = _images(simulated, replace(settings, angle_sigmas=(ARCMIN,) * 3, trend=trend))
    lines += _ties(simulated.options.world, simulated.options.tie_noise)
    sigmas = {**_PAPERS_SIGMAS, "image_sigma_px": _IMAGE_SIGMA[settings.name]}
    lines += _profiles(simulated, "", image_rows="back-projected", **sigmas)
    return _case(f"{settings.title}, papers", lines + _table("[solver]", line="measured", angles="opk-paper"))


def three_sites_case(simulated: SimulatedThreeSites) -> str:
    """Case over all three sites, whose files lie in folders of their names, and the bridge image."""
    lines, bridge = Tables(), simulated.bridge
    for site in simulated.sites:
        lines += _images(site, site.settings, f"{site.settings.name}/")
    lines += _table("[[images]]", name=bridge.name, isd=image_file(bridge), orientation=_orientation(BRIDGE_PRIOR))
    lines += _table("[ties]", network="network.pvl")
    for site in simulated.sites:
        lines += _profiles(site, f"{site.settings.name}/", **_drawn_sigmas(site))
    return _case("Eos, Gusev, Isidis and a bridge", lines)


def _images(simulated: SimulatedSite, settings: SiteSettings, folder: str = "") -> Tables:
    """The site's images with the a-priori sigmas of `settings`; their files lie in `folder` ("x/") beside the case."""
    lines, kernels = Tables(), [f"{folder}mgs.tm"]
    for image in simulated.images:
        label, orientation = folder + moc_file(image), _site_orientation(settings.prior(image.settings), settings.trend)
        lines += _table("[[images]]", name=image.settings.name, label=label, kernels=kernels, orientation=orientation)
    return lines


def _ties(world: World, sigma: float) -> Tables:
    """Ties, whose errors are as much in common as those of windows that overlap: as the world's are correlated."""
    window = round(world.window * float(np.sqrt(np.pi * world.matching)), 1)
    return _table("[ties]", network="network.pvl", sigma_px=float(sigma), **({"window_px": window} if window else {}))


def _orbit(world: World) -> Tables:
    """What the world's orbits have in common, where it is anything."""
    return _table("[[shared]]", kind="orbit position", sigma_m=world.orbit) if world.orbit else []


def _profiles(simulated: SimulatedSite, folder: str, **sigmas: Value) -> Tables:
    """The site's profiles, with further keys of each; their files lie in `folder` ("x/") beside the case."""
    lines, world = Tables(), simulated.options.world
    drawn: dict[str, Value] = {"beam_sigma_mrad": round(world.beam / MRAD, 6), "pulse_share": world.pulse}
    drawn |= {"drift_sigma_m": world.drift} if world.drift and "shift_sigma_m" in sigmas else {}
    for image in simulated.images:
        name = image.settings.name
        lines += _table("[[shots]]", file=folder + pedr_file(image), image=name, **drawn, **sigmas)
    return lines


def _drawn_sigmas(simulated: SimulatedSite) -> dict[str, Value]:
    """Sigmas of a profile from which its errors are drawn."""
    drawn = simulated.options
    return {
        "range_sigma_m": drawn.range_noise, "ground_sigma_m": drawn.footprint_noise,
        "height_sigma_m": drawn.height_noise, "shift_sigma_m": SHIFT_SIGMA,
    }  # fmt: skip


def _orientation(noise: NoiseSettings) -> dict[str, Value]:
    """A-priori sigmas of an image's orientation, as drawn from."""
    return {
        "position_sigma_m": float(noise.position), "angle_sigma_mrad": float(noise.angle / MRAD),
        "trend": [float(factor) for factor in noise.trend],
    }  # fmt: skip


def _site_orientation(prior: OrientationPrior, trend: tuple[float, ...]) -> dict[str, Value]:
    """Polynomials of order 2 as nominal orientation, and a-priori sigmas."""
    return {
        "nominal": "polynomial", "position_sigma_m": float(prior.sigmas[0, 0]),
        "angle_sigma_mrad": [round(angle / MRAD, 4) for angle in prior.sigmas[0, 3:].tolist()], "trend": list(trend),
    }  # fmt: skip


def _case(name: str, lines: Tables) -> str:
    return "\n".join(["format = 1", f'name = "{name}"', *lines, ""])


def _table(header: str, **values: Value) -> Tables:
    """A TOML table, after an empty line."""
    return ["", header, *(f"{key} = {_toml(value)}" for key, value in values.items())]


def _toml(value: Value) -> str:
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, dict):
        return f"{{ {', '.join(f'{key} = {_toml(inner)}' for key, inner in value.items())} }}"
    return repr(value) if isinstance(value, int | float) else f"[{', '.join(_toml(one) for one in value)}]"

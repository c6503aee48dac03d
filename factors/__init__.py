"""The measurement equations, and the GTSAM factors made of them: one measurement, one file.

    from mgsgraph import factors

    factors.pushbroom_projection    image coordinates of a ground point                     Yoon & Shan 2005, Eq. 1, 2
    factors.laser_range             range from the camera's place to a footprint            Eq. 3
    factors.ground_prior            a-priori position of a ground point                     Eq. 4
    factors.orientation_prior       a-priori sigmas of EO coefficients                      Eq. 4
    factors.terrain_height          height of a ground point above a terrain model          Ebner et al. 2004
    factors.stereo_height           height of a ground point above the surface of a stereo pair
    factors.linear_prior            whitened rows on several unknowns

Unknowns are Vectors (m, rad) and Point3 (m, body-fixed). What unknowns beyond an image's own polynomial do to a
measurement is an *effect*, an argument of these factors (`shared`, `moved`):

    factors.profile_shift           a laser profile, m east and north
    factors.boresight               rotation of a camera, rad
    factors.time_bias               an image's clock, s
    factors.range_bias              an altimeter's ranges, m
    factors.focal_length            m
    factors.OrientationImagesEffect orientation images of a pass                            Hofmann et al. 1984
    factors.constant, factors.PolynomialEffect      anything else

Installed as `mgsgraph.factors`; nothing named `factors` is ever installed at the top level. What runs the equations
over all points of a network is `mgsgraph.kernel`.
"""

from importlib import import_module
from typing import Any

_HOME = {
    "boresight": "effects",
    "constant": "effects",
    "Effect": "effects",
    "focal_length": "effects",
    "ground_prior": "ground",
    "laser_range": "ranging",
    "linear_prior": "priors",
    "orientation_polynomial": "effects",
    "orientation_prior": "priors",
    "OrientationImagesEffect": "effects",
    "PolynomialEffect": "effects",
    "profile_shift": "effects",
    "pushbroom_projection": "projection",
    "range_bias": "effects",
    "stereo_height": "stereo_surface",
    "terrain_height": "surface",
    "time_bias": "effects",
}
__all__ = sorted(_HOME)


def __getattr__(name: str) -> Any:
    """Import a public name on first use: the equations serve those who need no GTSAM, too."""
    if name not in _HOME:
        raise AttributeError(f"module 'mgsgraph.factors' has no attribute {name!r}; it has {', '.join(__all__)}")
    return getattr(import_module(f"mgsgraph.factors.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return __all__

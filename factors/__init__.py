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
from typing import TYPE_CHECKING, Any

from mgsgraph import modules_of_names

if TYPE_CHECKING:
    from mgsgraph.factors.effects import Effect as Effect
    from mgsgraph.factors.effects import OrientationImagesEffect as OrientationImagesEffect
    from mgsgraph.factors.effects import PolynomialEffect as PolynomialEffect
    from mgsgraph.factors.effects import boresight as boresight
    from mgsgraph.factors.effects import constant as constant
    from mgsgraph.factors.effects import focal_length as focal_length
    from mgsgraph.factors.effects import orientation_polynomial as orientation_polynomial
    from mgsgraph.factors.effects import profile_shift as profile_shift
    from mgsgraph.factors.effects import range_bias as range_bias
    from mgsgraph.factors.effects import time_bias as time_bias
    from mgsgraph.factors.ground import ground_prior as ground_prior
    from mgsgraph.factors.priors import linear_prior as linear_prior
    from mgsgraph.factors.priors import orientation_prior as orientation_prior
    from mgsgraph.factors.projection import pushbroom_projection as pushbroom_projection
    from mgsgraph.factors.ranging import laser_range as laser_range
    from mgsgraph.factors.stereo_surface import stereo_height as stereo_height
    from mgsgraph.factors.surface import terrain_height as terrain_height

_HOME = modules_of_names(__file__)
__all__ = sorted(_HOME)


def __getattr__(name: str) -> Any:
    """Import a public name on first use: the equations serve those who need no GTSAM, too."""
    if name not in _HOME:
        raise AttributeError(f"module 'mgsgraph.factors' has no attribute {name!r}; it has {', '.join(__all__)}")
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    return __all__

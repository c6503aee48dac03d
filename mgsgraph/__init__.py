"""Factor-graph bundle adjustment of planetary pushbroom images and laser altimetry.

>>> import mgsgraph
>>> solution = mgsgraph.adjust(mgsgraph.read_case("case.toml"))  # doctest: +SKIP
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mgsgraph.adjustment.adjust import Adjustment as Adjustment
    from mgsgraph.adjustment.adjust import adjust_network as adjust_network
    from mgsgraph.adjustment.settings import SolverSettings as SolverSettings
    from mgsgraph.adjustment.solution import Solution as Solution
    from mgsgraph.adjustment.solution import orientation_profile as orientation_profile
    from mgsgraph.analysis.posterior import Pixel as Pixel
    from mgsgraph.analysis.posterior import Posterior as Posterior
    from mgsgraph.case.reading import Case as Case
    from mgsgraph.case.reading import adjust as adjust
    from mgsgraph.case.reading import read_case as read_case
    from mgsgraph.case.scene import read_scene as read_scene
    from mgsgraph.dem.model import DemSettings as DemSettings
    from mgsgraph.dem.production import make_dem as make_dem
    from mgsgraph.errors import InputError as InputError
    from mgsgraph.errors import MgsgraphError as MgsgraphError
    from mgsgraph.export.exchange import convert as convert
    from mgsgraph.export.exchange_setting import ExchangeSetting as ExchangeSetting
    from mgsgraph.export.solution_export import export_solution as export_solution
    from mgsgraph.fetch.archives import Archives as Archives
    from mgsgraph.fetch.folder import fetch_images as fetch_images
    from mgsgraph.geometry.altimetry import LaserProfile as LaserProfile
    from mgsgraph.geometry.orientation import OrientationPrior as OrientationPrior
    from mgsgraph.incremental.impact import Impact as Impact
    from mgsgraph.incremental.incremental import IncrementalAdjustment as IncrementalAdjustment
    from mgsgraph.matching.files import match_into as match_into
    from mgsgraph.matching.settings import MatchSettings as MatchSettings
    from mgsgraph.network import Network as Network
    from mgsgraph.network.parts import KnownImage as KnownImage
    from mgsgraph.registration.relief import register_by_relief as register_by_relief
    from mgsgraph.registration.relief_files import write_coregistration as write_coregistration
    from mgsgraph.registration.relief_records import ReliefSettings as ReliefSettings
    from mgsgraph.reports.archive import read_solution as read_solution
    from mgsgraph.reports.page import write_report as write_report
    from mgsgraph.reports.results import write_results as write_results
    from mgsgraph.ties import TiePoints as TiePoints

_HOME = {
    "adjust": "mgsgraph.case.reading",
    "adjust_network": "mgsgraph.adjustment.adjust",
    "Adjustment": "mgsgraph.adjustment.adjust",
    "Archives": "mgsgraph.fetch.archives",
    "Case": "mgsgraph.case.reading",
    "convert": "mgsgraph.export.exchange",
    "DemSettings": "mgsgraph.dem.model",
    "export_solution": "mgsgraph.export.solution_export",
    "ExchangeSetting": "mgsgraph.export.exchange_setting",
    "fetch_images": "mgsgraph.fetch.folder",
    "Impact": "mgsgraph.incremental.impact",
    "IncrementalAdjustment": "mgsgraph.incremental.incremental",
    "InputError": "mgsgraph.errors",
    "KnownImage": "mgsgraph.network.parts",
    "LaserProfile": "mgsgraph.geometry.altimetry",
    "make_dem": "mgsgraph.dem.production",
    "match_into": "mgsgraph.matching.files",
    "MatchSettings": "mgsgraph.matching.settings",
    "MgsgraphError": "mgsgraph.errors",
    "Network": "mgsgraph.network",
    "orientation_profile": "mgsgraph.adjustment.solution",
    "OrientationPrior": "mgsgraph.geometry.orientation",
    "Pixel": "mgsgraph.analysis.posterior",
    "Posterior": "mgsgraph.analysis.posterior",
    "read_case": "mgsgraph.case.reading",
    "read_scene": "mgsgraph.case.scene",
    "read_solution": "mgsgraph.reports.archive",
    "register_by_relief": "mgsgraph.registration.relief",
    "ReliefSettings": "mgsgraph.registration.relief_records",
    "Solution": "mgsgraph.adjustment.solution",
    "SolverSettings": "mgsgraph.adjustment.settings",
    "TiePoints": "mgsgraph.ties",
    "write_coregistration": "mgsgraph.registration.relief_files",
    "write_report": "mgsgraph.reports.page",
    "write_results": "mgsgraph.reports.results",
}
__all__ = sorted(_HOME)


def __getattr__(name: str) -> Any:
    """Import a public name on first use: `mgsgraph --help` must not wait for numba and GTSAM."""
    if name not in _HOME:
        raise AttributeError(f"module 'mgsgraph' has no attribute {name!r}; it has {', '.join(__all__)}")
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    return __all__

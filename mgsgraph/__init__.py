"""Bundle adjustment of planetary pushbroom images and laser altimetry, as a factor graph.

A case file names the images, their orientation and what was observed; the adjustment refines orientation and ground
points together, with sigmas; the solution answers questions and is written, mapped and exported:

    import mgsgraph

    case = mgsgraph.read_case("case.toml")
    solution = mgsgraph.adjust(case)
    print(solution)                                # cost, sigma0, degrees of freedom
    solution.places, solution.sigmas               # (n, 3) of the ground points, m
    posterior = mgsgraph.Posterior.of(solution)
    print(posterior.difference("T17", "T42"))      # is the height difference real?
    mgsgraph.write_results(solution, "RESULT")     # tables, figures, archive

Images, points, passes and unknowns are asked for by their names, or by their numbers in the network. Every record shows
itself: `print(record)`, and in a notebook a table of its fields with their units.

Data from the archives
    fetch_images            images, kernels, laser shots and terrain by product ids, with a case file
    Archives                where the archives are

Cases and their adjustment
    read_case               a case file and all that it names
    Case                    what was read: a network, settings
    adjust                  adjusts a case
    adjust_network          adjusts a network, on a cluster, too
    open_cluster            a cluster for adjust_network
    SolverSettings          line, loss, rejection of blunders, tolerances

The factor graph, in GTSAM's hands
    factor_graph            a case or a solution as a graph, values and keys by name
    factors                 its factors one by one: pushbroom_projection, laser_range, ground_prior ...
    optimize                Levenberg-Marquardt over any graph, in time about linear in the number of factors
    Marginals               covariances of any variables, whatever their units
    solution_of             what any optimizer found, as a Solution
    with_factors            a network with factors of your own on its shared unknowns, for adjust

The solution and its covariance
    Solution                orientation, points, residuals, covariances
    orientation_profile     exterior orientation of an image along its lines: before, after, sigmas
    Posterior               covariance of any point, pose, pair, projection or new intersection
    Pixel                   an image point for Posterior.intersection
    sigma_grid              sigmas of new points all over the overlap of images

Checks of a solution
    verdict                 whether it may be used: what was tested, what was not, what could hide
    reliability             Baarda's w-tests, minimal detectable blunders, external reliability
    MeasureKind             kind of a measurement in these: ray, range, prior ...
    components              variance components: are the a-priori sigmas right?
    iterated_components     the same, repeated until the sigmas fit the residuals
    weak_directions         the least-constrained directions of the orientation
    unexplained             what residuals show and the adjustment has no unknown for
    pass_reports            nodes, corrections and sigmas of each pass
    compare                 two solutions: what moved, by how many sigmas

What to observe next
    ImageCoverage           what the images of a network show of the ground
    planned_point           a control or tie point that might be measured
    plan                    ranks candidates by what they do to the sigmas

Image by image
    IncrementalAdjustment   images and measures added and removed (iSAM2)
    Impact                  what a change has moved
    create_project          a project: a folder with a database that keeps images and changes
    open_project            opens it, for one change or for reading
    solve_project           adjusts all of it, with results
    remove_images           takes images out of it

What goes in
    Network                 images, points, rays, ranges with their sigmas
    build_network           a network from images and their observations
    select_points           some points of a network with their measurements
    KnownImage              an image with what is known of it beforehand
    PushbroomImage          an image: camera, times of its lines, trajectory
    InteriorOrientation     its camera
    LineTiming              times of its lines
    OrientationPrior        a-priori sigmas of its orientation
    TiePoints               tie and control points with their measures
    LaserProfile            shots of an altimeter with their ranges
    read_shots              shots of an altimeter from PEDR, RDR, CSV ...
    read_altimetry_cloud    their ground returns as points
    footprints_in_images    which image sees which shot
    points_in_images        which image sees which ground point

Tie points from the images
    read_scene              the images' pixels and geometry
    MatchSettings           how to match
    match_into              matches them; writes a control network
    read_verdicts           verdicts about tie points, as the studio writes them
    apply_verdicts          the tie points without the rejected ones

Products
    write_results           tables, figures, archive of a solution
    read_solution           a solution from its folder
    write_report            one page to look at and hand on
    draw_figures            figures of a solution, for matplotlib
    register_by_relief      laser, terrain model and images onto each other by relief
    ReliefSettings          how far to search for that
    write_coregistration    writes it
    make_dem                terrain model with sigmas, ortho image, check by laser shots
    DemSettings             grid and matching of that
    export_solution         SPICE, CSM, ISIS, ASP, GIS
    write_spice             SPICE kernels with ids of the mission
    SpiceNaming             ids of the mission, and its clock
    NaifIds                 those of an image
    ExportSettings          how
    to_pandas               a table of a solution as a DataFrame
    to_geopandas            the same with shapes
    to_xarray               orientation of all images as a Dataset
    convert                 control networks from one format to another
    ExchangeSetting         how

Simulated images with known truth: `mgsgraph.simulation` (simulate_pair, write_pair, simulate_strip, simulate_site ...).

Errors
    InputError              bad input, in one line: where, what was found, what was expected, what to do
    MgsgraphError           all errors that the program raises

Units are SI: m, rad, s TDB past J2000; places are body-fixed, matrices turn body-fixed components to the camera's,
pixels begin at the image's edge: the first one's centre is (0.5, 0.5). Residuals are measured minus predicted. Sigmas
are for sigma0 = 1, as the a-priori sigmas imply. All of it with examples: docs/api.md; the commands: `mgsgraph --help`.
"""

import re
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    __version__: str
    from mgsgraph.adjustment.adjust import adjust_network as adjust_network
    from mgsgraph.adjustment.cluster.connection import open_cluster as open_cluster
    from mgsgraph.adjustment.factor_graph import factor_graph as factor_graph
    from mgsgraph.adjustment.factor_graph import with_factors as with_factors
    from mgsgraph.adjustment.incremental.impact import Impact as Impact
    from mgsgraph.adjustment.incremental.incremental import IncrementalAdjustment as IncrementalAdjustment
    from mgsgraph.adjustment.optimize import Marginals as Marginals
    from mgsgraph.adjustment.optimize import optimize as optimize
    from mgsgraph.adjustment.optimized import solution_of as solution_of
    from mgsgraph.adjustment.settings import SolverSettings as SolverSettings
    from mgsgraph.adjustment.solution import Solution as Solution
    from mgsgraph.adjustment.solution import orientation_profile as orientation_profile
    from mgsgraph.analysis.components import components as components
    from mgsgraph.analysis.components import iterated_components as iterated_components
    from mgsgraph.analysis.measures import MeasureKind as MeasureKind
    from mgsgraph.analysis.places import sigma_grid as sigma_grid
    from mgsgraph.analysis.posterior import Pixel as Pixel
    from mgsgraph.analysis.posterior import Posterior as Posterior
    from mgsgraph.analysis.reliability import reliability as reliability
    from mgsgraph.analysis.statistics import pass_reports as pass_reports
    from mgsgraph.analysis.unexplained import unexplained as unexplained
    from mgsgraph.analysis.verdict import verdict as verdict
    from mgsgraph.analysis.weak import weak_directions as weak_directions
    from mgsgraph.case.reading import Case as Case
    from mgsgraph.case.reading import adjust as adjust
    from mgsgraph.case.reading import read_case as read_case
    from mgsgraph.case.scene import read_scene as read_scene
    from mgsgraph.errors import InputError as InputError
    from mgsgraph.errors import MgsgraphError as MgsgraphError
    from mgsgraph.export.exchange import convert as convert
    from mgsgraph.export.exchange_setting import ExchangeSetting as ExchangeSetting
    from mgsgraph.export.frames import to_geopandas as to_geopandas
    from mgsgraph.export.frames import to_pandas as to_pandas
    from mgsgraph.export.frames import to_xarray as to_xarray
    from mgsgraph.export.solution_export import ExportSettings as ExportSettings
    from mgsgraph.export.solution_export import export_solution as export_solution
    from mgsgraph.export.spice import NaifIds as NaifIds
    from mgsgraph.export.spice import SpiceNaming as SpiceNaming
    from mgsgraph.export.spice import write_spice as write_spice
    from mgsgraph.export.verdicts import apply_verdicts as apply_verdicts
    from mgsgraph.export.verdicts import read_verdicts as read_verdicts
    from mgsgraph.fetch.folder import fetch_images as fetch_images
    from mgsgraph.fetch.needs import Archives as Archives
    from mgsgraph.files.altimetry.shots import read_altimetry_cloud as read_altimetry_cloud
    from mgsgraph.files.altimetry.shots import read_shots as read_shots
    from mgsgraph.files.networks.tie_points import TiePoints as TiePoints
    from mgsgraph.geometry.altimetry import LaserProfile as LaserProfile
    from mgsgraph.geometry.camera import InteriorOrientation as InteriorOrientation
    from mgsgraph.geometry.image import LineTiming as LineTiming
    from mgsgraph.geometry.image import PushbroomImage as PushbroomImage
    from mgsgraph.geometry.orientation import OrientationPrior as OrientationPrior
    from mgsgraph.matching.settings import MatchSettings as MatchSettings
    from mgsgraph.network import Network as Network
    from mgsgraph.network.footprints import footprints_in_images as footprints_in_images
    from mgsgraph.network.footprints import points_in_images as points_in_images
    from mgsgraph.network.observations import build_network as build_network
    from mgsgraph.network.parts import KnownImage as KnownImage
    from mgsgraph.network.parts import select_points as select_points
    from mgsgraph.planning.candidates import planned_point as planned_point
    from mgsgraph.planning.coverage import ImageCoverage as ImageCoverage
    from mgsgraph.planning.plan import plan as plan
    from mgsgraph.project.changes import create_project as create_project
    from mgsgraph.project.changes import remove_images as remove_images
    from mgsgraph.project.changes import solve_project as solve_project
    from mgsgraph.project.project import open_project as open_project
    from mgsgraph.registration.dem.model import DemSettings as DemSettings
    from mgsgraph.registration.minima import ReliefSettings as ReliefSettings
    from mgsgraph.registration.relief import register_by_relief as register_by_relief
    from mgsgraph.results.archive import read_solution as read_solution
    from mgsgraph.results.comparison import compare as compare
    from mgsgraph.results.figures import draw_figures as draw_figures
    from mgsgraph.results.matching import match_into as match_into
    from mgsgraph.results.page import write_report as write_report
    from mgsgraph.results.relief import write_coregistration as write_coregistration
    from mgsgraph.results.results import write_results as write_results
    from mgsgraph.results.terrain_model import make_dem as make_dem


def modules_of_names(file: str) -> dict[str, str]:
    """Which module each name comes from that a package's file imports for type checkers alone, as this one does."""
    text = Path(file).read_text(encoding="utf-8")
    return {name: module for module, name in re.findall(r"^    from (\S+) import (\w+) as ", text, re.MULTILINE)}


_HOME = modules_of_names(__file__)
__all__ = sorted(_HOME)


def __getattr__(name: str) -> Any:
    """Import a public name on first use: `mgsgraph --help` must not wait for numba and GTSAM."""
    if name == "__version__":
        return import_module("importlib.metadata").version("mgsgraph")
    if name in {"factors", "simulation"}:
        return import_module(f"mgsgraph.{name}")
    if name not in _HOME:
        raise AttributeError(f"module 'mgsgraph' has no attribute {name!r}; it has {', '.join(__all__)}")
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    return __all__

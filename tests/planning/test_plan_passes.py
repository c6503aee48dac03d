"""Images planned over a strip whose images share a trajectory: promised against had."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.geometry.orientation import OrientationPrior
from mgsgraph.geometry.records import Array
from mgsgraph.network import Network
from mgsgraph.network.joining import definitions
from mgsgraph.network.parts import KnownImage, known_images, with_images, without_images
from mgsgraph.planning.candidates import PlannedTies, planned_image
from mgsgraph.planning.coverage import ImageCoverage
from mgsgraph.planning.plan import TargetSigmas, plan, targets_of
from mgsgraph.planning.state import CurrentState, added, correction_of, state_of_solution, together, updated
from mgsgraph.simulation.hrsc_block import BlockSettings, TrajectoryErrors, simulate_hrsc_block
from mgsgraph.units import MGON

AS_PROMISED = 0.01
LATE = "HRSC/00/S2"
"""The last one of the strip."""


@cache
def strip() -> Network:
    """One strip of a trajectory that is known well but for what changes on the way."""
    errors = TrajectoryErrors(attitude=1.0 * MGON, attitude_drift=0.5 * MGON, position=2.0, position_drift=1.0)
    settings = BlockSettings(strips=1, length=80e3, points=300, terrain=None, spacing=5.0, errors=errors)
    return simulate_hrsc_block(settings, seed=2).network


@cache
def coverage() -> ImageCoverage:
    """The strip without its last image."""
    left = without_images(strip(), {LATE})
    assert left is not None
    assert left.passes
    return ImageCoverage(state_of_solution(adjust_network(left, SolverSettings())))


def late() -> KnownImage:
    """The image that is missing, with an orientation of its own."""
    known = next(one for one in known_images(strip()) if one.image.name == LATE)
    return replace(known, prior=OrientationPrior(np.array([[2.0] * 3 + [2e-5] * 3])))


def measured(planned: Network) -> Network:
    """Planned measures as the orientation that is expected gives them, without noise."""
    state, places = coverage().state, planned.rays.places.copy()
    known = definitions(state.network)
    for j, one in enumerate(known_images(planned)):
        mine = planned.rays.image == j
        correction = correction_of(one, state.settings, state.values, known.of([one.image.name]))
        places[mine], _ = one.image.ground_to_image(planned.points.places[planned.rays.point[mine]], correction)
    return replace(planned, rays=replace(planned.rays, places=places))


def sigmas_of(network: Network, names: tuple[str, ...]) -> Array:
    """(n,) m of points, roots of the traces of their covariances, adjusted."""
    solution = adjust_network(network, SolverSettings())
    place = {name: i for i, name in enumerate(network.points.ids)}
    return np.sqrt(np.trace(solution.covariances[[place[name] for name in names]], axis1=1, axis2=2))


@pytest.mark.parametrize("existing", [False, True])
def test_an_image_over_a_strip_brings_what_was_promised(existing: bool) -> None:
    known = late()
    chosen = planned_image(coverage(), known, PlannedTies(12, sigma=0.3, existing=existing))
    assert chosen.addition is not None
    state = coverage().state
    present, targets = CurrentState(state), targets_of(state, ["all"])
    update = updated(present, added(present, [chosen.addition]))
    promised = TargetSigmas(present, targets).after(update)[:, 0]

    whole = with_images(together([state.network, measured(chosen.addition)]), [*known_images(state.network), known])
    had = sigmas_of(whole, targets.points)
    assert promised == pytest.approx(had, rel=AS_PROMISED)
    before = TargetSigmas(present, targets).before()[:, 0]
    large = had < 0.97 * before
    assert np.count_nonzero(large) > 10  # else nothing was promised
    assert (before - promised)[large] == pytest.approx((before - had)[large], rel=AS_PROMISED)


def test_it_is_ranked_and_an_image_is_a_target() -> None:
    chosen = planned_image(coverage(), late(), PlannedTies(12, sigma=0.3))
    found = plan(coverage().state, [chosen], 1)
    assert [one.name for one in found.chosen] == [LATE]
    assert found.drop > 0.0
    name = coverage().network.images[0].name
    ground = plan(coverage().state, [chosen], 1, [name])
    assert 0.0 < ground.after.total < ground.now.total

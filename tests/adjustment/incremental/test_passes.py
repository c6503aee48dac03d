"""Images of passes come and go: after every change the incremental result is batch's, on a trajectory that is continued
and shortened with them; so it is of shots on stereo surfaces.
"""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from increments import by_image
from mex_block import BlockSettings, simulate_hrsc_block
from nac_pair import NacSettings, PassErrors, simulate_nac_pair
from networks import pair
from outside import refuses
from stereo_pair import stereo_network

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.incremental.impact import EXACT, differences_from_batch
from mgsgraph.adjustment.incremental.incremental import IncrementalAdjustment
from mgsgraph.adjustment.incremental.state import InMemory
from mgsgraph.adjustment.incremental.sweep import Sweep
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.adjustment.solution import Solution
from mgsgraph.errors import InputError
from mgsgraph.geometry.image import LineTiming, PushbroomImage
from mgsgraph.geometry.orientation import evenly_spaced
from mgsgraph.geometry.records import Index
from mgsgraph.network import Network
from mgsgraph.network.parts import pass_unknowns, select_points, without_images
from mgsgraph.project.project import Project, open_project
from mgsgraph.project.settings import ProjectSettings

WITHIN = 0.01
"""Sigmas by which the two may differ, as for images with an orientation of their own."""


def segment(image: PushbroomImage, name: str, first: int, stop: int) -> PushbroomImage:
    """Lines `first` to `stop` (exclusive) of an image as an image of their own."""
    timing = image.timing
    later = np.flatnonzero((timing.first_lines > first) & (timing.first_lines < stop))
    start, period = timing.at(np.array([float(first)]))
    cut = LineTiming(
        np.append(0.0, timing.first_lines[later] - first), np.append(start, timing.start_times[later]),
        np.append(period, timing.periods[later]),
    )  # fmt: skip
    return replace(image, name=name, lines=stop - first, timing=cut)


def in_segments(network: Network, count: int) -> Network:
    """A simulated block with every image cut into `count` segments of equal length, NAME/1 to NAME/count, in which its
    rays fall.
    """
    images, edges = list[PushbroomImage](), list[Index]()
    for image in network.images:
        edge = np.linspace(0, image.lines, count + 1).astype(np.int64)
        edges.append(edge)
        cut = zip(edge[:-1].tolist(), edge[1:].tolist(), strict=True)
        images += [segment(image, f"{image.name}/{k + 1}", first, stop) for k, (first, stop) in enumerate(cut)]
    rays, table = network.rays, np.array(edges)[network.rays.image]
    inner = np.clip(np.sum(rays.places[:, :1] >= table, axis=1) - 1, 0, count - 1)
    places = rays.places - np.column_stack([table[np.arange(inner.size), inner], np.zeros(inner.size)])
    passes = tuple(
        replace(pass_, images=(pass_.images[:, None] * count + np.arange(count)).ravel()) for pass_ in network.passes
    )
    return replace(
        network, images=tuple(images), priors=tuple(prior for prior in network.priors for _ in range(count)),
        held=np.repeat(network.held, count),
        rays=replace(rays, image=rays.image * count + inner, places=places), passes=passes,
    )  # fmt: skip


@cache
def hrsc_passes(spacing: float = 10.0) -> Network:
    """Two HRSC passes, each line cut into two images."""
    settings = BlockSettings(passes=2, length=60e3, points=240, terrain=None, spacing=spacing)
    return in_segments(simulate_hrsc_block(settings, seed=4).network, 2)


@cache
def rig() -> Network:
    """Two passes of NAC-L and NAC-R, with R's boresight as shared unknown, and shots; no degree of a polynomial is
    held: batch squares the tight rows that do so.
    """
    errors = PassErrors((30.0, 10.0, 3.0, 1.0), (1.5e-4, 5e-5, 2e-5, 1e-5))
    return simulate_nac_pair(NacSettings(ties=60, beside=10, shots=6, errors=errors), 3).network


def parts(network: Network) -> dict[str, Network]:
    """What each image sees by itself."""
    return dict(sorted((one.images[0].name, one) for one in by_image(network)))


def first_grid(one: Network) -> Network:
    """The same, its pass with nodes over the lines of its image alone, as a case of that image would have it."""
    (own,) = one.passes
    image = one.images[0]
    edges = image.timing.at(np.array([0.0, float(image.lines)]))[0] + image.trajectory.epoch - own.nodes.epoch
    nodes = evenly_spaced(own.nodes.basis, own.nodes.epoch, (float(edges[0]), float(edges[1])), own.nodes.spacing)
    return replace(one, passes=(replace(own, nodes=nodes),))


def off(adjustment: IncrementalAdjustment, batch: Solution) -> tuple[float, float]:
    """Largest difference to batch of an unknown or a place, in its sigma, and of a covariance, as a share of itself."""
    network, stored = adjustment._as_network()
    assert network.points.ids == batch.network.points.ids
    values = adjustment.values
    places = Sweep(network, adjustment.settings, stored).places(values)
    shares, named = [0.0], adjustment.store.definitions().passes
    for k, one in enumerate(batch.network.passes):
        mine = [adjustment.joint([node]) for node in pass_unknowns(named[one.name])]
        first = int(batch.network.first_of_passes[k])
        for node in range(len(one.nodes)):
            theirs = batch.joint_covariance.block(first + node, first + node)
            sigmas = np.sqrt(np.diag(theirs))
            shares.append(np.max(np.abs(mine[node] - theirs) / np.outer(sigmas, sigmas)))
    _, _, covariances = adjustment.points(batch.network.points.ids)
    free = batch.determined & (batch.sigmas[:, 0] > 0.0)
    largest = np.max(batch.sigmas[free] ** 2, axis=1)[:, None, None]
    shares.append(np.max(np.abs(covariances[free] - batch.covariances[free]) / largest, initial=0.0))
    return differences_from_batch(batch, values, places).worst, float(max(shares))


def by_batch(adjustment: IncrementalAdjustment) -> Solution:
    return adjust_network(adjustment.network, adjustment.settings)


# above two seconds: ten images one by one, of nodes that are continued
def test_a_strip_grows_image_by_image() -> None:
    """From its first image, whose nodes are continued over the others' lines; what is there keeps its times."""
    adjustment, nodes, times = IncrementalAdjustment(), list[int](), np.zeros(0)
    every = parts(hrsc_passes())
    for name in [name for name in every if name.startswith("HRSC/00")]:
        impact = adjustment.add(first_grid(every[name]))
        assert impact.converged
        now = adjustment.store.definitions().passes["HRSC/00"].nodes
        assert set(times) <= set(now.times.tolist())
        assert np.ptp(np.diff(now.times)) < 1e-9
        times = now.times
        nodes.append(times.size)
    assert nodes[-1] > nodes[0]
    found = off(adjustment, by_batch(adjustment))
    assert found[0] < WITHIN, found
    assert found[1] < 1e-3, found


# above two seconds: fourteen changes of a block of passes
def test_any_order_of_additions_and_removals_ends_at_batch() -> None:
    rng = np.random.default_rng(8)
    every, adjustment, there = parts(hrsc_passes()), IncrementalAdjustment(), set[str]()
    names = [name for k, name in enumerate(every) if k % 4 in (0, 3)]  # now the first half of a line, now the second
    for name in [*rng.permutation(names), *rng.permutation(names)[:4]]:
        if name in there:
            adjustment.remove(name)
        else:
            adjustment.add(every[name])
        there ^= {name}
    assert set(adjustment.images) == there
    found = off(adjustment, by_batch(adjustment))
    assert found[0] < WITHIN, found
    assert found[1] < 1e-3, found


def test_a_rig_with_a_shared_boresight_comes_and_goes() -> None:
    """NAC-L and -R of two passes: R of the second pass shares the boresight of the first one's."""
    every, adjustment = parts(rig()), IncrementalAdjustment()
    names = [image.name for image in rig().images]
    for name in (names[2], names[1], names[0], names[3]):
        adjustment.add(every[name])
    adjustment.remove(names[1])
    adjustment.add(every[names[1]])
    batch = adjust_network(rig(), SolverSettings())
    assert len(batch.shared) == 1
    found = off(adjustment, by_batch(adjustment))
    assert found[0] < WITHIN, found
    assert found[1] < 1e-3, found
    adjustment.remove(names[1], names[3])
    assert not adjustment.store.definitions().shared
    assert {unknown.kind for unknown in adjustment.values} <= {"node", "trend", "shift"}


def test_nodes_that_no_image_needs_go() -> None:
    every, adjustment = parts(hrsc_passes(spacing=4.0)), IncrementalAdjustment()
    mine = [name for name in every if name.startswith("HRSC/00")]
    late = [name for name in mine if name.endswith("/2")]
    for name in mine:
        adjustment.add(every[name])
    before = adjustment.store.definitions().passes["HRSC/00"].nodes
    adjustment.remove(*late)
    after = adjustment.store.definitions().passes["HRSC/00"].nodes
    assert set(after.times.tolist()) < set(before.times.tolist())
    assert after.span == before.trend_span
    names = {unknown.name for unknown in adjustment.values if unknown.kind == "node"}
    assert names == {f"HRSC/00 at {time!r} s" for time in after.times.tolist()}
    adjustment.remove(*(set(mine) - set(late)))
    assert not adjustment.values
    assert not adjustment.store.definitions().passes


def test_it_goes_on_from_batch_and_from_its_store() -> None:
    """Both ways of beginning: the tree is grown from reduced systems and the rows of the priors."""
    every, store = parts(hrsc_passes()), InMemory()
    names = list(every)
    solution = adjust_network(without_images(hrsc_passes(), {names[-1]}), SolverSettings())  # type: ignore[arg-type]
    IncrementalAdjustment.of(solution, store)
    again = IncrementalAdjustment(store=store)
    again.add(every[names[-1]])
    found = off(again, by_batch(again))
    assert found[0] < WITHIN, found
    assert found[1] < 1e-3, found


# --- bad input


def test_what_contradicts_a_pass_is_one_line_and_changes_nothing() -> None:
    every, adjustment = parts(rig()), IncrementalAdjustment()
    left, right = (every[image.name] for image in rig().images[:2])
    adjustment.add(left)
    before = adjustment.values

    def refused(network: Network, said: str) -> None:
        refuses(said, adjustment.add, network)
        assert adjustment.images == [left.images[0].name]
        assert set(adjustment.values) == set(before)

    image = right.images[0]
    trajectory = image.trajectory
    late = replace(image, trajectory=replace(trajectory, epoch=trajectory.epoch + 7200.0))
    nodes = replace(right.passes[0].nodes, epoch=right.passes[0].nodes.epoch + 7200.0)
    refused(replace(right, images=(late,), passes=(replace(right.passes[0], nodes=nodes),)), "minutes apart")
    again = replace(left, passes=(replace(left.passes[0], name="another"),))
    refused(again, "an image that is there already")
    refuses("it is held", replace, right, held=np.array([True]))
    other = replace(right.shared[0], sigmas=2.0 * right.shared[0].sigmas)
    adjustment.add(right)
    with pytest.raises(InputError, match="sigmas in one part other than in another"):
        adjustment.add(replace(every[rig().images[3].name], shared=(other,)))


# --- shots on stereo surfaces: kept, made anew as the orientation moves

LATER = np.arange(6, 18)
"""Ties that come later."""


def begun() -> tuple[Network, Network]:
    """A network of shots on a stereo surface, one a blunder, one as on level ground; and ties that come later."""
    net = stereo_network(pair(24, 24))
    sooner = np.setdiff1d(np.arange(len(net.points)), LATER)
    first = select_points(net, sooner)
    assert first.stereo is not None
    blunder, level = (np.arange(len(first.points)) == len(first.points) - k for k in (3, 5))
    return replace(first, stereo=replace(first.stereo, rejected=blunder, level=level)), select_points(net, LATER)


def test_ties_that_come_later_move_the_surface_as_batch_does(tmp_path: Path) -> None:
    """In a project's file, from which everything is read again; `EXACT` sigmas, so that batch's isn't taken over."""
    first, more = begun()
    with Project.create(tmp_path / "one", "one", ProjectSettings()) as project:
        IncrementalAdjustment(store=project.store).adopt(adjust_network(first, SolverSettings()))
    with open_project(tmp_path / "one", write=True) as project:
        kept = project.store.network()
        assert kept.stereo is not None
        assert first.stereo is not None
        number = {name: i for i, name in enumerate(kept.points.ids)}
        order = [number[name] for name in first.points.ids]
        assert np.array_equal(kept.stereo.surface[order], first.stereo.surface)
        assert np.array_equal(kept.stereo.sigmas[order], first.stereo.sigmas)
        assert np.array_equal(kept.stereo.level[order], first.stereo.level)
        assert np.array_equal(kept.stereo.surfaces[0].places, first.stereo.surfaces[0].places)
        adjustment = IncrementalAdjustment(store=project.store)
        moved = adjustment.add(more)
        assert moved.converged
        assert moved.updates > 1  # systems were made anew
        closed, solution = adjustment.verify()
        assert closed.worst < EXACT
        assert not closed.adopted
        assert solution.stereo_used.sum() == 24
        adjustment.remove(first.images[1].name)
        for table in ("grid WHERE first IS NOT NULL", "packed WHERE kind = 'heights'"):
            assert project._connection.execute(f"SELECT count(*) FROM {table}").fetchone() == (0,)
        assert project._connection.execute("PRAGMA foreign_key_check").fetchall() == []


def test_heights_that_batch_rejected_stay_out() -> None:
    first, _ = begun()
    solution = adjust_network(first, SolverSettings())
    assert first.stereo is not None
    out = first.stereo.rejected
    rejected = IncrementalAdjustment.of(replace(solution, stereo_rejected=out))
    network = rejected.network
    assert network.stereo is not None
    assert np.count_nonzero(network.stereo.rejected) == 1
    assert [network.points.ids[i] for i in np.flatnonzero(network.stereo.rejected)] == [first.points.ids[-3]]

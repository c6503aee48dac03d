"""Shots on stereo surfaces in an incremental adjustment: kept, made anew as the orientation moves, as in batch."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from networks import pair
from stereo_pair import stereo_network

from mgsgraph.adjustment.adjust import adjust_network
from mgsgraph.adjustment.incremental.impact import EXACT
from mgsgraph.adjustment.incremental.incremental import IncrementalAdjustment
from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.network import Network
from mgsgraph.network.parts import part
from mgsgraph.project.project import Project, open_project
from mgsgraph.project.settings import ProjectSettings

LATER = np.arange(6, 18)
"""Ties that come later."""


def begun() -> tuple[Network, Network]:
    """A network of shots on a stereo surface, one a blunder, one as on level ground; and ties that come later."""
    net = stereo_network(pair(24, 24))
    sooner = np.setdiff1d(np.arange(len(net.points)), LATER)
    first = part(net, sooner)
    assert first.stereo is not None
    blunder, level = (np.arange(len(first.points)) == len(first.points) - k for k in (3, 5))
    return replace(first, stereo=replace(first.stereo, rejected=blunder, level=level)), part(net, LATER)


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
        closing, solution = adjustment.close()
        assert closing.worst < EXACT
        assert not closing.adopted
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

"""Tables of the nominal poses of many images, one after another, for compiled code (`filling.pose_at`)."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.records import Array, Index, Mask
from mgsgraph.geometry.trajectory import AttitudeTable, FixedTrajectory, Trajectory


class AttitudeTables(NamedTuple):
    """Tables of attitude (`geometry.trajectory.AttitudeTable`) of m images, one after another."""

    first: Index
    """(m + 1,) first sample of each."""
    times: Array
    """(a,) s past the epoch of each image's trajectory."""
    quaternions: Array
    """(a, 4) inertial to the sampled frame."""
    turns: Array
    """(a, 3) rad, to the next sample; zeros at the last one."""
    constants: Array
    """(m, 3, 3) sampled frame to the frame that is wanted."""

    def chosen(self, images: Index) -> "AttitudeTables":
        """Tables of some images, in the order given."""
        first, rows = _runs(self.first, images)
        tables = self.times[rows], self.quaternions[rows], self.turns[rows]
        return AttitudeTables(first, *tables, self.constants[images])


class PoseTables(NamedTuple):
    """Sampled trajectories and line timing of m images, one after another."""

    sampled: Mask
    """(m,) whether the image has a sampled trajectory; tables of others are empty."""
    timing_first: Index
    """(m + 1,) first segment of each image's line timing."""
    lines: Array
    """(s,) line at which each segment begins."""
    starts: Array
    """(s,) s past the epoch."""
    periods: Array
    """(s,) s per line."""
    position_first: Index
    """(m + 1,) first sample of each table of positions."""
    times: Array
    """(p,) s past the epoch."""
    positions: Array
    """(p, 3) m."""
    velocities: Array
    """(p, 3) m/s."""
    camera: AttitudeTables
    """Inertial to camera frame."""
    body: AttitudeTables
    """Inertial to body-fixed frame."""

    def chosen(self, images: Index) -> "PoseTables":
        """Tables of some images, in the order given."""
        timing_first, lines = _runs(self.timing_first, images)
        position_first, places = _runs(self.position_first, images)
        return PoseTables(
            self.sampled[images],
            timing_first, self.lines[lines], self.starts[lines], self.periods[lines],
            position_first, self.times[places], self.positions[places], self.velocities[places],
            self.camera.chosen(images), self.body.chosen(images),
        )  # fmt: skip


def pose_tables(images: Sequence[PushbroomImage], wanted: Mask) -> PoseTables:
    """Tables of images; those that are not `wanted` (m,), and those without sampled trajectories, have empty ones."""
    trajectories = [_sampled(image) if use else None for image, use in zip(images, wanted.tolist(), strict=True)]
    timings = [None if one is None else image.timing for image, one in zip(images, trajectories, strict=True)]
    positions = [None if one is None else one.position for one in trajectories]
    nothing = np.zeros((0, 3))
    return PoseTables(
        np.array([one is not None for one in trajectories]),
        _first([0 if one is None else one.periods.size for one in timings]),
        np.concatenate([nothing[:, 0], *(one.first_lines for one in timings if one is not None)]),
        np.concatenate([nothing[:, 0], *(one.start_times for one in timings if one is not None)]),
        np.concatenate([nothing[:, 0], *(one.periods for one in timings if one is not None)]),
        _first([0 if one is None else one.times.size for one in positions]),
        np.concatenate([nothing[:, 0], *(one.times for one in positions if one is not None)]),
        np.concatenate([nothing, *(one.positions for one in positions if one is not None)]),
        np.concatenate([nothing, *(one.velocities for one in positions if one is not None)]),
        _attitudes([None if one is None else one.camera for one in trajectories]),
        _attitudes([None if one is None else one.body for one in trajectories]),
    )


def _sampled(image: PushbroomImage) -> Trajectory | None:
    """The trajectory of an image as tables; None where it is none."""
    found = image.trajectory
    if isinstance(found, FixedTrajectory):
        return found.sampled
    return found if isinstance(found, Trajectory) else None


def _first(sizes: Sequence[int] | Index) -> Index:
    """Where each of several runs of these sizes begins, and where the last one ends."""
    return np.concatenate([[0], np.cumsum(np.array(sizes, dtype=np.int64))]).astype(np.int64)


def _runs(first: Index, chosen: Index) -> tuple[Index, Index]:
    """Runs that are chosen, one after another: where each begins, and which rows they are."""
    sizes = first[chosen + 1] - first[chosen]
    begins = _first(sizes)
    return begins, np.arange(begins[-1]) + np.repeat(first[chosen] - begins[:-1], sizes)


def _attitudes(tables: Sequence[AttitudeTable | None]) -> AttitudeTables:
    there = [one for one in tables if one is not None]
    turns = [part for one in there for part in (one.turns, np.zeros((1, 3)))]
    return AttitudeTables(
        _first([0 if one is None else one.times.size for one in tables]),
        np.concatenate([np.zeros(0), *(one.times for one in there)]),
        np.concatenate([np.zeros((0, 4)), *(one.quaternions for one in there)]),
        np.concatenate([np.zeros((0, 3)), *turns]),
        np.stack([np.eye(3) if one is None else one.constant for one in tables]),
    )

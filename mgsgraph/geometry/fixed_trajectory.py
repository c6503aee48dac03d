"""A sampled trajectory that is known against the body alone: how the body turns in inertial space is not."""

from dataclasses import dataclass

import numpy as np

from mgsgraph.geometry.records import Array
from mgsgraph.geometry.trajectory import AttitudeTable, Pose, PositionTable, Trajectory


@dataclass(frozen=True, slots=True, eq=False)
class FixedTrajectory:
    """Position and attitude in even or uneven steps, body-fixed, as model states of usgscsm have them."""

    epoch: float
    """s TDB past J2000 (or any other zero, where nobody knows) from which all times count."""
    position: PositionTable
    """Body-fixed, with body-fixed velocities."""
    camera: AttitudeTable
    """Body-fixed to camera frame."""

    @property
    def coverage(self) -> tuple[float, float]:
        """First and last time, s past the epoch, at which it holds."""
        return self.sampled.coverage

    @property
    def spin(self) -> Array | None:
        """None: how the body turns in inertial space is not in body-fixed tables."""
        return None

    @property
    def sampled(self) -> Trajectory:
        """The same with the body's axes for inertial ones."""
        unturned = np.tile([1.0, 0.0, 0.0, 0.0], (2, 1))
        still = AttitudeTable(self.position.times[[0, -1]], unturned, np.eye(3))
        return Trajectory(self.epoch, self.position, self.camera, still)

    def require(self, times: Array, where: str, slack: float = 0.0) -> None:
        """Raise EphemerisGap, naming `where`, unless all times (n,) lie in the coverage widened by `slack` seconds."""
        self.sampled.require(times, where, slack)

    def pose(self, times: Array) -> Pose:
        """Pose at times (n,) in s past the epoch, rates per second; outside the tables their outer intervals go on."""
        return self.sampled.pose(times)

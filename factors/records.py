"""What factors ask of an image: protocols that records of `mgsgraph.geometry` have, and a user's own may have."""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Pose(Protocol):
    """Of a camera at n lines, rates per line."""

    @property
    def position(self) -> Array:
        """(n, 3) m, body-fixed."""
        ...

    @property
    def matrix(self) -> Array:
        """(n, 3, 3) body-fixed to camera, +Z out of the lens."""
        ...

    @property
    def velocity(self) -> Array:
        """(n, 3) m per line, body-fixed."""
        ...

    @property
    def angular_rate(self) -> Array:
        """(n, 3) rad per line, in camera axes."""
        ...


class Interior(Protocol):
    """Interior orientation of a camera."""

    @property
    def focal_length(self) -> float:
        """Focal length, m."""
        ...

    def focal_plane(self, samples: Array) -> tuple[Array, Array]:
        """(n, 2) m, ideal places of image samples, and (n, 2) m per sample, how the detector goes on there."""
        ...


class PushbroomImage(Protocol):
    """What a factor asks of an image; `mgsgraph.geometry.image.PushbroomImage` has it."""

    @property
    def name(self) -> str:
        """Name of the image, which messages state."""
        ...

    @property
    def lines(self) -> int:
        """Number of lines."""
        ...

    @property
    def samples(self) -> int:
        """Number of samples."""
        ...

    @property
    def interior(self) -> Interior:
        """Interior orientation of its camera."""
        ...

    def pose(self, lines: Array) -> Pose:
        """Nominal pose at lines (n,)."""
        ...

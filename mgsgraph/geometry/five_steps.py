"""Ground to image as Shan et al. (2004) do it: a frame image of the central line, corrected line by line.

`PushbroomImage.ground_to_image` finds the same place by Newton's method, under any orientation; this is for comparison.
"""

import numpy as np

from mgsgraph.geometry import rotation
from mgsgraph.geometry.camera import InteriorOrientation
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import OrientationCorrection
from mgsgraph.geometry.records import Array

_STEPS = 50
_THRESHOLD = 1e-4
"""lines, at which the steps end."""


def five_steps(image: PushbroomImage, points: Array, correction: OrientationCorrection | None = None) -> Array:
    """Image places of ground points by the five steps of Shan et al. (2004), under linear orientation.

    1. Take the orientation of the central line. 2. Project as into a frame image (Eq. 5). 3. Take the orientation of
    the line found (Eq. 3: elements linear in the line, their rates from the first and the last line). 4. Project again:
    what is left is a correction of the line. 5. Add it; go back to 3 until it vanishes.

    Parameters
    ----------
    image : PushbroomImage
        Its orientation is replaced by the linear one through its first, central and last line.
    points : (n, 3)
        m, body-fixed.
    correction : OrientationCorrection, optional
        of the nominal orientation; none when absent.

    Returns
    -------
    places : (n, 2)
        line and sample; NaN behind the camera or more than half an image length before or after the image.
    """
    middle = 0.5 * image.lines
    pose = image.pose(np.array([0.0, middle, float(image.lines)]), correction)
    angles = np.unwrap(rotation.omega_phi_kappa(pose.matrix), axis=0)
    elements = np.column_stack([pose.position, angles])
    rate = (elements[2] - elements[0]) / image.lines

    def project(lines: Array) -> Array:
        moved = elements[1] + rate * (lines - middle)[:, None]
        camera = rotation.from_omega_phi_kappa(moved[:, 3:])
        ray = np.einsum("nij,nj->ni", camera, points - moved[:, :3])
        depth = np.where(ray[:, 2] > 0.0, ray[:, 2], np.nan)
        return np.asarray(image.interior.focal_length * ray[:, :2] / depth[:, None])

    lines = np.full(points.shape[0], middle)
    # the paper's x counts lines of the frame image: metres of the focal plane per line, once for each point
    per_line = project(lines + 1.0)[:, 0] - project(lines)[:, 0]
    samples = np.full(points.shape[0], 0.5 * image.samples)
    for _ in range(_STEPS):
        place = project(lines)
        samples, detector = _sample_of(image.interior, place[:, 1], samples)
        step = -(place[:, 0] - detector) / per_line
        lines = np.clip(lines + step, -middle, 3.0 * middle)
        if not np.any(np.abs(step) > _THRESHOLD):
            break
    places = np.column_stack([lines, samples])
    places[~(np.abs(step) < 1e2 * _THRESHOLD)] = np.nan
    return places


def _sample_of(interior: InteriorOrientation, y: Array, start: Array) -> tuple[Array, Array]:
    """Samples (n,) whose focal-plane place along the detector is y (n,) in m, and the detector's x (n,) there."""
    samples = start
    for _ in range(4):  # one step without distortion
        place, slope = interior.focal_plane(samples)
        samples = samples - (place[:, 1] - y) / slope[:, 1]
    return samples, interior.focal_plane(samples)[0][:, 0]

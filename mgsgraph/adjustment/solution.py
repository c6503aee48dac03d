"""The result of an adjustment: one frozen record from which every table, figure and later command is made."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np

from mgsgraph.adjustment.covariances import Linearity
from mgsgraph.adjustment.drivers import Drivers
from mgsgraph.adjustment.fit import Fit, Strained, strained_orientations
from mgsgraph.adjustment.marginals import JointCovariance
from mgsgraph.adjustment.multistart import Minima
from mgsgraph.adjustment.settings import Iteration, SolverSettings
from mgsgraph.geometry import rotation
from mgsgraph.geometry.body import in_turn
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.orientation import OrientationCorrection, corrected, correction_axes
from mgsgraph.geometry.records import Array, Index, Mask, sigmas_of
from mgsgraph.geometry.trajectory import Pose
from mgsgraph.kernel.rows import Small
from mgsgraph.network import Network, PointClass
from mgsgraph.network.corrections import Design, adjusted_image, correction_parts, design, whole_correction
from mgsgraph.record import Record, card

_TOGETHER = 1024
"""Images whose orientation is put together at a time: 31 lines of each take some 60 MB."""


@dataclass(frozen=True, eq=False)
class Solution(Record):
    """Adjusted orientation, ground points, residuals and covariances of one network.

    Examples
    --------
    >>> number = solution.network.point_number("TIE00001")
    >>> solution.places[number].round(0), solution.sigmas[number].round(1)
    (array([ 176989., 3383345.,  236273.]), array([ 6.2, 21.7,  7.6]))
    >>> solution.correction("SIM/A").coefficients[0].shape
    (6,)
    >>> solution.converged, round(solution.sigma0, 2)
    (True, 1.22)
    """

    name: str
    """What the case is called."""
    network: Network
    """What was adjusted."""
    settings: SolverSettings
    """How."""
    converged: bool
    """Whether the adjustment converged."""
    message: str
    """Why it stopped, and what to do where that is not well."""
    history: tuple[Iteration, ...]
    """Every step tried, over all blunder passes."""
    cost_initial: float
    """Half the weighted sum of squares with the nominal orientation."""
    cost_final: float
    """The same at the solution."""
    fit: Fit
    """sigma0 and degrees of freedom."""
    coefficients: tuple[Array, ...]
    """(degree + 1, 6) m and rad, of each image, its own alone (`correction` has the whole); zero for a held one."""
    shifts: Array
    """(p, 2) m, east and north, horizontal shifts of laser profiles and of the terrain model (network.shift_names)."""
    joint_covariance: JointCovariance
    """Of all orientation coefficients (variable j is image j), after them the shifts and then the shared unknowns; m,
    rad and s, for sigma0 = 1."""
    places_before: Array
    """(n, 3) m: a-priori places, and for free points the intersection of their rays with the nominal orientation."""
    places: Array
    """(n, 3) m, body-fixed, adjusted; NaN for points that nothing determines, or nothing after rejection."""
    covariances: Array
    """(n, 3, 3) m^2, for sigma0 = 1; zero for fixed points, NaN for undetermined ones."""
    determined: Mask
    """(n,) False for points that nothing determines, or nothing after rejection."""
    rays_used: Mask
    """(k,) False for rays that were rejected or belong to undetermined points."""
    ranges_used: Mask
    """(r,) the same of ranges."""
    residuals: Array
    """(k, 2) pixels, line and sample, measured minus predicted, of all rays, with what they have in common with others;
    NaN for undetermined points."""
    residuals_before: Array
    """(k, 2) pixels, the same with the nominal orientation and `places_before`."""
    range_residuals: Array
    """(r,) m, measured minus predicted."""
    range_residuals_before: Array
    """(r,) m, the same before."""
    sigmas_without_laser: Array | None
    """(3,) m, mean sigma of the tie points in x, y, z that the same network without its laser rows would have; None
    where there is no laser or no tie point, and of a mixture of minima: its sigmas are not those of one adjustment."""
    seconds: Mapping[str, float]
    """Wall time by stage."""
    versions: Mapping[str, str]
    """Versions of this program and of the libraries that computed."""
    median_sigmas_without_laser: Array | None = None
    """(3,) m, the same of their medians, which a few points of nearly parallel rays don't move; None as well where an
    older version didn't say."""
    rays_rejected: Mask | None = None
    """(k,) True for blunders, as the last pass judged; None where an older version didn't say."""
    ranges_rejected: Mask | None = None
    """(r,) the same."""
    stereo_rejected: Mask | None = None
    """(n,) the same of the points' heights above stereo surfaces."""
    test_dimensions: Small | None = None
    """(k + r + n,) degrees of freedom of the last blunder test of each ray, range and point's height above a stereo
    surface while it took part: 0 where nothing checks it, 1 of a ray that nothing checks along the epipolar line. None
    where no blunders were sought."""
    stereo_heights: Array | None = None
    """(n,) m, of each point above its stereo surface, along the normal; NaN for points on none. None where an older
    version didn't say."""
    shared: tuple[Array, ...] = ()
    """(w,) of each of the network's shared unknowns, in the unit of its kind: one value, or three of a boresight."""
    nodes: tuple[Array, ...] = ()
    """(k, 6) m and rad, corrections at the orientation images of each pass."""
    trends: tuple[Array, ...] = ()
    """(w,) m and rad, of each pass: bias and drift of its observed trajectory (`NodePrior.trend_components`)."""
    lift: Array | None = None
    """(w,) m and rad, of the terrain model's upward shift and of its tilts about east and north those that are unknown
    (`Surface.terms` after the horizontal shift); None where none is."""
    common: tuple[Array, ...] = ()
    """(w,) factors of each group of errors in common (`Network.common`), of unit variance beforehand."""
    linearity: Linearity | None = None
    """Whether the joint covariance may be used for statements about the shared unknowns together; None where nobody has
    looked (large networks, robust losses, no optimum; `linearity_of` looks), or an older version didn't say."""
    minima: Minima | None = None
    """What starts over the terrain model's shift have found; None where there were none. With several minima the joint
    covariance, and what follows from it, is the mean square about the lowest one over their mixture."""

    drivers: Drivers | None = None
    """Which images and points drive it; None where it converged with a sigma0 and orientations that can be, or an
    older version didn't say."""

    own_factors: int = 0
    """Factors on points that a graph of one's own has and the network does not (`solution_of`). Costs and covariances
    hold them; nothing that is computed from the network's measurements can, so that is refused."""

    @property
    def stereo_used(self) -> Mask:
        """(n,) True for points whose height above a stereo surface took part."""
        control = self.network.stereo
        if control is None:
            return np.zeros_like(self.determined)
        used = (control.surface >= 0) & self.determined
        return used if self.stereo_rejected is None else used & ~self.stereo_rejected

    @property
    def sigma0(self) -> float:
        """A-posteriori standard deviation of unit weight."""
        return self.fit.sigma0

    @property
    def sigmas(self) -> Array:
        """(n, 3) m, standard deviations of the points in x, y, z, for sigma0 = 1."""
        return sigmas_of(self.covariances)

    @property
    def iterations(self) -> int:
        """Number of steps tried."""
        return len(self.history)

    @cached_property
    def strained(self) -> tuple[Strained, ...]:
        """Images whose orientation was moved by far more than is said to be known of it, worst first."""
        return strained_orientations(self.network, self.coefficients, self.nodes)

    @cached_property
    def values(self) -> tuple[Array, ...]:
        """Value (width,) of each variable of the joint covariance: images, then shifts, then shared unknowns, then the
        nodes and the trend of each pass, then the factors of errors in common.
        """
        of_passes = [[*nodes, trend] for nodes, trend in zip(self.nodes, self.trends, strict=True)]
        polynomials = [coefficients.ravel() for coefficients in self.coefficients]
        passes = [unknown for unknowns in of_passes for unknown in unknowns if unknown.size]
        return (*polynomials, *self.shift_values, *self.shared, *passes, *self.common)

    # images, points, shifts and shared unknowns are asked for by their names or their numbers in the network

    def image(self, image: str | int) -> PushbroomImage:
        """One image with its adjusted interior orientation; its trajectory is the nominal one (`correction`)."""
        return adjusted_image(self.network, self.network.image_number(image), self.values)

    def correction(self, image: str | int) -> OrientationCorrection:
        """Whole orientation correction of one image: its own, and what shared unknowns do to it."""
        return whole_correction(self.network, self.network.image_number(image), self.values, self.settings.angles)

    def correction_covariance(self, *images: str | int) -> Array:
        """Joint covariance (d, d) of the coefficients of images' whole corrections, as `correction` has them, row after
        row, for sigma0 = 1.
        """
        numbers = [self.network.image_number(image) for image in images]
        parts = [correction_parts(self.network, image, self.settings.angles) for image in numbers]
        variables = sorted({variable for part in parts for variable in part})
        width, rows = self.joint_covariance.square_root.width, [next(iter(part.values())).shape[0] for part in parts]
        joint = np.block([
            [part.get(v, np.zeros((size, width[v]))) for v in variables] for part, size in zip(parts, rows, strict=True)
        ])  # fmt: skip
        return np.asarray(joint @ self.joint_covariance.of(variables) @ joint.T)

    def image_covariance(self, image: str | int) -> Array:
        """Covariance (6 (degree + 1), 6 (degree + 1)) of one image's own coefficients, m and rad; zero when held."""
        number = self.network.image_number(image)
        return self.joint_covariance.block(number, number)

    def shared_variable(self, shared: str | int) -> int:
        """Variable of a shared unknown in the joint covariance."""
        return self.network.first_shared + self.network.shared_number(shared)

    def shared_covariance(self, shared: str | int) -> Array:
        """Covariance (width, width) of one shared unknown, in its unit squared, for sigma0 = 1."""
        return self.joint_covariance.block(self.shared_variable(shared), self.shared_variable(shared))

    def shift_covariance(self, profile: str | int) -> Array:
        """Covariance (2, 2) in m^2 of one horizontal shift, for sigma0 = 1; zero of a terrain model that has none."""
        terms = self.network.shift_terms[self.network.shift_number(profile)]
        if terms[:1] and terms[0].name != "east shift":
            return np.zeros((2, 2))
        return self.shift_spread(profile)[:2, :2]

    def shift_spread(self, profile: str | int) -> Array:
        """Covariance (w, w) in m and rad of all unknowns of one shift (`Network.shift_terms`), for sigma0 = 1."""
        variable = len(self.coefficients) + self.network.shift_number(profile)
        return self.joint_covariance.block(variable, variable)

    @property
    def shift_values(self) -> list[Array]:
        """Value (w,) of the unknowns of each shift (`Network.shift_terms`)."""
        values, surface = list(self.shifts), self.network.surface
        if self.lift is not None and surface is not None:
            values[-1] = np.concatenate([values[-1][: 2 * bool(surface.shift_sigma)], self.lift])
        return values

    def members(self, point_class: PointClass) -> Index:
        """Determined points of one class."""
        return np.flatnonzero((self.network.points.classes == point_class) & self.determined)

    @property
    def ending(self) -> str:
        """How it ended, for sentences: converged, or NOT converged."""
        return "converged" if self.converged else "NOT converged"

    def _repr_html_(self) -> str:
        """For notebooks."""
        rows = [("points", "number", "mean sigma X, Y, Z"), ("", "", "m")]
        for point_class in PointClass:
            members = self.members(point_class)
            if members.size:
                means = ", ".join(f"{value:.3g}" for value in self.sigmas[members].mean(axis=0))
                rows.append((point_class.name.lower(), str(members.size), means))
        return card(repr(self), [self.message], rows, head=2)

    def __repr__(self) -> str:
        return (
            f"Solution({self.name!r}, {self.ending} after {self.iterations} iterations, cost {self.cost_initial:.6g} "
            f"-> {self.cost_final:.6g}, sigma0 {self.sigma0:.4g}, {self.fit.degrees_of_freedom} degrees of freedom; "
            f"{self.network!r})"
        )


@dataclass(frozen=True, slots=True, eq=False)
class OrientationProfile(Record):
    """Exterior orientation of images at some of their lines, before and after, with sigmas; image after image.

    Examples
    --------
    >>> profile = mgsgraph.orientation_profile(solution, "SIM/A", places=3)
    >>> profile.position_sigma.round(0)
    array([[24.,  5., 24.],
           [24.,  4., 24.],
           [24.,  5., 24.]])
    >>> np.degrees(profile.angle_differences).round(3)
    array([[-0.08 , -0.009,  0.079],
           [-0.075, -0.009,  0.073],
           [-0.07 , -0.009,  0.068]])
    """

    lines: Array
    """(n,) line coordinate."""
    times: Array
    """(n,) s TDB past J2000."""
    position_before: Array
    """(n, 3) m, body-fixed, nominal."""
    position_after: Array
    """(n, 3) m, adjusted."""
    position_sigma: Array
    """(n, 3) m, of the adjusted one, for sigma0 = 1."""
    angles_before: Array
    """(n, 3) rad, omega, phi, kappa in the papers' product, nominal."""
    angles_after: Array
    """(n, 3) rad, adjusted."""
    angles_sigma: Array
    """(n, 3) rad, of the adjusted one, for sigma0 = 1."""
    rotation: Array
    """(n, 3) rad, correction as a small rotation about the camera's axes: of one whose detector lies along y, x is
    roll and y is pitch; z, the optical axis, is yaw."""
    rotation_sigma: Array
    """(n, 3) rad, its sigma, for sigma0 = 1."""

    @property
    def angle_differences(self) -> Array:
        """(n, 3) rad, omega, phi, kappa after minus before, in -pi .. pi."""
        return in_turn(self.angles_after - self.angles_before)


def orientation_profile(solution: Solution, image: str | int, places: int = 31) -> OrientationProfile:
    """Exterior orientation of one image at evenly spaced lines from its first to its last (the papers' 31 samples).

    Examples
    --------
    >>> profile = mgsgraph.orientation_profile(solution, "SIM/A", places=3)
    >>> profile.lines
    array([   0., 2500., 5000.])
    >>> np.linalg.norm(profile.position_after - profile.position_before, axis=1).round(0)
    array([47., 47., 47.])
    """
    return orientation_profiles(solution, [image], places)


def orientation_profiles(
    solution: Solution, images: Sequence[str | int] | None = None, places: int = 31
) -> OrientationProfile:
    """Exterior orientation of images at evenly spaced lines from the first to the last of each.

    Sigmas by the law of error propagation from the joint covariance of each image's coefficients and of what it shares
    with others.

    Parameters
    ----------
    solution : Solution
    images : sequence of str or int, optional
        Which, by name or number; all of them when absent.
    places : int
        Lines of each image (the papers' 31 samples).

    Returns
    -------
    OrientationProfile
        One image after another, `places` rows of each.
    """
    network = solution.network
    chosen = range(len(network.images)) if images is None else [network.image_number(image) for image in images]
    blocks = [_profiles(solution, chosen[k : k + _TOGETHER], places) for k in range(0, len(chosen), _TOGETHER)]
    if len(blocks) == 1:
        return blocks[0]
    names = [field.name for field in fields(OrientationProfile)]
    return OrientationProfile(*(np.concatenate([getattr(block, name) for block in blocks]) for name in names))


def _profiles(solution: Solution, images: Sequence[int], places: int) -> OrientationProfile:
    """The same of so many images that their matrices find room."""
    network, angles = solution.network, solution.settings.angles
    pictures = [network.images[image] for image in images]
    lines = [np.linspace(0.0, float(picture.lines), places) for picture in pictures]
    moments = [picture.moments(at) for picture, at in zip(pictures, lines, strict=True)]
    poses = [picture.trajectory.pose(at.times) for picture, at in zip(pictures, moments, strict=True)]
    before = Pose(*(
        np.concatenate([getattr(pose, name) for pose in poses])
        for name in ("position", "velocity", "matrix", "angular_rate")
    ))  # fmt: skip
    designs = [design(network, image, angles, at) for image, at in zip(images, moments, strict=True)]
    correction, covariance = _corrections(solution, designs, places)
    after = corrected(before, correction, np.zeros_like(correction), angles)
    turn = correction_axes(before, correction, angles)
    about_camera = turn @ covariance[:, 3:, 3:] @ turn.mT
    angles_after = rotation.omega_phi_kappa(after.matrix)
    to_angles = np.linalg.solve(rotation.angle_axes(angles_after, camera_to_body=True), turn)
    of_angles = to_angles @ covariance[:, 3:, 3:] @ to_angles.mT
    return OrientationProfile(
        lines=np.concatenate(lines),
        times=np.concatenate([at.times + at.epoch for at in moments]),
        position_before=before.position,
        position_after=after.position,
        position_sigma=_root(covariance[:, :3, :3]),
        angles_before=rotation.omega_phi_kappa(before.matrix),
        angles_after=angles_after,
        angles_sigma=_root(of_angles),
        rotation=-rotation.logarithm(after.matrix @ before.matrix.mT),
        rotation_sigma=_root(about_camera),
    )


def _corrections(solution: Solution, images: Sequence[Sequence[Design]], places: int) -> tuple[Array, Array]:
    """Whole corrections (n, 6) of images, m and rad, and their covariances (n, 6, 6); `places` lines of each image."""
    values, runs = solution.values, [run for designs in images for run in designs]
    begin = np.repeat(np.arange(len(images)) * places, [len(designs) for designs in images]).tolist()
    flat, start = solution.joint_covariance.of_each([run.variables for run in runs]), 0
    correction, covariance = np.zeros((len(images) * places, 6)), np.zeros((len(images) * places, 6, 6))
    for run, first in zip(runs, begin, strict=True):
        matrix, at = run.matrix, slice(first + run.lines.start, first + run.lines.stop)
        width = matrix.shape[2]
        joint = flat[start : start + width * width].reshape(width, width)
        start += width * width
        correction[at] = matrix @ np.concatenate([values[v] for v in run.variables])
        covariance[at] = matrix @ joint @ matrix.mT
    return correction, covariance


def _root(covariance: Array) -> Array:
    """Standard deviations (n, 3) of covariances (n, 3, 3)."""
    return np.sqrt(np.maximum(np.diagonal(covariance, axis1=1, axis2=2), 0.0))

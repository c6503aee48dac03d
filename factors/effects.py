"""What unknowns do to a measurement: to the *state* of its instrument, thirteen numbers.

    0-2   position, m, body-fixed; of a known ground point or a terrain model, where it is itself
    3-5   attitude, rad, about the camera's axes (or additions to the papers' angles)
    6-8   what a pixel looks along, m in the focal plane: x, y, focal length
    9     what a measured range is too long, m
    10-12 how what a pixel looks along changes, m per sample; no derivative is taken by these

An effect is linear in its unknowns and a function of the image line: state(l) = sum_e E_e(l) x_e (Yoon & Shan 2005,
Eq. 2). All factors that take `shared` or `moved` take any effects.
"""

from collections.abc import Callable
from typing import NamedTuple, Protocol

import numpy as np

from mgsgraph.errors import require
from mgsgraph.factors.records import Array, PushbroomImage

STATE = 13
"""Numbers of a state."""
POSITION, ATTITUDE, LOOK, RANGE, SLOPE = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 10), slice(10, 13)
"""Which of them are which."""


class Effect(Protocol):
    """What one or several unknowns do to the state of a measurement, along an image."""

    @property
    def keys(self) -> tuple[int, ...]:
        """GTSAM keys of the unknowns, each a Vector."""
        ...

    @property
    def widths(self) -> tuple[int, ...]:
        """Length of each."""
        ...

    def at(self, line: float) -> tuple[Array, Array]:
        """(13, columns of all unknowns) at a line, m or rad per unit, and its derivative per line."""
        ...


class PolynomialEffect(NamedTuple):
    """Coefficients of a polynomial of the normalized line u, from -1 at the first line to 1 at the last.

    Examples
    --------
    >>> from gtsam.symbol_shorthand import U
    >>> drift = np.zeros((2, 13, 1))
    >>> drift[1, 4, 0] = 1.0  # of pitch, rad, in proportion to u
    >>> shared = [mgsgraph.factors.PolynomialEffect((U(5),), drift, 5000.0)]
    """

    keys: tuple[int, ...]
    """One GTSAM key."""
    coefficients: Array
    """(degree + 1, 13, columns) m or rad per unit of the unknown, of u^0, u^1, ..."""
    lines: float = 2.0
    """Of the image; of no meaning for a constant."""

    @property
    def widths(self) -> tuple[int, ...]:
        """Length of the unknown."""
        return (self.coefficients.shape[2],)

    def at(self, line: float) -> tuple[Array, Array]:
        """(13, columns), and per line."""
        terms, rows, columns = self.coefficients.shape
        u, rate, values, slopes = 2.0 * line / self.lines - 1.0, 2.0 / self.lines, [1.0], [0.0]
        for k in range(1, terms):
            slopes.append(k * rate * values[-1])
            values.append(u * values[-1])
        value, slope = (np.array([values, slopes]) @ self.coefficients.reshape(terms, -1)).reshape(2, rows, columns)
        return value, slope


def orientation_polynomial(key: int, degree: int, lines: float) -> PolynomialEffect:
    """The polynomial EO correction of one image: 6 (degree + 1) numbers, six of u^0 first: m body-fixed, rad about the
    camera's axes (Yoon & Shan 2005, Eq. 2).

    Examples
    --------
    >>> from gtsam.symbol_shorthand import X
    >>> mgsgraph.factors.orientation_polynomial(X(0), 2, 5000.0).widths
    (18,)
    """
    require(degree >= 0, "orientation polynomial", f"degree {degree}", "0, 1, 2, ...")
    terms = degree + 1
    coefficients = np.zeros((terms, STATE, 6 * terms))
    coefficients[:, :6] = np.eye(6 * terms).reshape(terms, 6, -1)
    return PolynomialEffect((int(key),), coefficients, lines)


def constant(key: int, rows: slice, matrix: Array) -> PolynomialEffect:
    """What doesn't change along an image: a matrix (rows, columns) for some numbers of the state.

    Examples
    --------
    >>> from gtsam.symbol_shorthand import U
    >>> lever_arm = mgsgraph.factors.constant(U(4), slice(0, 3), np.eye(3))  # m, body-fixed
    """
    coefficients = np.zeros((1, STATE, matrix.shape[1]))
    coefficients[0, rows] = matrix
    return PolynomialEffect((int(key),), coefficients)


def profile_shift(key: int, position: Array) -> PolynomialEffect:
    """Shift of a laser profile as a whole, 2 numbers: m east and m north, of its shot at a position (3,), m.

    Examples
    --------
    >>> from gtsam.symbol_shorthand import S
    >>> moved = [mgsgraph.factors.profile_shift(S(0), solution.places[-1])]
    """
    east = np.array([-position[1], position[0], 0.0]) / np.hypot(*position[:2])
    north = np.cross(position / np.linalg.norm(position), east)
    return constant(key, POSITION, np.column_stack([east, north]))


def boresight(key: int) -> PolynomialEffect:
    """Rotation of a camera against its spacecraft, 3 numbers: rad about the camera's axes.

    Examples
    --------
    >>> from gtsam.symbol_shorthand import U
    >>> shared = [mgsgraph.factors.boresight(U(0))]
    """
    return constant(key, ATTITUDE, np.eye(3))


def focal_length(key: int) -> PolynomialEffect:
    """Error of the focal length, 1 number: m, positive when the true one is longer.

    Examples
    --------
    >>> from gtsam.symbol_shorthand import U
    >>> shared = [mgsgraph.factors.focal_length(U(1))]
    """
    return constant(key, LOOK, np.array([[0.0], [0.0], [1.0]]))


def range_bias(key: int) -> PolynomialEffect:
    """What all ranges of an altimeter are too long, 1 number: m.

    Examples
    --------
    >>> from gtsam.symbol_shorthand import U
    >>> shared = [mgsgraph.factors.range_bias(U(2))]
    """
    return constant(key, RANGE, np.ones((1, 1)))


def time_bias(key: int, image: PushbroomImage, period: float) -> PolynomialEffect:
    """What the times of an image are too early, 1 number: s; `period` is of a line, s. The camera is then as far along
    its trajectory, body-fixed, as it flies in that time: a polynomial of second degree of the line.

    Examples
    --------
    >>> from gtsam.symbol_shorthand import U
    >>> shared = [mgsgraph.factors.time_bias(U(3), network.images[0], 0.0005)]
    """
    pose = image.pose(np.array([0.0, 0.5, 1.0]) * image.lines)
    rates = np.hstack([pose.velocity, pose.angular_rate]) / period
    coefficients = np.zeros((3, STATE, 1))
    coefficients[:, :6, 0] = np.linalg.solve(np.vander([-1.0, 0.0, 1.0], increasing=True), rates)
    return PolynomialEffect((int(key),), coefficients, float(image.lines))


class OrientationImagesEffect(NamedTuple):
    """Orientation images of a pass: corrections of the pose at several times, with weights along the line.

    Examples
    --------
    >>> from gtsam.symbol_shorthand import N
    >>> linear = lambda line: (np.array([1.0 - line / 5000.0, line / 5000.0]), np.array([-1.0, 1.0]) / 5000.0)
    >>> mgsgraph.factors.OrientationImagesEffect((N(0), N(1)), linear).widths
    (6, 6)
    """

    keys: tuple[int, ...]
    """Of each, 6 numbers: m body-fixed, rad about the camera's axes."""
    weights: Callable[[float], tuple[Array, Array]]
    """Weights (k,) of the orientation images at a line, and their rates per line (Hofmann et al. 1984)."""

    @property
    def widths(self) -> tuple[int, ...]:
        """Length of each unknown."""
        return (6,) * len(self.keys)

    def at(self, line: float) -> tuple[Array, Array]:
        """(13, columns), and per line."""
        value, rate = self.weights(line)
        each = np.eye(STATE, 6, dtype=np.float64)
        return np.asarray(np.kron(value, each)), np.asarray(np.kron(rate, each))

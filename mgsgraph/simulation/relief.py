"""Relief that is periodic: fractals, a canyon, craters."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mgsgraph.errors import InputError
from mgsgraph.geometry.records import Array, Index, assign, read_only
from mgsgraph.units import KM

"""Height of a crater's rim in units of its depth; radius at which its ejecta end, in units of the crater's."""
Float = NDArray[np.floating]
"""An array of float32 or float64: what goes in comes out."""
_Axis = tuple[Float, tuple[Float, Float, Float]]

RIM, REACH = 0.2, 2.5

DENSITY_DIAMETER = 100.0
"""m, crater diameter to which densities refer; above twice the diameter there are a quarter of the craters."""


@dataclass(frozen=True, slots=True, eq=False)
class PeriodicSurface:
    """A smooth surface that repeats itself: quadratic B-spline over a square grid."""

    step: float
    """m between coefficients."""
    coefficients: NDArray[np.float32]
    """(rows, columns) rows going north, columns going east; powers of two. Kept with one more row and column of its
    repetition on each side."""

    def __post_init__(self) -> None:
        rows, columns = self.coefficients.shape
        if rows & (rows - 1) or columns & (columns - 1):
            raise InputError("periodic surface", f"{rows} x {columns} coefficients", "powers of two")
        wrapped = np.pad(np.asarray(self.coefficients, dtype=np.float32), 1, mode="wrap")
        assign(self, coefficients=read_only(wrapped))

    @property
    def period(self) -> tuple[float, float]:
        """m, after which the surface repeats itself going east and going north."""
        rows, columns = self.coefficients.shape
        return (columns - 2) * self.step, (rows - 2) * self.step

    def at(self, east: Float, north: Float) -> tuple[Float, Float, Float]:
        """Value (n,) and its derivatives per m east and per m north (n,) at coordinates (n,) in m, in their dtype."""
        start, (first, along), (second, across) = self._stencil(east, north)
        value, by_east, by_north = np.zeros_like(east), np.zeros_like(east), np.zeros_like(east)
        slopes_along, slopes_across = _slopes(first), _slopes(second)
        for k in range(3):
            row = [self._neighbour(start, k, i) for i in range(3)]
            along_row = row[0] * along[0] + row[1] * along[1] + row[2] * along[2]
            value += across[k] * along_row
            by_north += slopes_across[k] * along_row
            by_east += across[k] * (row[0] * slopes_along[0] + row[1] * slopes_along[1] + row[2] * slopes_along[2])
        per_metre = east.dtype.type(1.0 / self.step)
        return value, by_east * per_metre, by_north * per_metre

    def value(self, east: Float, north: Float) -> Float:
        """Value (n,) alone, at coordinates (n,) in m."""
        start, (_, along), (_, across) = self._stencil(east, north)
        value = np.zeros_like(east)
        for k in range(3):
            value += across[k] * sum(self._neighbour(start, k, i) * along[i] for i in range(3))
        return value

    def _stencil(self, east: Float, north: Float) -> tuple[NDArray[np.intp], _Axis, _Axis]:
        """Index of the first of the nine coefficients about each point; offset and weights on both axes."""
        rows, columns = self.coefficients.shape
        column, along = _weights(east, self.step, columns - 2)
        row, across = _weights(north, self.step, rows - 2)
        return row * columns + column, along, across

    def _neighbour(self, start: NDArray[np.intp], row: int, column: int) -> NDArray[np.float32]:
        return self.coefficients.reshape(-1)[row * self.coefficients.shape[1] + column :].take(start)


def _weights(along: Float, step: float, size: int) -> tuple[NDArray[np.intp], _Axis]:
    """Index of the coefficient before the nearest one; offset from the nearest (steps), and weights of the three."""
    kind = along.dtype.type
    off = along * kind(1.0 / step)
    nearest = np.rint(off)
    off -= nearest
    square, half = off * off + kind(0.25), kind(0.5)
    index = nearest.astype(np.intp) & (size - 1)
    return index, (off, (half * (square - off), kind(1.0) - square, half * (square + off)))


def _slopes(off: Float) -> tuple[Float, Float, Float]:
    """Derivatives of the three weights per step."""
    half = off.dtype.type(0.5)
    return off - half, -off - off, off + half


def fractal(shape: tuple[int, int], hurst: float, rng: np.random.Generator) -> NDArray[np.float32]:
    """Periodic relief (rows, columns) of zero mean and unit rms whose spectrum falls as wave number^-(hurst + 1)."""
    spectrum = np.fft.rfft2(rng.standard_normal(shape, dtype=np.float32))
    wave = np.hypot(np.fft.fftfreq(shape[0])[:, None], np.fft.rfftfreq(shape[1]))
    outer = 1.0 / min(shape)
    spectrum *= (np.maximum(wave, outer) ** -(hurst + 1.0)).astype(np.float32)
    spectrum[0, 0] = 0.0
    relief = np.fft.irfft2(spectrum, shape).astype(np.float32)
    return np.asarray(relief / np.sqrt(np.mean(relief * relief)), dtype=np.float32)


def canyon(shape: tuple[int, int], step: float, rng: np.random.Generator) -> NDArray[np.float32]:
    """Canyon across the flight direction: 0 on its floor, 1 on the plateau; spurs and gullies bend its walls."""
    north = step * (np.arange(shape[0]) - shape[0] // 2)[:, None]
    shifted = np.roll(north + 750.0 * fractal(shape, 1.3, rng), shape[0] // 2, axis=0)
    northern = _smooth_step((shifted - 8e3) / 9e3)
    southern = 1.0 - _smooth_step((shifted + 29.5e3) / 7e3)
    return np.asarray(northern + southern, dtype=np.float32)


def _smooth_step(x: Array) -> Array:
    clipped = np.clip(x, 0.0, 1.0)
    return np.asarray(clipped * clipped * (3.0 - 2.0 * clipped))


def add_craters(
    field: NDArray[np.float32], step: float, density: float, sizes: tuple[float, float], rng: np.random.Generator
) -> None:
    """Add bowl-shaped craters with raised rims to a periodic field, the largest first.

    Their number above a diameter falls with its square; depth is 0.2 diameters for a fresh one and less for others.
    """
    smallest, largest = (DENSITY_DIAMETER / np.array(sizes)) ** 2
    area = field.size * (step / KM) ** 2
    number = round(density * area * float(smallest - largest))
    diameters = DENSITY_DIAMETER / np.sqrt(rng.uniform(largest, smallest, number))
    rows, columns = rng.uniform(0.0, field.shape[0], number), rng.uniform(0.0, field.shape[1], number)
    depths = 0.2 * diameters * rng.uniform(0.2, 1.0, number)
    for k in np.argsort(-diameters):
        radius = 0.5 * diameters[k] / step
        first, line = _around(rows[k], REACH * radius)
        second, across = _around(columns[k], REACH * radius)
        distance = np.hypot(line[:, None], across) / radius
        field[np.ix_(first % field.shape[0], second % field.shape[1])] += depths[k] * _crater(distance)


def _around(centre: float, reach: float) -> tuple[Index, Array]:
    """Indices within `reach` of a centre, and how far from it they are."""
    indices = np.arange(np.ceil(centre - reach), np.floor(centre + reach) + 1.0)
    return indices.astype(np.int64), indices - centre


def _crater(distance: Array) -> NDArray[np.float32]:
    """Height in units of the depth (rim crest to floor) at distances from the centre in units of the radius."""
    inside = RIM - 1.0 + np.minimum(distance, 1.0) ** 2
    ejecta = RIM * (np.maximum(distance, 1.0) ** -3 - REACH**-3) / (1.0 - REACH**-3)
    return np.where(distance < 1.0, inside, np.maximum(ejecta, 0.0)).astype(np.float32)

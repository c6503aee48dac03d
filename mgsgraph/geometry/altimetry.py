"""Laser altimetry: shots with their ranges, footprints and, where there are any, measures in images.

The laser altimeters whose archives are read: what each sees of the ground, and how well it ranges. One table.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from datetime import datetime
from typing import Any

import numpy as np

from mgsgraph.errors import InputError, require
from mgsgraph.geometry.body import Ellipsoid, distances, nearness, require_near, surface_radii
from mgsgraph.geometry.records import (
    Array,
    Index,
    Mask,
    assign,
    frozen,
    frozen_index,
    frozen_mask,
    no_rows,
    of_kind,
    read_only,
    require_covariances,
    require_names,
)
from mgsgraph.geometry.rotation import unit_vectors
from mgsgraph.geometry.trajectory import J2000, YEARS
from mgsgraph.names import Names, RepeatedNames
from mgsgraph.record import Record
from mgsgraph.units import KM, MRAD, SPEED_OF_LIGHT

_UNKNOWN = float("nan")


def _flight(first: str, last: str) -> tuple[float, float]:
    """S past J2000 of two days."""
    start, stop = ((datetime.fromisoformat(f"{day}T00:00Z") - J2000).total_seconds() for day in (first, last))
    return start, stop


@dataclass(frozen=True, slots=True)
class Altimeter(Record):
    """One instrument; NaN where nothing is published.

    Examples
    --------
    >>> from mgsgraph.geometry.altimetry import MOLA
    >>> MOLA.name, MOLA.footprint
    ('MOLA', 168.0)
    """

    name: str
    """As archives call it."""
    body: Ellipsoid | None
    """Sphere or ellipsoid of the body that it ranged to; None for any."""
    divergence: float
    """rad, full width of the beam."""
    footprint: float
    """m, diameter of its spots from the height of its orbit; NaN for an eccentric orbit, whose ranges tell."""
    range_sigma: float
    """m, of a range, where a case says none."""
    ground_sigma: float
    """m, of a footprint in each direction, where a case says none."""
    noise: str
    """Which returns don't count as ground."""
    sources: str
    """Of these figures."""
    height_sphere: float = _UNKNOWN
    """m, radius of the sphere above which tables with heights alone have them."""
    mission: tuple[float, float] = YEARS
    """s TDB past J2000, between which its spacecraft flew: from launch to loss."""
    reach: tuple[float, float] = (0.0, float("inf"))
    """m, between which its ranges lie, with room to spare: from its lowest orbits to where its echoes are lost."""

    def spot(self, ranges: Array) -> float:
        """m, diameter of its spots on the ground that lies at ranges (n,) in m; NaN where nothing tells."""
        if np.isfinite(self.footprint) or not np.any(np.isfinite(ranges)):
            return self.footprint
        return self.divergence * float(np.nanmedian(ranges))


MOLA = Altimeter(
    "MOLA", Ellipsoid(3396.19 * KM, 3376.2 * KM), 0.42 * MRAD, 168.0, 10.0, 10.0,
    "shots that are no ground by the archive's class: noise and clouds",
    "spots 168 m, 0.42 mrad from 400 km: Smith et al. (2001), Neumann et al. (2003); 10 m: Yoon & Shan (2005)",
    mission=_flight("1996-11-07", "2006-11-03"), reach=(80.0 * KM, 1000.0 * KM),
)  # fmt: skip
LOLA = Altimeter(
    "LOLA", Ellipsoid(1737.4 * KM, 1737.4 * KM), 0.1 * MRAD, 5.0, 1.0, 20.0,
    "spots with any of the flag's lowest eight bits, or without a radius",
    "spots 5 m, 0.1 mrad from 50 km: Smith et al. (2010); ranges below 1 m, orbits to 20 m: table 1 of "
    "doi:10.1155/2018/5363797", mission=_flight("2009-06-18", "2050-01-01"), reach=(5.0 * KM, 500.0 * KM),
)  # fmt: skip
LALT = Altimeter(
    "LALT", Ellipsoid(1737.4 * KM, 1737.4 * KM), 0.4 * MRAD, 40.0, 5.0, 50.0,
    "none: its table has ground returns",
    "spots 40 m, 0.4 mrad from 100 km: Tazawa et al. (2009); 5 m: Araki et al. (2008); orbits to 50 m: table 1 of "
    "doi:10.1155/2018/5363797", 1737.4 * KM, _flight("2007-09-14", "2009-06-12"), (5.0 * KM, 500.0 * KM),
)  # fmt: skip
MLA = Altimeter(
    "MLA", Ellipsoid(2439.4 * KM, 2439.4 * KM), 0.08 * MRAD, _UNKNOWN, 1.0, _UNKNOWN,
    "channels above 4",
    "0.08 mrad: PDS, instrument mess.mla; 2439.4 km: USGS, ode_csv2shapefile.py; channels: pyXover (steo85it)",
    mission=_flight("2004-08-03", "2015-05-02"), reach=(5.0 * KM, 3000.0 * KM),
)  # fmt: skip
ANY = Altimeter("an altimeter", None, _UNKNOWN, _UNKNOWN, _UNKNOWN, _UNKNOWN, "shots with ground = 0", "")
"""One of which the file says nothing."""
ALTIMETERS = {altimeter.name: altimeter for altimeter in (MOLA, LOLA, LALT, MLA)}
"""By name."""


_HALF_LIGHT = 0.5 * SPEED_OF_LIGHT
"""m/s, by which a range is longer for an echo that comes a second later."""
_FAR_OFF = 3.0
"""Times by which lengths may be longer or shorter than expected, before their unit is doubted."""
_SAME_TIME, _SAME_PLACE = 1e-5, 1e-2
"""s and m, by which the same shot may differ between two files."""
_FIRST_MINUTE = 10**11
"""Numbers of crossings from which on they are a year to a minute."""
SPOT_WIDTHS = 4.0
"""Standard deviations of the Gaussian energy in a laser spot's diameter."""


def require_lengths(lengths: Array, expected: Array, what: str, source: str, near: float = _FAR_OFF) -> None:
    """Raise InputError where lengths (n,) in m are more than `near` times those expected (n,) in m, or less, by the
    median ratio, which says whether metres and kilometres were exchanged.
    """
    ratio = float(np.median(lengths / expected))
    if 1.0 / near < ratio < near:
        return
    remedy = exchanged_units(ratio) or "check file and images"
    raise InputError(
        source, f"{what} of {np.median(lengths) / 1e3:,.6g} km (median), {ratio:,.4g} times what they should be",
        f"about {np.median(expected) / 1e3:,.6g} km", remedy,
    )  # fmt: skip


def exchanged_units(ratio: float) -> str:
    """What to fix where a length is so many times what it should be; empty where no unit explains it."""
    units = {1000.0: "metres stand where the format has kilometres", 0.001: "kilometres stand where it has metres"}
    exchanged = [words for factor, words in units.items() if abs(ratio / factor - 1.0) < 0.5]
    return f"{exchanged[0]}: fix the unit" if exchanged else ""


def require_on_body(footprints: Array, body: Ellipsoid, source: str, names: Sequence[str] = ()) -> None:
    """Raise InputError where footprints (n, 3) in m are not near the ellipsoid of the images' body (`nearness`), by
    their median or any of them, which are called so.
    """
    radii = distances(footprints)
    require_lengths(radii, surface_radii(footprints, body), "radii", source, nearness(body))
    require_near(radii, body, lambda k: f"{source}, {names[k] if names else f'point {k + 1}'}")


def _minute(number: int) -> str:
    digits = f"{number:012d}"
    return f"{digits[:4]}-{digits[4:6]}-{digits[6:8]}T{digits[8:10]}:{digits[10:]}"


def footprint_covariances(footprints: Array, horizontal: float, vertical: float | Array) -> Array:
    """(n, 3, 3) m^2 of footprints (n, 3) with one sigma (m) east and north and another one, or others (n,), upward."""
    outward = unit_vectors(footprints)
    more = (np.asarray(vertical)[..., None, None] ** 2 - horizontal**2) * outward[:, :, None] * outward[:, None]
    return np.asarray(horizontal**2 * np.eye(3) + more)


def with_common_errors(sigmas: Array | float, covariances: Array, errors: Array) -> tuple[Array, Array, Array]:
    """Ranges of `sigmas` (n,), m, and footprints of `covariances` (n, 3, 3), m^2, with one more error in common, which
    takes a footprint as far on along the beam as it makes the range too long: one sigma of it (n, 3) in m, along the
    beam away from the instrument. Returned are the sigmas that remain where the footprint is known, covariances of the
    footprints, and what of the footprint's error each range has, too (n, 3), m per m.
    """
    whole = covariances + errors[:, :, None] * errors[:, None]
    lengths = np.linalg.norm(errors, axis=1)
    shares = np.linalg.solve(whole, (lengths[:, None] * errors)[:, :, None])[:, :, 0]
    remain = lengths * (lengths - np.einsum("ni,ni->n", shares, errors))
    return np.sqrt(np.square(sigmas) + remain), whole, shares


@dataclass(frozen=True, slots=True, eq=False)
class LaserProfile(Record):
    """Laser shots, struct of arrays; the footprints' covariances are a-priori knowledge of the ground points.

    Examples
    --------
    >>> laser = pair.laser
    >>> print(laser)
    LaserProfile(8 shots, 16 image measures, from simulated pair)
    >>> laser.ids[0], float(laser.ranges[0].round(1))
    ('SHOT00001', 379871.6)
    """

    source: str
    """File they come from, for messages."""
    ids: Names
    """(n) names, each once; made of any sequence of them."""
    times: Array
    """(n,) s TDB past J2000, time of the shot."""
    ranges: Array
    """(n,) m, one-way, from the instrument to the footprint."""
    range_sigmas: Array
    """(n,) m, positive."""
    footprints: Array
    """(n, 3) m, body-fixed."""
    covariances: Array
    """(n, 3, 3) m^2, body-fixed, positive definite."""
    simultaneous_shot: Index
    """(r,) index of a shot that has images taken from the same place at the same time, in order of the shots."""
    simultaneous_image: RepeatedNames
    """(r) name of such an image, whose orientation carries the range; made of any sequence of them."""
    measure_shot: Index
    """(k,) index of the shot measured."""
    measure_image: RepeatedNames
    """(k) name of the image; made of any sequence of them."""
    measures: Array
    """(k, 2) line, sample, first pixel's centre at (0.5, 0.5)."""
    shares: Array | None = None
    """(n, 3) m per m, how much of the error of its footprint each range has, too; `range_sigmas` are then of the rest,
    which is independent of that error."""

    def __post_init__(self) -> None:
        measured, along = RepeatedNames.of(self.measure_image), RepeatedNames.of(self.simultaneous_image)
        assign(self, ids=Names.of(self.ids, self.source), measure_image=measured, simultaneous_image=along)
        n, k = len(self.ids), len(self.measure_image)
        require_names(self.ids, self.source)
        ranges = frozen(self.ranges, f"{self.source}, ranges", (n,))
        sigmas = frozen(self.range_sigmas, f"{self.source}, range sigmas", (n,))
        for what, values in (("range", ranges), ("range sigma", sigmas)):
            for i in np.flatnonzero(values <= 0.0)[:1]:
                raise InputError(f"{self.source}, shot {self.ids[i]}", f"{what} {values[i]} m", "a positive number")
        covariances = frozen(self.covariances, f"{self.source}, covariances", (n, 3, 3))
        require_covariances(covariances, np.ones(n, dtype=bool), self.ids, self.source)
        assign(
            self,
            times=frozen(self.times, f"{self.source}, times", (n,)),
            ranges=ranges,
            range_sigmas=sigmas,
            footprints=frozen(self.footprints, f"{self.source}, footprints", (n, 3)),
            covariances=covariances,
            simultaneous_shot=frozen_index(self.simultaneous_shot, f"{self.source}, images", len(along), n),
            measure_shot=frozen_index(self.measure_shot, f"{self.source}, measures", k, n),
            measures=frozen(self.measures, f"{self.source}, measures", (k, 2)),
            shares=None if self.shares is None else frozen(self.shares, f"{self.source}, shares", (n, 3)),
        )

    def __repr__(self) -> str:
        return f"LaserProfile({len(self.ids)} shots, {len(self.measure_image)} image measures, from {self.source})"


@dataclass(frozen=True, slots=True, eq=False)
class AltimeterShots(Record):
    """Altimeter shots as their archive holds them, struct of arrays; NaN where a source doesn't say.

    Examples
    --------
    >>> shots = mgsgraph.read_shots(Path("gusev/ap18933l.b"))
    >>> shots.altimeter.name, shots.profile_names()[0], int(shots.ground.sum())
    ('MOLA', '18933', 272)
    >>> near = shots.chosen(np.arange(10))
    >>> near.footprints.shape, near.ranges[:2].round(0)
    ((10, 3), array([382739., 382739.]))
    """

    source: str
    """File they come from, for messages."""
    orbits: Index
    """(n,) orbit, as the archive counts it, or year to minute (YYYYMMDDhhmm, UTC) in which a crossing began where it
    counts none; 0 where the source says neither."""
    frames: Index
    """(n,) number of the frame (or line) in its file, from 1; of LOLA's tables second of the mission and shot in it."""
    shots: Index
    """(n,) number of the shot in its frame, from 1; LOLA's spot."""
    times: Array
    """(n,) s TDB past J2000."""
    footprints: Array
    """(n, 3) m, body-fixed."""
    areoid_radii: Array
    """(n,) m, radius of the areoid under the footprint; NaN where unknown."""
    ranges: Array
    """(n,) m, one-way; NaN where there is none."""
    range_corrections: Array
    """(n,) m, as archived and not applied here; NaN where unknown."""
    spacecraft: Array
    """(n, 3) m, body-fixed place of the spacecraft; NaN where unknown."""
    off_nadir: Array
    """(n,) rad; NaN where unknown."""
    ground: Mask
    """(n,) True for a return from the ground, False for noise and clouds."""
    channels: Index
    """(n,) receiver channel 1 .. 4 that triggered; 0 where unknown."""
    clocks: Array
    """(n,) Hz, the altimeter's clock; NaN where unknown."""
    pulses: Array
    """(n,) s, standard deviation of the optical echo, which slopes and roughness in the spot make broad; NaN where
    unknown."""
    altimeter: Altimeter = MOLA
    """The instrument."""

    def __post_init__(self) -> None:
        n = np.size(self.times)
        times = frozen(self.times, f"{self.source}, times", (n,))
        numbers = {
            name: frozen_index(getattr(self, name), f"{self.source}, {name}", n, 2**62)
            for name in ("orbits", "frames", "shots", "channels")
        }
        order = np.lexsort([numbers["shots"], numbers["frames"], numbers["orbits"]])
        same = np.ones(max(n - 1, 0), dtype=bool)
        for name in ("orbits", "frames", "shots"):
            same &= np.diff(numbers[name][order]) == 0
        for k in np.flatnonzero(same)[:1]:
            shot = ":".join(str(numbers[name][order[k]]) for name in ("orbits", "frames", "shots"))
            raise InputError(self.source, f"the shot {shot} twice", "each shot once")
        partly = {
            name: _with_gaps(getattr(self, name), f"{self.source}, {name}", shape)
            for name, shape in (
                ("areoid_radii", (n,)), ("ranges", (n,)), ("range_corrections", (n,)), ("off_nadir", (n,)),
                ("clocks", (n,)), ("pulses", (n,)), ("spacecraft", (n, 3)),
            )
        }
        for k in np.flatnonzero(partly["ranges"] <= 0.0)[:1]:
            raise InputError(self.source, f"range {partly['ranges'][k]} m", "a positive range, or NaN for none")
        ground = frozen_mask(self.ground, f"{self.source}, ground", n)
        footprints = frozen(self.footprints, f"{self.source}, footprints", (n, 3))
        assign(self, times=times, footprints=footprints, ground=ground, **numbers, **partly)

    @property
    def ids(self) -> Names:
        """(n) names "orbit:frame:shot", each once in a file."""
        return Names.joined(self.orbits, self.frames, self.shots)

    def profile_names(self) -> RepeatedNames:
        """(n) of each shot, what its profile is called: the orbit's number, or the minute in which a crossing began."""
        orbits, numbers = np.unique(self.orbits, return_inverse=True)
        names = (_minute(orbit) if orbit >= _FIRST_MINUTE else str(orbit) for orbit in orbits.tolist())
        return RepeatedNames(tuple(names), numbers)

    @property
    def spacing(self) -> float:
        """m, median distance between footprints that follow each other within 0.15 s in one orbit; NaN without any."""
        order = np.lexsort([self.times, self.orbits])
        places, times = self.footprints[order], self.times[order]
        near = (np.diff(times) < 0.15) & (np.diff(times) > 0.0) & (np.diff(self.orbits[order]) == 0)
        steps = np.linalg.norm(np.diff(places, axis=0), axis=1)[near]
        return float(np.median(steps)) if steps.size else float("nan")

    def chosen(self, which: Mask | Index) -> "AltimeterShots":
        """The shots of a mask (n,) or of indices, in their order."""
        names = [field.name for field in fields(self) if field.name not in ("source", "altimeter")]
        some: dict[str, Any] = {name: read_only(getattr(self, name)[which]) for name in names}
        return replace(self, **some)

    def moved(self, footprints: Array, spacecraft: Array) -> "AltimeterShots":
        """The same shots with other places (n, 3) in m, body-fixed, of footprints and spacecraft."""
        return replace(self, footprints=footprints, spacecraft=spacecraft)

    def profile(
        self,
        range_sigma: float,
        ground_sigma: float,
        simultaneous: str | None = None,
        name: str = "",
        height_sigma: float | None = None,
        pulse_share: float = 0.0,
    ) -> LaserProfile:
        """The shots as observations of an adjustment, without image measures.

        Parameters
        ----------
        range_sigma : float
            m, of each range.
        ground_sigma : float
            m, of each footprint in each of the three directions (Yoon & Shan 2005: 10 m both).
        simultaneous : str, optional
            Image taken along with the shots, whose orientation carries the ranges; none when absent.
        name : str
            Put before the shots' names, where profiles of several files meet.
        height_sigma : float, optional
            m, of each footprint's height; `ground_sigma` when absent.
        pulse_share : float
            Sigma of a range's further error, in standard deviations of its echo. The footprint follows from the range
            and has the same error along the beam: what the two have in common.

        Raises
        ------
        InputError
            Where a shot has no range: leave it out with ``chosen`` first.
        """
        for k in np.flatnonzero(np.isnan(self.ranges))[:1]:
            raise InputError(
                f"{self.source}, shot {self.ids[k]}", "no range", "shots with ranges", "choose those that have one"
            )
        n = self.times.size
        ids = self.ids
        broad = pulse_share * _HALF_LIGHT * np.nan_to_num(self.pulses)
        beams = unit_vectors(
            np.where(np.isfinite(self.spacecraft), self.footprints - self.spacecraft, -self.footprints)
        )
        covariances = footprint_covariances(self.footprints, ground_sigma, height_sigma or ground_sigma)
        sigmas, covariances, shares = with_common_errors(range_sigma, covariances, broad[:, None] * beams)
        return LaserProfile(
            source=self.source,
            ids=ids.prefixed(f"{name}:") if name else ids,
            times=self.times,
            ranges=self.ranges,
            range_sigmas=sigmas,
            footprints=self.footprints,
            covariances=covariances,
            simultaneous_shot=np.arange(n if simultaneous else 0),
            simultaneous_image=RepeatedNames((simultaneous or "",), np.zeros(n if simultaneous else 0, dtype=np.int64)),
            measure_shot=no_rows(),
            measure_image=RepeatedNames.of(()),
            measures=np.zeros((0, 2)),
            shares=shares if np.any(broad) else None,
        )

    def __repr__(self) -> str:
        orbits = np.unique(self.orbits).size
        count = f"{self.times.size} shots, {int(self.ground.sum())} on the ground, {orbits} orbits"
        return f"AltimeterShots({self.altimeter.name}: {count})"


def joined_shots(parts: Sequence[AltimeterShots]) -> AltimeterShots:
    """Shots of several files of one altimeter, in the order of time; those that several files have are there once.

    Where files give the same number to other shots (lines of tables), frames are renumbered.
    """
    names = {part.altimeter.name: part.source for part in parts}
    if len(names) > 1:
        found = " and ".join(f"{source} ({name})" for name, source in names.items())
        raise InputError(found, "shots of several altimeters", "files of one", "select them one after the other")
    values = {
        field.name: np.concatenate([getattr(part, field.name) for part in parts])
        for field in fields(AltimeterShots) if field.name not in ("source", "altimeter")
    }  # fmt: skip
    places = np.round(values["footprints"] / _SAME_PLACE).astype(np.int64)
    keys = np.column_stack([np.round(values["times"] / _SAME_TIME).astype(np.int64), places])
    _, first = np.unique(keys, axis=0, return_index=True)
    values = {name: value[first] for name, value in values.items()}
    numbers = np.column_stack([values[name] for name in ("orbits", "frames", "shots")])
    if len(np.unique(numbers, axis=0)) < len(numbers):
        values["frames"] = np.arange(1, len(numbers) + 1)
    return AltimeterShots(source=parts[0].source, altimeter=parts[0].altimeter, **values)


@dataclass(frozen=True, slots=True, eq=False)
class AltimetryCloud(Record):
    r"""Ground returns of a laser altimeter, profile by profile, struct of arrays: control that needs no image.

    Examples
    --------
    >>> _ = Path("cloud.csv").write_text("x_m,y_m,z_m,id,profile\n171000.0,3382000.0,248000.0,1,9000\n")
    >>> cloud = mgsgraph.read_altimetry_cloud(Path("cloud.csv"), network.body)
    >>> cloud.profiles, cloud.points.shape
    (('9000',), (1, 3))
    """

    source: str
    """File they come from, for messages."""
    ids: Names
    """(n) names, each once; made of any sequence of them."""
    points: Array
    """(n, 3) m, body-fixed."""
    times: Array
    """(n,) s TDB past J2000, in which shots of a profile follow one another; NaN where unknown: then in the file's
    order."""
    profiles: tuple[str, ...]
    """(p) names, each once: shots of one crossing, which have their errors of place in common."""
    profile: Index
    """(n,) index of the profile."""
    footprint: float = float("nan")
    """m, diameter of the laser's spot on the ground; NaN where unknown."""

    def __post_init__(self) -> None:
        assign(self, ids=Names.of(self.ids, self.source))
        n = len(self.ids)
        require_names(self.ids, self.source)
        require_names(self.profiles, f"{self.source}, profiles")
        times = _with_gaps(self.times, f"{self.source}, times", (n,))
        profile = frozen_index(self.profile, f"{self.source}, profile", n, len(self.profiles))
        order = np.argsort(profile, kind="stable")
        back = (np.diff(times[order]) < 0.0) & (np.diff(profile[order]) == 0)
        for k in np.flatnonzero(back)[:1]:
            shot, name = self.ids[order[k + 1]], self.profiles[profile[order[k]]]
            raise InputError(f"{self.source}, profile {name}", f"shot {shot} before its time", "shots in order of time")
        if self.footprint <= 0.0:
            raise InputError(f"{self.source}, footprint", f"{self.footprint} m", "a positive diameter")
        points = frozen(self.points, f"{self.source}, points", (n, 3))
        assign(self, points=points, times=times, profile=profile)

    def chosen(self, which: Mask) -> "AltimetryCloud":
        """The shots of a mask (n,), and of the profiles those that still have any."""
        profiles, profile = np.unique(self.profile[which], return_inverse=True)
        return replace(
            self,
            ids=self.ids[which],
            points=self.points[which],
            times=self.times[which],
            profiles=tuple(self.profiles[k] for k in profiles),
            profile=profile,
        )

    def __repr__(self) -> str:
        return f"AltimetryCloud({len(self.ids)} shots, {len(self.profiles)} profiles, from {self.source})"


def _with_gaps(value: Array, where: str, shape: tuple[int, ...]) -> Array:
    """Copy to a read-only float64 array of a shape, in which NaN stands for what is not known; what nobody can write to
    is not copied.
    """
    array = of_kind(value, np.float64)
    require(array.shape == shape, where, f"an array of shape {array.shape}", f"shape {shape}")
    require(not np.any(np.isinf(array)), where, "an infinite value", "finite numbers, or NaN where unknown")
    return read_only(array)

"""Tables of shots over images: profiles for the eye, and the selection, which `altimetry.shots` reads back."""

import numpy as np

from mgsgraph.files.output.table import Column, Table, numbers
from mgsgraph.files.writing import begins
from mgsgraph.geometry.body import planetocentric
from mgsgraph.geometry.records import Mask
from mgsgraph.geometry.time_scales import utc_of_tdb, utc_texts
from mgsgraph.names import RepeatedNames
from mgsgraph.registration.crossings import Crossing, ShotsOverImages
from mgsgraph.text import many
from mgsgraph.units import DEG, MILLISECOND

_DAY = 86400.0
_MINUTES = "%Y-%m-%dT%H:%M"


def crossings_table(found: tuple[Crossing, ...]) -> Table:
    """One row for each image and profile that crosses it or was taken along."""
    return Table("crossings", "Laser profiles over images", (
        Column("image", [one.image for one in found], meaning="its name", text="<24"),
        Column("profile", [one.profile for one in found], meaning="orbit, or the minute it began", text="<17", gap=2),
        Column(
            "utc", [f"{utc_of_tdb(one.start):{_MINUTES}}" for one in found], text="<16", gap=2,
            meaning="of its first shot inside",
        ),
        Column("shots", numbers(found, "shots").astype(np.int64), meaning="of the profile", text=">7"),
        Column("inside", numbers(found, "inside").astype(np.int64), meaning="of them in the image", text=">7"),
        Column(
            "simultaneous", numbers(found, "simultaneous").astype(np.int64), text=">7", label="along",
            meaning="of them fired while the image was taken",
        ),
        Column("off_nadir", numbers(found, "off_nadir"), "deg", "median of those inside", text=">9.2f"),
        Column(
            "from_image", numbers(found, "seconds") / _DAY, "d", "from the image's nearest line, negative before it",
            text=">12.3f", label="from image",
        ),
    ))  # fmt: skip


SELECTION = begins("a selection of mgsgraph shots", "altimeter,profile,utc,images,simultaneous,orbit,")
"""Tables of `selection_table`, by their columns."""


def selection_table(over: ShotsOverImages) -> Table:
    """Shots that fall in an image, with all that `altimetry.shots.read_shots` takes back; what is empty is unknown."""
    shots, rows = over.shots.chosen(over.chosen), over.chosen
    longitude, latitude, radius = planetocentric(shots.footprints).T

    def names(which: Mask) -> RepeatedNames:
        seen, numbers = np.unique(which[:, rows], axis=1, return_inverse=True)
        texts = RepeatedNames.of([";".join(over.images[j].name for j in np.flatnonzero(one)) for one in seen.T])
        return texts[numbers.ravel()]

    return Table("shots", "Laser shots over images", (
        Column("altimeter", RepeatedNames((shots.altimeter.name,), np.zeros(rows.size, dtype=np.int64))),
        Column("profile", shots.profile_names(), meaning="orbit, or the minute (UTC) in which a crossing began"),
        Column("utc", utc_texts(shots.times + 0.5 * MILLISECOND)),
        Column("images", names(over.inside), meaning="in which the footprint falls"),
        Column("simultaneous", names(over.inside & (over.seconds == 0.0)), meaning="those taken while it was fired"),
        Column("orbit", shots.orbits), Column("frame", shots.frames), Column("shot", shots.shots),
        Column("ground", shots.ground.astype(np.int64), meaning="1 for a return from the ground, 0 for noise"),
        Column("channel", shots.channels, meaning="that triggered; 0 where unknown"),
        Column("time", shots.times, "s", "TDB past J2000"),
        Column("longitude", longitude / DEG % 360.0, "deg", "planetocentric, east", scale=1.0),
        Column("latitude", latitude, "deg", "planetocentric"),
        Column("radius", radius, "m"),
        Column("range", shots.ranges, "m", "one-way"),
        Column("range_correction", shots.range_corrections, "m", "as archived, not applied"),
        Column("areoid_radius", shots.areoid_radii, "m"),
        Column("spacecraft_{}", shots.spacecraft, "m", "body-fixed", parts=("x", "y", "z")),
        Column("off_nadir", shots.off_nadir, "deg"),
        Column("clock", shots.clocks, "Hz", "the altimeter's"),
        Column("pulse", shots.pulses, "s", "standard deviation of the echo"),
    ))  # fmt: skip


def crossing_sentences(over: ShotsOverImages, found: tuple[Crossing, ...]) -> list[str]:
    """What was found, with figures."""
    said = list[str]()
    for image in over.images:
        mine = [one for one in found if one.image == image.name]
        inside = [one for one in mine if one.inside]
        along = [one for one in inside if one.simultaneous]
        beside = [one.profile for one in mine if one.simultaneous and not one.inside]
        count = f"{many(sum(one.inside for one in inside), 'shot')} of {many(len(inside), 'profile')} fall in it"
        names = ", ".join(one.profile for one in along)
        words = f", {names} taken along with it" if along else ", none taken along with it"
        off = f"; beside it, taken along: {', '.join(beside)}" if beside else ""
        said.append(f"{image.name}: {count + words if inside else 'no shot falls in it'}{off}")
    return said

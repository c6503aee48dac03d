"""A-priori sigmas of orbit and pointing by mission, and who published the accuracy behind each.

Each sigma holds along each body-fixed axis, or about each axis of the camera. Of an accuracy of the total position each
axis gets the whole. Where a paper states the error of images on the ground alone, orbit and pointing each get all of
it. References: docs/case_file.md.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from mgsgraph.units import ARCSEC, MRAD


@dataclass(frozen=True, slots=True)
class Accuracy:
    """How well a mission's kernels know the position and attitude of its cameras."""

    mission: str
    """As in ISIS's serial numbers; "other missions" where none is in the table."""
    orbit: float
    """m, sigma along each body-fixed axis."""
    orbit_source: str
    pointing: tuple[float, ...]
    """mrad, sigma about the camera's axes: one for all, or three."""
    pointing_source: str

    @property
    def words(self) -> str:
        """Both sigmas with their sources."""
        sources = f" ({self.orbit_source})", f" ({self.pointing_source})"
        return f"{self.mission}: {sigmas_in_words([self.orbit], self.pointing, sources)}"

    @property
    def keys(self) -> tuple[str, str]:
        """The keys of [orientation] that state them."""
        angle = f"[{numbers(self.pointing)}]" if len(self.pointing) > 1 else numbers(self.pointing)
        return f"position_sigma_m = {self.orbit}", f"angle_sigma_mrad = {angle}"

    def lines(self) -> Iterator[str]:
        """These keys with comments, a line of TOML each."""
        meanings = ("constant term, body-fixed X, Y, Z", "constant term, about the camera's axes")
        sources = (f"orbit, {self.orbit_source}", f"pointing, {self.pointing_source}")
        for key, meaning, source in zip(self.keys, meanings, sources, strict=True):
            yield f"{key:39} # {meaning}; {self.mission}: {source}\n"


def sigmas_in_words(orbit: Sequence[float], pointing: Sequence[float], after: tuple[str, str] = ("", "")) -> str:
    """Sigmas in m and mrad, the latter as arcsec, each with a word after it."""
    arcsec = [float(f"{angle * MRAD / ARCSEC:.3g}") for angle in pointing]
    return f"orbit {numbers(orbit)} m{after[0]}, pointing {numbers(arcsec)} arcsec{after[1]}"


def numbers(values: Sequence[float]) -> str:
    """Numbers as a list has them, one where all are the same."""
    return ", ".join(f"{value:g}" for value in (values if len(set(values)) > 1 else values[:1]))


_OTHER = Accuracy("other missions", 100.0, "convention, no published accuracy known", (0.29,), "1 arcmin, convention")
_MISSIONS = {
    accuracy.mission: accuracy
    for accuracy in (
        Accuracy(
            "MGS", 100.0, "Yoon & Shan 2005", (0.29, 0.87, 0.87),
            "Yoon & Shan 2005: 1 arcmin; Shan et al. 2005: MOC 325 m off MOLA along the track",
        ),
        Accuracy(
            "MRO", 63.0, "Robbins et al. 2023: CTX within 155 m on the ground, 95 %", (0.22,),
            "the same from 290 km",
        ),
        Accuracy(
            "LRO", 20.0, "Mazarico et al. 2012: radio tracking", (0.4,),
            "Speyerer et al. 2012: NAC within 20 m on the ground, from 50 km",
        ),
        Accuracy(
            "KAGUYA", 50.0, "Goossens et al. 2009; kilometers in the extended mission, Goossens et al. 2020", (0.29,),
            "1 arcmin, convention",
        ),
        Accuracy(
            "MEX", 100.0, "Oberst et al. 2004: HRSC 100 m off MOLA", (0.44,), "Spiegel et al. 2006: 28 mgon",
        ),
    )
}  # fmt: skip


def accuracy_of(mission: str) -> Accuracy:
    """Of a mission, or the convention where none is known."""
    return _MISSIONS.get(mission, _OTHER)

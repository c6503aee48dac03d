"""A solution for another program: written, read back by code that shares nothing with the writer, and compared."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mgsgraph.adjustment.solution import Solution
from mgsgraph.errors import InputError
from mgsgraph.export import Target
from mgsgraph.export.round_trip import reprojection
from mgsgraph.files.output.csv_json import write_json
from mgsgraph.files.output.folders import EXPORT, PROGRAM, RECORD, fresh_folder
from mgsgraph.files.records import read_record, record_text
from mgsgraph.files.writing import write_file
from mgsgraph.geometry.records import Array
from mgsgraph.network import PointClass
from mgsgraph.results.archive import read_solution

FORMAT = 1
"""Version of export.json's layout."""
_FINE = 0.01
"""px, above which it is said that files are farther off than they should be."""
_SAME = 1e-6
"""m, by which adjusted points that come back may differ."""


@dataclass(frozen=True, slots=True)
class ExportSettings:
    """What a solution doesn't say of itself."""

    scaled: bool = False
    """Covariances and sigmas times sigma0^2 and sigma0, where a format has some."""
    support: Mapping[str, Path] | None = None
    """Image support data that images came from, by name: names, keywords and the Sun are taken over."""
    files: Mapping[str, str] = field(default_factory=dict)
    """File of each image, by name, for what is to be called like it."""
    networks: Sequence[Path] = ()
    """Networks that the points were read from, in place of those that the solution remembers."""
    raster: bool = False
    """Sigmas of new points over the images' overlap, too, as a GeoTIFF."""


class Exported(NamedTuple):
    """What was written and how it came back."""

    target: Target
    folder: Path
    files: tuple[str, ...]
    """Names in the folder."""
    measures: int
    """That were projected again through the files."""
    largest: float
    """px, largest difference of their places from the solution's; NaN where nothing was read back."""
    converged: bool = True
    """Whether the solution is."""
    noted: bool = True
    """Whether the solution's record says so, too; it can't where it may not be written."""
    notes: tuple[str, ...] = ()
    """What the files keep of those that the solution was made from, and what not, in sentences."""

    @property
    def sentence(self) -> str:
        """What came of it, in a sentence; what to beware of in more."""
        beware = {
            "They are farther off than they should be.": self.largest > _FINE,
            "The solution did NOT converge.": not self.converged,
            "This could not be noted in the solution's own record.": not self.noted,
        }
        said = f"{len(self.files)} files for {self.target.value}; {self._read_back}"
        return " ".join([said, *(words for words, holds in beware.items() if holds)])

    @property
    def _read_back(self) -> str:
        if self.target == Target.GIS:
            return "they hold no geometry of images to be read back."
        if not self.measures:
            return "no measure of a determined point is there to be read back."
        return (
            f"read back by code of its own, {self.measures} measures fall within {self.largest:.2g} px of where the "
            "solution has them."
        )


def export_solution(
    path: str | Path, target: Target | str, out: str | Path, settings: ExportSettings | None = None
) -> Exported:
    """Write a solution for another program, to a folder that appears whole or not at all, and read it back.

    The largest difference stands in the folder's export.json, and in the solution's own solution.json.

    Parameters
    ----------
    path : path
        Folder of a solution.
    target : Target or str
        One of `Target`, or its value.
    out : path
        Absent, empty, or an earlier export to the same target, which is replaced.
    settings : ExportSettings, optional

    Raises
    ------
    InputError
        No solution there, or one of another version; settings that the target has no use for; what the product can't
        hold, which is named; a folder that can't be written; a file that doesn't come back.

    Examples
    --------
    >>> done = mgsgraph.export_solution("RESULT", "csm", "csm")
    >>> print(*done.files)
    SIM_A.adjusted_state.json SIM_A.json SIM_B.adjusted_state.json SIM_B.json
    >>> done.largest < 1e-6  # pixels: read back and compared
    True
    """
    path, out, settings = Path(path), Path(out), settings or ExportSettings()
    target = target_of(target)
    _require_heeded(target, settings)
    _require_same_target(out, target)
    solution = read_solution(path)
    with fresh_folder(out, EXPORT) as aside, _called_as_asked(aside, out):
        written, compare, notes = _WRITERS[target](solution, aside, settings, path)
        differences = compare(solution, aside)
        names = tuple(sorted(file.relative_to(aside).as_posix() for file in written))
        largest = float(differences.max()) if differences.size else np.nan
        done = Exported(target, out, names, differences.size, largest, solution.converged, notes=notes)
        if lost := np.count_nonzero(~np.isfinite(differences)):
            raise InputError(
                f"export to {target.value}", f"{lost} measures don't come back",
                "all of them", "this is a fault of mgsgraph: report it",
            )
        write_json(aside / EXPORT, _record(done, solution, settings))
    return done._replace(noted=_note(path, done))


def _require_same_target(out: Path, target: Target) -> None:
    """Raise InputError where the folder holds an export to another target."""
    if not (out / EXPORT).is_file():  # no export: `fresh_folder` says what is there
        return
    earlier = read_record(out / EXPORT).get("target")
    if earlier != target.value:
        found = f"an export to {earlier}, which would be lost"
        raise InputError(str(out), found, f"one to {target.value}, or none", "choose another --out")


@contextmanager
def _called_as_asked(aside: Path, out: Path) -> Iterator[None]:
    """Errors of files name the folder that was asked for, not the one that is written to meanwhile."""
    try:
        yield
    except InputError as error:
        if not error.where.startswith(str(aside)):
            raise
        remedy = error.remedy or "free some space, or choose another --out"
        where = f"{out}{error.where.removeprefix(str(aside))}"
        raise InputError(where, error.found, error.expected, remedy) from None


def target_of(name: Target | str) -> Target:
    """The target of this name."""
    for target in Target:
        if name in (target, target.value):
            return target
    raise InputError("export, target", repr(name), ", ".join(target.value for target in Target))


def _require_heeded(target: Target, settings: ExportSettings) -> None:
    """Raise InputError for a setting that would do nothing."""
    for name, given, heeding in (
        ("scaled", settings.scaled, (Target.ISIS, Target.ASP)),
        ("raster", settings.raster, (Target.GIS,)),
        ("network", bool(settings.networks), (Target.ISIS,)),
        ("case", settings.support is not None or bool(settings.files), (Target.CSM, Target.ASP)),
    ):
        if given and target not in heeding:
            expected = f"it with {' or '.join(one.value for one in heeding)} alone"
            raise InputError(f"export to {target.value}, {name}", "nothing that heeds it", expected, "leave it out")


_Compare = Callable[[Solution, Path], Array]
_Written = tuple[Sequence[Path], _Compare, tuple[str, ...]]
"""Files, how to compare them, and what is to be said of them."""


def _spice(solution: Solution, folder: Path, settings: ExportSettings, path: Path) -> _Written:
    from mgsgraph.export.spice import write_spice
    from mgsgraph.export.spice_back import spice_differences

    return write_spice(solution, folder), lambda solution, folder: spice_differences(folder, reprojection(solution)), ()


def _csm(solution: Solution, folder: Path, settings: ExportSettings, path: Path, support: bool = True) -> _Written:
    from mgsgraph.export.csm import write_csm
    from mgsgraph.export.csm_back import csm_differences

    written = write_csm(solution, folder, settings.support, support, settings.files)
    return written, lambda solution, folder: csm_differences(folder, reprojection(solution)), ()


def _isis(solution: Solution, folder: Path, settings: ExportSettings, path: Path) -> _Written:
    from mgsgraph.export.control_back import control_differences
    from mgsgraph.export.isis import write_isis
    from mgsgraph.export.network_content import Sources, source_networks
    from mgsgraph.export.round_trip import measured_places

    def compare(solution: Solution, folder: Path) -> Array:
        found = control_differences(folder, measured_places(solution))
        # that points are seen where they should be says nothing of the places that are written
        return np.where(found.points <= _SAME, np.fmax(found.measured, found.predicted), np.inf)

    sources = Sources(None)
    if settings.networks or np.any(solution.network.points.classes == PointClass.TIE):
        sources = source_networks(path, settings.networks, solution.network.images[0].body)
    made = write_isis(solution, folder, settings.scaled, source=sources.network)
    return made.paths, compare, (*made.notes, *sources.notes)


def _asp(solution: Solution, folder: Path, settings: ExportSettings, path: Path) -> _Written:
    """Matches and control points, and the cameras that go with them."""
    from mgsgraph.export.asp import write_asp

    cameras, compare, _ = _csm(solution, folder, settings, path, support=False)
    return [*cameras, *write_asp(solution, folder, settings.files, scaled=settings.scaled)], compare, ()


def _gis(solution: Solution, folder: Path, settings: ExportSettings, path: Path) -> _Written:
    from mgsgraph.analysis.overlap_sigmas import sigma_grid
    from mgsgraph.analysis.posterior import Posterior
    from mgsgraph.export.gis import write_gis

    grid = sigma_grid(Posterior.of(solution)) if settings.raster else None
    return write_gis(solution, folder, grid), lambda solution, folder: np.zeros(0), ()


_WRITERS: dict[Target, Callable[[Solution, Path, ExportSettings, Path], _Written]] = {
    Target.SPICE: _spice,
    Target.CSM: _csm,
    Target.ISIS: _isis,
    Target.ASP: _asp,
    Target.GIS: _gis,
}


def _record(done: Exported, solution: Solution, settings: ExportSettings) -> dict[str, Any]:
    said = {"program": PROGRAM, "format": FORMAT, "name": solution.name, "converged": solution.converged}
    support = {name: str(path) for name, path in (settings.support or {}).items()}
    return {**said, **_figures(done), "scaled": settings.scaled, "support": support, "notes": list(done.notes),
            "files": list(done.files)}  # fmt: skip


def _figures(done: Exported) -> dict[str, Any]:
    largest = None if np.isnan(done.largest) else done.largest
    return {"target": done.target.value, "measures": done.measures, "largest_difference_px": largest}


def _note(path: Path, done: Exported) -> bool:
    """Say in the solution's record what was exported last for each target, and how it came back; False where that is
    damaged, absent (then the export alone says it) or not to be written.
    """
    file = (path if path.is_dir() else path.parent) / RECORD
    try:
        record = read_record(file)
        earlier = dict(record.get("exports", {}))
    except (ValueError, TypeError):
        return False
    exports = {**earlier, done.target.value: {**_figures(done), "folder": str(done.folder)}}
    try:
        write_file(file, record_text({**record, "exports": exports}))
    except InputError:
        return False  # the export is there all the same
    return True

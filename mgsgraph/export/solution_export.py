"""A solution for another program, written to a folder that appears whole or not at all."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from platform import node
from typing import Any, NamedTuple

import numpy as np

from mgsgraph.adjustment.solution import Solution
from mgsgraph.errors import InputError, require
from mgsgraph.export import Target
from mgsgraph.files.output.folders import EXPORT, PROGRAM, RECORD, fresh_folder
from mgsgraph.files.output.table import write_json
from mgsgraph.files.writing import account, read_record
from mgsgraph.network import PointClass
from mgsgraph.record import Record
from mgsgraph.results.archive import read_solution
from mgsgraph.text import many

FORMAT = 1
"""Version of export.json's layout."""
_FINE = 0.01
"""px, above which it is said that files are farther off than they should be."""


@dataclass(frozen=True, slots=True)
class ExportSettings(Record):
    """Settings that a solution doesn't hold.

    Examples
    --------
    >>> settings = mgsgraph.ExportSettings(scaled=True)
    >>> done = mgsgraph.export_solution("RESULT", "isis", "scaled", settings)
    >>> done.files[0]
    'bundleout_images.csv'
    """

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
    verify: bool = False
    """Read kernels back by SPICE alone, and compare them with the solution."""
    case: Path | None = None
    """Case file that names the ISIS cubes; the one that the solution remembers where it is left out."""
    update: bool = False
    """Replace these cubes by their adjusted copies, one after another, once all copies are as they should be."""


class Exported(NamedTuple):
    """Files written, and differences of kernels that were read back."""

    target: Target
    folder: Path
    files: tuple[str, ...]
    """Names in the folder."""
    measures: int = 0
    """That were projected again through the files; 0 where nothing was read back."""
    largest: float = np.nan
    """px, largest difference of their image coordinates from the solution's; NaN where nothing was read back."""
    converged: bool = True
    """Whether the solution is."""
    notes: tuple[str, ...] = ()
    """What the files keep of those that the solution was made from, and what not, in sentences."""

    @property
    def sentence(self) -> str:
        """The result in a sentence, and sentences of caution."""
        beware = {
            "They are farther off than they should be.": self.largest > _FINE,
            "The solution did NOT converge.": not self.converged,
        }
        written = f"{many(len(self.files), 'file')} for {self.target.value}"
        if self.measures:
            written += (
                f"; read back by SPICE alone, {self.measures} measures fall within {self.largest:.2g} px of where the "
                "solution has them"
            )
        return " ".join([f"{written}.", *(words for words, holds in beware.items() if holds)])


def export_solution(
    path: str | Path, target: Target | str, out: str | Path, settings: ExportSettings | None = None
) -> Exported:
    """Write a solution for another program, to a folder that appears whole or not at all.

    What was exported stands in the folder's export.json.

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
        hold, which is named; a folder that can't be written; kernels that don't show a point, when they are verified.

    Examples
    --------
    >>> done = mgsgraph.export_solution("RESULT", "csm", "csm")
    >>> print(*done.files)
    SIM_A.adjusted_state.json SIM_A.json SIM_B.adjusted_state.json SIM_B.json
    """
    with exporting(Path(path), target_of(target), Path(out), settings or ExportSettings()) as done:
        return done


@contextmanager
def exporting(path: Path, target: Target, out: Path, settings: ExportSettings) -> Iterator[Exported]:
    """The same, written when this is entered, and put in its place at the end: of several exports all or none."""
    require_supported((target,), settings)
    _require_same_target(out, target)
    solution = read_solution(path)
    with fresh_folder(out, EXPORT) as temporary, _called_as_asked(temporary, out):
        output = _WRITERS[target](solution, temporary, settings, path)
        if any(original.resolve().parent == out.resolve() for _, original in output.originals):
            raise InputError(str(out), "cubes of the case lie in it", "another folder for their copies")
        names = tuple(sorted(file.relative_to(temporary).as_posix() for file in output.paths))
        done = Exported(target, out, names, converged=solution.converged, notes=output.notes)
        if settings.verify:
            done = _verified(done, solution, temporary)
        write_json(temporary / EXPORT, _record(done, solution, settings))
        replaced = [(out / copy.relative_to(temporary), original) for copy, original in output.originals]
        yield done
    if settings.update:
        from mgsgraph.export.cubes import replace_cubes

        replace_cubes(replaced)


def _verified(done: Exported, solution: Solution, folder: Path) -> Exported:
    """With differences of kernels read by SPICE alone; InputError where they don't show a point."""
    from mgsgraph.export.spice_back import spice_differences
    from mgsgraph.export.spice_nodes import reprojection

    differences = spice_differences(folder, reprojection(solution))
    if missing := np.count_nonzero(~np.isfinite(differences)):
        raise InputError(
            f"export to {done.target.value}", f"{missing} measures don't come back",
            "all of them", "this is a fault of mgsgraph: report it",
        )
    return done._replace(measures=differences.size, largest=float(differences.max()) if differences.size else np.nan)


def _require_same_target(out: Path, target: Target) -> None:
    """Raise InputError where the folder holds an export to another target."""
    if not (out / EXPORT).is_file():  # no export: `fresh_folder` says what is there
        return
    present = read_record(out / EXPORT).get("target")
    found = f"an export to {present}, which would be lost"
    require(present == target.value, str(out), found, f"one to {target.value}, or none", "choose another --out")


@contextmanager
def _called_as_asked(temporary: Path, out: Path) -> Iterator[None]:
    """Errors of files name the output folder, not the temporary one."""
    try:
        yield
    except InputError as error:
        if not error.where.startswith(str(temporary)):
            raise
        remedy = error.remedy or "free some space, or choose another --out"
        where = f"{out}{error.where.removeprefix(str(temporary))}"
        raise InputError(where, error.found, error.expected, remedy) from None


def target_of(name: Target | str) -> Target:
    """The target of this name."""
    require(name in list(Target), "export, target", repr(name), ", ".join(Target))
    return Target(name)


def require_supported(targets: Sequence[Target], settings: ExportSettings) -> None:
    """Raise InputError for a setting that would do nothing with any of the targets."""
    for name, (option, used_by) in _USED_BY.items():
        if getattr(settings, name) not in (getattr(_DEFAULT, name), []) and not set(targets) & set(used_by):
            where, expected = (" or ".join(target.value for target in several) for several in (targets, used_by))
            found, remedy = "an option that it ignores", "leave it out"
            raise InputError(f"export to {where}, {option}", found, f"it with {expected} alone", remedy)


def settings_for(target: Target, settings: ExportSettings) -> ExportSettings:
    """The settings that a target uses, out of those of several targets."""
    unused = [name for name, (_, used_by) in _USED_BY.items() if target not in used_by]
    return replace(settings, **{name: getattr(_DEFAULT, name) for name in unused})


_DEFAULT = ExportSettings()
_USED_BY = {
    "scaled": ("scaled", (Target.ISIS, Target.ASP)), "raster": ("raster", (Target.GIS,)),
    "networks": ("ties", (Target.ISIS,)), "verify": ("verify", (Target.SPICE,)),
    **dict.fromkeys(("support", "files", "case"), ("case", (Target.CSM, Target.ASP, Target.CUBES))),
    "update": ("update", (Target.CUBES,)),
}  # fmt: skip
"""Option of each setting that not all targets use, and those that do."""


def _record_of(path: Path) -> tuple[Path, datetime]:
    """The record beside a solution, and when that was written, UTC."""
    record = (path if path.is_dir() else path.parent) / RECORD
    return record, datetime.fromtimestamp((record if record.is_file() else path).stat().st_mtime, UTC)


class _Written(NamedTuple):
    """What was written, what is to be said of it, and what of it may replace which files."""

    paths: Sequence[Path]
    notes: tuple[str, ...] = ()
    originals: Sequence[tuple[Path, Path]] = ()


def _spice(solution: Solution, folder: Path, settings: ExportSettings, path: Path) -> _Written:
    from mgsgraph.export.spice import write_spice

    record, when = _record_of(path)
    case = read_record(record).get("case", "unknown") if record.is_file() else "unknown"
    origin = f"Made by {account()} on {node()} from {path.resolve()} (adjusted {when:%Y-%m-%dT%H:%M:%SZ}, case {case})."
    return _Written(write_spice(solution, folder, origin=origin))


def _csm(solution: Solution, folder: Path, settings: ExportSettings, path: Path) -> _Written:
    from mgsgraph.export.csm import write_csm

    return _Written(write_csm(solution, folder, settings.support, True, settings.files))


def _isis(solution: Solution, folder: Path, settings: ExportSettings, path: Path) -> _Written:
    from mgsgraph.export.isis import write_isis
    from mgsgraph.export.network_content import Sources, source_networks

    sources = Sources(None)
    if settings.networks or np.any(solution.network.points.classes == PointClass.TIE):
        sources = source_networks(path, settings.networks, solution.network.body)
    output = write_isis(solution, folder, settings.scaled, source=sources.network)
    return _Written(output.paths, (*output.notes, *sources.notes))


def _asp(solution: Solution, folder: Path, settings: ExportSettings, path: Path) -> _Written:
    """Matches and control points, and the cameras that go with them."""
    from mgsgraph.export.asp import write_asp
    from mgsgraph.export.csm import write_csm

    cameras = write_csm(solution, folder, settings.support, False, settings.files)
    return _Written([*cameras, *write_asp(solution, folder, settings.files, scaled=settings.scaled)])


def _gis(solution: Solution, folder: Path, settings: ExportSettings, path: Path) -> _Written:
    from mgsgraph.analysis.places import sigma_grid
    from mgsgraph.analysis.posterior import Posterior
    from mgsgraph.export.gis import write_gis

    return _Written(write_gis(solution, folder, sigma_grid(Posterior.of(solution)) if settings.raster else None))


def _cubes(solution: Solution, folder: Path, settings: ExportSettings, path: Path) -> _Written:
    from mgsgraph.analysis.verdict import State, verdict
    from mgsgraph.case.case_file import decode, image_of
    from mgsgraph.export.cubes import is_changed, write_cubes
    from mgsgraph.results.results import case_of
    from mgsgraph.results.verdict import reason_sentences, state_of

    judged, state = verdict(solution), state_of(solution)
    doubts = [f"result is {state}: {reason}" for reason in reason_sentences(judged.reasons)[:1]]
    if settings.update and judged.state is State.INVALID:
        found, remedy = f"the {doubts[0].rstrip('.')}", "mend its input and adjust again, or leave out --update"
        raise InputError(str(path), found, "a valid or SUSPECT one for cubes in place", remedy)
    record, when = _record_of(path)
    case = settings.case or case_of(record.parent)
    if settings.case is None and not case.is_file():
        raise InputError(str(path), f"its case is no longer at {case}", "the case of its cubes", "name it with --case")
    tables, names = decode(case), solution.network.image_names
    images = [image for image in tables.images if image.cube or image.label]
    for k, entry in enumerate(tables.images if settings.update and not tables.mountings else ()):
        if entry.cube and entry.resection is None and entry.name in names:
            cube, j = tables.orientations[k].nominal_of(image_of(tables, k, case)), names.index(entry.name)
            found, remedy = "a cube that changed since it was adjusted", "adjust it anew, or leave out --update"
            require(not is_changed(cube, solution, j), str(case.parent / entry.cube), found, "as it was", remedy)
    files = {image.name: case.parent / str(image.cube or image.label) for image in images}
    paths, notes, new = write_cubes(solution, folder, files, when, state)
    placed = ["Each copy takes the place of its cube, too."] * settings.update
    return _Written(paths, (*(f"The {doubt}" for doubt in doubts), *notes, *placed), new)


_WRITERS: dict[Target, Callable[[Solution, Path, ExportSettings, Path], _Written]] = {
    Target.SPICE: _spice,
    Target.CSM: _csm,
    Target.ISIS: _isis,
    Target.ASP: _asp,
    Target.GIS: _gis,
    Target.CUBES: _cubes,
}


def _record(done: Exported, solution: Solution, settings: ExportSettings) -> dict[str, Any]:
    content = {"program": PROGRAM, "format": FORMAT, "name": solution.name, "converged": solution.converged}
    verified = {"measures": done.measures, "largest_difference_px": done.largest} if done.measures else {}
    support = {name: str(path) for name, path in (settings.support or {}).items()}
    return {**content, "target": done.target.value, **verified, "scaled": settings.scaled, "support": support,
            "notes": list(done.notes), "files": list(done.files)}  # fmt: skip

"""Settings of a project, which hold for all images and measurements that are added."""

import json
from pathlib import Path

import msgspec

from mgsgraph.atomic_write import resolved
from mgsgraph.case.case_file import decode
from mgsgraph.case.motion import Factor, Sigma
from mgsgraph.case.schema import CaseInput, OrientationInput, SolverInput, SpiceInput
from mgsgraph.errors import InputError
from mgsgraph.files.decoding import read_toml, validated


class MeasuresInput(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """Sigmas of measurements whose file does not state them."""

    tie_sigma_px: Sigma = 1.0
    """Sigma of a tie point's line and sample."""
    tie_sigma_factor: Factor = 1.0
    """Multiplies the sigmas of all added tie points, also those that a network states."""
    shot_image_sigma_px: Sigma = 30.0
    """Sigma of a laser shot's line and sample."""
    shot_range_sigma_m: Sigma | None = None
    """Sigma of an altimeter's range; that of the altimeter when absent, as in [[shots]]."""
    shot_ground_sigma_m: Sigma | None = None
    """Sigma of an altimeter's footprint in each direction; that of the altimeter when absent."""
    shot_height_sigma_m: Sigma | None = None
    """Sigma of the footprint's height, if different."""


class ProjectSettings(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """Settings of a project: the tables of a case file that do not name single files."""

    orientation: OrientationInput = OrientationInput()
    """Nominal orientation and a-priori sigmas of added images."""
    spice: SpiceInput | None = None
    """Kernels for MOC labels; absolute paths."""
    measures: MeasuresInput = MeasuresInput()
    """Sigmas of measurements whose files have none."""
    solver: SolverInput = SolverInput()
    """Settings of the solver."""


class _File(ProjectSettings, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """A file of settings."""

    format: int
    name: str = ""


def read_settings(path: Path) -> tuple[str, ProjectSettings]:
    """Name ("" where there is none) and settings of a TOML file: [orientation], [spice] and [solver] of a case file,
    and [measures]; InputError with the position of an error.
    """
    toml = read_toml(path, "settings")
    if "images" in toml.tables:
        raise InputError(str(path), "a case with images", "settings alone", "give it as --case, which takes them too")
    contents = validated(toml, _File, path, "see docs/projects.md")
    contents.orientation.prior(f"{path}, orientation")  # raises InputError for implausible sigmas
    spice = _absolute(contents.spice, path.parent)
    return contents.name, ProjectSettings(contents.orientation, spice, contents.measures, contents.solver)


def settings_of_case(path: Path) -> ProjectSettings:
    """Settings of a case file; sigmas of measurements are those of its first group of each kind."""
    case: CaseInput = decode(path)
    default = MeasuresInput()
    measures = MeasuresInput(
        next((group.sigma_px for group in case.tie_groups), default.tie_sigma_px),
        next((group.sigma_factor for group in case.tie_groups), default.tie_sigma_factor),
        next((group.image_sigma_px for group in case.laser_groups), default.shot_image_sigma_px),
        next((sigma for profile in case.shots if (sigma := profile.range_sigma_m) is not None), None),
        next((sigma for profile in case.shots if (sigma := profile.ground_sigma_m) is not None), None),
        next((profile.height_sigma_m for profile in case.shots), default.shot_height_sigma_m),
    )
    return ProjectSettings(case.orientation, _absolute(case.spice, path.parent), measures, case.solver)


def _absolute(spice: SpiceInput | None, folder: Path) -> SpiceInput | None:
    """Kernels by absolute paths, which do not depend on the working directory."""
    return spice and SpiceInput(tuple(str(resolved(folder / kernel, "")) for kernel in spice.kernels), spice.sampling_s)


def settings_to_json(settings: ProjectSettings) -> str:
    """One line of JSON; infinite sigmas as `Infinity`."""
    return json.dumps(msgspec.to_builtins(settings))


def settings_from_json(text: str, where: str) -> ProjectSettings:
    """Settings from a text of `settings_to_json`; InputError where it does not fit."""
    try:
        table = json.loads(text)
        for choice in ("form", "method"):  # keys of earlier versions
            table.get("solver", {}).pop(choice, None)
        return msgspec.convert(table, ProjectSettings, strict=False)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{where}, settings", str(error), remedy="open it with the mgsgraph that wrote it") from None


"""What a project takes for granted of every image and measure that is added to it."""

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
    """Sigmas of measures whose file doesn't state them."""

    tie_sigma_px: Sigma = 1.0
    """Of a tie point's line and sample."""
    tie_sigma_factor: Factor = 1.0
    """Multiplies the sigmas of all tie points that are added, those that a network itself states among them."""
    shot_image_sigma_px: Sigma = 30.0
    """Of a laser shot's line and sample."""
    shot_range_sigma_m: Sigma | None = None
    """Of an altimeter's range; that of the altimeter when absent, as in [[shots]]."""
    shot_ground_sigma_m: Sigma | None = None
    """Of an altimeter's footprint in each direction; that of the altimeter when absent."""
    shot_height_sigma_m: Sigma | None = None
    """Of its height, where it is another one."""


class ProjectSettings(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """Settings of a project: the tables of a case file that are not about single files."""

    orientation: OrientationInput = OrientationInput()
    """Nominal orientation and a-priori sigmas of images that are added."""
    spice: SpiceInput | None = None
    """Kernels for MOC labels; absolute paths."""
    measures: MeasuresInput = MeasuresInput()
    """Sigmas where the files have none."""
    solver: SolverInput = SolverInput()
    """Choices of the solver."""


class _File(ProjectSettings, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """A file of settings."""

    format: int
    name: str = ""


def read_settings(path: Path) -> tuple[str, ProjectSettings]:
    """Name ("" where it has none) and settings of a TOML file: a case file's [orientation], [spice], [solver], and
    [measures]; InputError with the place of what is wrong.
    """
    toml = read_toml(path, "settings")
    if "images" in toml.tables:
        raise InputError(str(path), "a case with images", "settings alone", "give it as --case, which takes them too")
    read = validated(toml, _File, path, "see docs/projects.md")
    read.orientation.prior(f"{path}, orientation")  # complains where its sigmas make no sense
    spice = _absolute(read.spice, path.parent)
    return read.name, ProjectSettings(read.orientation, spice, read.measures, read.solver)


def settings_of_case(path: Path) -> ProjectSettings:
    """Settings of a case file; sigmas of measures are those of its first group of each kind."""
    case: CaseInput = decode(path)
    usual = MeasuresInput()
    measures = MeasuresInput(
        next((group.sigma_px for group in case.tie_groups), usual.tie_sigma_px),
        next((group.sigma_factor for group in case.tie_groups), usual.tie_sigma_factor),
        next((group.image_sigma_px for group in case.laser_groups), usual.shot_image_sigma_px),
        next((one for profile in case.shots if (one := profile.range_sigma_m) is not None), None),
        next((one for profile in case.shots if (one := profile.ground_sigma_m) is not None), None),
        next((profile.height_sigma_m for profile in case.shots), usual.shot_height_sigma_m),
    )
    return ProjectSettings(case.orientation, _absolute(case.spice, path.parent), measures, case.solver)


def _absolute(spice: SpiceInput | None, folder: Path) -> SpiceInput | None:
    """Kernels by paths that hold in whatever folder the next command is called."""
    return spice and SpiceInput(tuple(str(resolved(folder / kernel, "")) for kernel in spice.kernels), spice.sampling_s)


def settings_to_json(settings: ProjectSettings) -> str:
    """One line of JSON; infinite sigmas as `Infinity`."""
    return json.dumps(msgspec.to_builtins(settings))


def settings_from_json(text: str, where: str) -> ProjectSettings:
    """The settings that the text holds."""
    try:
        found = json.loads(text)
        for choice in ("form", "method"):  # of earlier versions, which let one choose
            found.get("solver", {}).pop(choice, None)
        return msgspec.convert(found, ProjectSettings, strict=False)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{where}, settings", str(error), remedy="open it with the mgsgraph that wrote it") from None


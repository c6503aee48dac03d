"""For the Ames Stereo Pipeline: matches, ground control points, lists of files, and the commands that take them.

Cameras come from the export to CSM. Rejected measures are left out. Formats: `networks.asp`; options: StereoPipeline,
docs, bundle_adjust and jitter_solve.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import msgspec
import numpy as np

from mgsgraph.adjustment.solution import Solution
from mgsgraph.errors import InputError, require
from mgsgraph.export.csm import STATE, file_stems
from mgsgraph.export.isis import adjusted_network
from mgsgraph.files.networks.asp_match import match_files
from mgsgraph.files.networks.asp_text import ground_control_text
from mgsgraph.files.networks.record import ControlNetwork, ControlPoint, PointType
from mgsgraph.files.writing import write_files
from mgsgraph.units import KM

PREFIX, CONTROL, ADJUSTED = "matches/run", "control.gcp", "adjusted.gcp"
"""What matches begin with; control points as they were given; all points as adjusted."""
IMAGE_LIST, CAMERA_LIST, README = "images.txt", "cameras.txt", "README.txt"
_IMAGE = ".cub"
_GEOMETRY = (".isd", ".json", ".pvl", ".lbl")
"""How the file of an image's pixels ends, unless it is named."""


def write_asp(
    solution: Solution, folder: Path, images: Mapping[str, str] | None = None, scaled: bool = False
) -> list[Path]:
    """Write what bundle_adjust and jitter_solve read into an existing folder.

    Parameters
    ----------
    solution : Solution
        What was adjusted.
    folder : Path
        Where to.
    images : mapping, optional
        File of an image's pixels by the image's name, or one that is called like it; IMAGE.cub for those that it lacks.
    scaled : bool
        Whether sigmas of adjusted.gcp are times sigma0; else they are for sigma0 = 1.

    Returns
    -------
    list of Path
        Match files of free points (none without such points), control.gcp with the constrained and fixed points as they
        were given (where there are any that are measured), adjusted.gcp with all points as adjusted, images.txt and
        cameras.txt, which go together line by line, and README.txt.

    Raises
    ------
    InputError
        No point with a measure that took part; images whose files have one name for the pipeline; a file that can't
        be written.
    """
    files = _files(solution, images or {})
    network = _taking_part(solution, files, scaled)
    body = solution.network.body
    texts = dict[str, str | bytes]()
    if any(point.type == PointType.FREE and len(point.measures) > 1 for point in network.points):
        texts |= {path.as_posix(): content for path, content in match_files(network, Path(PREFIX)).items()}
    if any(point.type != PointType.FREE for point in network.points):
        texts[CONTROL] = ground_control_text(network, body)
    if (adjusted := _as_control(network)).points:
        texts[ADJUSTED] = ground_control_text(adjusted, body)
    texts[IMAGE_LIST] = "".join(f"{name}\n" for name in files)
    texts[CAMERA_LIST] = "".join(f"{stem}{STATE}\n" for stem in file_stems(solution, images))
    texts[README] = _readme(solution, list(texts), scaled)
    return write_files(folder, texts)


def _files(solution: Solution, named: Mapping[str, str]) -> list[str]:
    """File of each image's pixels."""
    names = solution.network.image_names
    for name in named:
        found, some_names = f"the image {name!r}", ", ".join(names[:4])
        require(name in names, "images of the export", found, f"some of the solution's images ({some_names})")
    for name, file in named.items():
        if not file or len(file.split()) != 1:
            raise InputError(f"image {name!r}", f"the file {file!r}", "a name without blanks, as the lists need it")
    stems = zip(names, file_stems(solution, named), strict=True)
    files = [file if _has_pixels(file := named.get(name, "")) else stem + _IMAGE for name, stem in stems]
    for file in [file for k, file in enumerate(files) if file in files[:k]][:1]:
        raise InputError("images of the export", f"the file {file!r} of two images", "one for each")
    return files


def _has_pixels(file: str) -> bool:
    """Whether a file may hold an image's pixels, and not its geometry alone."""
    return bool(file) and Path(file).suffix.lower() not in _GEOMETRY


def _taking_part(solution: Solution, files: Sequence[str], scaled: bool) -> ControlNetwork:
    """The adjusted network with only the measures that took part, and images named by their files."""
    network = adjusted_network(solution, scaled=scaled)
    file = dict(zip(solution.network.image_names, files, strict=True))
    ids, rays = solution.network.points.ids, solution.network.rays
    used = {
        (ids[i], solution.network.images[j].name)
        for i, j in zip(*(column[solution.rays_used].tolist() for column in (rays.point, rays.image)), strict=True)
    }
    points = list[ControlPoint]()
    for point in network.points:
        measures = tuple(
            msgspec.structs.replace(measure, serial_number=file[measure.serial_number])
            for measure in point.measures
            if (point.id, measure.serial_number) in used
        )
        if measures:
            points.append(msgspec.structs.replace(point, measures=measures, reference=None))
    require(points, f"solution {solution.name!r}", "no measure that took part", "some for the pipeline")
    return msgspec.structs.replace(network, points=tuple(points))


def _as_control(network: ControlNetwork) -> ControlNetwork:
    """Adjusted points as constrained ones; fixed points stay fixed."""
    points = [
        point if point.type == PointType.FIXED else msgspec.structs.replace(
            point, type=PointType.CONSTRAINED, apriori=point.adjusted, apriori_covariance=point.adjusted_covariance
        )
        for point in network.points
        if point.adjusted is not None and (point.type == PointType.FIXED or _positive(point.adjusted_covariance))
    ]  # fmt: skip
    return msgspec.structs.replace(network, points=tuple(points))


def _positive(covariance: Sequence[float]) -> bool:
    """Whether variances of a triangle xx, xy, xz, yy, yz, zz are there and positive."""
    return len(covariance) == 6 and min(covariance[k] for k in (0, 3, 5)) > 0.0


def _readme(solution: Solution, written: Sequence[str], scaled: bool) -> str:
    body, version = solution.network.body, solution.versions.get("mgsgraph", "")
    matches = any(name.startswith(PREFIX) for name in written)
    sample = f" --match-files-prefix {PREFIX}" if matches else ""
    control = f" {CONTROL}" if CONTROL in written else ""
    lists = f"--image-list {IMAGE_LIST} --camera-list {CAMERA_LIST}{sample}"
    meant = "times sigma0" if scaled else "for sigma0 = 1"
    sizes = f"geodetic, on the ellipsoid of {body.equatorial / KM:.10g} and {body.polar / KM:.10g} km"
    used = int(np.sum(solution.rays_used))
    left_out = "" if used == solution.rays_used.size else f", {solution.rays_used.size - used} left out as rejected"
    notes = [
        f"Solution {solution.name!r} of mgsgraph {version}, for the Ames Stereo Pipeline.",
        *([] if solution.converged else ["It did NOT converge."]),
        "",
        f"{IMAGE_LIST}, {CAMERA_LIST}: go together line by line. Put the images into this folder, and the cameras",
        f"  (IMAGE{STATE}), which mgsgraph export SOLUTION --to asp writes, or write other paths.",
        f"{PREFIX}-*.match: free points; places are float32." if matches else "No free point: no match files.",
        f"Measures that took part: {used}{left_out}.",
        *([f"{CONTROL}: constrained and fixed points as they were given, with a-priori sigmas along X, Y, Z."]
          if control else []),
        *([f"{ADJUSTED}: all points as adjusted, to hold other images to this ground; its sigmas are",
           f"  {meant}. Beside matches of the same points they would count twice."]
          if ADJUSTED in written else []),
        f"Latitudes and heights of .gcp files are {sizes}.",
        "",
        "The orientation is adjusted already. To see what the pipeline makes of it, without changing anything:",
        f"  bundle_adjust -t csm {lists}{control} --num-iterations 0 -o ba/run",
        "To adjust poses along the lines further:",
        f"  jitter_solve {lists}{control} \\",
        "    --num-lines-per-position 1000 --num-lines-per-orientation 1000 --max-initial-reprojection-error 20 \\",
        "    -o jitter/run",
        "To make terrain of it:",
        f"  parallel_stereo -t csm $(cat {IMAGE_LIST}) $(cat {CAMERA_LIST}) stereo/run",
        "",
        "--isis-cnet takes the network of the export to ISIS in place of the matches. The pipeline then takes 0.5 off",
        "its places, not 1 (its documentation, Using the ISIS cnet format in ASP): half a pixel from the match files;",
        "and it takes sigmas of constrained points from the adjusted covariances.",
    ]  # fmt: skip
    return "\n".join([*notes, ""])

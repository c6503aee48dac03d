"""CSM: refined image support data as ALE lays them out, and beside each the line-scanner model state of usgscsm.

Both hold geometric positions (no light time, no stellar aberration), and every correction once: time biases too.
Support data name an inertial frame, which an adjustment needs not know: it is that of the image's own support data
where there are any, or else the body's axes as they are in the image's middle.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from mgsgraph.adjustment.solution import Solution
from mgsgraph.errors import InputError
from mgsgraph.export.csm_state import RefinedTables, Turning, body_table, model_state, refined_tables
from mgsgraph.files.labels.aberration import Aberration
from mgsgraph.files.opening import read_json
from mgsgraph.files.support_data.isd import read_isd
from mgsgraph.files.support_data.isd_layout import (
    J2000,
    MODEL,
    RotationTable,
    StateTable,
    SunTable,
    rotation_table,
    state_table,
    support_fields,
)
from mgsgraph.files.writing import file_stem, write_files
from mgsgraph.geometry import rotation
from mgsgraph.geometry.body import geodetic
from mgsgraph.geometry.image import PushbroomImage
from mgsgraph.geometry.records import Array
from mgsgraph.geometry.trajectory import AttitudeTable, Trajectory
from mgsgraph.units import ISIS_OFFSET, MM

_AROUND = 100.0
"""m, by which the ground may be higher or lower than the points on it."""
SUPPORT_DATA, STATE = ".json", ".adjusted_state.json"
"""How the files of an image end. usgscsm's plugin opens support data as the image's file with its ending replaced by
.json (src/UsgsAstroPlugin.cpp, loadImageSupportData); the state's ending is that of ASP's bundle_adjust."""
_TIMING_TOLERANCE = 1e-2
"""Lines by which usgscsm may misread a line_scan_rate of several segments."""


def write_csm(
    solution: Solution, folder: Path, originals: Mapping[str, Path] | None = None, support: bool = True,
    files: Mapping[str, str] | None = None,
) -> list[Path]:  # fmt: skip
    """Write ``<image>.json`` and ``<image>.adjusted_state.json`` of every image into an existing folder.

    Parameters
    ----------
    solution : Solution
        What was adjusted.
    folder : Path
        Where to.
    originals : mapping, optional
        Support data from which an image was read, by its name: what the adjustment doesn't know is taken over from
        there (names of platform and sensor, NAIF keywords and frame codes, the Sun, the body's J2000 rotation).
    support : bool
        Whether support data are written; False leaves the states alone, which can hold more.
    files : mapping, optional
        File of an image by the image's name: what belongs to it is called like it, as usgscsm's plugin looks for
        support data beside the image; by the image's own name where there is none.

    Returns
    -------
    list of Path
        What was written.

    Raises
    ------
    InputError
        If a file can't be written, support data are of no image of the solution, or the format can't hold what an image
        has: which field is said.
    """
    originals = originals or {}
    known = {image.name for image in solution.network.images}
    for name in sorted((originals.keys() | (files or {}).keys()) - known):
        raise InputError(f"file of {name}", "no image of the solution", f"one that was adjusted ({min(known)}, ...)")
    stems = file_stems(solution, files)
    texts = dict[str, str | bytes]()
    for j, stem in enumerate(stems):
        image = solution.image(j)
        original = _original(image, originals.get(image.name), _heights(solution))
        tables = refined_tables(image, solution.correction(j))
        body = body_table(tables, _body_rotation(image, originals.get(image.name)))
        said = _provenance(solution) + _inertial_words(image, image.name in originals)
        data = _support_data(image, tables, body, original) | {"mgsgraph": said}
        if support:
            _require_timing(image)
            texts[stem + SUPPORT_DATA] = _text(data)
        state = model_state(solution, j, tables, data, body.at) | {"m_mgsgraph": _provenance(solution)}
        texts[stem + STATE] = f"{MODEL}\n{_text(state)}"
    return write_files(folder, texts)


def file_stems(solution: Solution, files: Mapping[str, str] | None = None) -> list[str]:
    """A file name for each image, without its end: that of its file, or else its own name."""
    names = [image.name for image in solution.network.images]
    own = {name: Path(file).stem for name, file in (files or {}).items()}
    stems = [file_stem(own.get(name, name)).lstrip(".") or "_" for name in names]
    folded = [stem.casefold() for stem in stems]
    for j, stem in enumerate(folded):
        if stem in folded[:j]:
            found = f"{names[folded.index(stem)]!r} and {names[j]!r}, whose files would be called {stems[j]}"
            raise InputError("image names", found, "names that differ as file names, too", "rename one of the images")
    return stems


def _provenance(solution: Solution) -> str:
    version = solution.versions.get("mgsgraph", "unknown")
    state = "converged" if solution.converged else "NOT converged"
    return (
        f"Adjusted by mgsgraph {version}, solution {solution.name!r}, {state}. Positions are geometric: no light time "
        "and no stellar aberration. Time biases are applied: do not apply them again."
    )


def _inertial_words(image: PushbroomImage, original: bool) -> str:
    """What reference_frame doesn't say where nobody knows how the body turns in J2000."""
    if isinstance(image.trajectory, Trajectory) or original:
        return ""
    return " Inertial axes are not J2000's but the body's own at center_ephemeris_time."


def _text(value: dict[str, Any]) -> str:
    """JSON with one key of the outermost object to a line: tables may be long."""
    rows = (f"{json.dumps(key)}: {json.dumps(entry, allow_nan=False)}" for key, entry in value.items())
    return "{\n" + ",\n".join(rows) + "\n}\n"


def _heights(solution: Solution) -> dict[str, Any]:
    """Between which heights (m above the ellipsoid) the adjusted points lie, and a hundred metres more; ALE's words for
    a solution without any.
    """
    places = solution.places[np.all(np.isfinite(solution.places), axis=1)]
    if places.size == 0:
        return {"maxheight": 1000, "minheight": -1000, "unit": "m"}
    heights = geodetic(places, solution.network.images[0].body)[:, 2]
    least, largest = np.floor(heights.min() - _AROUND), np.ceil(heights.max() + _AROUND)
    return {"maxheight": float(largest), "minheight": float(least), "unit": "m"}


def _original(image: PushbroomImage, path: Path | None, heights: dict[str, Any]) -> dict[str, Any]:
    """What support data say that the adjustment doesn't know; with ALE's own words for what nobody said."""
    unknown = {
        "isis_camera_version": 2, "name_platform": "UNKNOWN", "name_sensor": "UNKNOWN", "detector_line_summing": 1,
        "reference_height": heights, "naif_keywords": {},
    }  # fmt: skip
    if path is None:
        return unknown
    said = read_json(path)
    if (said.get("image_lines"), said.get("image_samples")) != (image.lines, image.samples):
        found = f"{said.get('image_lines')} x {said.get('image_samples')} lines x samples"
        raise InputError(str(path), found, f"those of image {image.name}, {image.lines} x {image.samples}")
    known = (*unknown, "sun_position", "body_rotation", "instrument_pointing")
    return unknown | {key: said[key] for key in known if key in said}


def _body_rotation(image: PushbroomImage, path: Path | None) -> Turning:
    """How the body turns in inertial space; times count from the tables' epoch, the image's middle."""
    trajectory, epoch = image.trajectory, image.trajectory.epoch
    edges, _ = image.timing.at(np.array([0.0, float(image.lines)]))
    middle = epoch + 0.5 * float(edges.sum())
    if not isinstance(trajectory, Trajectory) and path is not None:
        # where its positions were apparent, its rotation stands all the same
        other = read_isd(path, image.name, Aberration("NONE")).trajectory
        trajectory, epoch = other, other.epoch
    if isinstance(trajectory, Trajectory):
        table, since = trajectory.body, middle - epoch
        return lambda times: table.at(times + since)
    spin = np.zeros(3) if trajectory.spin is None else trajectory.spin
    return lambda times: (rotation.exponential(-spin * times[:, None]), np.broadcast_to(spin, (times.size, 3)))


def _require_timing(image: PushbroomImage) -> None:
    """Raise InputError where usgscsm would misread the line times: it changes segments half a line late
    (src/UsgsAstroLsSensorModel.cpp, getImageTime, compares its lines from 0 with ISIS's from 0.5).
    """
    timing = image.timing
    if timing.first_lines.size < 2:
        return
    late = np.concatenate([timing.first_lines[1:], timing.first_lines[1:] + 0.5])
    k = np.tile(np.arange(timing.first_lines.size - 1), 2)
    gone_on = timing.start_times[k] + (late - timing.first_lines[k]) * timing.periods[k]
    true = timing.start_times[k + 1] + (late - timing.first_lines[k + 1]) * timing.periods[k + 1]
    off = np.abs(gone_on - true) / timing.periods[k + 1]
    if off.max() > _TIMING_TOLERANCE:
        line = timing.first_lines[k[off.argmax()] + 1]
        raise InputError(
            f"image {image.name}, line_scan_rate", f"{timing.first_lines.size} segments; after the change at line "
            f"{line + ISIS_OFFSET:g} usgscsm would be {off.max():.3g} lines off", "one segment, or smaller changes",
            "write the model states alone (support=False), which hold them",
        )  # fmt: skip


def _support_data(
    image: PushbroomImage, tables: RefinedTables, body: AttitudeTable, original: dict[str, Any]
) -> dict[str, Any]:
    """Support data in the layout that ALE writes and `files.support_data.isd` reads."""
    summing = int(image.interior.sample_summing)
    if summing != image.interior.sample_summing:
        where = f"image {image.name}, detector_sample_summing"
        raise InputError(where, f"{image.interior.sample_summing:g}", "a whole number")
    kept = {k: v for k, v in original.items() if k not in ("sun_position", "body_rotation", "instrument_pointing")}
    found = support_fields(
        image, tables.epoch, _position_table(tables, body), _pointing_table(tables, body, original),
        _body_table(tables.epoch, body, original), _no_sun(tables),
    )  # fmt: skip
    return kept | found | {
        "detector_sample_summing": summing,
        "naif_keywords": _naif_keywords(original["naif_keywords"], image.interior.focal_length),
        "sun_position": original.get("sun_position", found["sun_position"]),
    }


def _naif_keywords(said: Mapping[str, Any], focal_length: float) -> dict[str, Any]:
    """ISIS's keywords: positions are geometric whatever they were, and the focal length may have been adjusted."""
    renewed: dict[str, Any] = {"_LIGHTTIME_CORRECTION": "NONE", "_FOCAL_LENGTH": focal_length / MM}
    ends = {key: end for key in said for end in renewed if key.endswith(end)}
    keywords = dict(said) | {key: renewed[end] for key, end in ends.items()}
    if "_LIGHTTIME_CORRECTION" not in ends.values():
        keywords["INS0_LIGHTTIME_CORRECTION"] = "NONE"
    return keywords


def _pointing_table(tables: RefinedTables, body: AttitudeTable, original: Mapping[str, Any]) -> RotationTable:
    times = tables.attitude_times
    to_camera = rotation.to_matrix(tables.quaternions)
    to_body, body_rate = body.at(times)
    rate = tables.angular_rates + np.einsum("nij,nj->ni", to_camera, body_rate)
    return _rotation_table(tables.epoch + times, to_camera @ to_body, rate, original.get("instrument_pointing"))


def _body_table(epoch: float, body: AttitudeTable, original: Mapping[str, Any]) -> RotationTable:
    return _rotation_table(epoch + body.times, *body.at(body.times), original.get("body_rotation"))


def _rotation_table(times: Array, matrices: Array, rates: Array, said: Any) -> RotationTable:
    """Rotation table of attitudes (n, 3, 3), inertial to the frame, with angular rates (n, 3), rad/s about the frame's
    axes; those of ALE and NAIF are about inertial ones.
    """
    frames = said.get("constant_frames") if isinstance(said, dict) else None
    return msgspec.structs.replace(
        rotation_table(times, rotation.continuous(rotation.from_matrix(matrices)), np.eye(3)),
        time_dependent_frames=[frames[0], J2000] if frames else None,
        constant_frames=[frames[0]] if frames else None,
        ck_table_start_time=float(times[0]),
        ck_table_end_time=float(times[-1]),
        ck_table_original_size=times.size,
        angular_velocities=np.einsum("nji,nj->ni", matrices, rates).tolist(),
    )


def _position_table(tables: RefinedTables, body: AttitudeTable) -> StateTable:
    to_body, rate = body.at(tables.position_times)
    times = tables.epoch + tables.position_times
    motion = tables.velocities + np.cross(rate, tables.positions)
    inertial = [np.einsum("nji,nj->ni", to_body, vectors) for vectors in (tables.positions, motion)]
    return msgspec.structs.replace(
        state_table(times, *inertial), spk_table_start_time=float(times[0]), spk_table_end_time=float(times[-1]),
        spk_table_original_size=times.size,
    )  # fmt: skip


def _no_sun(tables: RefinedTables) -> SunTable:
    """Zeros, as in a model state without a Sun (reset() of usgscsm): the key has to be there, and with three times."""
    times = tables.epoch + tables.position_times[[0, tables.position_times.size // 2, -1]]
    zeros = [(0.0, 0.0, 0.0)] * 3
    return SunTable(ephemeris_times=times.tolist(), positions=zeros, velocities=zeros, reference_frame=J2000)

"""Match files of the Ames Stereo Pipeline: places of the same ground in two images, one file for each pair of them.

Binary (``.match``), little-endian: two counts (uint64), which are equal; then a record for every place in the first
image, then those in the second: column, row (float32, first pixel's centre at 0, 0), the same as int32, orientation,
scale, interest (float32), polarity (1 byte), octave, level (uint32), number of descriptors (uint64), descriptors
(float32). The scale is what bundle_adjust takes for the sigma of column and row (pixels). Sources: StereoPipeline,
src/asp/Tools/parse_match_file.py; VisionWorkbench, src/vw/InterestPoint/{MatcherIO.cc,InterestPoint.h},
src/vw/BundleAdjustment/CameraRelation.cc (IPFeature::control_measure).

Text (``--matches-as-txt``, since 2026): ``x1 y1 unc1 x2 y2 unc2`` in every line, the same columns, rows and sigmas.
Source: StereoPipeline, docs, "Plain text match files".

Matches of pairs are joined to points of many images as VisionWorkbench does it (src/vw/BundleAdjustment:
ControlNetworkLoader.cc, build_control_network; CameraRelation.cc, write_controlnetwork): places of an image are one
where column and row are equal to the last bit; what matches connect is one point; a point that comes by an
image twice, at two places, is dropped.

Files are called PREFIX-IMAGE1__IMAGE2.match; images go by their files' names without folder and ending. Sources:
StereoPipeline, docs, "Match file naming convention"; VisionWorkbench, src/vw/InterestPoint/MatcherIO.cc, strip_path and
match_filename.
"""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, product
from pathlib import Path

import numpy as np

from mgsgraph.errors import InputError, require
from mgsgraph.files.networks.asp_text import (
    FROM_ASP,
    RENAME,
    UNSTATED_SIGMA,
    PixelMeasures,
    filled_lines,
    measures_of,
)
from mgsgraph.files.networks.record import ControlNetwork, MeasureType, PointType, with_names
from mgsgraph.files.networks.tie_points import PointArrays
from mgsgraph.files.opening import number_of, read_bytes
from mgsgraph.geometry.records import Array, Index, place_of
from mgsgraph.names import Names, RepeatedNames, grouped
from mgsgraph.text import root_mean_square, some

_COUNTS = np.dtype("<u8")


_RECORD = np.dtype([
    ("x", "<f4"), ("y", "<f4"), ("column", "<i4"), ("row", "<i4"), ("orientation", "<f4"), ("scale", "<f4"),
    ("interest", "<f4"), ("polarity", "u1"), ("octave", "<u4"), ("level", "<u4"), ("descriptors", "<u8"),
])  # fmt: skip
_HEAD = 2 * _COUNTS.itemsize
_DESCRIPTOR = 4
"""bytes."""
_EXPECTED = "a whole match file of the Ames Stereo Pipeline"
_LEAST_SIGMA = 1e-12
"""pixels; the square of much less is nothing."""
_LARGEST = 2.0**31 - 1.0
"""Columns and rows must fit into int32."""
_BETWEEN = "__"
_CLEAN = "-clean"
"""Ends the names of files from which bundle_adjust has taken the outliers."""
_LONGEST = 255
"""bytes of a file's name; the pipeline puts a hash into longer ones (since 2026), or cuts them (before)."""
_FORM = "PREFIX-IMAGE1__IMAGE2"


@dataclass(frozen=True, slots=True, eq=False)
class MatchFile:
    """Content of a match file, without the descriptors of its matches."""

    source: str
    """File, for messages."""
    images: tuple[str, str]
    """Their names."""
    pixels: Array
    """(2, n, 2) image, match; row, column, first pixel's centre at (0, 0)."""
    sigmas: Array
    """(2, n) pixels, of row and column; NaN where the file says 0 or less."""


def read_match(path: Path, images: tuple[str, str]) -> MatchFile:
    """Read a binary match file.

    Raises
    ------
    InputError
        If it is missing, cut short or longer than it says, its counts differ, or a place or scale is no finite number.
    """
    data = read_bytes(path)
    require(len(data) >= _HEAD, str(path), f"{len(data)} bytes", _EXPECTED)
    first, second = np.frombuffer(data, _COUNTS, 2).tolist()
    require(first == second, str(path), f"{first} places in one image, {second} in the other", "as many in both")
    require(first != 0, str(path), "no match", "at least one")
    if first + second > (len(data) - _HEAD) // _RECORD.itemsize:
        raise InputError(str(path), f"{len(data)} bytes for {first} matches", _EXPECTED, "it is cut short, or no such")
    records = _records(data, first + second, str(path)).reshape(2, first)
    with np.errstate(invalid="ignore"):  # NaN of any kind is refused below
        places = np.stack([records["y"], records["x"]], axis=-1).astype(np.float64)
        scales = records["scale"].astype(np.float64)
    return _checked(str(path), images, places, scales)


def _records(data: bytes, count: int, where: str) -> np.ndarray:
    """All records, without their descriptors."""
    starts, position, size = np.empty(count, dtype=np.int64), _HEAD, _RECORD.itemsize
    for k in range(count):
        starts[k] = position
        number = int.from_bytes(data[position + size - _COUNTS.itemsize : position + size], "little")
        position += size + _DESCRIPTOR * number
        if position > len(data):
            raise InputError(where, f"place {k + 1} of {count} lies beyond its end", _EXPECTED, "it is cut short")
    require(position == len(data), where, f"{len(data) - position} bytes after the last place", _EXPECTED)
    rows = np.frombuffer(data, np.uint8)[starts[:, None] + np.arange(size)]
    return np.asarray(rows.view(_RECORD)[:, 0])


def read_match_text(path: Path, images: tuple[str, str]) -> MatchFile:
    """Read a match file in text; the same errors, and for sigmas that are not positive, with the line."""
    places, rows = list[str](), list[list[float]]()
    for where, fields in filled_lines(path):
        require(len(fields) == 6, where, f"{len(fields)} fields", "six numbers: x1 y1 unc1 x2 y2 unc2")
        rows.append([number_of(text, where) for text in fields])
        places.append(where)
    require(rows, str(path), "no match", "at least one")
    table = np.array(rows, dtype=np.float64).reshape(-1, 2, 3).swapaxes(0, 1)
    for k in np.flatnonzero(np.any(table[..., 2] <= 0.0, axis=0))[:1]:
        raise InputError(places[k], f"uncertainty {table[:, k, 2].min():g} px", "a positive one")
    return _checked(str(path), images, table[..., 1::-1], table[..., 2])


def _checked(source: str, images: tuple[str, str], places: Array, sigmas: Array) -> MatchFile:
    fine = np.all(np.isfinite(places), axis=(0, 2)) & np.all(np.isfinite(sigmas), axis=0)
    for k in np.flatnonzero(~fine)[:1]:
        raise InputError(f"{source}, match {k + 1}", "a place or scale that is no finite number", "finite numbers")
    return MatchFile(source, images, places, np.where(sigmas > 0.0, sigmas, np.nan))


def match_files(network: ControlNetwork, prefix: Path, text: bool = False) -> dict[Path, bytes]:
    """Contents of the match files of a network by their paths, one for each pair of images with common points.

    Parameters
    ----------
    network : ControlNetwork
        Its free points that two images or more see, ignored ones left out; constrained and fixed points go into a
        ``.gcp``, as with the pipeline's own ``--output-cnet-type match-files``.
    prefix : Path
        What the files' names begin with.
    text : bool
        Plain text instead of binary; it keeps float64, which the pipeline reads as float32.

    Raises
    ------
    InputError
        If there is no such point, or two images have files of one name.
    """
    measures = measures_of(network, {PointType.FREE}, least=2)
    require(measures.points, network.source or "network", "no free point that two images see", "at least one")
    require_distinct(measures.images)
    if not np.all(np.abs(measures.pixels) < _LARGEST):
        raise InputError(network.source or "network", "a place beyond 2^31 pixels", "a place in an image")
    if np.any((measures.sigmas < _LEAST_SIGMA) | (measures.sigmas > _LARGEST)):
        expected = f"{_LEAST_SIGMA:g} .. {_LARGEST:.1g} px"
        raise InputError(network.source or "network", "a sigma that a match file can't hold", expected)
    contents = {}
    for (i, j), first, second in pairs_of(measures):
        path = match_path(prefix, measures.images[i], measures.images[j], ".txt" if text else ".match")
        contents[path] = (_text if text else _binary)(measures, first, second)
    return contents


def pairs_of(measures: PixelMeasures) -> Iterator[tuple[tuple[int, int], np.ndarray, np.ndarray]]:
    """Every pair of images (i < j) with common points, and indices of their measures, point by point."""
    order = np.lexsort((measures.image, measures.point))
    point = measures.point[order]
    firsts, seconds = list[np.ndarray](), list[np.ndarray]()
    for step in range(1, int(np.bincount(point).max(initial=0))):
        same = np.flatnonzero(point[:-step] == point[step:])
        firsts.append(order[same])
        seconds.append(order[same + step])
    first, second = np.concatenate(firsts), np.concatenate(seconds)
    sorting = np.lexsort((measures.point[first], measures.image[second], measures.image[first]))
    first, second = first[sorting], second[sorting]
    images = np.stack([measures.image[first], measures.image[second]], axis=1)
    starts = np.flatnonzero(np.any(np.diff(images, axis=0, prepend=-1), axis=1))
    for start, stop in zip(starts, [*starts[1:], len(first)], strict=True):
        yield (int(images[start, 0]), int(images[start, 1])), first[start:stop], second[start:stop]


def one_sigma(sigmas: Array) -> Array:
    """(k,) the one sigma that a format holds for rows and columns (k, 2): their quadratic mean; 1 px for unknown."""
    return np.where(np.isnan(sigmas).any(axis=1), UNSTATED_SIGMA, root_mean_square(sigmas, 1))


def _binary(measures: PixelMeasures, first: np.ndarray, second: np.ndarray) -> bytes:
    chosen = np.concatenate([first, second])
    records = np.zeros(len(chosen), dtype=_RECORD)
    records["y"], records["x"] = measures.pixels[chosen].T
    records["row"], records["column"] = np.trunc(measures.pixels[chosen]).T
    records["scale"] = one_sigma(measures.sigmas[chosen])
    return np.array([len(first), len(second)], dtype=_COUNTS).tobytes() + records.tobytes()


def _text(measures: PixelMeasures, first: np.ndarray, second: np.ndarray) -> bytes:
    columns = [
        np.column_stack([measures.pixels[k][:, ::-1], one_sigma(measures.sigmas[k])]) for k in (first, second)
    ]  # fmt: skip
    return "".join(" ".join(map(repr, row)) + "\n" for row in np.hstack(columns).tolist()).encode()


# --- points of many images


@dataclass(frozen=True, slots=True)
class Tracks:
    """A network made of matches."""

    network: ControlNetwork
    """Its points are counted (match1, ...) in the order of their first matches."""
    contradictory: int
    """Points that were dropped, having two places in one image."""


def joined(files: Sequence[MatchFile]) -> Tracks:
    """Make a network of match files.

    The sigma of a measure is that of the first file it is in. Raises InputError where nothing is left.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    images = list(dict.fromkeys(name for file in files for name in file.images))
    source = ", ".join(file.source for file in files[:3]) + (", ..." if len(files) > 3 else "")
    of_file = [np.array([images.index(name) for name in file.images]) for file in files]
    sizes = [file.pixels.shape[1] for file in files]
    image = np.concatenate([np.repeat(numbers, size) for numbers, size in zip(of_file, sizes, strict=True)])
    places = np.concatenate([file.pixels.reshape(-1, 2) for file in files])
    sigmas = np.concatenate([file.sigmas.reshape(-1) for file in files])
    left = np.concatenate([np.arange(size) for size in sizes])
    left += np.repeat(2 * np.cumsum([0, *sizes[:-1]]), sizes)  # where the file's places begin
    first, place = _distinct(image, places)
    right, n = place[left + np.repeat(sizes, sizes)], len(first)
    _, track = connected_components(coo_array((np.ones(len(left)), (place[left], right)), shape=(n, n)), directed=False)
    return _network(images, image[first], places[first], sigmas[first], track, source)


def _distinct(image: Index, places: Array) -> tuple[Index, Index]:
    """Where each distinct place first stands, in that order, and which of them every place is."""
    keys = np.column_stack([image.astype(np.float64), places]) + 0.0  # -0.0 is 0.0
    _, first, which = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first, kind="stable")
    return first[order], place_of(order, order.size)[which.reshape(-1)]


def _network(
    images: list[str], image: Index, places: Array, sigmas: Array, track: Index, source: str
) -> Tracks:  # fmt: skip
    order = np.lexsort((image, track))
    track, image, places, sigmas = track[order], image[order], places[order], sigmas[order]
    twice = (np.diff(track) == 0) & (np.diff(image) == 0)
    wrong = np.unique(track[1:][twice])
    fine = np.isin(track, wrong, invert=True)
    require(np.any(fine), source, f"only contradictory matches ({len(wrong)} points)", "one place of a point per image")
    first = np.flatnonzero(np.diff(track[fine], prepend=-1, append=-1))
    n, k = first.size - 1, int(first[-1])
    places, sigmas = places[fine] + FROM_ASP, np.where(sigmas[fine] > 0.0, sigmas[fine], np.nan)
    points = PointArrays(
        ControlNetwork("", "", (), source=source), Names.of([f"match{k}" for k in range(1, n + 1)]),
        np.full(n, PointType.FREE), np.zeros(n, dtype=bool), np.full((n, 3), np.nan), np.full((n, 6), np.nan), first,
        RepeatedNames(tuple(images), image[fine]), np.column_stack([places, sigmas, sigmas]), np.zeros(k, dtype=bool),
    )  # fmt: skip
    return Tracks(with_names(points.network(np.full(k, MeasureType.CANDIDATE), np.full(n, -1))), len(wrong))


# --- names of files


def stem(image: str) -> str:
    """An image's name without folder and ending."""
    name = image.rsplit("/", 1)[-1]
    return name.rpartition(".")[0] or name


def images_of(path: Path, known: Collection[str] = (), prefix: str | None = None) -> tuple[str, str]:
    """The two images of a match file, by its name.

    Parameters
    ----------
    path : Path
        Match file, binary or text.
    known : collection of str
        All images there are; the name is then split by theirs.
    prefix : str, optional
        What precedes the first image, without the hyphen; empty for nothing. A folder before it counts for nothing.

    Raises
    ------
    InputError
        If the name is not of this form, or can be split in several ways: hyphens may be of the prefix or of the
        first image, and there is no telling.
    """
    names = [path.stem.removesuffix(_CLEAN), path.stem]
    if known:  # one of them may itself be called so
        names.reverse()
    pairs = _image_pairs(names[0], known, prefix) or _image_pairs(names[1], known, prefix)
    if len(pairs) == 1:
        return pairs[0]
    if not pairs:
        if known:
            remedy = f"they are {some(list(known))}"
            raise InputError(str(path), "a file's name without two of the images", _FORM, remedy)
        expected = _FORM if prefix is None else f"{prefix}-IMAGE1__IMAGE2"
        raise InputError(str(path), "a file's name that doesn't tell the images", expected)
    several = ", or ".join(" and ".join(pair) for pair in pairs[:3])
    raise InputError(str(path), f"its images may be {several}", "one reading", "say --prefix, or give the --case")


def _image_pairs(name: str, known: Collection[str], prefix: str | None) -> list[tuple[str, str]]:
    """Every pair of images that a name can mean."""
    of_stems = grouped((stem(image), image) for image in known)
    pairs = []
    for k in range(1, len(name) - len(_BETWEEN)):
        if not name.startswith(_BETWEEN, k):
            continue
        second = name[k + len(_BETWEEN) :]
        for first in _heads(name[:k], prefix, bool(known)):
            if not known:
                pairs.append((first, second))
            else:
                pairs += product(of_stems.get(first, ()), of_stems.get(second, ()))
    return [pair for pair in pairs if pair[0] != pair[1]]


def _heads(head: str, prefix: str | None, known: bool) -> list[str]:
    """Possible names of the first image: all that follows a hyphen, or the whole without one, or where images are
    known, so that a wrong one does no harm.
    """
    if prefix is not None:
        start = f"{prefix.rsplit('/', 1)[-1]}-" if prefix else ""
        return [head[len(start) :]] if head.startswith(start) and len(head) > len(start) else []
    heads = [head[k + 1 :] for k, mark in enumerate(head) if mark == "-" and head[k + 1 :]]
    return [head, *heads] if known or not heads else heads


def require_distinct(images: Collection[str]) -> None:
    """Raise InputError where two images have one name in match files."""
    stems = dict[str, str]()
    for image in images:
        name = stem(image)
        require(name and "\0" not in name, f"image {image!r}", "a name that no file can have", remedy=RENAME)
        if stems.setdefault(name, image) != image:
            found = f"the same name as {stems[name]} without folder and ending ({name})"
            raise InputError(f"image {image}", found, "a name of its own in match files", RENAME)


def match_path(prefix: Path, first: str, second: str, ending: str) -> Path:
    """File of the matches of two images; InputError if its name is too long."""
    name = f"{prefix.name}-{stem(first)}{_BETWEEN}{stem(second)}{ending}"
    if len(name.encode()) > _LONGEST:
        raise InputError(name, f"a name of {len(name.encode())} bytes", f"at most {_LONGEST}", RENAME)
    return prefix.with_name(name)


def prefix_of(output: Path, images: Collection[str]) -> Path:
    """Prefix of match files written for `output`: its name without its ending, and without a pair of images."""
    name = output.stem
    for first, second in combinations(images, 2):
        if (pair := f"-{stem(first)}{_BETWEEN}{stem(second)}") and name.endswith(pair):
            return output.with_name(name.removesuffix(pair))
    return output.with_name(name)

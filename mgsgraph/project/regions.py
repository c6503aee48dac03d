"""The case of a region divided into cases of connected images, which `run_campaign` adjusts one by one.

Images are connected by tie points or by a laser profile that they have in common; in a case without tie points by
footprints that overlap. A group becomes a case file in a folder that is called after its first image, so a later image
changes the files of one group. The horizontal place of a terrain model is estimated by each group.
"""

import os
import re
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from msgspec import Struct
from msgspec.structs import fields, replace

from mgsgraph.case.assembly import shots_in_images
from mgsgraph.case.case_file import case_text, decode, read_images, toml_lines
from mgsgraph.case.reading import read_profile
from mgsgraph.case.schema import CaseInput, ImageInput, ShotsInput, TiesInput
from mgsgraph.errors import require
from mgsgraph.export.exchange import contents, format_of, read_networks
from mgsgraph.export.exchange_setting import ExchangeSetting
from mgsgraph.files.networks.editing import used_images
from mgsgraph.files.networks.record import ControlNetwork, ControlPoint, PointType
from mgsgraph.files.opening import head_of, read_bytes
from mgsgraph.files.output.folders import MATCH
from mgsgraph.files.writing import write_file
from mgsgraph.geometry.footprint import footprint, overlaps
from mgsgraph.names import numbered
from mgsgraph.network.connectivity import groups

_CASE = "case.toml"
_HEAD = "# Written by `mgsgraph split`"
_WHOLE = ("laser", "altimetry", "ground_control", "checkpoints", "considered", "passes", "mountings", "shared")
"""Tables that belong to all images."""
_NAMES = ("name", "image", "like")
"""Keys of names, which are no paths."""


class Division(NamedTuple):
    """A case that has been divided into groups of connected images."""

    groups: Mapping[str, tuple[str, ...]]
    """Names of the images of each group by its folder, the largest group first."""
    alone: tuple[str, ...]
    """Images that are connected to none, and are in no group."""
    merged: tuple[str, ...]
    """Folders of earlier groups that have become parts of others: their case files are removed."""
    measured: bool
    """Whether the groups have tie points; else `match` finds them."""


class _Group(NamedTuple):
    images: list[ImageInput]
    shots: list[ShotsInput]
    points: list[list[ControlPoint]]
    """Of each network."""


def split_case(case: Path, out: Path) -> Division:
    """Divide a case into groups of connected images, and write a case for each into a folder of its own in `out`.

    The call may be repeated: the same input gives the same files, and a group's case file is written last.

    Raises
    ------
    InputError
        A case that can't be read, tables that belong to all images, a profile that crosses none of them, or a case file
        in `out` that was not written here.
    """
    tables = decode(case)
    for name in _WHOLE:
        expected, remedy = "images, ties, shots and a terrain model", "take it out, or adjust the case as a whole"
        require(not getattr(tables, name), f"{case}, {name}", "a table that belongs to all images", expected, remedy)
    networks = [read_networks(case.parent / entry.network)[0] for entry in tables.tie_groups]
    found = _connected(tables, networks, case)
    connected = [group for group in found if len(group.images) > 1]
    folders = {re.sub(r"[^\w.-]", "-", group.images[0].name): group for group in connected}
    clash = "names that differ in punctuation alone"
    require(len(folders) == len(connected), f"{case}, images", clash, "names that can be of folders")
    earlier = [path for path in sorted(out.glob(f"*/{_CASE}")) if head_of(path, len(_HEAD)) == _HEAD.encode()]
    for path in (out / folder / _CASE for folder in folders):  # before anything is written
        require(path in earlier or not path.exists(), str(path), "a case file of yours", remedy="choose another --out")
    for folder, group in folders.items():
        _write(group, networks, tables, case, out / folder / _CASE)
    merged = [path for path in earlier if path.parent.name not in folders]
    for path in merged:
        path.unlink()
    named = {folder: tuple(image.name for image in group.images) for folder, group in folders.items()}
    alone = tuple(group.images[0].name for group in found if len(group.images) == 1)
    return Division(named, alone, tuple(path.parent.name for path in merged), bool(networks))


def _connected(tables: CaseInput, networks: Sequence[ControlNetwork], case: Path) -> list[_Group]:
    """Groups of connected images, each with its profiles and its points; an image that nothing connects is one."""
    profiles, links = _links(tables, networks, case)
    number = numbered(image.name for image in tables.images)
    pairs = {pair for link in links for pair in pairwise(sorted(number[name] for name in link if name in number))}
    parts = groups(len(number), np.array(sorted(pairs), dtype=np.int64).reshape(-1, 2))
    found = [_Group([tables.images[j] for j in part], [], [[] for _ in networks]) for part in parts]
    group_of = {image.name: group for group in found for image in group.images}
    for entry, images in zip(tables.shots, profiles, strict=True):
        group_of[images[0]].shots.append(entry)
    for k, network in enumerate(networks):
        for point in network.points:
            seen = [name for name in dict.fromkeys(m.serial_number for m in point.measures) if name in group_of]
            if len(seen) >= (2 if point.type == PointType.FREE else 1):
                group_of[seen[0]].points[k].append(point)
    return found


def _links(
    tables: CaseInput, networks: Sequence[ControlNetwork], case: Path
) -> tuple[list[tuple[str, ...]], list[tuple[str, ...]]]:
    """Names of the images of each laser profile; names of images that are connected, these among them."""
    profiles: list[tuple[str, ...]] = [(entry.image,) if entry.image else () for entry in tables.shots]
    needed = not networks or not all(profiles)
    images = read_images(tables, tables.orientations, (), case) if needed else ()
    for k, entry in [(k, entry) for k, entry in enumerate(tables.shots) if not entry.image]:
        hits, usable = shots_in_images(images, read_profile(entry, case.parent))
        profiles[k] = tuple(images[j].name for j in np.flatnonzero((hits.inside & usable).any(axis=1)))
        require(profiles[k], f"{case}, shots[{k}]", "shots in none of the images", remedy="take it out")
    links = [*profiles, *(used_images(point) for network in networks for point in network.points)]
    if not networks:
        shared = overlaps([footprint(image) for image in images])
        links += [(images[i].name, images[j].name) for i, j in shared.pairs.tolist()]
    return profiles, links


def _write(group: _Group, networks: Sequence[ControlNetwork], tables: CaseInput, case: Path, path: Path) -> None:
    """Write the networks of a group and its case file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    ties: tuple[TiesInput, ...] = () if networks else (TiesInput("matches/network.pvl"),)
    for k, (entry, network, points) in enumerate(zip(tables.tie_groups, networks, group.points, strict=True), start=1):
        if points:
            source = case.parent / entry.network
            output, record = path.with_name(f"ties_{k}").absolute() / source.name, source.with_name(MATCH)
            files = contents(replace(network, points=tuple(points)), output, format_of(output), ExchangeSetting())
            files |= {output.with_name(MATCH): read_bytes(record)} if record.is_file() else {}
            output.parent.mkdir(exist_ok=True)
            for file, content in files.items():
                write_file(file, content)
            ties += (replace(entry, network=str(output)),)
    own = replace(tables, images=tuple(group.images), shots=tuple(group.shots), ties=ties)
    lines = [
        line for key, value in _stated(own, case.parent, path.parent).items() if isinstance(value, dict | list)
        for table in (value if isinstance(value, list) else [value])
        for line in toml_lines(f"[[{key}]]" if isinstance(value, list) else f"[{key}]", **table)
    ]  # fmt: skip
    text = case_text(group.images[0].name, lines)  # nothing of the other groups, whose growth would change it
    write_file(path, f"{_HEAD}: change the case that was split, and split it again.\n{text}")


def _stated(value: Any, source: Path, target: Path, key: str = "") -> Any:
    """Tables of a case in the folder `source` without defaults, for one in `target`: texts that name files are paths
    from there.
    """
    if isinstance(value, Struct):
        stated = {field.name: of for field in fields(value) if (of := getattr(value, field.name)) != field.default}
        return {name: _stated(of, source, target, name) for name, of in stated.items()}
    if isinstance(value, list | tuple):
        return [_stated(one, source, target, key) for one in value]
    is_path = isinstance(value, str) and key not in _NAMES and (source / value).is_file()
    return os.path.relpath(source / value, target) if is_path else value

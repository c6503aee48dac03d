"""Other readings of damaged files, by the formats' descriptions and without this program's code: struct, json, csv,
NumPy.

Each gives (name, what was read, what it finds itself), gives up on what it doesn't understand (None, or any error), and
says nothing about what it leaves out.
"""

import csv
import gzip
import io
import json
import math
import re
import struct
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from fuzz_judging_images import (
    archive,
    campaign,
    case_file,
    cube_tables,
    lock,
    megdr_posts,
    mirrors,
    model_state,
    part,
    picture,
    raw_cube,
    result,
    support_data,
)
from fuzz_trials import Judge

Pairs = Iterator[tuple[str, Any, Any]]
_HALF = 0.5
"""pixels, by which ISIS counts more than this program."""


def _places(longitude: Any, latitude: Any, radius: Any) -> Any:
    """(n, 3) of planetocentric degrees and a length."""
    lon, lat, r = (np.asarray(one, dtype=float) for one in (longitude, latitude, radius))
    lon, lat = np.radians(lon), np.radians(lat)
    return np.stack([r * np.cos(lat) * np.cos(lon), r * np.cos(lat) * np.sin(lon), r * np.sin(lat)], axis=-1)


def _number(text: str) -> float:
    """A number in decimal, as C reads it."""
    if not re.fullmatch(r"\s*[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?\s*", text):
        raise ValueError(text)
    return float(text)


# --- networks


def network_pvl(data: bytes, read: Any) -> Pairs:
    """Points and measures by lines `Key = value`; the first of a key counts."""
    network = read[0] if isinstance(read, tuple) else read
    points = list[dict[str, Any]]()
    inside = dict[str, Any]()
    for raw in data.decode("utf-8-sig").replace("\r\n", "\n").replace("\r", "\n").splitlines():
        line = raw.split("#")[0].strip()
        key, equals, value = (part.strip() for part in line.partition("="))
        word = key.lower()
        if word == "object" and value.lower() == "controlpoint":
            points.append({"measures": []})
            inside = points[-1]
        elif word == "group" and value.lower() == "controlmeasure":
            points[-1]["measures"].append({})
            inside = points[-1]["measures"][-1]
        elif equals and word not in ("object", "group", "end_object", "end_group"):
            inside.setdefault(word, value)
    if data.lower().count(b"/*") or any(
        mark in data.replace(b" <pixels>", b"") for mark in (b"{", b"(", b"'", b"#", b"<")
    ):
        return
    yield "number of points", len(network.points), len(points)
    for mine, theirs in zip(points, network.points, strict=True):
        yield "id", theirs.id, mine["pointid"].split(" <")[0].strip('"')
        yield "number of measures", len(theirs.measures), len(mine["measures"])
        for one, other in zip(mine["measures"], theirs.measures, strict=True):
            yield "image", other.serial_number, one["serialnumber"].split(" <")[0].strip('"')
            for key in ("sample", "line"):
                yield key, float(getattr(other, key)), _number(one[key].split("<")[0].strip('"'))


def network_binary(data: bytes, read: Any) -> Pairs:
    """Version 5 by protobuf's wire format, as ISIS's proto file numbers its fields."""
    label = data[:65536].split(b"\0")[0].decode()
    keys = dict(re.findall(r"(\w+)\s*=\s*(\d+)", label))
    if keys["Version"] != "5":
        return
    at = int(keys["PointsStartByte"])
    end, points = at + int(keys["PointsBytes"]), list[dict[int, list[Any]]]()
    while at < end:
        size = struct.unpack_from("<I", data, at)[0]
        points.append(_message(data[at + 4 : at + 4 + size]))
        at += 4 + size
    yield "number of points", len(read.points), len(points)
    for mine, theirs in zip(points, read.points, strict=True):
        yield "id", theirs.id, mine[1][-1].decode()
        measures = [_message(one) for one in mine.get(25, [])]
        yield "number of measures", len(theirs.measures), len(measures)
        for one, other in zip(measures, theirs.measures, strict=True):
            yield "image", other.serial_number, one[1][-1].decode()
            for key, number in (("sample", 3), ("line", 4)):
                value = struct.unpack("<d", one[number][-1])[0]
                yield key, getattr(other, key), value if abs(value) < 1e300 else None  # ISIS's Null


def _message(data: bytes) -> dict[int, list[Any]]:
    found, at = dict[int, list[Any]](), 0

    def varint() -> int:
        nonlocal at
        value = shift = 0
        while True:
            value |= (data[at] & 127) << shift
            at, shift = at + 1, shift + 7
            if data[at - 1] < 128:
                return value

    while at < len(data):
        key = varint()
        kind = key & 7
        if kind == 0:
            value: Any = varint()
        elif kind == 2:
            size = varint()
            value, at = data[at : at + size], at + size
        else:
            size = {1: 8, 5: 4}[kind]
            value, at = data[at : at + size], at + size
        found.setdefault(key >> 3, []).append(value)
    return found


def network_table(data: bytes, read: Any) -> Pairs:
    rows = list(csv.DictReader(io.StringIO(data.decode("utf-8-sig"), newline=None), strict=True))
    measures = {(point.id, one.serial_number): one for point in read.points for one in point.measures}
    yield "number of measures", len(measures), len(rows)
    for row in rows:
        known = {key.strip().lower(): value for key, value in row.items()}
        one = measures[known["id"], known.get("image", known.get("serial_number", ""))]
        for key in ("line", "sample"):
            more = 0.0 if f"isis_{key}" in known else _HALF
            yield key, one.__getattribute__(key), _number(known.get(f"isis_{key}", known.get(key, ""))) + more


def match_binary(data: bytes, read: Any) -> Pairs:
    at, found = 16, list[tuple[float, float]]()
    first, second = struct.unpack_from("<QQ", data)
    yield "numbers", (len(read.pixels[0]), len(read.pixels[1])), (first, second)
    for _ in range(first + second):
        x, y = struct.unpack_from("<ff", data, at)
        count = struct.unpack_from("<Q", data, at + 37)[0]
        found.append((y, x))
        at += 45 + 4 * count
    yield "places", read.pixels.reshape(-1, 2), np.array(found)


def match_text(data: bytes, read: Any) -> Pairs:
    lines = [
        line.split() for line in data.decode("utf-8-sig").splitlines() if line.strip() and not line.startswith("#")
    ]
    rows = np.array([[_number(one) for one in line] for line in lines])
    yield "places", read.pixels, np.stack([rows[:, [1, 0]], rows[:, [4, 3]]])
    yield "sigmas", read.sigmas, rows[:, [2, 5]].T


def ground_control(data: bytes, read: Any) -> Pairs:
    lines = [line.split() for line in data.decode("utf-8-sig").replace("\r", "\n").split("\n")]
    lines = [words for words in lines if words and not words[0].startswith("#")]
    yield "number of points", len(read.points), len(lines)
    for words, point in zip(lines, read.points, strict=True):
        yield "id", point.id, words[0]
        lat, lon, height = (_number(one) for one in words[1:4])
        phi, lam = math.radians(lat), math.radians(lon)
        a, b = 3396190.0, 3376200.0
        e2 = 1.0 - (b / a) ** 2
        n = a / math.sqrt(1.0 - e2 * math.sin(phi) ** 2)
        x, y = ((n + height) * math.cos(phi) * part for part in (math.cos(lam), math.sin(lam)))
        yield "place", np.array(point.apriori), np.array([x, y, (n * (1.0 - e2) + height) * math.sin(phi)])
        for k, one in enumerate(point.measures):
            name, x_pixel, y_pixel = words[7 + 5 * k : 10 + 5 * k]
            yield "image", one.serial_number, name
            yield "measure", (one.sample, one.line), (_number(x_pixel) + 1.0, _number(y_pixel) + 1.0)


def places(data: bytes, read: Any) -> Pairs:
    text = "\n".join(line for line in data.decode("utf-8-sig").splitlines() if not line.startswith("#"))
    rows = list(csv.DictReader(io.StringIO(text, newline=None), strict=True))
    known = [{key.strip().lower(): value for key, value in row.items()} for row in rows]
    given = [[_number(row[key]) for key in ("longitude_deg", "latitude_deg", "radius_m")] for row in known]
    yield "places", read.points, _places(*np.array(given).T)


def verdicts(data: bytes, read: Any) -> Pairs:
    lines = data.decode("utf-8-sig").replace("\r\n", "\n").split("\n")
    start = next(k for k, line in enumerate(lines) if line.strip(" ,") and line[0] != "#")
    rows = [row for row in csv.reader(io.StringIO("\n".join(lines[start + 1 :]), newline="")) if "".join(row).strip()]
    said = {row[0]: row[1].strip().lower() or "undecided" for row in rows}
    yield "verdicts", {key: str(value) for key, value in read.of.items()}, said


# --- altimetry


def lidar(data: bytes, read: Any) -> Pairs:
    shots = json.loads(data.decode("utf-8-sig"))["points"]
    yield "ids", list(read.ids), [one["id"] for one in shots]
    yield "times", read.times, np.array([one["time"] for one in shots], dtype=float)
    yield "ranges", read.ranges, 1e3 * np.array([one["range"] for one in shots], dtype=float)
    yield "sigmas", read.range_sigmas, np.array([one["sigmaRange"] for one in shots], dtype=float)
    yield (
        "places",
        read.footprints,
        1e3 * _places(*np.array([[one[key] for key in ("longitude", "latitude", "radius")] for one in shots]).T),
    )
    measures = [(one["line"], one["sample"]) for shot in shots for one in shot["measures"]]
    yield "measures", read.measures, np.array(measures, dtype=float).reshape(-1, 2) - _HALF


def _columns(data: bytes) -> Mapping[str, list[str]]:
    """Of a table with commas, by the letters of their names."""
    rows = [line.split(",") for line in data.decode("utf-8-sig").replace("\r\n", "\n").split("\n") if line.strip()]
    if len({len(row) for row in rows}) != 1:
        raise ValueError("rows of unequal length")
    names = [re.sub(r"[^a-z]", "", name.lower()) for name in rows[0]]
    if len(set(names)) < len(names):
        raise ValueError("a name twice")
    return {name: [row[k] for row in rows[1:]] for k, name in enumerate(names)}


def shots(data: bytes, read: Any) -> Pairs:
    """Of ODE's tables of MOLA and MLA, and of CSV."""
    table = _columns(gzip.decompress(data) if data[:2] == b"\x1f\x8b" else data)

    def column(*names: str) -> Any:
        name = next(name for name in names if name in table)
        return np.array([_number(one) for one in table[name]])

    radius = column("planetrad", "planetradius", "radius")
    scale = 1e3 if np.all(np.abs(radius) < 1e4) else 1.0
    there = radius != 0.0  # where there was no ground
    yield "number of shots", read.times.size, int(there.sum())
    where = _places(column("longeast", "longitude", "lon"), column("latnorth", "latitude", "lat"), scale * radius)
    yield "places", read.footprints, where[there]
    if "molarange" in table:
        ranges = column("molarange")[there]
        yield "ranges", read.ranges, np.where(ranges > 0.0, ranges, np.nan)


def cloud(data: bytes, read: Any) -> Pairs:
    rows = list(csv.DictReader(io.StringIO(data.decode("utf-8-sig"), newline=None), strict=True))
    known = [{key.strip().lower(): value for key, value in row.items()} for row in rows]
    given = np.array([[_number(row[key]) for key in ("longitude_deg", "latitude_deg", "radius_m")] for row in known])
    yield "places", _sorted(read.points), _sorted(_places(*given.T))  # profile by profile


def _sorted(places: Any) -> Any:
    return places[np.lexsort(places.T.round(6))]


def lola(data: bytes, read: Any) -> Pairs:
    """By LOLARDR.FMT: spots of 40 bytes from byte 40 on, 256 bytes a record; those without a radius are left out."""
    starts = [256 * k + 40 + 40 * spot for k in range(len(data) // 256) for spot in range(5)]
    spots = [struct.unpack_from("<3i24xI", data, start) for start in starts]
    ground_alone = not hasattr(read, "footprints")
    found = np.array([spot for spot in spots if spot[2] != -1 and not (ground_alone and spot[3] & 255)], dtype=float)
    where = _places(found[:, 0] * 1e-7, found[:, 1] * 1e-7, found[:, 2] * 1e-3)
    places = read.points if ground_alone else read.footprints
    if len(places) == len(where):
        yield "places", _sorted(places), _sorted(where)


def pedr(data: bytes, read: Any) -> Pairs:
    """Longitude, latitude and radius of each frame's tenth and eleventh shot are the frame's own: here the count alone
    and the orbit (PEDR's SIS, bytes 13 to 14).
    """
    frames = (len(data) - 7760) // 776
    yield "number of shots", read.times.size <= 20 * frames, True


JUDGES: dict[str, Judge] = {
    "case file": case_file, "support data": support_data, "support data of ISIS": support_data,
    "model state of CSM": model_state, "ISIS cube with tables": cube_tables,
    "picture, TIFF": picture, "picture, packed TIFF": picture, "picture, PNG": picture, "picture, JPEG": picture,
    "picture, ISIS cube": raw_cube, "terrain, MEGDR's posts": megdr_posts, "network, PVL": network_pvl,
    "network, PVL, version 1": network_pvl, "network, PVL, version 3": network_pvl, "network, binary": network_binary,
    "network, table": network_table, "match file": match_binary, "match file, text": match_text,
    "ground control": ground_control, "table of places": places, "verdicts": verdicts, "lidar JSON": lidar,
    "shots of ODE": shots, "shots, CSV": shots, "shots of MLA": shots, "shots, packed": shots, "altimetry cloud": cloud,
    "real network of MOC": network_pvl, "real network of LROC": network_pvl, "real lidar JSON": lidar,
    "real support data": support_data, "real shots of ODE": shots,
    "LOLA's records": lola, "altimetry cloud, LOLA": lola, "PEDR": pedr, "kept tile": archive, "result": result,
    "campaign's record": campaign, "mirrors": mirrors, "lock of fetch": lock, "part of fetch": part,
}  # fmt: skip
"""By the readers' names."""

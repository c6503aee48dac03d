"""Other readings of images, of what the program keeps and of what it fetches; see `fuzz_judging`."""

import io
import json
import re
import struct
import tomllib
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

Pairs = Iterator[tuple[str, Any, Any]]


# --- images


def support_data(data: bytes, read: Any) -> Pairs:
    isd = json.loads(data.decode("utf-8-sig"))
    times_km = {"km": 1e3, "m": 1.0}[isd["radii"].get("unit", "km").lower()]
    yield "lines", read.lines, isd["image_lines"]
    yield "samples", read.samples, isd["image_samples"]
    yield "radius", read.body.equatorial, float(isd["radii"]["semimajor"]) * times_km
    yield "polar radius", read.body.polar, float(isd["radii"]["semiminor"]) * times_km
    yield "focal length", read.interior.focal_length, float(isd["focal_length_model"]["focal_length"]) * 1e-3
    yield "epoch", read.trajectory.epoch, float(isd["center_ephemeris_time"])
    rates = np.array(isd["line_scan_rate"], dtype=float)
    yield "line periods", read.timing.periods, rates[:, 2]
    table = isd["instrument_position"]
    unit = {"km": 1e3, "m": 1.0}[table.get("unit", "km").lower()]
    if len(table["positions"]) == len(read.trajectory.position.positions):
        yield (
            "positions",
            _near(read.trajectory.position.positions, np.array(table["positions"], dtype=float) * unit),
            True,
        )
        epoch = read.trajectory.epoch
        yield "times of positions", read.trajectory.position.times + epoch, _times(table)


def _near(found: Any, wanted: Any) -> bool:
    """Within what light-time and aberration move a spacecraft."""
    return found.shape == wanted.shape and bool(np.all(np.abs(found - wanted) < 0.02 * np.abs(wanted).max()))


def _times(table: Mapping[str, Any]) -> Any:
    if "ephemeris_times" in table:
        return np.array(table["ephemeris_times"], dtype=float)
    count = len(table["positions"])
    start, stop = (float(table[f"spk_table_{key}_time"]) for key in ("start", "end"))
    return np.linspace(start, stop, count)


def model_state(data: bytes, read: Any) -> Pairs:
    state = json.loads(data[data.index(b"{") :])
    yield "lines", read.lines, state["m_nLines"]
    yield "samples", read.samples, state["m_nSamples"]
    yield "focal length", read.interior.focal_length, state["m_focalLength"] * 1e-3
    yield "radii", (read.body.equatorial, read.body.polar), (float(state["m_majorAxis"]), float(state["m_minorAxis"]))
    yield "epoch", read.trajectory.epoch, float(state["m_centerEphemerisTime"])
    yield "line periods", read.timing.periods, np.array(state["m_intTimes"], dtype=float)


def cube_tables(data: bytes, read: Any) -> Pairs:
    label = data[:65536].split(b"\0")[0].decode()
    found = re.search(
        r"Name = InstrumentPosition\s+StartByte = (\d+)\s+Bytes = (\d+)\s+Records = (\d+)\s+ByteOrder = Lsb\s", label
    )
    if found is None:
        return
    start, size, count = map(int, found.groups())
    rows = np.frombuffer(data, "<f8", size // 8, start - 1).reshape(count, 7)
    yield "positions", _near(read.trajectory.position.positions, rows[:, :3] * 1e3), True
    yield "times", read.trajectory.position.times + read.trajectory.epoch, rows[:, 6]


def megdr_posts(data: bytes, read: Any) -> Pairs:
    yield "posts", read.radii.ravel(), np.frombuffer(data, ">i2").astype(float) + 3_396_000.0


def picture(data: bytes, read: Any) -> Pairs:
    """TIFF of one band by its tags (TIFF 6.0), without packing or by zlib alone; PNG and JPEG of grey by Pillow."""
    if data[:2] in (b"II", b"MM"):
        pixels = _tiff(data)
        yield "size", read.shape, pixels.shape
        yield "pixels", read, pixels
        return
    from PIL import Image

    with Image.open(io.BytesIO(data)) as image:
        if image.mode != "L" or (image.format == "PNG" and data[24] != 8):
            return
        pixels = np.asarray(image)
        yield "size", read.shape, pixels.shape
        if image.format != "JPEG":
            yield "pixels", read, pixels


def _tiff(data: bytes) -> Any:
    """Pixels of a plain TIFF; ValueError for any other."""
    order = "<" if data[:2] == b"II" else ">"
    begin = struct.unpack_from(f"{order}I", data, 4)[0]
    tags = dict[int, tuple[int, ...]]()
    for k in range(struct.unpack_from(f"{order}H", data, begin)[0]):
        tag, kind, count = struct.unpack_from(f"{order}HHI", data, begin + 2 + 12 * k)
        letter, size = {1: ("B", 1), 3: ("H", 2), 4: ("I", 4)}.get(kind, ("", 0))
        if letter and count < 1000:
            at = begin + 10 + 12 * k
            at = at if count * size <= 4 else struct.unpack_from(f"{order}I", data, at)[0]
            tags.setdefault(tag, struct.unpack_from(f"{order}{count}{letter}", data, at))
    one = {tag: values[0] for tag, values in tags.items() if values}
    plain = {277: 1, 262: 1, 339: 1, 266: 1, 274: 1}
    if (
        one[259] != 1
        or any(one.get(tag, usual) != usual for tag, usual in plain.items())
        or 322 in tags
        or 42113 in tags
    ):
        raise ValueError("another kind of TIFF")
    if set(tags) - {*plain, 254, 256, 257, 258, 259, 273, 278, 279, 284, 317} or one.get(317, 1) != 1:
        raise ValueError("tags that may say more")
    content = b"".join(data[start : start + size] for start, size in zip(tags[273], tags[279], strict=True))
    pixels = np.frombuffer(content, f"{order}u{one[258] // 8}")
    return pixels[: one[256] * one[257]].reshape(one[257], one[256])


def raw_cube(data: bytes, read: Any) -> Pairs:
    """Eight bits for each pixel behind the label, where the label says so and nothing of a base."""
    label = data[:4096].split(b"\0")[0].decode()
    pairs = re.findall(r"(\w+)\s*=\s*(\S+)", label)
    keys = dict(pairs)
    if len({key.lower() for key, _ in pairs} - {"object", "group"}) < sum(
        key.lower() not in ("object", "group") for key, _ in pairs
    ):
        return
    if keys["Type"] != "UnsignedByte" or float(keys["Base"]) != 0.0 or float(keys["Multiplier"]) != 1.0:
        return
    lines, samples, start = int(keys["Lines"]), int(keys["Samples"]), int(keys["StartByte"])
    pixels = np.frombuffer(data, "u1", lines * samples, start - 1).reshape(lines, samples)
    if keys.get("Format", "BandSequential") == "BandSequential" and keys["Bands"] == "1":
        yield "pixels", read, pixels


# --- what is kept and fetched


def archive(data: bytes, read: Any) -> Pairs:
    if read is None:  # a tile that is matched again
        yield "tile", None, None
        return
    with np.load(io.BytesIO(data)) as arrays:
        for name in arrays.files:
            yield name, read[name], arrays[name]


def result(data: bytes, read: Any) -> Pairs:
    """By NumPy: every array stands in the record under its name."""
    with np.load(io.BytesIO(data)) as arrays:
        for name in arrays.files:
            found = read
            for step in re.findall(r"\w+", name):
                found = found[int(step)] if step.isdigit() else getattr(found, step, None)
            if isinstance(found, np.ndarray):
                yield name, found, arrays[name]


def campaign(data: bytes, read: Any) -> Pairs:
    whole = data[: data.rfind(b"\n") + 1].decode()  # the last line may have been cut short: its case is done again
    lines = [json.loads(line) for line in whole.split("\n")[1:] if line.strip()]
    entries = {line["case"]: line for line in lines if "case" in line}
    yield "cases", sorted(read), sorted(entries)
    for name, entry in entries.items():
        for key in ("folder", "status", "message", "seconds", "converged", "sigma0", "cost", "iterations"):
            yield key, getattr(read[name], key), entry[key]


def mirrors(data: bytes, read: Any) -> Pairs:
    for key, value in tomllib.loads(data.decode("utf-8-sig")).items():
        yield key, getattr(read, key), value if value.endswith("/") else f"{value}/"


def lock(data: bytes, read: Any) -> Pairs:
    content = json.loads(data)
    yield "files", sorted(read.files), sorted(content["files"])
    for name, entry in content["files"].items():
        for key, value in entry.items():
            yield key, getattr(read.files[name], key), value


def part(data: bytes, read: Any) -> Pairs:
    if read is None:
        yield "part", None, None
        return
    for key, value in json.loads(data).items():
        yield key, getattr(read, key), value


def case_file(data: bytes, read: Any) -> Pairs:
    """Every value of the file stands in the record under the same keys."""
    yield from _under(
        tomllib.loads(data.decode("utf-8-sig").replace("\r\n", "\n")), read[1] if isinstance(read, tuple) else read, ""
    )


def _under(table: Any, record: Any, where: str) -> Pairs:
    if isinstance(table, dict):
        for key, value in table.items():
            yield from _under(value, getattr(record, key), f"{where}.{key}")
    elif isinstance(table, list):
        yield f"length of {where}", len(record), len(table)
        for one, other in zip(table, record, strict=True):
            yield from _under(one, other, where)
    else:
        yield where, str(record) if isinstance(table, str) else record, table

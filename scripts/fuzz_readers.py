"""Every way into the program for files from outside, each with a sound file and the damage that its format can take."""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import cubes
import fuzz_seeds as seeds
import mex
import mgs
import numpy as np
import rasters
from fuzz_addresses import png
from fuzz_commands import of_commands
from fuzz_kinds import BYTES, CSV, DAF, JSON, PVL, TIFF, TOML, Row
from fuzz_readers_of_data import of_real_files
from fuzz_readers_of_tables import of_altimetry, of_archives, of_networks, of_what_is_kept
from fuzz_seeds import made, of_pair, of_tests, text
from fuzz_structures import records
from fuzz_trials import Judge, Reader, Seed

from mgsgraph.geometry.body import Ellipsoid

MARS = Ellipsoid(3396190.0, 3376200.0)
_IMAGE = "E0202855.img"


def every(only: Sequence[str] = (), judges: dict[str, Judge] | None = None) -> list[Reader]:
    """All readers, or those whose names hold one of some words."""
    rows = [
        *_cases(), *_images(), *_kernels(), *_pictures(), *_terrain(), *of_networks(), *of_altimetry(),
        *of_what_is_kept(), *of_archives(), *of_real_files(), *of_commands(),
    ]  # fmt: skip
    chosen = [row for row in rows if not only or any(word in row.name for word in only)]
    return [
        Reader(row.name, row.read, row.seed(), row.changes, row.owner, (judges or {}).get(row.name), *row[5:])
        for row in chosen
    ]


def _cases() -> Iterator[Row]:
    from mgsgraph.case.case_file import decode, stated
    from mgsgraph.case.draft import draft_case
    from mgsgraph.case.reading import read_case
    from mgsgraph.files.kinds import kind_of

    def drafted(path: Path) -> object:
        (path.parent / "out.toml").unlink(missing_ok=True)
        return draft_case([path.parent], path.parent / "out.toml").text

    yield Row("case file", "F", lambda path: (stated(path), decode(path)), seeds.case_seed, TOML, gaps=(".trend[]",
    ".position_sigma_m", ".angle_sigma_mrad"))
    yield Row("whole case", "F", read_case, seeds.case_seed, TOML)
    yield Row("mgsgraph new, support data", "E", drafted, partial(seeds.case_seed, "image_A.isd"), JSON)
    yield Row("mgsgraph new, network", "E", drafted, partial(seeds.case_seed, "network.pvl"), PVL)
    yield Row("kind of a table", "E", kind_of, lambda: text("a.csv", seeds.ode_table()), CSV)
    yield Row("kind of a label", "E", kind_of, lambda: text("a.img", mgs.image_bytes()), PVL)
    yield Row("kind of JSON", "E", kind_of, partial(of_pair, "lidar.json"), JSON)
    yield Row("kind of gzip", "E", kind_of, lambda: text("a.gz", seeds.packed(seeds.mla_table())), BYTES)


def _images() -> Iterator[Row]:
    from mgsgraph.files.cameras.label import read_line_scan_label, read_line_times
    from mgsgraph.files.labels.isis_cube import read_isis_cube
    from mgsgraph.files.pvl import read_label
    from mgsgraph.files.support_data.isd import read_isd
    from mgsgraph.files.support_data.model_state import read_model_state

    def times(seconds: float, path: Path) -> object:
        label = read_line_scan_label(path)
        return read_line_times(label.times, label.lines, mex.START, mex.START + seconds, str(path))

    def times_of_text(path: Path) -> object:
        return read_line_times(path, 15088, mex.START, mex.START + 196.7, str(path))

    def isis_label(folder: Path) -> None:
        (folder / "a.pvl").write_text(cubes.LABEL + "End\n")

    table = [("time", "<f8"), ("exposure", "<f8"), ("line", "<i4")]
    prefix = np.dtype({"names": ["time", "exposure"], "formats": ["<f8", "<f4"], "offsets": [0, 4], "itemsize": 512})
    hrsc = mex.image_bytes([mex.START + 0.01 * k for k in range(20)], [10.0] * 20)
    doubles, rows = [records("<f8", 65536)] * 20, [records(table, 4096)] * 10
    support = lambda: text("image.isd", seeds.support_data())  # noqa: E731
    yield Row("support data", "B", lambda path: read_isd(path, "M00/00001"), support, JSON)
    yield Row("support data of ISIS", "B", lambda path: read_isd(path, "SIM/A"), partial(of_pair, "image_A.isd"), JSON)
    state = lambda: text("a.json", seeds.model_state())  # noqa: E731
    yield Row("model state of CSM", "B", lambda path: read_model_state(path, "A/1"), state, JSON)
    yield Row("ISIS cube with tables", "B", read_isis_cube, lambda: made("image.cub", cubes.written), (*PVL, *doubles))
    yield Row("label of a cube", "B", read_label, lambda: made("a.pvl", isis_label), PVL, gaps=(".value",))
    yield Row("line-scan label, PDS3", "B", read_line_scan_label, lambda: text("M0402852.IMG", mgs.image_bytes()), PVL)
    yield Row("line times, cube", "B", partial(times, 196.7), lambda: text("a.cub", mex.cube_bytes()), (*PVL, *rows))
    changes = (*PVL, *[records(prefix, 2048)] * 10)
    yield Row("line times, PDS3", "B", partial(times, 0.19), lambda: text("a.img", hrsc), changes)
    yield Row("line times, text", "B", times_of_text, lambda: made("line_times.csv", mex.times_file), CSV)


def _kernels() -> Iterator[Row]:
    from mgsgraph.files.labels.kernels import loaded
    from mgsgraph.files.labels.labelled_image import read_labelled_image

    def furnished(path: Path) -> None:
        with loaded([path]):
            pass

    def image_of(path: Path) -> object:
        return read_labelled_image(path.with_name(_IMAGE), [path.with_name("mgs.tm")])

    yield Row("image with its kernels", "B", image_of, partial(seeds.kernels_seed, _IMAGE), PVL)
    for name in ("mgs.tls", "mgs.tsc", "mars.tpc", "mgs.tf", "moc.ti"):
        yield Row(f"text kernel {name}", "B", image_of, partial(seeds.kernels_seed, name), PVL, share=0.4)
    yield Row("text kernel alone", "B", furnished, partial(seeds.of_site, "mgs.tls"), PVL)
    yield Row("meta-kernel", "B", image_of, partial(seeds.kernels_seed, "mgs.tm"), PVL)
    yield Row("binary kernel, SPK", "B", image_of, partial(seeds.kernels_seed, "mgs_ext1.bsp"), DAF, share=0.8)
    yield Row("binary kernel, CK", "B", image_of, partial(seeds.kernels_seed, "mgs_sc_ext1.bc"), DAF)


def _pictures() -> Iterator[Row]:
    from mgsgraph.files.pvl import read_label
    from mgsgraph.files.rasters.pictures import is_moc, pixel_area, read_moc_pixels, read_picture

    tests = of_tests("files/rasters/test_pictures.py")
    grey = np.arange(300).reshape(15, 20)

    def moc(path: Path) -> object:
        return is_moc(path), pixel_area(path, read_label(path)), read_moc_pixels(path)

    def tiff(kind: str, **more: Any) -> Callable[[], Seed]:
        return lambda: made("a.tif", lambda folder: tests.tif(folder / "a.tif", grey.astype(kind), **more))

    def encoded(name: str, form: str) -> Callable[[], Seed]:
        from PIL import Image

        return lambda: made(name, lambda folder: Image.fromarray(grey.astype(np.uint8)).save(folder / name, form))

    def cube(folder: Path) -> None:
        tests.cube(folder / "a.cub", np.arange(30).reshape(5, 6).astype("uint8"), "UnsignedByte")

    yield Row("picture, TIFF", "A", read_picture, tiff("uint8"), TIFF, gaps=("",))
    deflated = tiff("uint16", compress="deflate", predictor=2)
    yield Row("picture, packed TIFF", "A", read_picture, deflated, TIFF, gaps=("",))
    yield Row("picture, PNG", "A", read_picture, encoded("a.png", "PNG"), (*BYTES, *[png] * 5))
    yield Row("picture, JPEG", "A", read_picture, encoded("a.jpg", "JPEG"), BYTES)
    yield Row("picture, ISIS cube", "A", read_picture, lambda: made("a.cub", cube), PVL)
    yield Row("pixels of MOC", "A", moc, lambda: text("M0402852.img", mgs.image_bytes()), PVL)


def _terrain() -> Iterator[Row]:
    from mgsgraph.files.rasters.megdr import read_megdr
    from mgsgraph.files.rasters.terrain_file import read_terrain

    def raster(name: str, folder: Path) -> None:
        crs, places = rasters.PROJECTIONS[name]
        shape = (12, 14)
        transform, x, y = rasters.pixels(crs, shape=shape)
        radii = (rasters.RADIUS + rasters.ground(*places(x, y))).reshape(shape)
        rasters.raster(folder / "dem.tif", radii, crs, transform)

    def terrain(path: Path) -> object:
        return read_terrain(path, body=MARS)

    posts = (*BYTES, *[records(">i2", 0)] * 10)
    gaps = (".values", ".posts", ".radii")
    for name in ("equirectangular", "polar stereographic"):
        seed = partial(made, "dem.tif", partial(raster, name))
        yield Row(f"terrain, {name}", "A", terrain, seed, (*TIFF, *[records("<f8", 300)] * 4), gaps=gaps)
    yield Row("terrain, MEGDR's label", "A", read_megdr, partial(seeds.grid_seed, "megr_x.lbl"), PVL)
    yield Row("terrain, MEGDR's posts", "A", read_megdr, partial(seeds.grid_seed, "megr_x.img"), posts)

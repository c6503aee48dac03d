"""Three ways from a pixel to the ground, for 5 x 5 pixels of each camera: label and kernels, support data, and the
equations of camera_equations.py, which makes the support data, too, of SPICE alone.

Kernels and labels of CTX, LROC, MOC, Kaguya TC and HRSC are real. Of HiRISE, MI and THEMIS-IR the label is made up,
over the real orbits of MRO, Kaguya and (under Odyssey's numbers) MGS; the CRISM-like camera with its gimbal is made up
wholly, and so has no label. The scenes stand in camera_scenes.py.
"""

import json
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from camera_equations import Scene, Variant, Vector, furnished
from camera_scenes import CAMERAS, Tabled, kernels_of, without
from study import Blocks, command, default, table, write_page

from mgsgraph.files.labels.isis_cube import read_isis_cube
from mgsgraph.files.labels.labelled_image import read_labelled_image
from mgsgraph.files.support_data.isd import read_isd
from mgsgraph.geometry.image import PushbroomImage

ROOT, PAGE = Path(__file__).resolve().parents[1], "cameras.md#camera_roads"
HEAD = (
    "camera", "image", "label and kernels against own equations", "support data against own equations", "the two roads",
    "why",
)  # fmt: skip


class Row(NamedTuple):
    """Largest differences in pixels of 25 places; NaN where a path is missing."""

    camera: str
    image: str
    label: float
    support: float
    between: float
    why: str


def rows(name: str, data: Path) -> list[Row]:
    """Rows of one camera, by its name in CAMERAS: the scene, then its variants."""
    make, folder, more = CAMERAS[name]
    kernels = kernels_of(data, folder, *more) if folder else []
    with tempfile.TemporaryDirectory() as place:
        with furnished(kernels):
            scene = make(data, Path(place))
            places = [(line, sample) for line in np.linspace(0.5, scene.size[0] - 0.5, 5)
                      for sample in np.linspace(0.5, scene.size[1] - 0.5, 5)]  # fmt: skip
            exact = np.array([scene.ground(*pixel) for pixel in places])
            steps = np.array([
                [scene.ground(line + 0.5, sample) - scene.ground(line - 0.5, sample),
                 scene.ground(line, sample + 0.5) - scene.ground(line, sample - 0.5)] for line, sample in places
            ])  # fmt: skip
            variants = [] if "MOC-WA" in scene.camera else [Variant("", without(scene.code)), *scene.variants]
            support = [(v, scene.support_data(v)) for v in variants]
        label = by_label(scene, [*kernels, *scene.kernels])

        def pixels(first: Vector, second: Vector) -> float:
            pairs = zip(steps, first - second, strict=True)
            return float(np.max([np.linalg.norm(np.linalg.lstsq(step.T, off, rcond=None)[0]) for step, off in pairs]))

        def grounds(image: PushbroomImage) -> Vector:
            return np.asarray(image.image_to_ground(*np.array(places).T)[0])

        labelled = grounds(label) if label else np.full_like(exact, np.nan)
        compared = []
        for variant, isd in support or [(Variant("", {}), None)]:
            theirs = np.full_like(exact, np.nan)
            if isd is not None:
                path = Path(place) / "image.json"
                path.write_text(json.dumps(isd))
                theirs = grounds(read_isd(path, "image"))
            title = ", ".join(filter(None, [scene.name, variant.name]))
            largest = [pixels(labelled, exact), pixels(theirs, exact), pixels(labelled, theirs)]
            compared.append(Row(scene.camera, title, *largest, variant.why if variant.name else scene.why))
    return compared


def by_label(scene: Scene, kernels: Sequence[Path]) -> PushbroomImage | None:
    """The image as the program reads it from its label; None without a label."""
    if scene.label is None:
        return None
    if isinstance(scene, Tabled):
        return read_isis_cube(scene.label)
    return read_labelled_image(scene.label, kernels, line_times=scene.line_times)


def cell(pixels: float) -> str:
    """px, in two digits; empty where a path is missing."""
    return "" if np.isnan(pixels) else f"{pixels:.2g} px"


def made(data: Path, names: Sequence[str]) -> Blocks:
    """The table."""
    compared = [row for name in names for row in rows(name, data)]
    return {"camera_roads": table(HEAD, [
        [row.camera, row.image, cell(row.label), cell(row.support), cell(row.between), row.why] for row in compared
    ])}  # fmt: skip


def main() -> int:
    """Command line."""
    parser = command(__doc__)
    parser.add_argument("--data", type=Path, default=ROOT.parent / "shared" / "data")
    parser.add_argument("--out", type=Path, default=default(PAGE))
    parser.add_argument("--cameras", nargs="+", choices=CAMERAS, help="these alone, and no page is written")
    chosen = parser.parse_args()
    if chosen.cameras:
        print("\n".join(made(chosen.data, chosen.cameras)["camera_roads"]))
        return 0
    return write_page(parser, chosen.out, PAGE, lambda: made(chosen.data, list(CAMERAS)))


if __name__ == "__main__":
    sys.exit(main())

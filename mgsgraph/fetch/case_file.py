"""The case and the meta-kernel of what has been fetched.

A-priori sigmas are the papers': those of orbit and pointing stand in files.labels.accuracy; Yoon & Shan (2005) take
10 m for ranges and footprints; MOLA's profiles lie within 100 m (Kirk et al. 2002).
"""

import re
from collections.abc import Sequence
from pathlib import Path

from mgsgraph.errors import InputError
from mgsgraph.fetch.needs import FIXED, LEAP_SECONDS, Grid, ImageNeeds, kernel_path, kernels_of, topography
from mgsgraph.files.labels.accuracy import accuracy_of
from mgsgraph.files.opening import number_of, read_text
from mgsgraph.text import some

CASE = "case.toml"
_INSTRUMENT = kernel_path("ik/mgs_moc_v20.ti")
_PIXEL_SIZE = re.compile(r"^[ \t]*INS-94031_PIXEL_SIZE[ \t]*=[ \t]*\(?[ \t]*([-+.\deE]+)", re.MULTILINE)
"""m, in NAIF's instrument kernel."""
_LEAST, _LARGEST = 1e-6, 1e-4
"""m, between which a pixel is: it has 13 micrometres."""
_PIXEL_ANGLE = 3.7497308149e-6
"""rad, that a pixel sees, by ISIS (mocAddendum004.ti: 13.1240578522949 micrometres on 3500 mm). NAIF's kernel has
13 micrometres on a nominal 3.5 m, of which it says that the truth may be 2 percent off."""

_MOC_NOMINAL = 'nominal = "polynomial"                  # fitted to the kernels\' trajectory, order 2\n'
_PROFILE = """\
range_sigma_m = 10.0
ground_sigma_m = 10.0
shift_sigma_m = 100.0                   # a common horizontal error of the profile, as an unknown
check_every = 5                         # every fifth shot takes no part: checkpoints of `mgsgraph dem`
"""


META_KERNEL_HEAD = """\
KPL/MK

Kernels fetched from NAIF. mgsgraph looks for them beside this file; SPICE itself in the current folder.
"""


def meta_kernel_path(needs: Sequence[ImageNeeds]) -> str:
    """Of our own meta-kernel in the folder, called after the spacecraft."""
    camera = needs[0].camera
    return "kernels/mgs.tm" if camera is None else f"kernels/{camera.kernels.partition('_')[0]}.tm"


def meta_kernel(needs: Sequence[ImageNeeds]) -> str:
    """Text of a meta-kernel that names files beside it, in the order of loading."""
    kernels = [LEAP_SECONDS, *FIXED, *kernels_of(needs)]
    if needs[0].camera is not None:
        kernels = list(dict.fromkeys(path for image in needs for path in (*image.kernels, image.addendum) if path))
    names = [Path(kernel_path(kernel)).name for kernel in kernels]
    listed = "\n".join(f"  '{name}'" for name in names)
    return f"""{META_KERNEL_HEAD}

\\begindata
KERNELS_TO_LOAD = (
{listed}
)
\\begintext
"""


def case_text(needs: Sequence[ImageNeeds], grid: Grid | None, folder: Path) -> str:
    """A case file for all images, their profiles and a terrain; tie points are still to be found."""
    names = [image.product.name for image in needs]
    parts = [
        "# Written by `mgsgraph fetch`, and yours to change: it is not overwritten then.\n"
        f'format = 1\nname = "{some(names, len(names))}"\n',
        _orientation(needs[0]),
        f'[spice]\nkernels = ["{meta_kernel_path(needs)}"]\n',
    ]
    if needs[0].camera is None:
        focal_length = camera_focal_length(folder)
        parts += [_image(image, focal_length) for image in needs]
    parts += [_other_image(image) for image in needs if image.camera is not None]
    parts += [_other_shots(image) for image in needs if image.shots]
    parts += [
        f'[[shots]]\nfile = "{image.pedr_path}"\nimage = "{image.product.name}"\n{_PROFILE}'
        for image in needs
        if image.pedr
    ]
    return "\n".join([*parts, *([] if grid is None else [_terrain(grid)])])


def _orientation(image: ImageNeeds) -> str:
    """Prior of the images' orientation, by the mission of one of them."""
    nominal = _MOC_NOMINAL if image.camera is None else ""
    mission = "MGS" if image.camera is None else image.camera.kernels.partition("_")[0].upper()
    return "".join([
        "[orientation]\n", nominal, _commented("degree = 2", "of the corrections"), *accuracy_of(mission).lines(),
        _commented("trend = [1.0, 0.1, 0.01]", "of these, for the terms 1, u, u^2"),
    ])


def _image(image: ImageNeeds, focal_length: float) -> str:
    return "".join([
        "[[images]]\n",
        _commented(f'name = "{image.product.name}"', f"{image.start}, orbit {image.orbit}"),
        f'label = "{image.image_path}"\n',
        _commented('constants = "ik"', "of NAIF's instrument kernel, but for"),
        _commented(f"focal_length_m = {focal_length}", "by which a pixel sees 3.7497 microradians, as in ISIS"),
    ])


def _other_image(image: ImageNeeds) -> str:
    return "".join([
        "[[images]]\n", _commented(f'name = "{image.product.name}"', image.start), f'label = "{image.image_path}"\n',
    ])


def _other_shots(image: ImageNeeds) -> str:
    """Laser shots over an image, for the user to choose from: many profiles, seldom one that was taken along."""
    return (
        f"# laser shots about {image.product.name}; which ones fall in it:\n"
        f"# mgsgraph footprints {CASE} {image.shots_path}\n"
        f'# [[altimetry]]\n# file = "{image.shots_path}"\n'
    )


def _commented(line: str, comment: str) -> str:
    return f"{line:39} # {comment}\n"


def camera_focal_length(folder: Path) -> float:
    """Focal length (m) with which the pixels of the folder's instrument kernel see the angle that they do.

    Raises
    ------
    InputError
        A kernel that has no pixel size.
    """
    path = folder / _INSTRUMENT
    match = _PIXEL_SIZE.search(read_text(path, encoding="latin-1"))
    if match is None or not _LEAST < (size := number_of(match[1], f"{path}, INS-94031_PIXEL_SIZE")) < _LARGEST:
        problem = "no INS-94031_PIXEL_SIZE" if match is None else f"INS-94031_PIXEL_SIZE = {match[1]} m"
        raise InputError(str(path), problem, "NAIF's instrument kernel of MOC", "try another mirror")
    return round(size / _PIXEL_ANGLE, 6)


def _terrain(grid: Grid) -> str:
    def files(stems: Sequence[str]) -> str:
        names = [f'"megdr/{Path(stem).name}.lbl"' for stem in stems]
        return names[0] if len(names) == 1 else f"[{', '.join(names)}]"

    lines = ["[terrain]\n", f"radius = {files(grid.stems)}\n"]
    if len(grid.stems) == 1:  # of several tiles a case takes the radii only
        lines.append(f"topography = {files([topography(grid.stems[0])])}\n")
    lines.append(_commented(f"vertical_sigma_m = {grid.sigma}", "between its posts (docs/fetch.md)"))
    lines.append(_commented("planimetric_sigma_m = 100.0", "MOLA's (Kirk et al. 2002)"))
    return "".join(lines)

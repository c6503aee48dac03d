"""What kind of file an image is given by, told by what is in the file, and what the file calls the image."""

from pathlib import Path
from typing import Literal

from mgsgraph.errors import InputError
from mgsgraph.files.cameras.label import label_of
from mgsgraph.files.kinds import Kind, kind_of
from mgsgraph.files.labels.image_label import read_label
from mgsgraph.files.labels.isis_cube import has_tables, serial_number
from mgsgraph.files.opening import head_of
from mgsgraph.files.support_data.model_state import read_state_json

ImageKind = Literal["isd", "state", "label", "cube"]

_HEAD = 512
_KEYS: dict[Kind | None, ImageKind] = {
    Kind.SUPPORT_DATA: "isd", Kind.MODEL_STATE: "state", Kind.CUBE_TABLES: "cube",
}  # fmt: skip
_OF_LABELS = (Kind.PDS3, Kind.CUBE, Kind.MAPPED_CUBE, Kind.CUBE_LABEL, Kind.RASTER)
"""A raster may be a map-projected cube, which its reader refuses."""


def image_kind(path: Path, kernels_of_its_own: bool = False, kernels: bool = False) -> ImageKind:
    """The kind of an image's file.

    Parameters
    ----------
    path : Path
        Image support data (JSON), model state, ISIS cube or its label, tables of a cube as JSON, or PDS3 label.
    kernels_of_its_own : bool
        Whether kernels are named for this very image, which go before the tables of its cube.
    kernels : bool
        Whether there are any kernels that a label could be read with.

    Raises
    ------
    InputError
        Missing file, or none of these.
    """
    kind = kind_of(path)
    if kind in _KEYS:
        return _KEYS[kind]
    if kind is None and head_of(path, _HEAD).lstrip().startswith(b"{"):  # what is wrong in it, its reader says
        return "isd"
    if kind not in _OF_LABELS:
        raise InputError(
            str(path), str(kind) if kind else "no image, label or support data",
            "an ISIS cube, a PDS3 label, JSON of ALE or ISIS, or a model state of usgscsm",
        )  # fmt: skip
    root = read_label(path)
    if "PDS_VERSION_ID" in root:
        return "label"
    with_tables = has_tables(path, root)
    return "label" if kernels_of_its_own or (kernels and not with_tables) else "cube"


def image_name(path: Path, kind: ImageKind) -> str:
    """By which control networks call the image: ISIS's serial number, or what support data call it, or the file."""
    if kind == "cube":
        return serial_number(path)
    if kind == "label":
        return label_of(path, read_label(path)).serial
    stated = read_state_json(path).get("m_imageIdentifier" if kind == "state" else "image_identifier")
    return stated if isinstance(stated, str) and stated else path.stem

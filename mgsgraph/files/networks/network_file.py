"""ISIS control networks read from either of their forms, told apart by what is in the file: whole, or as TiePoints."""

from pathlib import Path

from mgsgraph.errors import InputError
from mgsgraph.files.networks.binary import binary_tie_points, is_binary, parse_binary_network
from mgsgraph.files.networks.pvl import parse_pvl_network, where_in
from mgsgraph.files.networks.record import ControlNetwork, Where, with_names
from mgsgraph.files.networks.tie_points import tie_points
from mgsgraph.files.opening import read_bytes
from mgsgraph.files.pvl import Document
from mgsgraph.files.records import require_as_recorded
from mgsgraph.files.tie_points import TiePoints
from mgsgraph.geometry.body import Ellipsoid


def read_network(path: Path) -> ControlNetwork:
    """Read an ISIS control network with all that is in it.

    Parameters
    ----------
    path : Path
        PVL text of version 1 to 5, or ISIS's binary form of version 1, 2 or 5, whatever its name.

    Returns
    -------
    ControlNetwork
        Points in the file's order, ignored ones too.

    Raises
    ------
    InputError
        With the file, and line and point (text) or byte, number and id (binary): see `parse_pvl_network` and
        `parse_binary_network`.
    """
    return _with_places(path, _content(path))[0]


def read_control_network(path: Path, body: Ellipsoid | None = None) -> TiePoints:
    """Read what an adjustment takes from an ISIS control network; see `tie_points` for what that is.

    Parameters
    ----------
    path : Path
        PVL text of version 1 to 5, or ISIS's binary form of version 1, 2 or 5, told apart by what is in the file.
    body : Ellipsoid, optional
        That of the images.

    Returns
    -------
    TiePoints
        In the file's order; images are called by their serial numbers; measure sigmas are NaN where the file has none.

    Raises
    ------
    InputError
        With the file, and line and point (text) or byte, number and id of the point (binary): what `read_network` and
        `tie_points` refuse; a network of another body.
    """
    data = _content(path)
    if is_binary(data):
        return binary_tie_points(data, str(path), body)
    network, where = _with_places(path, data)
    return tie_points(network, where, body)


def _content(path: Path) -> bytes:
    data = read_bytes(path)
    require_as_recorded(path, data)
    return data


def _with_places(path: Path, data: bytes) -> tuple[ControlNetwork, Where]:
    """The network, and words for where its points and measures stand in the file."""
    if is_binary(data):
        network = with_names(parse_binary_network(data, str(path)))
        return network, network.where
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        expected = "a control network, in PVL text or ISIS's binary form"
        raise InputError(str(path), f"byte {error.start} is not UTF-8 text", expected) from None
    document = Document(str(path), text.replace("\r\n", "\n").replace("\r", "\n"))
    return with_names(parse_pvl_network(document)), where_in(document)

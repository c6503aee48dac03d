"""ISIS control networks, in PVL text or in ISIS's binary form, to TiePoints."""

from pathlib import Path

from mgsgraph.io.control.network_file import read_network_with_places
from mgsgraph.io.control.ties import tie_points
from mgsgraph.ties import TiePoints


def read_control_network(path: Path) -> TiePoints:
    """Read what an adjustment takes from an ISIS control network; see `tie_points` for what that is.

    Parameters
    ----------
    path : Path
        PVL text of version 3, 4 or 5, or ISIS's binary form of version 2 or 5, told apart by what is in the file.

    Returns
    -------
    TiePoints
        In the file's order; images are called by their serial numbers; measure sigmas are NaN where the file has none.

    Raises
    ------
    InputError
        With the file, and line and point (text) or number and id of the point (binary): what `read_network` and
        `tie_points` refuse.
    """
    network, place = read_network_with_places(path)
    return tie_points(network, place)

"""GTSAM keys of a network's unknowns, asked for by the names of images, points, profiles and passes; and what a graph
can be made of.
"""

from typing import Any, Protocol, runtime_checkable

import gtsam
import numpy as np

from mgsgraph.adjustment.settings import SolverSettings
from mgsgraph.errors import InputError
from mgsgraph.geometry.records import Array, Mask
from mgsgraph.network import Network
from mgsgraph.record import card

_KINDS = "osunc"
"""Letters of images, shifts, shared unknowns, orientation images and groups of errors in common."""


class Keys:
    """GTSAM keys of a network's unknowns, asked for by name.

    Examples
    --------
    >>> graph, values, keys = mgsgraph.factor_graph(network)
    >>> gtsam.DefaultKeyFormatter(keys.point("TIE00001")), keys.name(keys.image("SIM/A"))
    ('p0', 'image SIM/A')
    """

    def __init__(self, network: Network) -> None:
        self._network = network

    def __repr__(self) -> str:
        return f"Keys({self._network!r})"

    def _repr_html_(self) -> str:
        return card(repr(self))

    def image(self, image: str | int) -> int:
        """Of an image's EO coefficients; InputError where it has none of its own."""
        number = self._network.image_number(image)
        if not self._network.with_polynomial[number]:
            name, owner = self._network.images[number].name, int(self._network.pass_of[number])
            problem = "held, it has no unknowns" if owner < 0 else f"of pass {self._network.passes[owner].name!r}"
            raise InputError(f"image {name}", problem, "an image with a polynomial of its own", "ask for `keys.node`")
        return self.variable(number)

    def point(self, point: str | int) -> int:
        """Of a ground point."""
        return int(gtsam.symbol("p", self._network.point_number(point)))

    def profile(self, profile: str | int) -> int:
        """Of the shift of a laser profile, or of the "terrain model"."""
        return self.variable(len(self._network.images) + self._network.shift_number(profile))

    def shared(self, name: str | int) -> int:
        """Of an unknown that images share."""
        return self.variable(self._network.first_shared + self._network.shared_number(name))

    def node(self, of_pass: str | int, node: int) -> int:
        """Of an orientation image of a pass, counted from 0; after the last one its trend, where it has one."""
        number = self._network.pass_number(of_pass)
        count = self._network.passes[number].widths.size
        if not 0 <= node < count:
            where = f"pass {self._network.passes[number].name!r}"
            raise InputError(where, f"orientation image {node}", f"0 .. {count - 1}")
        return self.variable(int(self._network.first_of_passes[number]) + node)

    def variable(self, number: int) -> int:
        """Of one of the network's variables: images, shifts, shared unknowns, orientation images, factors of errors in
        common, in this order.
        """
        kind = int(np.searchsorted(self._firsts, number, side="right")) - 1
        return int(gtsam.symbol(_KINDS[kind], number - self._firsts[kind]))

    @property
    def _firsts(self) -> tuple[int, ...]:
        """First variable of each kind."""
        network = self._network
        return (0, len(network.images), network.first_shared, *network.first_of_passes[[0, -1]].tolist())

    def width(self, key: int) -> int:
        """How many numbers a variable has: 3 of a point."""
        return 3 if self.is_point(key) else self._network.widths[self._number(key)]

    @staticmethod
    def is_point(key: int) -> bool:
        """Whether a key is of a ground point: a Point3; all others are Vectors."""
        return gtsam.Symbol(key).chr() == ord("p")

    def number(self, key: int) -> int:
        """The way back from `variable`; InputError for a key that isn't of the network, of a point, or of an image
        without unknowns.
        """
        number = self._number(key)
        if number < len(self._network.images):
            self.image(number)
        return number

    def _number(self, key: int) -> int:
        symbol, kind = gtsam.Symbol(key), _KINDS.find(chr(gtsam.Symbol(key).chr()))
        number = self._firsts[kind] + symbol.index() if kind >= 0 else -1
        if not 0 <= number < len(self._network.widths) or self.variable(number) != key:
            problem = f"key {gtsam.DefaultKeyFormatter(key)}"
            raise InputError("factor graph", problem, "a key of the network, and of no point")
        return number

    def name(self, key: int) -> str:
        """What a key stands for, in words."""
        symbol, network = gtsam.Symbol(key), self._network
        kind, k = chr(symbol.chr()), symbol.index()
        if kind == "p" and k < len(network.points):
            return f"point {network.points.ids[k]}"
        self._number(key)
        if kind == "n":
            pass_, node = network.of_passes(int(network.first_of_passes[0]) + k)
            what = f"orientation image {node} of pass" if node < len(pass_.nodes) else "trend of"
            return f"{what} {pass_.name}"
        if kind == "c":
            return f"errors in common of group {k}"
        if kind == "o":
            return f"image {network.images[k].name}"
        if kind == "s":
            return f"shift of {network.shift_names[k]}"
        return f"shared unknown {network.shared[k].name}"


@runtime_checkable
class Case(Protocol):
    """A network and how to adjust it; `mgsgraph.Case` is one."""

    network: Network
    """Who sees what."""
    settings: SolverSettings
    """How to solve it."""


@runtime_checkable
class Adjusted(Case, Protocol):
    """A network and what was found of it; `mgsgraph.Solution` is one."""

    places: Array
    """(n, 3) m, of points."""
    rays_used: Mask
    """(k,)"""
    ranges_used: Mask
    """(r,)"""

    @property
    def determined(self) -> Mask:
        """(n,) points that have a place."""
        ...

    @property
    def stereo_used(self) -> Mask:
        """(n,) points whose height above a stereo surface took part."""
        ...

    @property
    def values(self) -> tuple[Array, ...]:
        """Of all variables of the network."""
        ...


Source = Case | Network
"""What a graph can be made of."""


def network_and_settings(source: Any) -> tuple[Network, SolverSettings]:
    """Network and settings; the defaults of a network alone."""
    if not isinstance(source, Network | Case):
        problem = f"a {type(source).__name__}"
        raise InputError("factor graph", problem, "a Case, Network or Solution", "read a file by `mgsgraph.read_case`")
    return (source, SolverSettings()) if isinstance(source, Network) else (source.network, source.settings)

"""Settings of a conversion between network formats: case, radii, names."""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from msgspec import structs

from mgsgraph.errors import InputError, require
from mgsgraph.files.networks.record import (
    ControlNetwork,
)
from mgsgraph.files.networks.tie_points import require_places
from mgsgraph.geometry.body import Ellipsoid, may_be, target_name
from mgsgraph.record import Record

_SIZE = re.compile(r"([1-9][0-9]{0,8})x([1-9][0-9]{0,8})", re.IGNORECASE)
_OPTIONS = "--body, --radii, --case"
"""Where a setting comes from, for messages."""


@dataclass(frozen=True, slots=True)
class ExchangeSetting(Record):
    """Settings that files don't state.

    Examples
    --------
    >>> setting = mgsgraph.ExchangeSetting(target="Mars", renamed={"SIM/A": "E02-00665"})
    >>> mgsgraph.convert("pair/network.pvl", "renamed.net", setting).written[0].name
    'renamed.net'
    """

    sizes: Mapping[str, tuple[int, int]] = field(default_factory=dict)
    """Lines and samples of images by their names."""
    ellipsoid: Ellipsoid | None = None
    """To which geodetic latitudes and heights refer."""
    target: str = ""
    """Body, as ISIS calls it."""
    renamed: Mapping[str, str] = field(default_factory=dict)
    """New names of images by those in the files that are read."""
    prefix: str | None = None
    """What the names of match files begin with, before the hyphen; None: not said."""
    shifted: bool = True
    """Whether NVM counts from the optical centres."""

    def old_sizes(self) -> dict[str, tuple[int, int]]:
        """Sizes by the names in files that are read, too."""
        return dict(self.sizes) | {old: self.sizes[new] for old, new in self.renamed.items() if new in self.sizes}

    def old_names(self) -> list[str]:
        """Names that images may have in files that are read; empty where none is known."""
        news = set(self.renamed.values())
        return [name for name in self.sizes if name not in news] + list(self.renamed) if self.sizes else []


def case_setting(case: Path) -> ExchangeSetting:
    """Names and sizes of a case's images, the body's ellipsoid and, if known by its size, name; the case's other files
    need not be there.
    """
    from mgsgraph.case.case_file import decode, image_of

    tables = decode(case)
    images = [image_of(tables, j, case) for j in range(len(tables.images))]
    body = images[0].body
    target = target_name(body)
    sizes = {image.name: (image.lines, image.samples) for image in images}
    return ExchangeSetting(sizes, body, "" if target == "UNKNOWN" else target)


def setting_of(
    case: Path | None,
    sizes: Iterable[str],
    radii: tuple[float, float] | None,
    target: str,
    rename: Iterable[str],
    prefix: str | None,
    shifted: bool,
) -> ExchangeSetting:
    """A setting of options' texts (NAME=LINESxSAMPLES, OLD=NEW; radii in m), which come before what a case says.

    Raises InputError for a malformed one, or one twice.
    """
    of_case = case_setting(case) if case is not None else ExchangeSetting()
    stated = {}
    for name, text in _pairs("--size", "NAME=LINESxSAMPLES", sizes):
        if not (size := _SIZE.fullmatch(text)):
            raise InputError("--size", repr(f"{name}={text}"), "NAME=LINESxSAMPLES, as E0200665=9856x1024")
        stated[name] = int(size[1]), int(size[2])
    return replace(
        of_case,
        sizes=dict(of_case.sizes) | stated,
        ellipsoid=of_case.ellipsoid if radii is None else Ellipsoid(*radii),
        target=target or of_case.target,
        renamed=dict(_pairs("--rename", "OLD=NEW", rename)),
        prefix=prefix,
        shifted=shifted,
    )


def _pairs(option: str, form: str, texts: Iterable[str]) -> list[tuple[str, str]]:
    pairs = list[tuple[str, str]]()
    for text in texts:
        name, equals, value = text.rpartition("=")
        require(name and equals and value, option, repr(text), form)
        require(name not in dict(pairs), option, f"{name!r} twice", "each image once")
        pairs.append((name, value))
    return pairs


def require_one_body(networks: Sequence[ControlNetwork], setting: ExchangeSetting) -> None:
    """Raise InputError if networks and setting name several bodies, or an ellipsoid that can't be the named one's, or
    on which points don't lie.
    """
    stated = [(network.source, network.target_name) for network in networks if network.target_name]
    stated += [(_OPTIONS, setting.target)] if setting.target else []
    for where, name in stated[1:]:
        if name.casefold() != stated[0][1].casefold():
            found, expected = f"the target body {name}", f"{stated[0][1]}, as in {stated[0][0]}"
            raise InputError(where, found, expected, "convert networks of one body at a time")
    if setting.ellipsoid is not None and stated and not may_be(setting.ellipsoid, stated[0][1]):
        found = f"an equatorial radius of {setting.ellipsoid.equatorial:.10g} m"
        expected = f"that of {stated[0][1]}, the target body in {stated[0][0]}"
        raise InputError(_OPTIONS, found, expected, "radii are in m")
    if setting.ellipsoid is None:
        return
    for network in networks:
        positions = [place for point in network.points if (place := point.apriori or point.adjusted)]
        require_places(np.array(positions).reshape(-1, 3), setting.ellipsoid, network.source)


def leading(networks: Sequence[ControlNetwork]) -> ControlNetwork:
    """The network whose head several of them get: the first one that names its body, else the first one."""
    return next((network for network in networks if network.target_name), networks[0])


def ellipsoid_of(network: ControlNetwork, output: Path, setting: ExchangeSetting) -> Ellipsoid:
    """The stated ellipsoid, or that of the network."""
    if setting.ellipsoid is not None:
        return setting.ellipsoid
    radii = network.target_radii
    if len(radii) == 3 and radii[0] == radii[1]:
        return Ellipsoid(radii[0], radii[2])
    found = "heights above a body of three unlike radii" if len(radii) == 3 else "heights above an unknown ellipsoid"
    raise InputError(str(output), found, "its radii", "say --radii, or --case")


def with_head(network: ControlNetwork, output: Path, setting: ExchangeSetting) -> ControlNetwork:
    """With a target, which ISIS demands, an id and radii."""
    target = network.target_name or setting.target
    require(target, str(output), "no name of the target body", "one", "say --body MARS, or another")
    radii = network.target_radii
    if not radii and setting.ellipsoid is not None:
        radii = (setting.ellipsoid.equatorial, setting.ellipsoid.equatorial, setting.ellipsoid.polar)
    name = network.network_id or output.stem
    return structs.replace(network, network_id=name, target_name=target, target_radii=radii)

"""The head of a network that is written: its body and its name, from files, options and a case, which must agree."""

from collections.abc import Sequence
from pathlib import Path

from msgspec import structs

from mgsgraph.errors import InputError
from mgsgraph.export.exchange_setting import ExchangeSetting
from mgsgraph.geometry.body import Ellipsoid, may_be
from mgsgraph.io.control.record import ControlNetwork

_SAID = "--target, --radii, --case"
"""Where a setting comes from, for messages."""


def require_one_body(networks: Sequence[ControlNetwork], setting: ExchangeSetting) -> None:
    """Raise InputError if networks and setting name several bodies, or an ellipsoid that can't be the named one's."""
    stated = [(one.source, one.target_name) for one in networks if one.target_name]
    stated += [(_SAID, setting.target)] if setting.target else []
    for where, name in stated[1:]:
        if name.casefold() != stated[0][1].casefold():
            found, expected = f"the target body {name}", f"{stated[0][1]}, as in {stated[0][0]}"
            raise InputError(where, found, expected, "convert networks of one body at a time")
    if setting.ellipsoid is not None and stated and not may_be(setting.ellipsoid, stated[0][1]):
        found = f"an equatorial radius of {setting.ellipsoid.equatorial:.10g} m"
        expected = f"that of {stated[0][1]}, the target body in {stated[0][0]}"
        raise InputError(_SAID, found, expected, "radii are in m")


def leading(networks: Sequence[ControlNetwork]) -> ControlNetwork:
    """The network whose head several of them get: the first one that names its body, else the first one."""
    return next((one for one in networks if one.target_name), networks[0])


def ellipsoid_of(network: ControlNetwork, output: Path, setting: ExchangeSetting) -> Ellipsoid:
    """As it is said, or as the network has it."""
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
    if not target:
        raise InputError(str(output), "no name of the target body", "one", "say --target MARS, or another")
    radii = network.target_radii
    if not radii and setting.ellipsoid is not None:
        radii = (setting.ellipsoid.equatorial, setting.ellipsoid.equatorial, setting.ellipsoid.polar)
    name = network.network_id or output.stem
    return structs.replace(network, network_id=name, target_name=target, target_radii=radii)

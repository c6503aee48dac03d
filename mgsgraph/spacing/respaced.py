"""Networks with other orientation images than they have."""

from collections.abc import Sequence
from dataclasses import replace

from mgsgraph.errors import InputError
from mgsgraph.geometry.orientation_images import OrientationImages, evenly_spaced
from mgsgraph.network import Network, NodePrior


def respaced(network: Network, spacing: float) -> Network:
    """A network whose strips all have even nodes at a spacing of at most `spacing` s, over the same time."""
    return with_nodes(
        network,
        [
            evenly_spaced(strip.nodes.basis, strip.nodes.epoch, strip.nodes.coverage, spacing)
            for strip in network.strips
        ],
    )


def with_nodes(network: Network, nodes: Sequence[OrientationImages]) -> Network:
    """A network with other nodes of its strips, in their order; the priors stay, which know any nodes."""
    require_respaceable(network)
    strips = (replace(strip, nodes=other) for strip, other in zip(network.strips, nodes, strict=True))
    return replace(network, strips=tuple(strips))


def require_respaceable(network: Network) -> None:
    """Raise InputError unless there are strips, and priors that hold for any nodes."""
    if not network.strips:
        raise InputError("network", "no strips", "images whose orientation follows from orientation images")
    for strip in network.strips:
        if not isinstance(strip.prior, NodePrior):
            found = "a joint prior of just its nodes"
            raise InputError(f"strip {strip.name!r}", found, "one of any nodes (bias, drift and sigmas)")

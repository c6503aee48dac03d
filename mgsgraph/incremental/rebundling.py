"""Which bundles a change takes apart, and what takes their place."""

from collections.abc import Sequence

from mgsgraph.errors import InputError
from mgsgraph.incremental.state import Store
from mgsgraph.network import Network
from mgsgraph.network.parts import KnownImage, Members, bundles, joined, without_images
from mgsgraph.units import KM


def with_addition(store: Store, addition: Network | None) -> tuple[list[Members], dict[Members, Network]]:
    """Bundles with points that an addition sees, too, and what they become with it.

    Raises InputError when the two contradict each other (`network.parts.joined`).
    """
    if addition is None:
        return [], {}
    gone = sorted(set(store.homes(addition.points.ids).values()))
    return _completed(store, gone, [*(store.bundle(members).network for members in gone), addition])


def without(store: Store, images: Sequence[str]) -> tuple[list[Members], dict[Members, Network]]:
    """Bundles that some images see, and what is left of them; points that nothing else sees go with the images."""
    gone = list(dict.fromkeys(members for image in images for members in store.seen_by(image)))
    parts = (store.bundle(members).network for members in gone)
    return _completed(store, gone, [rest for network in parts if (rest := without_images(network, images)) is not None])


def require_one_body(store: Store, new: Sequence[KnownImage]) -> None:
    """Raise InputError for a new image that shows another body than those that are there, or than the first new one."""
    there = store.image_names()
    known = [store.image(there[0])] if there else []
    for one in new:
        first = (known or new)[0].image
        if one.image.body != first.body:
            found = f"a body of {one.image.body.equatorial / KM:.1f} km"
            expected = f"that of image {first.name}, {first.body.equatorial / KM:.1f} km"
            raise InputError(f"image {one.image.name}", found, expected, "keep bodies apart, in projects of their own")


def _completed(
    store: Store, gone: list[Members], parts: list[Network]
) -> tuple[list[Members], dict[Members, Network]]:
    """Bundles of some parts, together with those that were there before of the same unknowns."""
    found = bundles(joined(parts)) if parts else {}
    there = set(store.members()) - set(gone)
    if others := [members for members in found if members in there]:
        found = bundles(joined([*parts, *(store.bundle(members).network for members in others)]))
    return [*gone, *others], found

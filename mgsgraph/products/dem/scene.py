"""Pictures of a case as an adjustment has oriented them."""

from collections.abc import Sequence
from dataclasses import replace

from mgsgraph.adjustment.analysis.posterior import Posterior
from mgsgraph.errors import InputError
from mgsgraph.matching.scene import Scene
from mgsgraph.wording import some


def adjusted_names(
    there: Sequence[str], posterior: Posterior, chosen: Sequence[str] = (), where: str = "the case"
) -> list[str]:
    """Of the images `there`, those `chosen` (all when empty); `where` names their case in errors.

    Raises
    ------
    InputError
        Where one was not adjusted, isn't there, or there are fewer than two.
    """
    for name in chosen:
        if name not in there:
            raise InputError(where, f"no image {name}", f"one of {some(list(there), len(there))}")
    names = list(dict.fromkeys(chosen)) or list(there)
    if len(names) < 2:
        raise InputError(where, f"one image for a terrain model ({names[0]})", "two different ones, at least")
    adjusted = [image.name for image in posterior.network.images]
    if missing := [name for name in names if name not in adjusted]:
        both = sum(name in adjusted for name in there) > 1
        raise InputError(
            where, f"images that the solution doesn't have: {some(missing, len(missing))}",
            f"those that were adjusted ({some(adjusted, len(adjusted))})",
            "adjust this case, or give --pair" if both else "give the case that was adjusted",
        )  # fmt: skip
    return names


def adjusted_scene(scene: Scene, posterior: Posterior, chosen: Sequence[str] = ()) -> Scene:
    """A scene whose pictures, those of the names `chosen` (all when empty), have the images and corrections that an
    adjustment found, by name.

    Raises
    ------
    InputError
        As `adjusted_names`.
    """
    there = {picture.image.name: picture for picture in scene.pictures}
    pictures = [
        replace(there[name], image=posterior.image(j), correction=posterior.correction(j))
        for name in adjusted_names(list(there), posterior, chosen)
        for j in [posterior.image_number(name)]
    ]
    return replace(scene, pictures=tuple(pictures))

"""Pictures of a case as an adjustment has oriented them."""

from collections.abc import Sequence
from dataclasses import replace

from mgsgraph.adjustment.analysis.posterior import Posterior
from mgsgraph.errors import InputError
from mgsgraph.matching.scene import Scene
from mgsgraph.wording import some


def adjusted_scene(scene: Scene, posterior: Posterior, chosen: Sequence[str] = ()) -> Scene:
    """A scene whose pictures, those of the names `chosen` (all when empty), have the images and corrections that an
    adjustment found, by name.

    Raises
    ------
    InputError
        Where a picture was not adjusted, or an image chosen isn't there.
    """
    there = {picture.image.name: picture for picture in scene.pictures}
    for name in chosen:
        if name not in there:
            raise InputError(f"image {name}", "not in the case", f"one of {some(list(there), len(there))}")
    names = list(dict.fromkeys(chosen)) or list(there)
    if len(names) < 2:
        raise InputError("images for a terrain model", some(names, len(names)), "two different ones, at least")
    adjusted = [image.name for image in posterior.network.images]
    if missing := [name for name in names if name not in adjusted]:
        raise InputError(
            "the case", f"images that the solution doesn't have: {some(missing, len(missing))}",
            f"those that were adjusted ({some(adjusted, len(adjusted))})", "adjust this case, or give --pair",
        )  # fmt: skip
    pictures = [
        replace(there[name], image=posterior.image(j), correction=posterior.correction(j))
        for name in names
        for j in [posterior.image_number(name)]
    ]
    return replace(scene, pictures=tuple(pictures))

"""A simulated strip as files: support data, network, shots, case and truth, and what each image adds to those before.

A network of a hundred thousand points takes seconds to write and to read, one of a million some minutes.
"""

from pathlib import Path

from mgsgraph.simulation.files import (
    case_text,
    image_file,
    json_text,
    lidar_text,
    network_text,
    support_data,
    truth_text,
    write_texts,
)
from mgsgraph.simulation.strip import SimulatedStrip

_NETWORK = ("simulated_strip", "Simulated strip of stereo pairs")
"""Name and description of the network."""


def write_strip(strip: SimulatedStrip, folder: Path, steps: bool = False) -> Path:
    """Write a simulated strip, its case file and its truth; returns the path of ``case.toml``.

    Parameters
    ----------
    strip : SimulatedStrip
        As simulated.
    folder : Path
        Made when absent; files of the same names in it are replaced.
    steps : bool
        Write for each image k, in ``step_007`` and the like, the ``ties.pvl`` and ``lidar.json`` that it brings. They
        are the whole network and all shots once more, but for known shots, which stand there again with the measure in
        the new image and without a simultaneous one.

    Raises
    ------
    InputError
        If the folder can't be written.
    """
    texts = {image_file(image): json_text(support_data(image)) for image in strip.images}
    texts["network.pvl"] = network_text(strip.ties, *_NETWORK)
    texts["lidar.json"] = lidar_text(strip.lasers)
    texts["truth.json"] = truth_text(strip, strip.lasers, strip.true_footprints)
    texts["case.toml"] = case_text("simulated strip", strip.images, strip.settings.noise)
    for k in range(len(strip.images)) if steps else ():
        texts |= _step(strip, k)
    write_texts(folder, texts)
    return folder / "case.toml"


def _step(strip: SimulatedStrip, k: int) -> dict[str, str]:
    _, ties, laser = strip.addition(k)
    texts = {f"step_{k:03d}/ties.pvl": network_text(ties, *_NETWORK)} if ties.ids else {}
    return texts | ({f"step_{k:03d}/lidar.json": lidar_text((laser,))} if laser else {})

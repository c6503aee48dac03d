"""Readers of small real files, where ../shared/data is there; nothing of them is kept."""

from collections.abc import Iterator
from functools import partial
from pathlib import Path

from fuzz_kinds import CSV, DAF, GZIP, JSON, PVL, Row
from fuzz_seeds import packed
from fuzz_trials import Seed

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
_LABEL = "m0402852_isis.lbl"


def _beside(folder: str, main: str, *others: str) -> Seed:
    return Seed({name: (DATA / folder / name).read_bytes() for name in (main, *others)}, main)


def _begin(folder: str, name: str, lines: int) -> Seed:
    """The first lines of a long table."""
    with (DATA / folder / name).open("rb") as file:
        return Seed({name: b"".join(file.readline() for _ in range(lines))}, name)


def _packed(folder: str, name: str, lines: int) -> Seed:
    import gzip

    with gzip.open(DATA / folder / name) as file:
        return Seed({name: packed(b"".join(file.readline() for _ in range(lines)))}, name)


def of_real_files() -> Iterator[Row]:
    """None where there are no such files."""
    if not DATA.is_dir():
        return
    import mgs

    from mgsgraph.files.altimetry.lidar import read_lidar
    from mgsgraph.files.altimetry.shots import read_shots
    from mgsgraph.files.labels.isis_cube import read_isis_cube
    from mgsgraph.files.labels.labelled_image import read_labelled_image
    from mgsgraph.files.networks.binary import read_network
    from mgsgraph.files.support_data.isd import read_isd

    kernels = [path.name for path in mgs.kernels(DATA)]
    moc, lola, hadley, m04 = "mgs_moc_wa_three", "lro_nac_lola", "lro_nac_hadley", "mgs_moc_m0402852"
    gaps = (".ranges", ".spacecraft", ".areoid_radii", ".off_nadir", ".pulses", ".times")

    def image(path: Path) -> object:
        return read_labelled_image(path.with_name(_LABEL), [path.with_name(name) for name in kernels])

    yield Row("real network of MOC", "E", read_network, partial(_beside, moc, "controlnetwork.net"), PVL)
    yield Row("real network of LROC", "E", read_network, partial(_beside, hadley, "observationPair.net"), PVL)
    yield Row("real tables of a cube", "B", read_isis_cube, partial(_beside, moc, "cube1.isd", "cube1.pvl"), JSON)
    label = partial(_beside, moc, "cube1.pvl", "cube1.isd")
    yield Row("real label of a cube", "B", read_isis_cube, label, PVL)
    isd = partial(_beside, lola, "lidarObservationImage2.isd")
    yield Row("real support data", "B", lambda path: read_isd(path, "LRO/1"), isd, JSON)
    yield Row("real lidar JSON", "E", read_lidar, partial(_beside, lola, "lidarData.json"), JSON)
    ode = partial(_begin, "mola_pedr_ode", "curiosity_topography.csv", 12)
    yield Row("real shots of ODE", "E", read_shots, ode, CSV, gaps=gaps)
    yield Row("real shots of LOLA", "E", read_shots, partial(_begin, lola, "lidarPoints.csv", 12), CSV, gaps=gaps)
    shots = partial(_packed, hadley, "RDR_hadley_LOLA.csv.gz", 12)
    yield Row("real shots, packed", "E", read_shots, shots, GZIP, gaps=gaps)
    for name, changes in (("m0402852.ale_1.bsp", DAF), ("mgs_sc_map2_1_sliced_-94000.bc", DAF), (_LABEL, PVL)):
        others = [one for one in (_LABEL, *kernels) if one != name]
        kind = "label of MOC" if name == _LABEL else f"binary kernel, {Path(name).suffix}"
        yield Row(f"real {kind}", "B", image, partial(_beside, m04, name, *others), changes, share=0.5)

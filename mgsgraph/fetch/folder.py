"""From ids of images to a folder with images, kernels, profiles, a terrain and a case, with a lock over all of it."""

import hashlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path

from mgsgraph.errors import InputError, command_line, errors_from, printable, require
from mgsgraph.fetch.camera_search import Box, shots_in
from mgsgraph.fetch.case_file import (
    CASE,
    META_KERNEL_HEAD,
    camera_focal_length,
    case_text,
    meta_kernel,
    meta_kernel_path,
)
from mgsgraph.fetch.download import Remote, RetryPolicy
from mgsgraph.fetch.needs import (
    CTX,
    LROC_NAC,
    Archives,
    ImageNeeds,
    Product,
    WantedFile,
    grid_of,
    products_of,
    require_one_mission,
    terrain_of,
    wanted_files,
    wanted_grids,
)
from mgsgraph.fetch.search import Search, volumes_of
from mgsgraph.fetch.store import FOLDERS, LOCK, DownloadFolder, Lock, Progress
from mgsgraph.files.opening import read_bytes
from mgsgraph.files.writing import claimed, write_file, writing_to
from mgsgraph.record import Record
from mgsgraph.text import many
from mgsgraph.workers import no_progress

_REMEDY = "choose another --out"
_PROJECT = "project"
"""Where the commands that are said next put it, in the folder."""


@dataclass(frozen=True, slots=True)
class Fetched(Record):
    """A folder that holds all that its images need."""

    folder: Path
    images: tuple[ImageNeeds, ...]
    """All images of the folder, those of earlier runs too."""
    brought: dict[str, int]
    """bytes of files that came in this run, by their paths in the folder; indices and labels too."""
    here: int
    """Files that were there as locked."""
    notes: tuple[str, ...]
    """What could not be had, and what was not as expected."""

    @property
    def case(self) -> Path:
        """The case file."""
        return self.folder / CASE

    @property
    def sentences(self) -> list[str]:
        """What there is now, one line each."""
        lines = [
            f"{image.product}: {image.start}, {f'orbit {image.orbit}, ' if image.orbit else ''}"
            f"{_kernels(image)}, {Path(image.pedr or image.shots_path).name or 'no laser profile'}"
            for image in self.images
        ]
        size = sum(self.brought.values()) / 1e6
        lines.append(f"{many(len(self.brought), 'file')} fetched, {size:.1f} MB; {self.here} were here already")
        return [printable(line) for line in (*lines, *self.notes)]

    def commands(self) -> list[str]:
        """What to type next; none for a single image."""
        if len(self.images) < 2:
            return []
        project = self.folder / _PROJECT
        return [
            command_line("project", "init", project, "--case", self.folder / CASE),
            command_line("match", project),
            command_line("project", "solve", project),
            command_line("dem", project, "--out", self.folder / "dem"),
        ]


def fetch_images(
    images: Sequence[str],
    out: str | Path,
    *,
    terrain: str = "16",
    archives: Archives | None = None,
    volumes: Sequence[str] = (),
    retry: RetryPolicy | None = None,
    progress: Progress = no_progress,
    say: Callable[[str], None] = no_progress,
) -> Fetched:
    r"""Fetch all that the adjustment of some images needs; the same call again brings only what is not there.

    Parameters
    ----------
    images : sequence of str
        Ids of MOC narrow-angle images, such as E02/00665, or of CTX, LROC NAC or HRSC; of one mission.
    out : path
        Folder: absent, empty, or an earlier one of ours, to which the images are added.
    terrain : str
        "4", "16" or "128" pixels per degree, or "none".
    archives : Archives, optional
        Mirrors; the public archives when absent.
    volumes : sequence of str
        Where to look for the images, as mgsc_1068; everywhere when empty.
    retry : RetryPolicy, optional
        How long to wait for archives.
    progress : callable
        Called with the bytes that have come and all bytes known to come.
    say : callable
        Called with a sentence on every wait before an archive is asked again.

    Raises
    ------
    InputError
        Anything that can go wrong, one line; what has come is kept, and the same call goes on.

    Examples
    --------
    >>> fetched = mgsgraph.fetch_images(["E02/00665", "E02/01453"], "data", archives=mirror)
    >>> print(*fetched.sentences, sep="\n")
    E02/00665: 2001-03-08T12:52:54.00, orbit 8933, mgs_ext1.bsp, mgs_sc_ext1.bc, ap18933l.b
    E02/01453: 2001-03-17T18:39:14.00, orbit 9043, mgs_ext1.bsp, mgs_sc_ext1.bc, ap19043l.b
    28 files fetched, 67.1 MB; 0 were here already
    >>> fetched.commands()[0]
    'mgsgraph project init data/project --case data/case.toml'
    """
    products, choice, folder = products_of(images), terrain_of(terrain), Path(out)
    volumes, archives = volumes_of(volumes), archives or Archives()
    with _opened(folder, retry, say, progress) as store:
        lock = store.lock
        _find(products, lock, Search(archives, store, volumes))
        needs = tuple(lock.images.values())
        store.get_all(wanted_files(needs, archives))
        notes = _write_own(lock, meta_kernel_path(needs), meta_kernel(needs))
        notes += [note for image in needs for note in image.notes]
        places = list[tuple[float, float]]()
        for image in needs if choice == "128" else ():
            with errors_from(f"{image.product}, whose place its tiles depend on"):
                places += ground_places(image, folder)
        on_the_moon = any(image.camera is not None and image.camera.moon for image in needs)
        grid = None if choice == "none" or on_the_moon else grid_of(choice, places)
        if grid is not None:
            store.get_all(wanted_grids(grid, archives))
        store.mend()
        notes += [*store.notes, *_write_own(lock, CASE, case_text(needs, grid, folder))]
    return Fetched(folder, needs, store.brought, len(lock.files) - len(store.brought), tuple(notes))


FOUND_BY_BOX = {"moc": None, "ctx": CTX, "lroc": LROC_NAC}
"""Cameras whose images are found by region; None for MOC's narrow angle."""


def find_images(
    camera: str,
    box: tuple[float, float, float, float],
    out: str | Path,
    *,
    archives: Archives | None = None,
    volumes: Sequence[str] = (),
    retry: RetryPolicy | None = None,
    progress: Progress = no_progress,
    say: Callable[[str], None] = no_progress,
) -> tuple[str, ...]:
    """Ids of the images of a region, for `fetch_images`: of MOC's narrow angle those with their middle in the box, by
    the indices of all volumes, which stay in the folder; of CTX and LROC NAC those whose footprints meet it, by the
    Orbital Data Explorer.

    Parameters
    ----------
    camera : str
        "moc", "ctx" or "lroc".
    box : 4 numbers
        deg: western and eastern longitude (east), least and largest planetocentric latitude.
    out, archives, volumes, retry, progress, say
        As of `fetch_images`.

    Raises
    ------
    InputError
        A box that is none, or without images; indices without places; anything that can go wrong on the way.
    """
    region, volumes = _region(box), volumes_of(volumes)
    require(camera in FOUND_BY_BOX, "camera", repr(camera), f"one of {', '.join(FOUND_BY_BOX)}")
    with _opened(Path(out), retry, say, progress) as store:
        found = Search(archives or Archives(), store, volumes).images_in(region, FOUND_BY_BOX[camera])
    require(found, f"{camera} in {box}", "no image", "a box in which there are some", "check it: W E S N, in degrees")
    return tuple(found)


def _region(box: tuple[float, float, float, float]) -> Box:
    west, east, south, north = box
    if not (-90.0 <= south < north <= 90.0 and -180.0 <= west < east <= 360.0):
        raise InputError("box", f"{west:g} {east:g} {south:g} {north:g}", "west < east, south < north, in degrees")
    return Box(south, north, west, east)


DATA_SETS = {"mola": "molapedr", "lola": "lolardr"}
"""What ODE calls the shots of altimeters."""


def fetch_shots(
    altimeter: str,
    box: tuple[float, float, float, float],
    out: str | Path,
    *,
    archives: Archives | None = None,
    retry: RetryPolicy | None = None,
    progress: Progress = no_progress,
    say: Callable[[str], None] = no_progress,
) -> Path:
    """Fetch the table of an altimeter's shots in a box, which the Orbital Data Explorer makes; see `fetch_images`.

    Parameters
    ----------
    altimeter : str
        "mola" or "lola".
    box : 4 numbers
        deg: western and eastern longitude (east), least and largest planetocentric latitude.

    Returns
    -------
    Path
        The table, in shots/.

    Raises
    ------
    InputError
        A box that is none, or without shots; anything that can go wrong on the way.
    """
    folder, archives, region = Path(out), archives or Archives(), _region(box)
    require(altimeter in DATA_SETS, "altimeter", repr(altimeter), f"one of {', '.join(DATA_SETS)}")
    name = f"shots/{altimeter}_{'_'.join(f'{side:g}' for side in box)}_pts_csv.csv".replace("-", "m")
    with _opened(folder, retry, say, progress) as store:
        lock = store.lock
        if not lock.whole(name):
            path = shots_in(region, DATA_SETS[altimeter], archives, store.remote)
            require(path, f"{altimeter} in {box}", "no table of shots by ODE", "a box that its profiles cross")
            if name in lock.files:  # ODE makes another table each time it is asked
                del lock.files[name]
            store.get(WantedFile(archives.ode + path, name))
        return store.path(name)


@contextmanager
def _opened(
    folder: Path, retry: RetryPolicy | None, say: Callable[[str], None], progress: Progress
) -> Iterator[DownloadFolder]:
    """The folder, ours alone as long as this lasts."""
    with closing(Remote(retry, say)) as remote, claimed(_made_folder(folder), "another mgsgraph is fetching into it"):
        lock = Lock.read(folder)
        lock.write()
        yield DownloadFolder(lock, remote, progress)


def _made_folder(folder: Path) -> Path:
    """The folder, made where there is none; InputError where it is neither empty nor an earlier one of ours."""
    with writing_to(folder, "a folder", _REMEDY):
        if folder.exists() and not (folder / LOCK).exists():
            require(folder.is_dir(), str(folder), "exists and is a file", "a folder to fetch into", _REMEDY)
            found, expected = f"exists, and has no {LOCK}", "an empty folder, or one fetched into"
            require(not any(folder.iterdir()), str(folder), found, expected, _REMEDY)
        folder.mkdir(parents=True, exist_ok=True)
        for inside in map(folder.joinpath, FOLDERS):
            if inside.is_symlink() or (inside.exists() and not inside.is_dir()):
                found = "a link, and what it leads to would be written into" if inside.is_symlink() else "a file"
                raise InputError(str(inside), found, "a folder", "move it away")
    return folder


def _find(products: Sequence[Product], lock: Lock, search: Search) -> None:
    """Enter what each image needs in the lock; no network for those that are there."""
    require_one_mission([*products, *(image.product for image in lock.images.values())])
    for product in products:
        if str(product) not in lock.images:
            lock.images[str(product)] = search.needs(product)
            lock.write()


def _kernels(image: ImageNeeds) -> str:
    """Names of an image's SPK and CK."""
    return ", ".join(Path(path).name for path in image.kernels if path.lower().split("/")[-2] in ("spk", "ck"))


def ground_places(image: ImageNeeds, folder: Path) -> list[tuple[float, float]]:
    """Longitude east and planetocentric latitude (deg) of an image's corners and middle, by its kernels; along the box
    of another camera's image.

    Raises
    ------
    InputError
        When the kernels don't hold its time, or it looks past Mars.
    """
    if image.camera is not None:
        require(image.box, str(image.product), "no place on the ground in its label", "that of its kernels")
        south, north, west, east = image.box
        step = (east - west) % 360.0 / 4.0  # a tile is 90 degrees wide
        return [(west + k * step, latitude) for k in range(5) for latitude in (south, north)]
    import numpy as np

    from mgsgraph.files.labels.labelled_image import read_labelled_image
    from mgsgraph.geometry.body import planetocentric
    from mgsgraph.units import DEG

    label, kernels = folder / image.image_path, [folder / "kernels/mgs.tm"]
    picture = read_labelled_image(label, kernels, constants="ik", focal_length=camera_focal_length(folder))
    lines, samples = np.array([0.0, 0.0, 0.5, 1.0, 1.0]), np.array([0.0, 1.0, 0.5, 0.0, 1.0])
    points, _ = picture.image_to_ground(lines * picture.lines, samples * picture.samples)
    places = planetocentric(points[np.all(np.isfinite(points), axis=1)]) / DEG
    require(len(places), image.image_path, "looks past Mars", "ground")
    return [(float(longitude), float(latitude)) for longitude, latitude, _ in places]


def _write_own(lock: Lock, name: str, text: str) -> list[str]:
    """Write the case file or the meta-kernel unless the user has made it theirs; what there is to say of it."""
    path, digest = lock.folder / name, hashlib.sha256(text.encode()).hexdigest()
    if path.exists():
        content = read_bytes(path)
        old = name not in lock.written and content.startswith(META_KERNEL_HEAD.encode())  # that was not locked then
        if not old and hashlib.sha256(content).hexdigest() not in (lock.written.get(name), digest):
            return [f"{path} is not as it was written here, and was left alone; move it away to have a new one"]
    write_file(path, text, remedy=_REMEDY)
    lock.written[name] = digest
    lock.write()
    return []

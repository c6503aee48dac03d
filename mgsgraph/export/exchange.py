"""Networks from one program to another: read in any format, united, written in any, and what gets
lost on the way said. Of files of a network's name those alone are replaced that are networks by their content.
"""

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path

from msgspec import structs

from mgsgraph.atomic_write import resolved
from mgsgraph.errors import InputError, require
from mgsgraph.export import Format
from mgsgraph.export.exchange_losses import losses
from mgsgraph.export.exchange_setting import ExchangeSetting, ellipsoid_of, leading, require_one_body, with_head
from mgsgraph.export.verdicts import Verdicts, ignore_rejected
from mgsgraph.files.kinds import Kind, kind_of
from mgsgraph.files.networks.asp_match import (
    MatchFile,
    joined,
    match_files,
    prefix_of,
    read_match,
    read_match_text,
)
from mgsgraph.files.networks.asp_match import images_of as named_images
from mgsgraph.files.networks.asp_text import (
    ground_control_text,
    half_sizes,
    nvm_files,
    offsets_path,
    read_ground_control_network,
    read_nvm,
    read_offsets,
    stated_datum,
)
from mgsgraph.files.networks.binary import binary_network, read_network
from mgsgraph.files.networks.editing import images_of, in_images, united
from mgsgraph.files.networks.pvl import network_text
from mgsgraph.files.networks.record import (
    ControlNetwork,
    ControlPoint,
    Duplicates,
)
from mgsgraph.files.networks.table import read_table, table_parquet, table_text
from mgsgraph.files.writing import Output, begins, fresh_file, require_free
from mgsgraph.record import Record
from mgsgraph.text import many, some

Paths = str | Path | Iterable[str | Path]
"""One file or several."""
_ENDINGS = {f".{form}": form for form in Format if form != Format.MATCH_TEXT} | {".txt": Format.MATCH_TEXT}
_EDGE = 0.5
"""ISIS's count of an image's first edge; the last one is at its lines and samples and as much."""
_MATCHES = (Format.MATCH, Format.MATCH_TEXT)
_TABLES = (Format.CSV, Format.PARQUET)
_ELSEWHERE = "name another file; or say --replace"


@dataclass(frozen=True, slots=True)
class Conversion(Record):
    """Networks and files read and written, and what was lost."""

    network: ControlNetwork
    written: tuple[Path, ...]
    """Files, in the order in which they took their places."""
    notes: tuple[str, ...]
    """What happened to the input when it was read."""
    losses: tuple[str, ...]
    """What the format can't hold, a line for each kind of thing."""


@dataclass(frozen=True, slots=True)
class Selection:
    """The part of the read networks that is written."""

    duplicates: Duplicates = Duplicates.REFUSE
    """What becomes of points that several files have."""
    images: tuple[str, ...] = ()
    """Names or patterns of images to keep; all when empty."""
    verdicts: Verdicts | None = None
    """About the points that are read; rejected ones are written with Ignore = True."""


class Lossy(InputError):
    """A format can't hold all of a network, and `strict` forbids losses; `losses` lists them."""

    def __init__(self, output: Path, losses: Sequence[str]) -> None:
        found = f"it can't hold {many(len(losses), 'kind')} of things ({losses[0]}{'; ...' if len(losses) > 1 else ''})"
        super().__init__(str(output), found, "a format that holds all", "leave --strict out to write it nevertheless")
        self.losses = tuple(losses)


def format_of(path: Path, named: str | None = None, option: str = "--from") -> Format:
    """A file's format by its ending, or as named; InputError for an unknown one."""
    if named is not None:
        require(named in list(Format), option, repr(named), ", ".join(Format))
        return Format(named)
    if (form := _ENDINGS.get(path.suffix.lower())) is None:
        remedy = f"or say the format with {option}"
        found = "a folder" if os.path.isdir(path) else f"the ending {path.suffix!r}"
        raise InputError(str(path), found, ", ".join(_ENDINGS), remedy)
    return form


def read_networks(
    paths: Paths, setting: ExchangeSetting | None = None, named: str | None = None,
    duplicates: Duplicates = Duplicates.REFUSE,
) -> tuple[ControlNetwork, tuple[str, ...]]:
    """Read one or more files as one network, in any format.

    Parameters
    ----------
    paths : path or paths
        Match files are joined to points of many images; points of the same id in other files: `duplicates`.
    setting : ExchangeSetting, optional
        What they don't say of themselves.
    named : str, optional
        Format of all of them; by their endings when absent.
    duplicates : Duplicates
        What becomes of points that several files have.

    Returns
    -------
    network : ControlNetwork
    notes : tuple of str
        What happened to it, in sentences.

    Raises
    ------
    InputError
        As the readers do; and for a file twice, an id in two files that is to be refused, networks of two bodies, or a
        new name for an image that is none.
    """
    setting = setting or ExchangeSetting()
    forms = [(path, format_of(path, named)) for path in _listed(paths)]
    matches = [_match(path, form, setting) for path, form in forms if form in _MATCHES]
    networks, notes = list[ControlNetwork](), list[str]()
    if matches:
        tracks = joined(matches)
        networks.append(tracks.network)
        if tracks.contradictory:
            dropped = many(tracks.contradictory, "point")
            notes.append(f"Left out, having two places in one image, as the Ames Stereo Pipeline does: {dropped}")
        if setting.prefix is None and not setting.old_names():
            names = dict.fromkeys(name for match in matches for name in match.images)
            notes.append(f"Images, by the names of the match files: {some(list(names))}")
    networks += [_read(path, form, setting) for path, form in forms if form not in _MATCHES]
    require_one_body(networks, setting)
    notes += _other_heads(networks)
    merged = _merged(networks, duplicates, notes)
    _require_inside(merged, setting.old_sizes())
    return _renamed(merged, setting.renamed), tuple(notes)


def _require_inside(network: ControlNetwork, sizes: Mapping[str, tuple[int, int]]) -> None:
    """Raise InputError unless all measures that count lie on those images whose sizes are known."""
    beyond = [
        (point.id, m)
        for point in network.points
        for m in point.measures
        if not (m.ignore or point.ignore)
        and (size := sizes.get(m.serial_number)) is not None
        and m.line is not None
        and m.sample is not None
        and not all(_EDGE <= place <= count + _EDGE for place, count in zip((m.line, m.sample), size, strict=True))
    ]
    if beyond:
        name, worst = beyond[0]
        lines, samples = sizes[worst.serial_number]
        raise InputError(
            f"{network.source}, point {name}, image {worst.serial_number}",
            f"line {worst.line:g}, sample {worst.sample:g} (counted from 1), and {len(beyond) - 1} more beyond theirs",
            f"places inside {lines} lines x {samples} samples",
            "the case's image may be another one or a part of it; leave the size out to convert nevertheless",
        )


def _listed(paths: Paths) -> list[Path]:
    """One path or several, as a list; InputError for none, or one twice."""
    listed = [Path(item) for item in ([paths] if isinstance(paths, str | Path) else paths)]
    require(listed, "convert", "nothing to read", "one file or more")
    resolved_paths = set[Path]()
    for path in listed:
        require((place := resolved(path, "")) not in resolved_paths, str(path), "given twice", "each file once")
        resolved_paths.add(place)
    return listed


def _match(path: Path, form: Format, setting: ExchangeSetting) -> MatchFile:
    """One match file; its images by the names that are known, unless a prefix is."""
    require(os.path.exists(path), str(path), "no such file", remedy="check the path")
    names = () if setting.prefix is not None else setting.old_names()
    return (read_match if form == Format.MATCH else read_match_text)(path, named_images(path, names, setting.prefix))


def _read(path: Path, form: Format, setting: ExchangeSetting) -> ControlNetwork:
    if form == Format.GCP:
        ellipsoid = setting.ellipsoid or stated_datum(path)
        if ellipsoid is None:
            raise InputError(str(path), "heights above an unknown ellipsoid", "its radii", "say --radii, or --case")
        return read_ground_control_network(path, ellipsoid)
    if form == Format.NVM:
        return read_nvm(path, half_sizes(setting.old_sizes()), setting.shifted)
    return read_table(path, setting.ellipsoid) if form in _TABLES else read_network(path)


def _merged(networks: Sequence[ControlNetwork], duplicates: Duplicates, notes: list[str]) -> ControlNetwork:
    """All points, with the head of the first network that names its body; sentences are added to `notes`."""
    if len(networks) == 1:
        return networks[0]
    points, sentences = united(networks, duplicates)
    notes += sentences
    return structs.replace(leading(networks), points=points, source=", ".join(network.source for network in networks))


def _other_heads(networks: Sequence[ControlNetwork]) -> list[str]:
    """A note where heads of networks differ and one must be chosen."""
    first = leading(networks)
    bare = structs.replace(first, points=(), source="")
    sources = [n.source for n in networks if n.network_id and structs.replace(n, points=(), source="") != bare]
    return [f"NetworkId, Description and dates are those of {first.source}"] if sources else []


def _renamed(network: ControlNetwork, names: Mapping[str, str]) -> ControlNetwork:
    if not names:
        return network
    present = images_of(network)
    for old in names:
        require(old in present, network.source, f"no image {old!r} to rename", some(sorted(present)))
    after = [names.get(name, name) for name in present]
    if len(set(after)) < len(after):
        twice = next(name for name in after if after.count(name) > 1)
        raise InputError("--rename", f"two images that would be called {twice!r}", "names of their own")

    def of_point(point: ControlPoint) -> ControlPoint:
        measures = tuple(
            structs.replace(measure, serial_number=names.get(measure.serial_number, measure.serial_number))
            for measure in point.measures
        )
        return structs.replace(point, measures=measures)

    return structs.replace(network, points=tuple(map(of_point, network.points)))


def contents(network: ControlNetwork, output: Path, form: Format, setting: ExchangeSetting) -> dict[Path, bytes]:
    """Contents of a network's files by their paths; InputError where the format can't hold it."""
    if form in _MATCHES:
        return match_files(network, prefix_of(output, images_of(network)), form == Format.MATCH_TEXT)
    if form == Format.GCP:
        return {output: ground_control_text(network, ellipsoid_of(network, output, setting)).encode()}
    if form == Format.NVM:
        centres = half_sizes(setting.sizes) if setting.shifted else dict.fromkeys(images_of(network), (0.0, 0.0))
        return nvm_files(network, output, centres)
    if form == Format.CSV:
        return {output: table_text(network).encode()}
    if form == Format.PARQUET:
        return {output: table_parquet(network)}
    complete = with_head(network, output, setting)
    return {output: binary_network(complete) if form == Format.NET else network_text(complete).encode()}


def convert(
    inputs: Paths,
    output: str | Path,
    setting: ExchangeSetting | None = None,
    selection: Selection | None = None,
    *,
    read_as: str | None = None,
    write_as: str | None = None,
    strict: bool = False,
    replace: bool = True,
    anything: bool = False,
) -> Conversion:
    """Read networks and write them as one, in another format.

    Parameters
    ----------
    inputs : path or paths
        What to read; several are made one network (`read_networks`).
    output : path
        What to write; match files get names of their own, which begin with this one's without its ending.
    setting : ExchangeSetting, optional
        What the files don't say of themselves.
    selection : Selection, optional
        What of them is written; all when absent.
    read_as, write_as : str, optional
        Formats, by name; by the endings when absent.
    strict : bool
        Raise `Lossy`, and write nothing, where the format can't hold all.
    replace : bool
        False refuses to overwrite a file of one of the formats that are read: it may be one that was to be read, too.
    anything : bool
        Overwrite files of any kind; else those alone that are networks of the same format, by their content.

    Raises
    ------
    InputError
        With the place, the finding and the remedy; nothing is written then.

    Examples
    --------
    >>> made = mgsgraph.convert("pair/network.pvl", "network.csv")
    >>> len(made.network.points), [path.name for path in made.written]
    (20, ['network.csv'])
    >>> made.losses[0]
    'NetworkId, TargetName, UserName, Created, LastModified and Description of the network'
    """
    setting, selection = setting or ExchangeSetting(), selection or Selection()
    paths, output = _listed(inputs), Path(output)
    form = format_of(output, write_as, "--to")
    if not replace and os.path.exists(output) and form in {format_of(path, read_as) for path in paths}:
        remedy = "name what is written last; or say --replace"
        raise InputError(str(output), "exists, and is of a format that is read", "a new file", remedy)
    network, notes = read_networks(paths, setting, read_as, selection.duplicates)
    if selection.verdicts is not None:
        network = ignore_rejected(network, selection.verdicts, setting.old_names())
        ignored = sum(point.ignore for point in network.points)
        notes = (*notes, f"Ignored: {ignored} of {many(len(network.points), 'point')}")
    network, sentences = in_images(network, selection.images) if selection.images else (network, [])
    files = contents(network, output, form, setting)
    lossy = losses(network, form)
    _require_others(paths, files)
    for path in files:
        require_free(path, None if anything else replaceable_network(form, path), remedy=_ELSEWHERE)
    if strict and lossy:
        raise Lossy(output, lossy)
    _write(files)
    return Conversion(network, tuple(files), (*notes, *sentences), tuple(lossy))


def _require_others(inputs: Sequence[Path], files: Mapping[Path, bytes]) -> None:
    read = {resolved(path, "") for path in inputs}
    for path in files:
        if resolved(path, _ELSEWHERE) in read:
            raise InputError(str(path), "one of the files that are read", "another name for what is written")


def _write(files: Mapping[Path, bytes]) -> None:
    """All files or none: each is written to a temporary file before the first is moved."""
    with ExitStack() as stack:
        asides = [stack.enter_context(fresh_file(path, "a file that may be written")) for path in files]
        for temporary, content in zip(asides, files.values(), strict=True):
            temporary.write_bytes(content)


_NVM = "a network of VisualSFM"
_OFFSETS = offsets_path(Path(".nvm")).name.removeprefix(".nvm")
_PAIR = ("first", "second")


def replaceable_network(form: Format, path: Path) -> Output:
    """Content by which a file may be replaced by a network of a format, or by a part of one."""
    match form:
        case Format.PVL:
            return begins("an ISIS control network as PVL", r"\s*Object\s*=\s*ControlNetwork\b")
        case Format.NET:
            return begins("an ISIS control network (binary)", r"\s*Object\s*=\s*ProtoBuffer\b")
        case Format.CSV | Format.PARQUET:
            return Output("a table of tie points", lambda path: kind_of(path) is Kind.TIE_TABLE)
        case Format.GCP:
            return begins("ground control points of mgsgraph convert", "# id latitude longitude height sigma_x")
        case Format.NVM if path.name.endswith(_OFFSETS):
            return Output(f"optical centres of {_NVM}", _read_by(read_offsets))
        case Format.NVM:
            return begins(_NVM, "NVM_V3")
        case Format.MATCH:
            return Output("a match file of the Ames Stereo Pipeline", _read_by(lambda path: read_match(path, _PAIR)))
        case Format.MATCH_TEXT:
            return Output("a match file in text", _read_by(lambda path: read_match_text(path, _PAIR)))


def _read_by(read: Callable[[Path], object]) -> Callable[[Path], bool]:
    """Whether a reader accepts a file whose beginning doesn't tell its kind."""

    def known(path: Path) -> bool:
        with suppress(InputError):
            read(path)
            return True
        return False

    return known

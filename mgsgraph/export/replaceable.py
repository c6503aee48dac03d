"""Networks that were written before, known by their content: of files of a network's name these alone are replaced."""

from collections.abc import Callable
from pathlib import Path

from mgsgraph.errors import InputError
from mgsgraph.export import Format
from mgsgraph.files.kinds import Kind, kind_of
from mgsgraph.files.networks.asp_match import read_match, read_match_text
from mgsgraph.files.networks.asp_nvm import offsets_path, read_offsets
from mgsgraph.files.writing import Output, begins

_NVM = "a network of VisualSFM"
_OFFSETS = offsets_path(Path(".nvm")).name.removeprefix(".nvm")
_PAIR = ("first", "second")


def earlier_network(form: Format, path: Path) -> Output:
    """What a file has to be by its content to be replaced by a network of a format, or by a part of one."""
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
    """Whether a reader takes a file, of a kind whose beginning doesn't tell."""

    def known(path: Path) -> bool:
        try:
            read(path)
        except InputError:
            return False
        return True

    return known

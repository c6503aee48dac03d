"""Names in columns: ids of points, names of the images of their measures, without a Python object for each.

`Names` are the ids, most of which differ, as one text and the places where each begins; `RepeatedNames` come often, as
the numbers of a few distinct ones. Both are sequences of str, and Arrow arrays without a copy.

Arrays go to Arrow and back by their buffers and by DLPack: `pyarrow.array`, `pyarrow.scalar` and `Array.to_numpy` would
load pandas, where it is installed, for a sixth of a second.
"""

import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from functools import cached_property
from operator import index
from typing import Any, Self, TypeVar, Union, overload

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from mgsgraph.errors import InputError, require

_MOST_COMPARED = 20_000
"""Names among which those nearest to a misspelt one are sought."""
_MOST_NAMED = 6
"""Names that a message lists."""
_IMAGE = "image"
Name = TypeVar("Name")
Item = TypeVar("Item")
Chosen = Union[slice, "NDArray[np.int64]", "NDArray[np.bool_]"]
"""Which names: a slice, numbers (m,) or marks (n,)."""


class _Column(Sequence[str]):
    """What both kinds do alike."""

    __slots__ = ()

    def __eq__(self, other: object) -> bool:
        if isinstance(other, Sequence) and not isinstance(other, str):
            return len(self) == len(other) and self.tolist() == list(other)
        return NotImplemented

    __hash__ = None  # type: ignore[assignment]

    def __add__(self, others: Sequence[str]) -> Self:
        kind: Any = type(self)
        joined: Self = kind.concatenated([self, kind.of(others)])
        return joined

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        return np.array(self.tolist(), dtype=str if dtype is None else dtype)

    def tolist(self) -> list[str]:
        """(n,) Python texts."""
        return list(self)


@dataclass(frozen=True, eq=False, repr=False)
class Names(_Column):
    """Names, a text each, in columns."""

    data: NDArray[np.uint8]
    """(b,) UTF-8 of all names, one after another."""
    offsets: NDArray[np.int64]
    """(n + 1,) place in `data` where each name begins, and where the last one ends."""

    def __post_init__(self) -> None:
        ends = self.offsets
        if not (ends.size and ends[0] == 0 and ends[-1] == self.data.size and np.all(ends[1:] >= ends[:-1])):
            raise InputError("names", "places that don't follow each other", "begin of each name and end of the last")
        self.data.flags.writeable = ends.flags.writeable = False

    @classmethod
    def of(cls, names: "Iterable[str] | pa.Array | pa.ChunkedArray", source: str = "names") -> "Names":
        """Names from any texts, or from an Arrow array of them, which a `source` in messages has;
        what are Names already stays as it is.

        Raises
        ------
        TypeError
            For what are no texts.
        InputError
            For half a character, which no text has.
        """
        if isinstance(names, Names):
            return names
        if isinstance(names, RepeatedNames):
            names = names.arrow.cast(pa.large_string())
        if isinstance(names, pa.ChunkedArray):
            names = names.combine_chunks()
        if not isinstance(names, pa.Array):
            return _encoded(names if isinstance(names, list | tuple) else list(names), source)
        if names.null_count:
            raise TypeError("a name that is none")
        return cls._from_arrow(names.cast(pa.large_string()))

    @classmethod
    def _from_arrow(cls, array: pa.Array) -> "Names":
        """Of large strings."""
        _, begins, texts = array.buffers()
        n = len(array)
        if n == 0 or begins is None:
            return cls(np.zeros(0, dtype=np.uint8), np.zeros(n + 1, dtype=np.int64))
        offsets = np.frombuffer(begins, np.int64)[array.offset : array.offset + n + 1]
        data = np.zeros(0, dtype=np.uint8) if texts is None else np.frombuffer(texts, np.uint8)
        return cls(data[offsets[0] : offsets[-1]], offsets - offsets[0] if offsets[0] else offsets)

    @staticmethod
    def concatenated(parts: "Sequence[Names]") -> "Names":
        """The names of several, one after another."""
        if len(parts) == 1:
            return parts[0]
        sizes = np.concatenate([np.zeros(1, dtype=np.int64), *(np.diff(part.offsets) for part in parts)])
        nothing = np.zeros(0, dtype=np.uint8)
        return Names(np.concatenate([nothing, *(part.data for part in parts)]), np.cumsum(sizes))

    @staticmethod
    def joined(*columns: "NDArray[np.int64] | pa.Array", mark: str = ":") -> "Names":
        """Names made of numbers or texts side by side, (n,) each, with a mark between them."""
        parts = ((one if isinstance(one, pa.Array) else arrow_of(one)).cast(pa.large_string()) for one in columns)
        return Names.of(pc.binary_join_element_wise(*parts, _scalar(mark)))

    def prefixed(self, text: str) -> "Names":
        """Each with a text before it."""
        return Names.of(pc.binary_join_element_wise(_scalar(text), self.arrow, _scalar("")))

    @property
    def arrow(self) -> pa.Array:
        """Arrow array of large strings, on the same memory."""
        buffers = [None, pa.py_buffer(self.offsets), pa.py_buffer(self.data)]
        return pa.Array.from_buffers(pa.large_string(), len(self), buffers)

    @property
    def text(self) -> str:
        """All names, one after another, with nothing between them."""
        return self.data.tobytes().decode()

    def __len__(self) -> int:
        return self.offsets.size - 1

    @overload
    def __getitem__(self, which: "int | np.integer[Any]") -> str: ...
    @overload
    def __getitem__(self, which: Chosen) -> "Names": ...
    def __getitem__(self, which: Any) -> Any:
        if isinstance(which, slice):
            which = np.arange(len(self))[which]
        if isinstance(which, np.ndarray) and which.ndim:
            chosen = np.flatnonzero(which) if which.dtype == bool else which.astype(np.int64, copy=False)
            if chosen.size and chosen.min() < 0:
                chosen = np.where(chosen < 0, chosen + len(self), chosen)
            return Names._from_arrow(self.arrow.take(arrow_of(chosen)))
        number = index(which)
        if not -len(self) <= number < len(self):
            raise IndexError(f"name {number} of {len(self)}")
        number %= len(self)
        return self.data[self.offsets[number] : self.offsets[number + 1]].tobytes().decode()

    def __iter__(self) -> Iterator[str]:
        return iter(self.tolist())

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str) and name in set(self.tolist())

    def __eq__(self, other: object) -> bool:
        if isinstance(other, Names):
            return np.array_equal(self.offsets, other.offsets) and np.array_equal(self.data, other.data)
        return super().__eq__(other)

    def __repr__(self) -> str:
        shown = ", ".join(map(repr, self[:3]))
        return f"Names({len(self)}: {shown}{', ...' if len(self) > 3 else ''})"

    def tolist(self) -> list[str]:
        """(n,) Python texts."""
        ends = self.offsets.tolist()
        text = self.text
        if len(text) == self.data.size:  # ASCII alone: a byte is a character
            return [text[a:b] for a, b in itertools.pairwise(ends)]
        data = self.data.tobytes()
        return [data[a:b].decode() for a, b in itertools.pairwise(ends)]

    def find(self, others: "Names | Sequence[str]") -> NDArray[np.int64]:
        """(m,) number of each of other names among these, -1 for one that is not here."""
        if len(others) == 1:  # compared with each of these, which takes less than a table of them
            return np.array([pc.index(self.arrow, _scalar(others[0])).as_py()])
        return _numbers_among(Names.of(others).arrow, self.arrow)

    def containing(self, text: str, whole: bool = False) -> NDArray[np.bool_]:
        """(n,) whether each contains a text, in small or capital letters; or is it, where `whole`."""
        case = text.lower() != text.upper()  # without them it is much faster
        found = pc.equal(self.arrow, _scalar(text)) if whole else pc.match_substring(self.arrow, text, ignore_case=case)
        contains = np.zeros(len(self), dtype=np.bool_)
        contains[np.from_dlpack(pc.indices_nonzero(found))] = True
        return contains

    @staticmethod
    def united(parts: "Sequence[Names]") -> "tuple[Names, list[NDArray[np.int64]]]":
        """The names of several, each once, as they come; and of each part the numbers of its names among them."""
        every = Names.concatenated(parts)
        names = Names.of(pc.unique(every.arrow))
        ends = np.cumsum([len(part) for part in parts])
        return names, np.split(names.find(every), ends[:-1])

    @cached_property
    def first_repeated(self) -> int | None:
        """Number of the first name that stands before it already; None where each is there once."""
        if len(pc.unique(self.arrow)) == len(self):
            return None
        first = dict[str, int]()
        return next(k for k, name in enumerate(self.tolist()) if first.setdefault(name, k) != k)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class RepeatedNames(_Column):
    """Names of which few differ, as those of the images that points are measured in."""

    distinct: tuple[str, ...]
    """Each of them once; some may not be used."""
    numbers: NDArray[np.int64]
    """(k,) number of each name among these."""

    def __post_init__(self) -> None:
        if self.numbers.size and not 0 <= self.numbers.min() <= self.numbers.max() < len(self.distinct):
            raise InputError("names", f"numbers up to {self.numbers.max()}", f"0 .. {len(self.distinct) - 1}")
        require(len(set(self.distinct)) >= len(self.distinct), "names", "a distinct name twice", "each once")
        self.numbers.flags.writeable = False

    @classmethod
    def of(cls, names: "Iterable[str] | pa.Array | pa.ChunkedArray") -> "RepeatedNames":
        """Names from any texts, or from an Arrow array of them, numbered as they come."""
        if isinstance(names, RepeatedNames):
            return names
        if isinstance(names, pa.ChunkedArray):
            names = names.combine_chunks()
        array = names if isinstance(names, pa.Array) else Names.of(names).arrow
        coded = array if pa.types.is_dictionary(array.type) else array.dictionary_encode()
        if coded.null_count:
            raise TypeError("a name that is none")
        return cls(tuple(coded.dictionary.to_pylist()), np.from_dlpack(coded.indices).astype(np.int64))

    @staticmethod
    def concatenated(parts: "Sequence[RepeatedNames]") -> "RepeatedNames":
        """The names of several, one after another."""
        if len(parts) == 1:
            return parts[0]
        distinct = tuple(dict.fromkeys(name for part in parts for name in part.distinct))
        nothing = np.zeros(0, dtype=np.int64)
        return RepeatedNames(distinct, np.concatenate([nothing, *(part.over(distinct) for part in parts)]))

    @property
    def used(self) -> tuple[str, ...]:
        """Distinct names that occur, in the order of their first."""
        used, first = np.unique(self.numbers, return_index=True)
        return tuple(self.distinct[k] for k in used[np.argsort(first)].tolist())

    @property
    def arrow(self) -> pa.Array:
        """Arrow's dictionary array."""
        numbers = arrow_of(np.asarray(self.numbers, dtype=np.int64))
        return pa.DictionaryArray.from_arrays(numbers, Names.of(self.distinct).arrow)

    def over(self, names: Sequence[str]) -> NDArray[np.int64]:
        """(k,) number of each name among others, each of which is there once; -1 for one that is not there."""
        number = numbered(names)
        return np.array([*(number.get(name, -1) for name in self.distinct), -1], dtype=np.int64)[self.numbers]

    def __len__(self) -> int:
        return self.numbers.size

    @overload
    def __getitem__(self, which: "int | np.integer[Any]") -> str: ...
    @overload
    def __getitem__(self, which: Chosen) -> "RepeatedNames": ...
    def __getitem__(self, which: Any) -> Any:
        if isinstance(which, slice) or (isinstance(which, np.ndarray) and which.ndim):
            return RepeatedNames(self.distinct, self.numbers[which])
        return self.distinct[self.numbers[which]]

    def __iter__(self) -> Iterator[str]:
        return map(self.distinct.__getitem__, self.numbers.tolist())

    def __contains__(self, name: object) -> bool:
        return name in self.distinct and bool(np.any(self.numbers == self.distinct.index(str(name))))

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        names = np.array(self.distinct or ("",), dtype=str if dtype is None else dtype)
        return names[self.numbers]

    def __repr__(self) -> str:
        return f"RepeatedNames({len(self)} of {len(self.distinct)} distinct ones)"


def number_of(asked: "str | int | np.integer[Any]", numbers: Mapping[str, int], what: str) -> int:
    """The number of one of several, asked for by its name or by its number, 0 .. n - 1; of an image also by a part of
    its name that no other has.

    Parameters
    ----------
    asked : str or int
    numbers : mapping
        Number of each name.
    what : str
        What they are, for messages: image, point.

    Raises
    ------
    InputError
        Where there is none of that name, with the names that come nearest, or of that number; a part of several names.
    """
    found, near = f"no such {what} among {len(numbers)}", list[str]()
    if isinstance(asked, str):
        if asked in numbers:
            return numbers[asked]
        if what == _IMAGE and asked:
            near = [name for name in numbers if asked in name]
        if len(near) == 1:
            return numbers[near[0]]
        if near:
            found = f"a part of {len(near)} names"
        elif len(numbers) <= _MOST_COMPARED:
            near = get_close_matches(asked, numbers, n=3)
        expected = "one of their names"
    else:
        if 0 <= index(asked) < len(numbers):
            return index(asked)
        expected = f"a number from 0 to {len(numbers) - 1}, or a name"
    require(numbers, f"{what} {asked}", f"there is no {what}")
    names = near[:_MOST_NAMED] or list(itertools.islice(numbers, 3))
    raise InputError(f"{what} {asked}", found, f"{expected}, e.g. {', '.join(names)}")


def numbered(names: Iterable[Name]) -> dict[Name, int]:
    """Number of each of several names, as they come."""
    return {name: number for number, name in enumerate(names)}


def grouped(pairs: Iterable[tuple[Name, Item]]) -> dict[Name, list[Item]]:
    """What belongs to each name, or other key, as they come."""
    groups = dict[Name, list[Item]]()
    for name, item in pairs:
        groups.setdefault(name, []).append(item)
    return groups


def image_names(asked: Iterable[str], names: Sequence[str]) -> list[str]:
    """Names of images, each once, of which names or parts of names were asked for (`number_of`)."""
    numbers = numbered(names)
    return list(dict.fromkeys(names[number_of(one, numbers, _IMAGE)] for one in asked))


def _encoded(names: Sequence[str], source: str) -> Names:
    try:
        texts = list(map(str.encode, names))
    except UnicodeEncodeError as error:
        found = f"the name {str(error.object)[:60]!r}"
        raise InputError(source, found, "characters that can be printed", "rename it") from None
    ends = np.cumsum([0, *map(len, texts)], dtype=np.int64)
    return Names(np.frombuffer(b"".join(texts), np.uint8), ends)


def _scalar(text: str) -> pa.Scalar:
    """A text as Arrow's functions take it."""
    return Names.of([text]).arrow[0]


def arrow_of(values: NDArray[Any]) -> pa.Array:
    """Numbers or truths as Arrow array, on the same memory where that can be; null for what is not finite."""
    known = pa.py_buffer(np.packbits(np.isfinite(values), bitorder="little")) if values.dtype.kind == "f" else None
    data = np.packbits(values, bitorder="little") if values.dtype.kind == "b" else np.ascontiguousarray(values)
    return pa.Array.from_buffers(pa.from_numpy_dtype(values.dtype), values.size, [known, pa.py_buffer(data)])


def _numbers_among(wanted: pa.Array, known: pa.Array) -> NDArray[np.int64]:
    found, numbers = pc.index_in(wanted, value_set=known), np.full(len(wanted), -1)
    numbers[np.from_dlpack(pc.indices_nonzero(found.is_valid()))] = np.from_dlpack(found.drop_null())
    return numbers

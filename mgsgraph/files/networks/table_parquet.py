"""Tables of tie points in Apache Parquet: the columns of `networks.table_columns`, numbers as float64 or whole ones,
flags as truth values or words, null for nothing.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc

from mgsgraph.errors import InputError
from mgsgraph.files.networks.table_columns import TEXTS, TRUTHS, header_of
from mgsgraph.files.opening import ANY_SIZE, opened, read_bytes, understood

PARQUET, MAGIC = ".parquet", b"PAR1"
"""Ending of a file's name, and how its content begins."""
_WHAT = "an Apache Parquet file"
_MOST_PACKED, _LEAST_LIMIT = 100, 1 << 25
"""By how much a table may be packed, and bytes and rows that it may always have."""


def parquet_columns(path: Path) -> dict[str, pa.Array]:
    """Columns by their names: texts without blanks around them, empty ones for nothing; numbers as float64, null for
    nothing.

    InputError for a file that is none, a column of another kind, and what `header_of` refuses.
    """
    content = read_bytes(path)
    with understood(str(path), _WHAT):
        table = _table(content, str(path))
        names = header_of(table.column_names, f"{path}, columns")
        return {name: _column(name, table.column(k), str(path)) for k, name in enumerate(names)}


def parquet_names(path: Path) -> list[str]:
    """Names of the columns, in small letters; InputError for a file that is none."""
    from pyarrow import parquet

    with opened(path, ANY_SIZE) as file, understood(str(path), _WHAT), _damage():
        return [name.strip().lower() for name in parquet.read_schema(file).names]


def parquet_rows(path: Path) -> Iterator[tuple[str, list[str]]]:
    """Place and fields of the header and of every row, as texts: what says in which row something is wrong."""
    columns = parquet_columns(path)
    yield "columns", list(columns)
    texts = [[_text(value) for value in column.to_pylist()] for column in columns.values()]
    for number, fields in enumerate(zip(*texts, strict=True), start=1):
        yield f"row {number}", list(fields)


def _text(value: str | float | None) -> str:
    return "" if value is None else value if isinstance(value, str) else repr(value)


def _table(content: bytes, source: str) -> pa.Table:
    """The whole of a file; InputError where it says to hold more than it can."""
    from pyarrow import parquet

    with _damage():
        file = parquet.ParquetFile(pa.BufferReader(content))
        head, limit = file.metadata, max(_LEAST_LIMIT, _MOST_PACKED * len(content))
        size = sum(head.row_group(k).total_byte_size for k in range(head.num_row_groups))
        if head.num_rows > limit or size > limit:
            found = f"{head.num_rows} rows, {size} bytes unpacked"
            raise InputError(source, found, f"up to {limit} of either, the file being so small", "write it anew")
        return file.read(use_threads=False)


@contextmanager
def _damage() -> Iterator[None]:
    """What Arrow raises of a damaged file, as a ValueError."""
    try:
        yield
    except OSError as error:
        raise ValueError(error) from None


def _column(name: str, chunks: pa.ChunkedArray, source: str) -> pa.Array:
    column = pa.chunked_array(chunks).combine_chunks() if chunks.num_chunks != 1 else chunks.chunk(0)
    if pa.types.is_dictionary(column.type):
        column = column.cast(column.type.value_type)
    column.validate(full=True)  # texts that are none
    kind = column.type
    if pa.types.is_null(kind) or pa.types.is_string(kind) or pa.types.is_large_string(kind):
        return pc.utf8_trim_whitespace(column.cast(pa.large_string()).fill_null(""))
    in_words = name in (*TEXTS, *TRUTHS)
    if (pa.types.is_integer(kind) and in_words) or (pa.types.is_boolean(kind) and name in TRUTHS):
        return column.cast(pa.large_string()).fill_null("")
    if (pa.types.is_integer(kind) or pa.types.is_floating(kind)) and not in_words:
        values = column.cast(pa.float64())
        return pc.if_else(pc.is_nan(values), None, values)
    expected = "texts" if name in TEXTS else "truth values" if name in TRUTHS else "numbers"
    raise InputError(f"{source}, column {name}", f"values of the kind {kind}", expected)

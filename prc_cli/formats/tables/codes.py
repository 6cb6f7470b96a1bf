"""Class codes in Parquet files."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.classes import NO_CODE
from prc_cli.core.errors import InputError
from prc_cli.core.types import I64
from prc_cli.formats.labels import code_of_name, dimension_of_codes
from prc_cli.formats.records import CodeSource
from prc_cli.formats.tables.read import read_batches

_DAMAGED = (OSError, ValueError, LookupError, MemoryError)


def open_parquet_codes(path: Path, dimension: str | None) -> CodeSource:
    """Open a column of a Parquet file."""
    import pyarrow as pa
    from pyarrow import parquet

    damaged = "copy it from the archive again"
    try:
        with parquet.ParquetFile(path) as file:
            schema = file.schema_arrow
            n = file.metadata.num_rows
    except (pa.ArrowException, *_DAMAGED) as error:
        raise InputError(
            str(path), f"no whole Parquet file ({' '.join(str(error).split())[:160]})", damaged
        ) from error
    name = dimension_of_codes(path, list(schema.names), dimension)
    kind = schema.types[schema.names.index(name)]
    plain = kind.value_type if pa.types.is_dictionary(kind) else kind
    if pa.types.is_string(plain) or pa.types.is_large_string(plain):
        return CodeSource(path, n, lambda: _named_codes(path, name))
    if not (pa.types.is_integer(kind) or pa.types.is_floating(kind)):
        problem = f"column {name!r} holds {kind}, expected class codes, whole numbers"
        raise InputError(str(path), problem, "name the column that holds class codes")
    if not n:
        raise InputError(str(path), "no rows, expected a class code a record", damaged)

    def read() -> Iterator[NDArray[Any]]:
        first = 0
        try:
            for batch in read_batches(path, [name]):
                column = batch.column(0)
                if column.null_count:
                    wide = pa.float64() if pa.types.is_floating(kind) else pa.int64()
                    column = column.cast(wide).fill_null(NO_CODE)
                first += len(column)
                yield column.to_numpy(zero_copy_only=False)
        except (pa.ArrowException, *_DAMAGED) as error:
            problem = f"record {first} and on cannot be read ({' '.join(str(error).split())[:160]})"
            raise InputError(str(path), problem, damaged) from error

    return CodeSource(path, n, read, name=name)


def _named_codes(path: Path, name: str) -> Iterator[I64]:
    import pyarrow as pa

    for batch in read_batches(path, [name]):
        column = batch.column(0)
        coded = column if pa.types.is_dictionary(column.type) else column.dictionary_encode()
        codes = [code_of_name(str(path), word or "") for word in coded.dictionary.to_pylist()]
        index = coded.indices.cast(pa.int64()).fill_null(len(codes)).to_numpy(zero_copy_only=False)
        yield np.array([*codes, NO_CODE], np.int64)[index]

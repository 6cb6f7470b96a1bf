"""Writes objects as they end: CSV, GeoJSON or Parquet; the file gets its name when it is whole."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import fields
from itertools import chain, repeat
from pathlib import Path
from typing import Any

from prc_cli.core.errors import ConfigError
from prc_cli.core.files import atomic_output, output_errors
from prc_cli.jobs.objects.grow import Thing

COLUMNS = tuple(one.name for one in fields(Thing))
SUFFIXES = (".csv", ".geojson", ".parquet")
ROWS_AT_ONCE = 10_000
"""Rows of a group of a Parquet file."""
_TEXT = ("kind",)
_WHOLE = ("id", "scanner", "first_line", "last_line", "first_column", "last_column", "n_shots")


def check_suffix(path: Path) -> str:
    """Return the suffix of an output, which decides its format."""
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        problem = f"found suffix {path.suffix!r}, expected one of {', '.join(SUFFIXES)}"
        raise ConfigError(str(path), problem, "choose an output name that ends in one of them")
    return suffix


@contextmanager
def open_things(path: Path) -> Iterator[Callable[[Thing], None]]:
    """Open an output; call what is yielded with every object."""
    writer = {".csv": _csv, ".geojson": _geojson, ".parquet": _parquet}[check_suffix(path)]
    with atomic_output(path) as temporary, output_errors(path), writer(temporary) as put:
        yield put


def plain(value: Any) -> Any:
    """Return a value for a text: metres and degrees to a tenth of a millimetre, NaN as None."""
    if isinstance(value, float):
        return None if math.isnan(value) else round(value, 4)
    return value


@contextmanager
def _csv(path: Path) -> Iterator[Callable[[Thing], None]]:
    with path.open("w", encoding="utf-8", newline="\n") as handle:
        handle.write(",".join(COLUMNS) + "\n")

        def put(thing: Thing) -> None:
            values = (plain(getattr(thing, name)) for name in COLUMNS)
            handle.write(",".join("" if value is None else str(value) for value in values) + "\n")

        yield put


@contextmanager
def _geojson(path: Path) -> Iterator[Callable[[Thing], None]]:
    with path.open("w", encoding="utf-8", newline="\n") as handle:
        handle.write('{"type": "FeatureCollection", "features": [')
        comma = chain([""], repeat(","))

        def put(thing: Thing) -> None:
            values = {name: plain(getattr(thing, name)) for name in COLUMNS}
            x, y, z = (values.pop(axis) for axis in ("x", "y", "z"))
            place = None if x is None else {"type": "Point", "coordinates": [x, y, z]}
            feature = {"type": "Feature", "geometry": place, "properties": values}
            handle.write(f"{next(comma)}\n{json.dumps(feature)}")

        yield put
        handle.write("\n]}\n")


@contextmanager
def _parquet(path: Path) -> Iterator[Callable[[Thing], None]]:
    # imported here: only this format needs it
    import pyarrow as pa
    import pyarrow.parquet as pq

    kinds = {**dict.fromkeys(_TEXT, pa.string()), **dict.fromkeys(_WHOLE, pa.int64())}
    schema = pa.schema([(name, kinds.get(name, pa.float64())) for name in COLUMNS])
    rows: list[dict[str, Any]] = []
    with pq.ParquetWriter(path, schema) as writer:

        def put(thing: Thing) -> None:
            rows.append({name: plain(getattr(thing, name)) for name in COLUMNS})
            if len(rows) == ROWS_AT_ONCE:
                flush()

        def flush() -> None:
            writer.write_table(pa.Table.from_pylist(rows, schema))
            rows.clear()

        yield put
        if rows:
            flush()

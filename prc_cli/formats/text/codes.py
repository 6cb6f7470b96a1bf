"""Class codes in text files, as numbers or as the names of classes."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from prc_cli.core.files import suffix_of
from prc_cli.core.types import I64
from prc_cli.formats.labels import code_of_name, dimension_of_codes, open_record_codes
from prc_cli.formats.records import CodeSource
from prc_cli.formats.registry import by_suffix
from prc_cli.formats.text.dialect import is_number
from prc_cli.formats.text.read import TextBody, TextSource


def open_text_codes(path: Path, dimension: str | None) -> CodeSource:
    """Open a column of class codes, or of class names."""
    source = by_suffix("scans")[suffix_of(path)].open_records(path, None)
    assert isinstance(source, TextSource)
    name = dimension_of_codes(path, list(source.dimensions), dimension)
    column = int(source.columns[name].key)
    body = TextBody(path, source.text)
    if all(is_number(cell, source.text.decimal) for _, cell in next(body.cells(column), [])):
        return open_record_codes(path, dimension)

    def read() -> Iterator[I64]:
        for cells in body.cells(column):
            yield np.array(
                [code_of_name(f"{path}: line {line}", cell) for line, cell in cells], np.int64
            )

    # without a name, because the reader of numbers cannot read this column
    return CodeSource(path, None, read)

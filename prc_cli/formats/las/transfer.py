"""LAS or LAZ with class codes from elsewhere: everything else stays, bit for bit."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, Self

from numpy.typing import NDArray

from prc_cli.core.classes import ClassCodes
from prc_cli.core.errors import ConfigError
from prc_cli.core.files import output_errors
from prc_cli.core.types import I64, U8
from prc_cli.formats.las.rewrite import LasRewriter
from prc_cli.formats.writing.columns import OPTIONAL_COLUMNS
from prc_cli.formats.writing.options import OutputConfig
from prc_cli.formats.writing.record import RunRecord

CARRIED = tuple(column.name for column in OPTIONAL_COLUMNS)
"""Dimensions of this program's own outputs that can go along with the class."""


class LasRecoder(LasRewriter):
    """Writer of a LAS or LAZ file from another one, with a class code for every record.

    Use it as a context manager: :meth:`put` every record once, then :meth:`finish`; without that nothing is left.

    Parameters
    ----------
    path : Path
        Output, ``.las`` or ``.laz``.
    source : Path
        LAS or LAZ file that is written again.
    carried : tuple of str
        Dimensions of :data:`CARRIED` that are set too, for records that get them; values that the source has under
        this name are replaced.

    Raises
    ------
    ConfigError
        When a dimension cannot be carried.
    InputError
        When the source has no sound header.
    """

    def __init__(self, path: Path, source: Path, carried: tuple[str, ...] = ()) -> None:
        super().__init__(path, ClassCodes(), OutputConfig(), source)
        for name in carried:
            if name not in CARRIED:
                raise ConfigError("--carry", f"found {name!r}, expected one of {', '.join(CARRIED)}")
        chosen = (column for column in OPTIONAL_COLUMNS if column.name in carried)
        self._optional = tuple(replace(column, keep=False) for column in chosen)

    def __enter__(self) -> Self:
        super().__enter__()
        try:
            with output_errors(self.path):
                self._settle(None)
        except BaseException:
            self._stack.close()
            raise
        return self

    def put(self, record: I64, codes: U8) -> None:
        """Set class codes by record index.

        Raises
        ------
        OutputError
            When they cannot be written (disk full).
        """
        with output_errors(self.path):
            self._put(record, codes, {})

    def put_values(self, record: I64, values: dict[str, NDArray[Any]]) -> None:
        """Set carried dimensions by record index.

        Raises
        ------
        OutputError
            When they cannot be written (disk full).
        """
        with output_errors(self.path):
            for column in self._optional:
                self._spools[column.name].put(record, values[column.name].astype(column.dtype))

    def finish(self, record: RunRecord) -> RunRecord:
        """Write the output and ``<output>.prc.json``, give both their names; return the record as written.

        Raises
        ------
        OutputError
            When the output cannot be written whole; nothing is left then.
        InputError
            When the source, read again, is damaged.
        """
        return super().finish(record)

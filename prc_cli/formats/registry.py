"""The formats: one record each, in the ``__init__`` of its room, or in another package.

Suffixes, readers and writers are looked up here. Another package adds a format by an entry point of
the group ``prc_cli.formats`` that names a :class:`Format`; nothing of this package has to be
touched.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from importlib import import_module
from pathlib import Path
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

from prc_cli.core.files import suffix_of
from prc_cli.core.plugins import load_plugins

if TYPE_CHECKING:
    from prc_cli.core.stream import ScanStream
    from prc_cli.formats.options import InputConfig, Layout
    from prc_cli.formats.records import CodeSource, Source
    from prc_cli.formats.writing.base import StagedWriter, StreamShape
    from prc_cli.formats.writing.columns import LabelOutput

ENTRY_POINTS = "prc_cli.formats"
"""Group of the entry points of other packages."""
_ROOMS = (
    "raw_binary",
    "text",
    "clouds",
    "las",
    "arrays",
    "organised",
    "bags",
    "packets",
    "labels",
    "tables",
)
"""Rooms of this package, in the order in which messages list their suffixes."""

Held: TypeAlias = Literal[
    "codes", "registered", "relative", "angles", "times", "intensity", "returns"
]
"""Values of a stream beside its ranges.

``registered`` are coordinates of the input, ``relative`` ones are relative to the scanner.
"""
EVERYTHING: frozenset[Held] = frozenset(
    ("codes", "registered", "relative", "angles", "times", "intensity", "returns")
)
Role: TypeAlias = Literal["scans", "streams", "labels", "codes"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Format:
    """A format: what it reads and writes.

    Functions are named ``"module:function"`` and imported when they are needed.
    """

    name: str
    scans: tuple[str, ...] = ()
    """Suffixes of scans that can be read."""
    records: str = ""
    """Opens a scan as a list of records: ``(path, layout) -> Source``."""
    images: str = ""
    """Opens a scan of lines and columns: ``(path, configuration, lines at once) -> ScanStream``."""
    has_layout: bool = False
    """Whether a layout describes the records of its scans."""
    is_dump: bool = False
    """Whether only a layout describes them."""
    streams: Mapping[str, str] = field(default_factory=dict)
    """Suffixes of streams that can be written, each with a description."""
    write_stream: str = ""
    """Writes a stream: ``(path, shape) -> StagedWriter``."""
    holds: frozenset[Held] = EVERYTHING
    """Values that a written stream can hold."""
    labels: tuple[str, ...] = ()
    """Suffixes of outputs of ``prc classify``."""
    write_labels: str = ""
    """Writes them: ``(output) -> StagedWriter``."""
    keeps_points: bool = False
    """Whether an output has all values of its input, if both are of this format."""
    codes: tuple[str, ...] = ()
    """Suffixes of files of class codes."""
    open_codes: str = ""
    """Opens them: ``(path, dimension) -> CodeSource``."""
    columns: str = ""
    """Opens the columns of a file that is not a list of records: ``(path) -> Source``."""

    @property
    def holds_all(self) -> bool:
        """Whether a written stream loses no value, as tables and clouds do not."""
        return self.holds == EVERYTHING

    def open_records(self, path: Path, layout: Layout | None) -> Source:
        """Open a scan as a list of records."""
        return _call(self.records, path, layout)  # type: ignore[no-any-return]

    def open_images(self, path: Path, config: InputConfig, lines_at_once: int) -> ScanStream:
        """Open a range image or an organised scan."""
        return _call(self.images, path, config, lines_at_once)  # type: ignore[no-any-return]

    def stream_writer(self, path: Path, shape: StreamShape) -> StagedWriter:
        """Return the writer of a stream."""
        return _call(self.write_stream, path, shape)  # type: ignore[no-any-return]

    def label_writer(self, output: LabelOutput) -> StagedWriter:
        """Return the writer of a classified input."""
        return _call(self.write_labels, output)  # type: ignore[no-any-return]

    def code_source(self, path: Path, dimension: str | None) -> CodeSource:
        """Open the class codes of a file."""
        return _call(self.open_codes, path, dimension)  # type: ignore[no-any-return]

    def column_source(self, path: Path) -> Source | None:
        """Open the columns of a file as records; None if it has none."""
        if self.records and suffix_of(path) in self.scans:
            return self.open_records(path, None)
        return _call(self.columns, path) if self.columns else None


@lru_cache(maxsize=1)
def formats() -> tuple[Format, ...]:
    """Return all formats, those of other packages last."""
    built_in = [
        form for room in _ROOMS for form in import_module(f"prc_cli.formats.{room}").FORMATS
    ]
    return (*built_in, *load_plugins(ENTRY_POINTS))


@lru_cache(maxsize=4)
def by_suffix(role: Role) -> dict[str, Format]:
    """Return the formats of a role by suffix; the first format of a suffix is used."""
    forms: dict[str, Format] = {}
    for form in formats():
        for suffix in getattr(form, role):
            forms.setdefault(suffix, form)
    return forms


def format_of(path: Path, role: Role = "scans") -> Format | None:
    """Return the format of a file in a role, by its suffix; None if there is none."""
    return by_suffix(role).get(suffix_of(path))


def is_dump(path: Path) -> bool:
    """Whether nothing but a layout describes the bytes of a scan."""
    form = format_of(path)
    return form is not None and form.is_dump


def is_bag(path: Path) -> bool:
    """Whether a file name is that of a bag, a recording of messages without columns."""
    form = format_of(path, "labels")
    return form is not None and bool(form.images) and not form.columns


def is_cloud(path: Path) -> bool:
    """Whether an output of this name contains points with classes, not only classes."""
    form = format_of(path, "labels")
    return form is not None and form.keeps_points


def _call(name: str, *arguments: Any) -> Any:
    return resolve_name(name)(*arguments)

"""Arrays in ``.npy`` and ``.npz`` files, read a few rows at a time.

numpy maps a ``.npy`` file or loads it whole, and loads a member of an ``.npz`` archive whole; here both are
read like any other stream, so that memory does not grow with the file. Pickled objects are never loaded.
"""

from __future__ import annotations

import math
import struct
import tempfile
import warnings
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.lib import format as npy_format
from numpy.typing import NDArray

from prc_cli.core.errors import InputError
from prc_cli.core.files import open_to_read

_COPIED_BYTES = 1 << 20
MAX_MEMBERS = 1000
"""Most arrays in an archive."""

_VERSIONS = {(1, 0): npy_format.read_array_header_1_0, (2, 0): npy_format.read_array_header_2_0}
_COPY = "copy it from the archive again"
_DAMAGED = (
    zipfile.BadZipFile, zlib.error, struct.error, EOFError, OSError, NotImplementedError, RuntimeError, ValueError,
)  # fmt: skip
"""Exceptions of zipfile for damaged archives; ValueError: a name that is not valid UTF-8."""


@dataclass(frozen=True, slots=True)
class NpyHeader:
    """Header of an array."""

    where: str
    """File, and the name of the array in an archive, for messages."""
    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    fortran: bool
    """Fortran order: the first index runs fastest, so rows are not contiguous."""
    offset: int
    """Bytes before the first number."""
    turned: bool = False
    """Whether rows and columns are exchanged: ``shape`` is that of the rows that are read."""

    @property
    def stored_shape(self) -> tuple[int, ...]:
        """Shape as the file has it."""
        return (self.shape[1], self.shape[0], *self.shape[2:]) if self.turned else self.shape

    def exchanged(self) -> NpyHeader:
        """Return the header with rows and columns exchanged."""
        return replace(self, shape=(self.shape[1], self.shape[0], *self.shape[2:]), turned=not self.turned)

    @property
    def is_scattered(self) -> bool:
        """Whether the numbers of a row lie apart in the file."""
        return self.turned or (self.fortran and len(self.shape) > 1)

    @property
    def n_bytes(self) -> int:
        """Bytes of numbers."""
        return math.prod(self.shape) * self.dtype.itemsize

    def check_numbers(self, kinds: str = "iuf", expected: str = "floats or integers") -> None:
        """Refuse arrays of anything but numbers."""
        if self.dtype.kind not in kinds:
            problem = f"found an array of {_type_name(self.dtype)}, expected {expected}"
            raise InputError(self.where, problem, "save it as numbers, for example array.astype('f4')")


class Rows:
    """Reads the rows of one array in order."""

    def __init__(self, header: NpyHeader, handle: IO[bytes]) -> None:
        self.header = header
        self._handle = handle
        self._row_bytes = math.prod(header.shape[1:]) * header.dtype.itemsize
        self._n_read = 0

    def read(self, n: int) -> NDArray[Any]:
        """Return the next ``n`` rows, (n, ...) in the array's type."""
        header = self.header
        try:
            raw = self._handle.read(n * self._row_bytes)
        except _DAMAGED as error:
            problem = f"rows {self._n_read} to {self._n_read + n - 1} cannot be read ({error})"
            raise InputError(header.where, problem, _COPY) from error
        if len(raw) < n * self._row_bytes:
            at = self._n_read + len(raw) // self._row_bytes
            problem = f"the numbers end in row {at}, expected {header.shape[0]} rows"
            raise InputError(header.where, problem, _COPY)
        self._n_read += n
        return np.frombuffer(raw, header.dtype).reshape(n, *header.shape[1:])

    def finish(self) -> None:
        """Check that nothing follows; in an archive, zipfile compares the checksum here."""
        try:
            more = self._handle.read(1)
        except _DAMAGED as error:
            raise InputError(self.header.where, f"the numbers are damaged ({error})", _COPY) from error
        if more:
            raise InputError(self.header.where, f"more bytes than {self._n_read} rows take", _COPY)


class _GatheredRows(Rows):
    """Reads rows that are not contiguous: of arrays in Fortran order, or with rows and columns exchanged."""

    def read(self, n: int) -> NDArray[Any]:
        header = self.header
        shape = header.stored_shape
        # axes from the slowest to the fastest in the file, and the one whose indices are rows
        axes = list(range(len(shape)))[:: -1 if header.fortran else 1]
        place = axes.index(1 if header.turned else 0)
        n_outer = math.prod(shape[axis] for axis in axes[:place])
        each = math.prod(shape[axis] for axis in axes[place + 1 :])
        found = np.empty((n_outer, n * each), header.dtype)
        size = header.dtype.itemsize
        try:
            for outer in range(n_outer):
                self._handle.seek(header.offset + (outer * header.shape[0] + self._n_read) * each * size)
                found[outer] = np.frombuffer(self._handle.read(n * each * size), header.dtype)
        except (OSError, ValueError) as error:
            problem = f"rows {self._n_read} to {self._n_read + n - 1} cannot be read ({error})"
            raise InputError(header.where, problem, _COPY) from error
        self._n_read += n
        sizes = [n if axis == axes[place] else shape[axis] for axis in axes]
        wanted = [1, 0, *range(2, len(shape))] if header.turned else range(len(shape))
        return found.reshape(sizes).transpose([axes.index(axis) for axis in wanted])

    def finish(self) -> None:
        """Do nothing: the size was checked when the file was opened."""


class ArrayFile:
    """The arrays of a ``.npy`` (one, without a name) or ``.npz`` file."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.is_archive = path.suffix.lower() == ".npz"
        self.headers: dict[str, NpyHeader] = {}
        """By name, in the order of the file."""
        if not self.is_archive:
            with open_to_read(path) as handle:
                size = handle.seek(0, 2)
                handle.seek(0)
                self.headers[""] = _read_header(str(path), handle, size)
            return
        with _archive(path) as archive:
            members = [info for info in archive.infolist() if info.filename.endswith(".npy")]
            if len(members) > MAX_MEMBERS:
                raise InputError(str(path), f"{len(members)} arrays, expected at most {MAX_MEMBERS}")
            for info in members:
                name = info.filename.removesuffix(".npy")
                with _member(path, archive, name) as handle:
                    self.headers[name] = _read_header(_where(path, name), handle, info.file_size)

    @contextmanager
    def open(self, *names: str) -> Iterator[list[Rows]]:
        """Open arrays to be read side by side."""
        with ExitStack() as stack:
            archive = stack.enter_context(_archive(self.path)) if self.is_archive else None
            rows = []
            for name in names:
                header = self.headers[name]
                handle: IO[bytes]
                if archive is None:
                    handle = stack.enter_context(open_to_read(self.path))
                    size = handle.seek(0, 2)
                    handle.seek(0)
                else:
                    handle = stack.enter_context(_member(self.path, archive, name))
                    size = archive.getinfo(f"{name}.npy").file_size
                found = _read_header(header.where, handle, size)
                if (found.exchanged() if header.turned else found) != header:
                    raise InputError(header.where, "the array has changed since the file was opened", "try again")
                if archive is not None and header.is_scattered:
                    handle = stack.enter_context(_unpacked(header, handle))
                rows.append((_GatheredRows if header.is_scattered else Rows)(header, handle))
            yield rows


def _where(path: Path, name: str) -> str:
    return f"{path}: {name}"


@contextmanager
def _archive(path: Path) -> Iterator[zipfile.ZipFile]:
    with open_to_read(path) as handle:
        try:
            archive = zipfile.ZipFile(handle)
        except _DAMAGED as error:
            problem = f"not a whole npz archive, which is a zip file ({error})"
            raise InputError(str(path), problem, f"{_COPY}, or write it with numpy.savez_compressed") from error
        with archive:
            yield archive


@contextmanager
def _member(path: Path, archive: zipfile.ZipFile, name: str) -> Iterator[IO[bytes]]:
    where = _where(path, name)
    info = archive.getinfo(f"{name}.npy")
    if info.flag_bits & 1 or info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        found = "encryption" if info.flag_bits & 1 else f"compression method {info.compress_type}"
        raise InputError(where, f"found {found}, expected deflate or none", "write it with numpy.savez_compressed")
    try:
        handle = archive.open(info)
    except _DAMAGED as error:
        raise InputError(where, f"the array cannot be read ({error})", _COPY) from error
    with handle:
        yield handle


@contextmanager
def _unpacked(header: NpyHeader, handle: IO[bytes]) -> Iterator[IO[bytes]]:
    """Copy an array from an archive to an unnamed temporary file, where any row can be reached."""
    with tempfile.TemporaryFile(prefix="prc-array-") as copy:
        copy.seek(header.offset)
        try:
            while data := handle.read(_COPIED_BYTES):
                copy.write(data)
        except _DAMAGED as error:
            raise InputError(header.where, f"the array cannot be unpacked ({error})", _COPY) from error
        yield copy


def _read_header(where: str, handle: IO[bytes], size: int) -> NpyHeader:
    """Read the header of an array that takes ``size`` bytes, header included."""
    try:
        version, (shape, fortran, dtype) = _parse_header(handle)
    except Exception as error:  # numpy parses the header as Python: a damaged one can raise anything
        problem = f"no npy header ({' '.join(str(error).split())[:120]})"
        raise InputError(where, problem, f"{_COPY}, or write it with numpy.save") from error
    if version not in _VERSIONS:
        problem = f"found npy format {version[0]}.{version[1]}, expected 1.0 or 2.0, plain numbers"
        raise InputError(where, problem, "save it as numbers, without named fields")
    header = NpyHeader(where, shape, dtype, fortran, handle.tell())
    if min(shape, default=0) < 0:
        raise InputError(where, f"found shape {shape}, expected no negative size", _COPY)
    # object arrays are pickles of any length: refused by their type
    if not dtype.hasobject and size - header.offset != header.n_bytes:
        problem = f"found {size - header.offset} bytes of numbers, expected {header.n_bytes} for shape {shape}"
        raise InputError(where, problem, _COPY)
    return header


def _parse_header(handle: IO[bytes]) -> tuple[tuple[int, int], tuple[tuple[int, ...], bool, np.dtype[Any]]]:
    """Return the version of the format, and shape, order and type (placeholders for unknown versions)."""
    with warnings.catch_warnings():
        # headers written by Python 2 are read all the same
        warnings.simplefilter("ignore")
        version = npy_format.read_magic(handle)
        read = _VERSIONS.get(version)
        return version, read(handle) if read is not None else ((), False, np.dtype(np.float32))


def _type_name(dtype: np.dtype[Any]) -> str:
    """Return a type in words."""
    if dtype.names is not None:
        return f"records with the fields {', '.join(dtype.names[:8])}"
    kinds = {"O": "Python objects", "c": "complex numbers", "U": "text", "S": "text", "b": "true/false values"}
    return kinds.get(dtype.kind, f"type {dtype.name}")

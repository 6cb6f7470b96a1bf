"""Arrays in ``.npy`` and ``.npz`` files, read a few rows at a time.

numpy loads an array of an ``.npz`` archive as a whole. Here memory does not grow with the file.
Pickled objects are never loaded.
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
    zipfile.BadZipFile,
    zlib.error,
    struct.error,
    EOFError,
    OSError,
    NotImplementedError,
    RuntimeError,
    ValueError,
)
"""Exceptions of zipfile for damaged archives; ValueError: a name that is not valid UTF-8."""
_KINDS = {
    "O": "Python objects",
    "c": "complex numbers",
    "U": "text",
    "S": "text",
    "b": "true/false values",
}


@dataclass(frozen=True, slots=True)
class NpyHeader:
    """Header of an array."""

    where: str
    """File, and the name of the array in an archive, for messages."""
    stored_shape: tuple[int, ...]
    """Shape in the file."""
    dtype: np.dtype[Any]
    fortran: bool
    """Whether the first index runs fastest (Fortran order), so that rows are not contiguous."""
    offset: int
    """Bytes before the first number."""
    turned: bool = False
    """Whether rows and columns are exchanged when they are read."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the array as it is read, rows first."""
        shape = self.stored_shape
        return (shape[1], shape[0], *shape[2:]) if self.turned else shape

    def check_numbers(self, expected: str = "floats or integers") -> None:
        """Refuse arrays of anything but numbers."""
        if self.dtype.kind not in "iuf":
            names = self.dtype.names
            kind = _KINDS.get(self.dtype.kind, f"type {self.dtype.name}")
            if names is not None:
                kind = f"records with the fields {', '.join(names[:8])}"
            problem = f"found an array of {kind}, expected {expected}"
            raise InputError(
                self.where, problem, "save it as numbers, for example array.astype('f4')"
            )


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
        first = self._n_read
        with _damage(header.where, f"rows {first} to {first + n - 1} cannot be read"):
            raw = self._handle.read(n * self._row_bytes)
        if len(raw) < n * self._row_bytes:
            row = first + len(raw) // self._row_bytes
            problem = f"the numbers end in row {row}, expected {header.shape[0]} rows"
            raise InputError(header.where, problem, _COPY)
        self._n_read += n
        return np.frombuffer(raw, header.dtype).reshape(n, *header.shape[1:])

    def finish(self) -> None:
        """Check that no bytes follow; in an archive, zipfile compares the checksum here."""
        with _damage(self.header.where, "the numbers are damaged"):
            next_byte = self._handle.read(1)
        if next_byte:
            raise InputError(self.header.where, f"more bytes than {self._n_read} rows take", _COPY)


class _MappedRows(Rows):
    """Reads rows that are not contiguous: Fortran order, or rows and columns exchanged."""

    def read(self, n: int) -> NDArray[Any]:
        header = self.header
        first = self._n_read
        with _damage(header.where, f"rows {first} to {first + n - 1} cannot be read"):
            # a new map every time, so that pages do not stay in memory
            stored: NDArray[Any] = np.memmap(
                self._handle,
                header.dtype,
                "r",
                header.offset,
                header.stored_shape,
                "F" if header.fortran else "C",
            )
            rows = np.ascontiguousarray(
                (stored.swapaxes(0, 1) if header.turned else stored)[first : first + n]
            )
        self._n_read += n
        return rows

    def finish(self) -> None:
        """Do nothing: the size was checked when the file was opened."""


class ArrayFile:
    """The arrays of a ``.npy`` (one, without a name) or ``.npz`` file."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.is_archive = path.suffix.lower() == ".npz"
        self.headers: dict[str, NpyHeader] = {}
        """By name, in the order of the file."""
        with self._archive() as archive:
            files = [""] if archive is None else archive.namelist()
            names = [
                file.removesuffix(".npy")
                for file in files
                if archive is None or file.endswith(".npy")
            ]
            if len(names) > MAX_MEMBERS:
                raise InputError(str(path), f"{len(names)} arrays, expected at most {MAX_MEMBERS}")
            for name in names:
                with self._member(archive, name) as (self.headers[name], _):
                    pass

    def exchange(self, shape: tuple[int, ...]) -> None:
        """Exchange rows and columns of all arrays with the shape of an image."""
        for name, header in self.headers.items():
            if header.shape[:2] == shape:
                self.headers[name] = replace(header, turned=not header.turned)

    @contextmanager
    def open(self, *names: str) -> Iterator[list[Rows]]:
        """Open arrays to be read side by side."""
        with ExitStack() as stack:
            archive = stack.enter_context(self._archive())
            rows = []
            for name in names:
                header = self.headers[name]
                stored, handle = stack.enter_context(self._member(archive, name))
                if replace(stored, turned=header.turned) != header:
                    raise InputError(
                        header.where, "the array has changed since the file was opened", "try again"
                    )
                is_scattered = header.turned or (header.fortran and len(header.shape) > 1)
                if archive is not None and is_scattered:
                    handle = stack.enter_context(_unpacked(header, handle))
                rows.append((_MappedRows if is_scattered else Rows)(header, handle))
            yield rows

    @contextmanager
    def _archive(self) -> Iterator[zipfile.ZipFile | None]:
        if not self.is_archive:
            yield None
            return
        with open_to_read(self.path) as handle:
            hint = f"{_COPY}, or write it with numpy.savez_compressed"
            with _damage(str(self.path), "not a whole npz archive, which is a zip file", hint):
                archive = zipfile.ZipFile(handle)
            with archive:
                yield archive

    @contextmanager
    def _member(
        self, archive: zipfile.ZipFile | None, name: str
    ) -> Iterator[tuple[NpyHeader, IO[bytes]]]:
        if archive is None:
            with open_to_read(self.path) as handle:
                size = handle.seek(0, 2)
                handle.seek(0)
                yield _read_header(str(self.path), handle, size), handle
            return
        where = f"{self.path}: {name}"
        info = archive.getinfo(f"{name}.npy")
        known_methods = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
        if info.flag_bits & 1 or info.compress_type not in known_methods:
            is_encrypted = info.flag_bits & 1
            method = "encryption" if is_encrypted else f"compression method {info.compress_type}"
            problem = f"found {method}, expected deflate or none"
            raise InputError(where, problem, "write it with numpy.savez_compressed")
        with _damage(where, "the array cannot be read"):
            handle = archive.open(info)
        with handle:
            yield _read_header(where, handle, info.file_size), handle


@contextmanager
def _damage(where: str, problem: str, hint: str = _COPY) -> Iterator[None]:
    try:
        yield
    except _DAMAGED as error:
        raise InputError(where, f"{problem} ({error})", hint) from error


@contextmanager
def _unpacked(header: NpyHeader, handle: IO[bytes]) -> Iterator[IO[bytes]]:
    """Copy an array of an archive to an unnamed temporary file with access to any row."""
    with tempfile.TemporaryFile(prefix="prc-array-") as copy:
        copy.seek(header.offset)
        with _damage(header.where, "the array cannot be unpacked"):
            while data := handle.read(_COPIED_BYTES):
                copy.write(data)
        copy.flush()
        yield copy


def _read_header(where: str, handle: IO[bytes], size: int) -> NpyHeader:
    """Read the header of an array of ``size`` bytes, header included."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # headers written by Python 2 are read all the same
            version = npy_format.read_magic(handle)
            read = _VERSIONS.get(version)
            shape, fortran, dtype = ((), False, np.dtype("f4")) if read is None else read(handle)
    except (
        Exception
    ) as error:  # numpy parses the header as Python: a damaged one can raise anything
        problem = f"no npy header ({' '.join(str(error).split())[:120]})"
        raise InputError(where, problem, f"{_COPY}, or write it with numpy.save") from error
    if read is None:
        problem = f"found npy format {version[0]}.{version[1]}, expected 1.0 or 2.0, plain numbers"
        raise InputError(where, problem, "save it as numbers, without named fields")
    if min(shape, default=0) < 0:
        raise InputError(where, f"found shape {shape}, expected no negative size", _COPY)
    header = NpyHeader(where, shape, dtype, fortran, handle.tell())
    n_bytes = math.prod(shape) * dtype.itemsize
    # object arrays are pickles of any length: refused by their type
    if not dtype.hasobject and size - header.offset != n_bytes:
        problem = (
            f"found {size - header.offset} bytes of numbers, expected {n_bytes} for shape {shape}"
        )
        raise InputError(where, problem, _COPY)
    return header

"""Chooses the writer of a whole stream by suffix, and checks the output before any work is done."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from prc_cli.core.errors import ConfigError
from prc_cli.core.files import check_output, suffix_of
from prc_cli.formats.writing.record import record_path
from prc_cli.formats.writing.stream_writer import StreamShape, StreamWriter

STREAM_SUFFIXES = {
    ".las": "point cloud",
    ".laz": "point cloud, compressed",
    ".csv": "table, a row a cell",
    ".csv.gz": "table, compressed",
    ".csv.zst": "table, compressed",
    ".parquet": "table, for other programs: prc reads no stream from it",
    ".npz": "range image with angles, times, coordinates, intensities and classes",
    ".npy": "range image alone",
    ".bin": "raw dump, with a configuration beside it that reads it",
    ".ply": "cloud, a point a cell, with line, column, range and class",
    ".pcd": "the same",
    ".e57": "organised scans, relative to the scanner",
}
"""Outputs that hold a stream, by suffix."""


def stream_suffix(path: Path) -> str:
    """Return the suffix, which decides the writer.

    Raises
    ------
    ConfigError
        When it is unknown.

    Examples
    --------
    >>> stream_suffix(Path("drive.CSV.gz"))
    '.csv.gz'
    >>> stream_suffix(Path("drive.xyz"))
    Traceback (most recent call last):
    ...
    prc_cli.core.errors.ConfigError: drive.xyz: found suffix '.xyz', expected one of .las .laz .csv .csv.gz .csv.zst \
.parquet .npz .npy .bin .ply .pcd .e57; choose an output name that ends in one of them
    """
    suffix = suffix_of(path)
    if suffix not in STREAM_SUFFIXES:
        problem = f"found suffix {suffix!r}, expected one of {' '.join(STREAM_SUFFIXES)}"
        raise ConfigError(str(path), problem, "choose an output name that ends in one of them")
    return suffix


def outputs_of(path: Path) -> tuple[Path, ...]:
    """Return all files of a stream output, the run record included."""
    from prc_cli.formats.raw_binary.write import config_path

    beside = (config_path(path),) if stream_suffix(path) == ".bin" else ()
    return (path, *beside, record_path(path))


def check_stream_output(path: Path, *, overwrite: bool, inputs: tuple[Path, ...] = ()) -> None:
    """Refuse an output before any work is done.

    Raises
    ------
    ConfigError
        When its suffix is unknown.
    OutputExistsError, OutputError
        As :func:`prc_cli.core.files.check_output`, for every file of the output.
    """
    for each in outputs_of(path):
        check_output(each, overwrite=overwrite, inputs=inputs)


def open_stream_writer(path: Path, shape: StreamShape, *, compress: bool = False) -> StreamWriter:
    """Choose a writer; nothing is created before its ``with`` block.

    Parameters
    ----------
    path : Path
        Output; its suffix decides the format (:data:`STREAM_SUFFIXES`).
    shape : StreamShape
        What the stream has.
    compress : bool
        Deflate the arrays of an ``.npz`` (as ``numpy.savez_compressed``).
    """
    from prc_cli.formats.arrays.write import NpyStream, NpzStream
    from prc_cli.formats.cloud_writing import CloudStream
    from prc_cli.formats.e57.write import E57Stream
    from prc_cli.formats.las.build import LasStream
    from prc_cli.formats.raw_binary.write import RawStream
    from prc_cli.formats.tables.write import CsvStream, ParquetStream

    suffix = stream_suffix(path)
    if suffix == ".npz":
        return NpzStream(path, shape, compress=compress)
    makers: dict[str, Callable[[Path, StreamShape], StreamWriter]] = {
        ".las": LasStream,
        ".laz": LasStream,
        ".csv": CsvStream,
        ".csv.gz": CsvStream,
        ".csv.zst": CsvStream,
        ".parquet": ParquetStream,
        ".npy": NpyStream,
        ".bin": RawStream,
        ".ply": CloudStream,
        ".pcd": CloudStream,
        ".e57": E57Stream,
    }
    return makers[suffix](path, shape)

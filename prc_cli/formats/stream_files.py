"""Chooses the writer of a whole stream by suffix, and checks the output before any work is done."""

from __future__ import annotations

from pathlib import Path

from prc_cli.core.errors import ConfigError
from prc_cli.core.files import check_output, suffix_of
from prc_cli.formats.registry import by_suffix
from prc_cli.formats.writing.record import record_path
from prc_cli.formats.writing.stream_writer import StreamShape, StreamWriter


def stream_suffix(path: Path) -> str:
    """Return the suffix, which decides the writer.

    >>> stream_suffix(Path("drive.CSV.gz"))
    '.csv.gz'
    >>> stream_suffix(Path("drive.xyz"))
    Traceback (most recent call last):
    ...
    prc_cli.core.errors.ConfigError: drive.xyz: found suffix '.xyz', expected one of .bin .csv .csv.gz .csv.zst .ply \
.pcd .las .laz .npy .npz .e57 .parquet; choose an output name that ends in one of them
    """
    suffix, known = suffix_of(path), by_suffix("streams")
    if suffix not in known:
        problem = f"found suffix {suffix!r}, expected one of {' '.join(known)}"
        raise ConfigError(str(path), problem, "choose an output name that ends in one of them")
    return suffix


def outputs_of(path: Path) -> tuple[Path, ...]:
    """Return all files of a stream output, the run record included."""
    from prc_cli.formats.raw_binary.write import config_path

    beside = (config_path(path),) if stream_suffix(path) == ".bin" else ()
    return (path, *beside, record_path(path))


def check_stream_output(path: Path, *, overwrite: bool, inputs: tuple[Path, ...] = ()) -> None:
    """Refuse an output before any work is done."""
    for each in outputs_of(path):
        check_output(each, overwrite=overwrite, inputs=inputs)


def open_stream_writer(path: Path, shape: StreamShape) -> StreamWriter:
    """Choose a writer by the suffix of the output; nothing is created before its ``with`` block."""
    return by_suffix("streams")[stream_suffix(path)].stream_writer(path, shape)

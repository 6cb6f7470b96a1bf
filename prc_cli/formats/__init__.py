"""File formats, one package each for reading and writing; the tables here choose the reader by suffix."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from prc_cli.core.errors import InputError
from prc_cli.core.files import suffix_of
from prc_cli.core.stream import ScanStream
from prc_cli.formats.options import RANGES_ONLY, InputConfig, Layout
from prc_cli.formats.records import RecordSource


def _raw_binary(path: Path, layout: Layout | None) -> RecordSource:
    if path.name.startswith("pulse-"):
        from prc_cli.formats.echopulse.read import EchoPulseSource, is_count_file

        if is_count_file(path):
            return EchoPulseSource(path)
    from prc_cli.formats.raw_binary.read import RawBinarySource

    return RawBinarySource(path, layout if layout is not None and layout.fields else _ranges_only(layout))


def _ranges_only(layout: Layout | None) -> Layout:
    """Return a layout of ranges alone, with the header, byte order and line length of a layout without fields."""
    return RANGES_ONLY if layout is None else layout.model_copy(update={"fields": RANGES_ONLY.fields})


def _text(path: Path, layout: Layout | None) -> RecordSource:
    from prc_cli.formats.text.read import TextSource

    return TextSource(path, layout)


def _uos(path: Path, layout: Layout | None) -> RecordSource:
    from prc_cli.formats.text.read import TextSource
    from prc_cli.formats.uos import uos_layout

    return TextSource(path, uos_layout(layout))


def _las(path: Path, layout: Layout | None) -> RecordSource:
    from prc_cli.formats.las.read import LasSource

    return LasSource(path)


def _ply(path: Path, layout: Layout | None) -> RecordSource:
    from prc_cli.formats.ply.read import open_ply

    return open_ply(path, layout)


def _pcd(path: Path, layout: Layout | None) -> RecordSource:
    from prc_cli.formats.pcd.read import open_pcd

    return open_pcd(path, layout)


READERS: dict[str, Callable[[Path, Layout | None], RecordSource]] = {
    ".bin": _raw_binary,
    ".raw": _raw_binary,
    ".dat": _raw_binary,
    ".csv": _text,
    ".csv.gz": _text,
    ".csv.zst": _text,
    ".txt": _text,
    ".txt.gz": _text,
    ".txt.zst": _text,
    ".3d": _uos,
    ".ply": _ply,
    ".pcd": _pcd,
    ".xyz": _text,
    ".asc": _text,
    ".pts": _text,
    ".las": _las,
    ".laz": _las,
}
"""Readers of record lists by suffix."""


def _array(path: Path, config: InputConfig, lines_at_once: int) -> ScanStream:
    from prc_cli.formats.arrays.read import ArrayStream

    return ArrayStream(path, config, lines_at_once=lines_at_once)


def _ptx(path: Path, config: InputConfig, lines_at_once: int) -> ScanStream:
    from prc_cli.formats.ptx import PtxStream

    return PtxStream(path, config)


def _e57(path: Path, config: InputConfig, lines_at_once: int) -> ScanStream:
    from prc_cli.formats.e57.read import E57Stream

    return E57Stream(path, config)


def _bag(path: Path, config: InputConfig, lines_at_once: int) -> ScanStream:
    from prc_cli.formats.bags.read import BagStream

    return BagStream(path, config)


def _packets(path: Path, config: InputConfig, lines_at_once: int) -> ScanStream:
    from prc_cli.formats.packets.read import PacketStream

    return PacketStream(path, config)


IMAGE_READERS: dict[str, Callable[[Path, InputConfig, int], ScanStream]] = {
    ".npy": _array,
    ".npz": _array,
    ".ptx": _ptx,
    ".e57": _e57,
    **dict.fromkeys((".bag", ".db3", ".mcap"), _bag),
    **dict.fromkeys((".pcap", ".pcapng"), _packets),
}
"""Readers of range images and organised scans by suffix; these files hold lines and columns."""

LAS_SUFFIXES = (".las", ".laz")


_BAG_PARTS = (".db3", ".mcap")
"""Files of a ROS 2 bag, which is a folder."""


def check_input(path: Path) -> str:
    """Return the suffix of a readable input file.

    Raises
    ------
    InputError
        When it is absent, not a file, empty, or has an unknown suffix.
    """
    known = (*READERS, *IMAGE_READERS)
    suffix = suffix_of(path)
    if path.is_dir():
        raise InputError(str(path), "is a folder, expected a file", _file_of_folder(path, known))
    if path.exists() and not path.is_file():
        problem = "not a regular file, expected an archive file (it is read more than once)"
        raise InputError(str(path), problem, "write the stream to a file first")
    if suffix not in known:
        found = f"unknown suffix {suffix!r}" if suffix else "no suffix"
        raise InputError(str(path), f"{found}, expected one of: {' '.join(known)}", _not_a_scan(path))
    if not path.exists():
        raise InputError(str(path), "no such file", "check the name and that the disk is mounted")
    try:
        with path.open("rb") as handle:
            empty = not handle.read(1)
    except OSError as error:
        raise InputError(str(path), f"cannot be read ({error.strerror})", "check its permissions") from error
    if empty:
        raise InputError(str(path), "the file is empty (0 bytes), expected scan data", "copy it from the archive again")
    return suffix


def _file_of_folder(path: Path, known: tuple[str, ...]) -> str:
    """Return which file of a folder to name."""
    from prc_cli.formats.echopulse.read import count_file

    counts = count_file(path)
    if counts is not None:
        return f"name the file that counts its returns: {counts}"
    bags = _files_with(path, _BAG_PARTS)
    if bags and (path / "metadata.yaml").is_file():
        more = f", or {bags[1]}" if len(bags) == 2 else f", or another of its {len(bags)} parts"
        return f"name the file in this bag: {bags[0]}{more if len(bags) > 1 else ''}"
    scans = _files_with(path, known)
    if not scans:
        return "name a file; this folder itself has no scan"
    return f"name a file in it, for example {scans[0]}"


def _files_with(folder: Path, suffixes: tuple[str, ...]) -> list[Path]:
    """Return the files of a folder with such suffixes, by name; none where it cannot be read."""
    try:
        return [each for each in sorted(folder.iterdir()) if suffix_of(each) in suffixes and each.is_file()]
    except OSError:
        return []


def _not_a_scan(path: Path) -> str:
    """Return what to do with a file of an unknown suffix: its scan may lie beside it."""
    if path.name == "metadata.yaml" and path.is_file():
        bags = _files_with(path.parent, _BAG_PARTS)
        if bags:
            return f"this describes a bag: name the file beside it, {bags[0]}"
    if path.suffix.lower() == ".json":
        captures = [path.with_suffix(suffix) for suffix in (".pcap", ".pcapng") if path.with_suffix(suffix).is_file()]
        if captures:
            return f"this describes a scanner: name the capture beside it, {captures[0]}"
    return "rename the file or convert it"


def open_source(path: Path, layout: Layout | None = None) -> RecordSource | None:
    """Open an input as a list of records; None for range images and organised scans."""
    suffix = check_input(path)
    return READERS[suffix](path, layout) if suffix in READERS else None


def open_images(path: Path, config: InputConfig, *, lines_at_once: int = 1) -> ScanStream:
    """Open a range image or organised scans, for which :func:`open_source` returns None.

    Parameters
    ----------
    path : Path
        Range image or organised scans.
    config : InputConfig
        How the file is read.
    lines_at_once : int
        Preferred number of lines per read: a multiple of it.
    """
    return IMAGE_READERS[suffix_of(path)](path, config, lines_at_once)


__all__ = [
    "IMAGE_READERS",
    "LAS_SUFFIXES",
    "READERS",
    "check_input",
    "open_images",
    "open_source",
]

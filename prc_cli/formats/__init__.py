"""File formats, one room each for reading and writing.

:mod:`prc_cli.formats.registry` finds the one of a file.
"""

from __future__ import annotations

from pathlib import Path

from prc_cli.core.errors import InputError
from prc_cli.core.files import suffix_of
from prc_cli.core.stream import ScanStream
from prc_cli.formats.bags import METADATA, parts_of
from prc_cli.formats.foreign import hint_of
from prc_cli.formats.las import SUFFIXES as LAS_SUFFIXES
from prc_cli.formats.options import InputConfig, Layout
from prc_cli.formats.records import Source
from prc_cli.formats.registry import by_suffix

_BAG_PARTS = (".db3", ".mcap")
"""Files of a ROS 2 bag, which is a folder."""


def scan_file(path: Path) -> Path:
    """Return the file to read in a folder, such as a bag's metadata; else the folder itself."""
    if not path.is_dir():
        return path
    from prc_cli.formats.echopulse import count_file

    scan = count_file(path)
    parts = parts_of(path / METADATA)
    bags = _files_with(path, _BAG_PARTS)
    if scan is None and len(parts) > 1 and set(parts) <= set(bags):  # some may be missing here
        scan = path / METADATA
    elif scan is None and len(parts) == len(bags) == 1 and (path / METADATA).is_file():
        scan = bags[0]
    return path if scan is None else scan


def check_input(path: Path) -> str:
    """Return the suffix of an input.

    Raises
    ------
    InputError
        If the input is absent, not a file, empty, or has an unknown suffix.
    """
    known = tuple(by_suffix("scans"))
    suffix = suffix_of(path)
    if len(parts := parts_of(path)) > 1:
        for part in parts:
            suffix = check_input(part)
        return suffix
    if path.is_dir():
        raise InputError(str(path), "is a folder, expected a file", _file_of_folder(path, known))
    if path.exists() and not path.is_file():
        problem = "not a regular file, expected an archive file (it is read more than once)"
        raise InputError(str(path), problem, "write the stream to a file first")
    if suffix not in known:
        what_suffix = f"unknown suffix {suffix!r}" if suffix else "no suffix"
        raise InputError(
            str(path), f"{what_suffix}, expected one of: {' '.join(known)}", _not_a_scan(path)
        )
    if not path.exists():
        raise InputError(str(path), "no such file", "check the name and that the disk is mounted")
    try:
        with path.open("rb") as handle:
            empty = not handle.read(1)
    except OSError as error:
        raise InputError(
            str(path), f"cannot be read ({error.strerror})", "check its permissions"
        ) from error
    if _is_hollow(path):
        problem = f"the disk stores almost none of its {path.stat().st_size:,} bytes"
        raise InputError(
            str(path), problem, "the copy did not finish: copy it from the archive again"
        )
    if empty:
        raise InputError(
            str(path),
            "the file is empty (0 bytes), expected scan data",
            "copy it from the archive again",
        )
    return suffix


HOLLOW_BYTES = 1 << 32
HOLLOW_RATIO = 256
"""Files of ``HOLLOW_BYTES`` are hollow if the disk stores less than 1 / ``HOLLOW_RATIO``."""


def _is_hollow(path: Path) -> bool:
    status = path.stat()
    n_blocks = getattr(status, "st_blocks", None)  # of 512 bytes; Windows does not say
    large = status.st_size >= HOLLOW_BYTES
    return n_blocks is not None and large and n_blocks * 512 * HOLLOW_RATIO < status.st_size


def _file_of_folder(path: Path, known: tuple[str, ...]) -> str:
    if (scan := scan_file(path)) != path:
        return f"name the file in it: {scan}"
    bags = _files_with(path, _BAG_PARTS)
    if bags and (path / METADATA).is_file():
        others = f", or {bags[1]}" if len(bags) == 2 else ", or another of its parts"
        return f"name the file in this bag: {bags[0]}{others}"
    scans = _files_with(path, known)
    return (
        f"name a file in it, for example {scans[0]}"
        if scans
        else "name a file; this folder itself has no scan"
    )


def _files_with(folder: Path, suffixes: tuple[str, ...]) -> list[Path]:
    try:
        files = sorted(path for path in folder.iterdir() if suffix_of(path) in suffixes)
        return [path for path in files if path.is_file()]
    except OSError:
        return []


def _not_a_scan(path: Path) -> str:
    """Return a hint for a file of an unknown suffix: the scan may be a file beside it."""
    if path.name == METADATA and path.is_file():
        bags = _files_with(path.parent, _BAG_PARTS)
        if bags:
            return f"this describes a bag: name the file beside it, {bags[0]}"
    if path.suffix.lower() == ".json":
        for suffix in (".pcap", ".pcapng"):
            capture = path.with_suffix(suffix)
            if capture.is_file():
                return f"this describes a scanner: name the capture beside it, {capture}"
    return hint_of(path) or "rename the file or convert it"


def open_source(path: Path, layout: Layout | None = None) -> Source | None:
    """Open an input as a list of records; None for range images and organised scans."""
    form = by_suffix("scans")[check_input(path)]
    return form.open_records(path, layout) if form.records else None


def open_images(path: Path, config: InputConfig, *, lines_at_once: int = 1) -> ScanStream:
    """Open a range image or organised scans, for which :func:`open_source` returns None.

    Blocks have ``lines_at_once`` lines, or a multiple.
    """
    return by_suffix("scans")[suffix_of(parts_of(path)[0])].open_images(path, config, lines_at_once)


__all__ = ["LAS_SUFFIXES", "check_input", "open_images", "open_source", "scan_file"]

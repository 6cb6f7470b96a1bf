"""An input: which file it is, its format, its layout, and whether it can be read.

:meth:`Input.of` answers all of it once. Everything below takes an :class:`Input`, not a name.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from prc_cli.core.errors import InputError
from prc_cli.core.files import suffix_of
from prc_cli.core.stream import ScanStream
from prc_cli.formats.bags import METADATA, parts_of
from prc_cli.formats.foreign import hint_of
from prc_cli.formats.las import SUFFIXES as LAS_SUFFIXES
from prc_cli.formats.options import InputConfig, Layout
from prc_cli.formats.records import Source
from prc_cli.formats.registry import Format, by_suffix, format_of, is_bag

HOLLOW_BYTES = 1 << 32
HOLLOW_RATIO = 256
"""Files of ``HOLLOW_BYTES`` are hollow if the disk stores less than 1 / ``HOLLOW_RATIO``."""
_BAG_PARTS = (".db3", ".mcap")
"""Files of a ROS 2 bag, which is a folder."""


@dataclass(frozen=True, slots=True)
class Input:
    """An input, resolved once.

    Nothing is refused before :meth:`check`, so that a command can refuse its output first.

    >>> scan = Input.of("drive.CSV.gz")
    >>> scan.suffix, scan.format.name, scan.refusal.problem
    ('.csv.gz', 'text', 'no such file')
    """

    path: Path
    """The file; for a folder that is a recording, the file in it that is read."""
    parts: tuple[Path, ...]
    """Files of a recording that its metadata names; else ``path`` alone."""
    suffix: str
    """Suffix that decides the format, in lower case, compression included."""
    format: Format | None
    """None if no format has the suffix."""
    layout: Layout | None = None
    """Layout of the records; None if the file describes them itself, or if it is not known."""
    refusal: InputError | None = None
    """Why the input cannot be read: it is absent, no file, hollow, empty, or of no format."""

    @classmethod
    def of(cls, path: Path | str, layout: Layout | None = None) -> Input:
        """Resolve a name."""
        path = scan_file(Path(path))
        parts = tuple(parts_of(path))
        suffix = suffix_of(parts[-1])
        refusals = (_refusal(part) for part in parts)
        refusal = next((refusal for refusal in refusals if refusal is not None), None)
        return cls(path, parts, suffix, by_suffix("scans").get(suffix), layout, refusal)

    def __str__(self) -> str:
        """Return the name of the file, for messages."""
        return str(self.path)

    @property
    def name(self) -> str:
        """Name of the file, without its folder."""
        return self.path.name

    @property
    def is_las(self) -> bool:
        """Whether it is LAS or LAZ."""
        return self.suffix in LAS_SUFFIXES

    @property
    def has_layout(self) -> bool:
        """Whether a layout describes its records."""
        return self.format is not None and self.format.has_layout

    @property
    def is_dump(self) -> bool:
        """Whether nothing but a layout describes its bytes."""
        return self.format is not None and self.format.is_dump

    @property
    def is_bag(self) -> bool:
        """Whether it is a bag in one file."""
        return is_bag(self.path)

    def keeps_points(self, output: Path) -> bool:
        """Whether a classified output contains the points of this input."""
        output_form = format_of(output, "labels")
        return (
            self.format is not None
            and output_form is not None
            and self.format.keeps_points
            and self.suffix in self.format.labels
            and self.format.write_labels == output_form.write_labels
        )

    def check(self) -> None:
        """Raise :class:`InputError` if the input cannot be read."""
        if self.refusal is not None:
            raise self.refusal

    def records(self) -> Source | None:
        """Open the input as a list of records; None for range images and organised scans."""
        form = self.readable_format()
        return form.open_records(self.path, self.layout) if form.records else None

    def images(self, config: InputConfig, *, lines_at_once: int = 1) -> ScanStream:
        """Open a range image or organised scans, for which :meth:`records` returns None.

        Blocks have ``lines_at_once`` lines, or a multiple.
        """
        return self.readable_format().open_images(self.path, config, lines_at_once)

    def readable_format(self) -> Format:
        """Return the format; raise :class:`InputError` if the input cannot be read."""
        self.check()
        assert self.format is not None
        return self.format


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


def _refusal(path: Path) -> InputError | None:
    """Return why a file cannot be read as a scan; None if it can."""
    known = tuple(by_suffix("scans"))
    suffix = suffix_of(path)
    if path.is_dir():
        return InputError(str(path), "is a folder, expected a file", _file_of_folder(path, known))
    if path.exists() and not path.is_file():
        problem = "not a regular file, expected an archive file (it is read more than once)"
        return InputError(str(path), problem, "write the stream to a file first")
    if suffix not in known:
        what_suffix = f"unknown suffix {suffix!r}" if suffix else "no suffix"
        problem = f"{what_suffix}, expected one of: {' '.join(known)}"
        return InputError(str(path), problem, _not_a_scan(path))
    if not path.exists():
        return InputError(str(path), "no such file", "check the name and that the disk is mounted")
    try:
        with path.open("rb") as handle:
            is_empty = not handle.read(1)
    except OSError as error:
        problem = f"cannot be read ({error.strerror})"
        return InputError(str(path), problem, "check its permissions")
    if _is_hollow(path):
        problem = f"the disk stores almost none of its {path.stat().st_size:,} bytes"
        hint = "the copy did not finish: copy it from the archive again"
        return InputError(str(path), problem, hint)
    if is_empty:
        problem = "the file is empty (0 bytes), expected scan data"
        return InputError(str(path), problem, "copy it from the archive again")
    return None


def _is_hollow(path: Path) -> bool:
    status = path.stat()
    n_blocks = getattr(status, "st_blocks", None)  # of 512 bytes; Windows does not say
    large = status.st_size >= HOLLOW_BYTES
    return n_blocks is not None and large and n_blocks * 512 * HOLLOW_RATIO < status.st_size


def _file_of_folder(path: Path, known: tuple[str, ...]) -> str:
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

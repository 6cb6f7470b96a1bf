"""Finds the inputs of an archive and the places of their outputs.

Names are paths relative to the archive with POSIX slashes, in the order of their bytes, the same on
every machine. Only folders are opened.
"""

from __future__ import annotations

import fnmatch
import os
import queue
import re
import stat
import threading
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path, PurePosixPath
from typing import TypeVar

from prc_cli.core.errors import ConfigError, InputError
from prc_cli.core.files import suffix_of
from prc_cli.formats import LAS_SUFFIXES
from prc_cli.formats.registry import by_suffix
from prc_cli.jobs.batch.types import OWN_FOLDER, BatchSettings
from prc_cli.jobs.drive import LABELS, output_name

PATIENCE_S = 60.0
"""Time limit for one answer of the file system [s]."""
_UNITS = {"s": 1, "min": 60, "h": 3600, "d": 86400, "w": 7 * 86400}


@dataclass(frozen=True, slots=True)
class InputFile:
    """An input."""

    name: str
    path: Path
    size: int
    """Size [bytes]."""
    mtime_ns: int
    """Time of the last change [ns since 1970]."""
    drive: str = ""
    """Name of the drive, see :class:`Drives`; of a single file, its name."""


@dataclass(frozen=True, slots=True)
class LeftOut:
    """A file or folder of the archive that prc does not read, although the user might expect it."""

    name: str
    reason: str


@dataclass(frozen=True, slots=True)
class Discovery:
    """Contents of an archive."""

    files: tuple[InputFile, ...]
    """Inputs of this run, sorted by the bytes of their names.

    Files of one drive are together, in the order of their numbers.
    """
    left_out: tuple[LeftOut, ...]
    """Files and folders that look like inputs but are not read."""
    n_not_selected: int
    """Inputs excluded from this run by patterns, times or the shard."""
    older: frozenset[str] = frozenset()
    """Names of the inputs that only ``--since`` excludes; they belong to the archive."""


def discover(settings: BatchSettings, *, patience_s: float = PATIENCE_S) -> Discovery:
    """List the inputs of an archive."""
    files: list[InputFile] = []
    numbers: dict[str, tuple[str | int, ...]] = {}
    left_out: list[LeftOut] = []
    n_not_selected = 0
    newest: Counter[str] = Counter()
    since_ns = -1 if settings.since is None else parse_since(settings.since)
    include = Patterns(settings.include)
    exclude = Patterns(settings.exclude)
    drives = Drives(settings.drives)
    # calls that may hang are made in a thread
    for item in _in_time(_walk(settings, exclude), settings.archive, patience_s):
        if isinstance(item, LeftOut):
            left_out.append(item)
            continue
        selected = (not include or include.match(item.name)) and not exclude.match(item.name)
        drive, numbers[item.name] = drives.of(item.name)
        if not selected or (settings.shard is not None and not settings.shard.holds(drive)):
            n_not_selected += 1
        else:
            files.append(replace(item, drive=drive))
            newest[drive] = max(newest[drive], item.mtime_ns)
    # a drive with a new file is new
    older = frozenset(item.name for item in files if newest[item.drive] < since_ns)
    files = [item for item in files if item.name not in older]

    def place(item: InputFile) -> tuple[bytes, tuple[str | int, ...], bytes]:
        return os.fsencode(item.drive), numbers[item.name], os.fsencode(item.name)

    files.sort(key=place)
    left_out.sort(key=lambda item: os.fsencode(item.name))
    return Discovery(tuple(files), tuple(left_out), n_not_selected + len(older), older)


def check(settings: BatchSettings, *, patience_s: float = PATIENCE_S) -> None:
    """Check the settings before anything is written; raises as :func:`discover`."""
    Patterns((*settings.include, *settings.exclude))
    Drives(settings.drives)
    output_name("a.laz", settings.to)
    if settings.since is not None:
        parse_since(settings.since)
    for _ in _in_time(map(_folders, [settings]), settings.archive, patience_s):
        pass


def _folders(settings: BatchSettings) -> tuple[Path, Path]:
    # archive and output folder, without links
    try:
        archive = settings.archive.resolve(strict=True)
        out = settings.out.resolve()
    except (OSError, RuntimeError) as error:
        problem = f"cannot be opened ({getattr(error, 'strerror', None) or error})"
        raise InputError(
            str(settings.archive), problem, "check the name and that the disk is mounted"
        ) from error
    if not archive.is_dir():
        problem = "is no folder, expected a tree of inputs"
        raise ConfigError(str(settings.archive), problem, "prc classify takes a single file")
    if archive == out or archive.is_relative_to(out):
        problem = "the archive is the output folder or lies in it; inputs are never modified"
        raise ConfigError(str(settings.out), problem, "choose another output folder")
    if out.exists() and not out.is_dir():
        raise ConfigError(
            str(settings.out), "is no folder, expected one for the outputs", "choose another"
        )
    return archive, out


# -- walking ---------------------------------------------------------------------------------------

_ItemT = TypeVar("_ItemT")


def _walk(settings: BatchSettings, exclude: Patterns) -> Iterator[InputFile | LeftOut]:
    # no recursion: a hostile tree may be thousands of folders deep
    archive, out = _folders(settings)
    waiting: list[tuple[str, Path]] = [("", archive)]
    while waiting:
        prefix, folder = waiting.pop()
        try:
            with os.scandir(folder) as listing:
                entries = sorted(listing, key=lambda entry: os.fsencode(entry.name))
        except OSError as error:
            if not prefix:
                problem = f"cannot be listed ({error.strerror or error})"
                raise InputError(
                    str(archive), problem, "check its permissions and that the disk is mounted"
                ) from error
            yield LeftOut(prefix, f"folder cannot be listed ({error.strerror or error})")
            continue
        if prefix and any(entry.name == OWN_FOLDER for entry in entries):
            yield LeftOut(prefix, "the output folder of another batch run")
            continue
        for entry in entries:
            if entry.name.startswith("."):
                continue
            content = _look(entry, f"{prefix}{entry.name}", archive)
            if not isinstance(content, str):
                if content is not None:
                    yield content
            elif Path(entry.path) != out and not exclude.match(content.removesuffix("/")):
                waiting.append((content, Path(entry.path)))


def _look(entry: os.DirEntry[str], name: str, archive: Path) -> InputFile | LeftOut | str | None:
    """Return an input, or why it is left out, or the name of a folder and "/"; else None."""
    try:
        is_link = entry.is_symlink()
        if entry.is_dir(follow_symlinks=False):
            return f"{name}/"
        readable = suffix_of(Path(entry.name)) in by_suffix("scans")
        if is_link:
            reason = _why_not_followed(entry, archive, readable=readable)
            if reason is not None:
                return LeftOut(name, reason)
        if not readable:
            return None
        status = entry.stat()
    except OSError as error:
        return LeftOut(name, f"cannot be looked at ({error.strerror or error})")
    if not stat.S_ISREG(status.st_mode):
        return LeftOut(name, "not a regular file")
    inside = PurePosixPath(entry.name)
    # LAS files are never label files
    if inside.stem.endswith(LABELS) and inside.suffix.lower() not in LAS_SUFFIXES:
        return LeftOut(name, "labels that this program wrote")
    return InputFile(name, Path(entry.path), status.st_size, status.st_mtime_ns)


def _why_not_followed(entry: os.DirEntry[str], archive: Path, *, readable: bool) -> str | None:
    # None for a link to a readable file of the archive
    try:
        target = Path(entry.path).resolve(strict=True)
    except (OSError, RuntimeError):
        return "a symbolic link to nothing"
    if not target.is_relative_to(archive):
        return "a symbolic link that leads out of the archive"
    if target.is_dir():
        return "a symbolic link to a folder of the archive, whose files have their own names"
    return None if readable else "a symbolic link"


def _in_time(items: Iterable[_ItemT], archive: Path, patience_s: float) -> Iterator[_ItemT]:
    """Run an iterator in a daemon thread, which may hang in a system call; raise on a timeout."""
    answers: queue.SimpleQueue[tuple[_ItemT] | BaseException | None] = queue.SimpleQueue()

    def run() -> None:
        try:
            for item in items:
                answers.put((item,))
        except BaseException as error:  # raised again by the consumer
            answers.put(error)
        else:
            answers.put(None)

    threading.Thread(target=run, name="discovery", daemon=True).start()
    while True:
        try:
            answer = answers.get(timeout=patience_s)
        except queue.Empty:
            problem = f"the file system has not answered for {patience_s:g} s"
            raise InputError(
                str(archive), problem, "check that the disk or share is mounted and reachable"
            ) from None
        if answer is None:
            return
        if isinstance(answer, BaseException):
            raise answer
        yield answer[0]


# -- patterns and times ----------------------------------------------------------------------------


class Patterns:
    """Glob patterns of names; a pattern without a slash is for the last part of a name.

    >>> Patterns(["*.laz"]).match("2026/a/b.laz"), Patterns(["2026/*.laz"]).match("2026/a/b.laz")
    (True, False)
    >>> Patterns(["**/night/*"]).match("night/b.laz"), bool(Patterns([]))
    (True, False)
    """

    def __init__(self, patterns: Iterable[str]) -> None:
        self._patterns: list[tuple[bool, list[re.Pattern[str] | None]]] = []
        for pattern in patterns:
            text = pattern.replace(os.sep, "/").removeprefix("./").rstrip("/")
            if not text or "\0" in text:
                raise ConfigError(
                    "pattern", f"found {pattern!r}, expected a glob such as *.laz or night/**/*.laz"
                )
            # by names between slashes, so that no star matches a slash
            compiled = [
                None if name == "**" else re.compile(fnmatch.translate(name))
                for name in text.removeprefix("/").split("/")
            ]
            self._patterns.append(("/" in text, compiled))

    def __bool__(self) -> bool:
        return bool(self._patterns)

    def match(self, name: str) -> bool:
        """Check whether a pattern matches a name."""
        names = name.split("/")
        return any(
            _match(names if has_slash else names[-1:], pattern)
            for has_slash, pattern in self._patterns
        )


class Drives:
    """Patterns of the files of drives.

    The last wildcards are the number. The files of one drive are equal in all other characters.
    """

    def __init__(self, patterns: Iterable[str]) -> None:
        self._patterns: list[tuple[Patterns, str, str, str]] = []
        for text in patterns:
            match = re.fullmatch(
                r"(.*?)((?:[*?]|\[[^]]+\])+)([^]*?[]*)",
                text.replace(os.sep, "/").rpartition("/")[2],
            )
            if match is None or match[2] == "**":
                problem = (
                    f"found {text!r}, "
                    "expected a wildcard in the file name for the number of the part"
                )
                raise ConfigError("--drive", problem, "for example 'drive_*_??.laz'")
            self._patterns.append((Patterns([text]), match[1], match[2], match[3]))

    def of(self, name: str) -> tuple[str, tuple[str | int, ...]]:
        """Return the drive of a file and its number: words, with digits as int.

        Of a single file: its name and ().
        """
        folder, slash, last = name.rpartition("/")
        for pattern, before, wildcards, after in self._patterns:
            if not pattern.match(name):
                continue
            middle = last.removesuffix(after)
            # the number is as short as possible
            for i in range(len(middle), -1, -1):
                is_split = fnmatch.fnmatchcase(middle[:i], before)
                if is_split and fnmatch.fnmatchcase(middle[i:], wildcards):
                    words = re.split(r"([0-9]+)", middle[i:])
                    number = tuple(int(word) if k % 2 else word for k, word in enumerate(words))
                    return f"{folder}{slash}{middle[:i]}{wildcards}{after}", number
        return name, ()


def _match(names: Sequence[str], pattern: Sequence[re.Pattern[str] | None]) -> bool:
    """Match all of a path, by its names; None (``**``) = any number, at the end one or more."""
    # how many names the beginning of the pattern may match
    matched = {0}
    for i, name_pattern in enumerate(pattern):
        if name_pattern is None:
            is_last = i == len(pattern) - 1
            matched = set(range(min(matched) + is_last, len(names) + 1))
        else:
            matched = {n + 1 for n in matched if n < len(names) and name_pattern.match(names[n])}
        if not matched:
            return False
    return len(names) in matched


def parse_since(text: str, now: Callable[[], datetime] = lambda: datetime.now(UTC)) -> int:
    """Return the time of ``--since`` [ns since 1970].

    >>> parse_since("1970-01-02T00:00:00+00:00") // 10**9
    86400
    """
    duration = re.fullmatch(r"([0-9]{1,9})\s*(s|min|h|d|w)", text.strip())
    if duration is not None:
        try:
            return _nanoseconds(now() - timedelta(seconds=int(duration[1]) * _UNITS[duration[2]]))
        except OverflowError:
            return 0
    try:
        return _nanoseconds(datetime.fromisoformat(text.strip()).astimezone())
    except (ValueError, OverflowError, OSError):
        pass
    try:
        if not text.strip():
            raise ValueError
        return Path(text).stat().st_mtime_ns
    except (OSError, ValueError):
        problem = f"found {text!r}, expected a duration (7d), a date (2026-01-31) or a file"
        raise ConfigError("--since", problem, "durations end in s, min, h, d or w") from None


def _nanoseconds(time: datetime) -> int:
    return round(time.timestamp() * 10**6) * 1000

"""Folders of frames, a file for every turn of a spinning scanner, as odometry reads them."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TypeVar

from prc_cli.core.errors import ConfigError, InputError, OutputExistsError
from prc_cli.core.files import name_folder, output_errors, remove_stale, suffix_of, temporary_name
from prc_cli.formats.input import Input
from prc_cli.formats.registry import by_suffix
from prc_cli.formats.writing.record import record_path
from prc_cli.matching.pairs import files_of, stem_of

Summary = TypeVar("Summary")


def frames_of(folder: Path) -> list[Path]:
    """Return the frames of a folder, in the order of the numbers in their names."""
    known = by_suffix("streams").keys() & by_suffix("scans").keys()
    try:
        frames = [
            path
            for path in folder.iterdir()
            if suffix_of(path) in known and not path.name.startswith(".")
        ]
    except OSError as error:
        raise InputError(
            str(folder), f"cannot be read ({error.strerror})", "check its permissions"
        ) from error
    kinds = sorted({suffix_of(path) for path in frames})
    if len(kinds) == 1:
        return sorted(
            frames,
            key=lambda path: ([int(number) for number in re.findall(r"\d+", path.name)], path.name),
        )
    inside = folder / "velodyne"
    hint = f"give {inside}" if inside.is_dir() else "name a folder that contains only frames"
    raise InputError(
        str(folder), f"found {', '.join(kinds) or 'no frames'}, expected frames of one kind", hint
    )


def labels_of(folder: Path, frames: list[Path]) -> dict[Path, Path]:
    """Return the file of class codes of every frame.

    It has the name of the frame, with another suffix or with one more.
    """
    if not folder.is_dir():
        problem = "found a file, expected a folder" if folder.exists() else "no such folder"
        raise InputError(
            str(folder), f"{problem} with the class codes of every frame", "check the name"
        )
    by_name: dict[str, Path] = {}
    for path in files_of([folder]):
        by_name.setdefault(stem_of(path).removesuffix(".labels"), path)
    label_files = {
        frame: by_name.get(frame.name, by_name.get(frame.name[: -len(suffix_of(frame))]))
        for frame in frames
    }
    if missing := [frame.name for frame, labels in label_files.items() if labels is None]:
        shown = ", ".join(missing[:4]) + (", ..." if len(missing) > 4 else "")
        problem = f"no class codes of {len(missing)} of {len(frames)} frames: {shown}"
        raise InputError(str(folder), problem, "give a file of the name of every frame")
    return {frame: labels for frame, labels in label_files.items() if labels is not None}


@contextmanager
def thin_frames(
    frames: list[Path],
    output: Path,
    thin_one: Callable[[Path, Path], Summary],
    *,
    every_frame: bool,
) -> Iterator[list[Summary]]:
    """Thin frames into a folder, and yield their summaries before it gets its name.

    An empty dump stays empty. With ``every_frame`` the frames are numbered from 000000.
    """
    for path in (output, record_path(output)):
        if path.exists() or path.is_symlink():
            raise OutputExistsError(
                str(path), "exists already", "frames go to a new folder: choose another name"
            )
    if not output.absolute().parent.is_dir():
        raise ConfigError(str(output), "the folder above it is not there", "make it first")
    remove_stale(output)
    temporary = temporary_name(output)
    summaries: list[Summary] = []
    try:
        with output_errors(output):
            temporary.mkdir()
        for number, frame in enumerate(frames):
            thinned = temporary / (f"{number:06d}{suffix_of(frame)}" if every_frame else frame.name)
            if not frame.stat().st_size and Input.of(frame).is_dump:
                thinned.touch()
                continue
            summaries.append(thin_one(frame, thinned))
            for extra_file in temporary.glob(f"{thinned.name}.*"):
                extra_file.unlink()
        yield summaries
        name_folder(temporary, output)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)

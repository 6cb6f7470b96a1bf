"""Pairs of predicted and reference files when folders are compared."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

from prc_cli.core.errors import InputError
from prc_cli.formats.labels import code_suffix_of

_SHOWN = 4


def pair_files(
    predicted: Path, reference: Path, *, allow_missing: bool = False
) -> tuple[tuple[Path, Path], ...]:
    """Pair two files, or the files of two folders by name.

    Files of folders count if their suffix is that of class codes.
    """
    if not (predicted.is_dir() or reference.is_dir()):
        return ((predicted, reference),)
    for side, folder in ((predicted, reference), (reference, predicted)):
        if not side.is_dir():
            problem = f"a file against the folder {folder}" if side.exists() else "no such folder"
            raise InputError(
                str(side),
                problem,
                "give two files or two folders, or match by time, dimension or nearest",
            )
    left = _by_name(predicted)
    right = _by_name(reference)
    if allow_missing and left.keys() & right.keys():
        return tuple((left[name], right[name]) for name in sorted(left.keys() & right.keys()))
    for folder, other_folder, unpaired in (
        (predicted, reference, left.keys() - right.keys()),
        (reference, predicted, right.keys() - left.keys()),
    ):
        if unpaired:
            have = "file has" if len(unpaired) == 1 else "files have"
            problem = f"{len(unpaired)} {have} no partner in {other_folder}: {_listed(unpaired)}"
            raise InputError(
                str(folder),
                problem,
                "give partners the same name but for the suffix",
            )
    return tuple((left[name], right[name]) for name in sorted(left))


def files_of(paths: Iterable[Path]) -> list[Path]:
    """Return files as they are, and in place of a folder those in it that can hold class codes."""
    files: list[Path] = []
    for path in paths:
        inside = list(_label_files(path)) if path.is_dir() else [path]
        if not inside:
            raise InputError(
                str(path), "no files with class codes in it", "check the name of the folder"
            )
        files += inside
    return files


def stem_of(path: Path) -> str:
    """Return the name without the suffix, compression included.

    >>> stem_of(Path("drive_1.csv.gz"))
    'drive_1'
    """
    return path.name[: len(path.name) - len(code_suffix_of(path))]


def _by_name(folder: Path) -> dict[str, Path]:
    by_name: dict[str, Path] = {}
    for path in _label_files(folder):
        name = stem_of(path)
        if name in by_name:
            problem = (
                f"{by_name[name].name} and {path.name} have one name, "
                "expected one file of class codes each"
            )
            raise InputError(str(folder), problem, "move one of them away")
        by_name[name] = path
    if not by_name:
        raise InputError(
            str(folder), "no files with class codes in it", "check the name of the folder"
        )
    return by_name


def _label_files(folder: Path) -> Iterator[Path]:
    try:
        paths = sorted(folder.iterdir())
    except OSError as error:
        problem = f"cannot be read ({error.strerror or error})"
        raise InputError(str(folder), problem, "check the name and its permissions") from error
    return (
        path
        for path in paths
        if path.is_file() and code_suffix_of(path) and not path.name.startswith(".")
    )


def _listed(names: Iterable[str]) -> str:
    known = sorted(names)
    return ", ".join(known[:_SHOWN]) + (", ..." if len(known) > _SHOWN else "")

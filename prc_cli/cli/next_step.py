"""Commands to type next, with the options of the last command."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Any

from prc_cli.cli.options import PICTURE_FLAGS, given_words
from prc_cli.core.files import suffix_of
from prc_cli.formats import Input, scan_file
from prc_cli.formats.labels import KITTI_SUFFIX
from prc_cli.formats.registry import is_cloud


def typed(path: Path | str) -> str:
    """Return a file name to type: without ``./`` a name that starts with a dash is an option.

    >>> typed(Path("-dash.npz")), typed(Path("drive.npz"))
    ('./-dash.npz', 'drive.npz')
    """
    return f"./{path}" if str(path).startswith("-") else str(path)


def output_for(source: Path) -> Path:
    """Return a name for the output: a cloud for a cloud, labels for other files.

    Examples
    --------
    >>> output_for(Path("drive.laz")).name, output_for(Path("drive.csv.gz")).name
    ('drive_classified.laz', 'drive_labels.npy')
    """
    folder = source.parent
    if scan_file(folder) == source:  # a new file in the folder would be read as a part of the scan
        return (
            folder / ".." if folder.name in ("", "..") else folder.parent
        ) / f"{folder.resolve().name}_labels.npy"
    end = f"_classified{suffix_of(source)}" if is_cloud(source) else "_labels.npy"
    return source.with_name(_stem(source) + end)


def _stem(path: Path) -> str:
    return path.name[: len(path.name) - len(suffix_of(path))]


def after_classify(source: Path, output: Path, options: dict[str, Any]) -> list[str]:
    """Return the commands that draw, check and compare the result, if possible.

    Parameters
    ----------
    source, output : Path
        Of the run.
    options : dict
        As given to ``prc classify``.

    Examples
    --------
    >>> after_classify(Path("drive.v2.npy"), Path("out.v2.csv.gz"), {})[0]
    'draw it: prc render drive.v2.npy out.v2.png --labels out.v2.csv.gz'
    >>> after_classify(Path("drive.v2.npy"), Path("out.v2.csv.gz"), {})[1]
    'check it by hand: prc check drive.v2.npy --labels out.v2.csv.gz'
    """
    scan = Input.of(source)
    # a new cloud has other records than its input
    has_records = not is_cloud(output) or scan.keeps_points(output)
    picture = output.with_name(f"{_stem(output)}.png")
    if options.get("only"):
        # labels of a part do not fit the whole input, a cloud of a part is complete
        draw = ["prc", "render", typed(output), typed(picture), "--labels", typed(output)]
        return [] if not is_cloud(output) else [f"draw it: {shlex.join(draw)}"]
    draw = ["prc", "render", typed(source), typed(picture)]
    if not has_records:
        return [f"draw it: {shlex.join([*draw, *given_words(options, flags=PICTURE_FLAGS)])}"]
    labels = ["--labels", typed(output)]
    of_method = ("--method", "--preset")
    draw += [*labels, *given_words(options, of_method, PICTURE_FLAGS)]
    check = ["prc", "check", typed(source), *labels, *given_words(options, of_method)]
    reference = source.with_suffix(KITTI_SUFFIX)
    has_reference = scan.is_dump and reference.is_file()
    compare = ["prc", "evaluate", typed(output), str(reference) if has_reference else "REFERENCE"]
    return [
        f"draw it: {shlex.join(draw)}",
        f"check it by hand: {shlex.join(check)}",
        f"compare it: {shlex.join(compare)}",
    ]

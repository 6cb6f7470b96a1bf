"""Opens the files of both sides and groups them into pools that are compared with each other."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from prc_cli.core.errors import ConfigError, InputError
from prc_cli.jobs.coordinates import placed_source
from prc_cli.jobs.evaluate.options import EvaluateOptions
from prc_cli.matching.keys import AXES, KeyRule
from prc_cli.matching.pairs import files_of, pair_files, stem_of
from prc_cli.matching.sides import Side, SideFile


def open_pools(predicted: list[Path], reference: list[Path], options: EvaluateOptions) -> list[tuple[Side, Side]]:
    """Return the pairs of sides to compare."""
    if not predicted or not reference:
        raise ConfigError("files", "found none on one side, expected predicted and reference files")
    for path in (*predicted, *reference):
        if not path.exists():
            raise InputError(str(path), "no such file or folder, expected class codes", "check the name")
    pooled: list[tuple[list[Path], list[Path]]] = []
    if options.pool:
        pooled.append((files_of(predicted), files_of(reference)))
    elif len(predicted) != len(reference):
        if options.match == "order":
            problem = f"found {len(predicted)} predicted and {len(reference)} reference files, expected as many"
            raise ConfigError("files", problem, "give pairs, or match by time, dimension or nearest")
        pooled.append((files_of(predicted), files_of(reference)))
    else:
        for one, other in zip(predicted, reference, strict=True):
            pooled += _pair(one, other, options)
    keys = _keys(options)
    sides = (
        (options.predicted_dimension, options.predicted_points),
        (options.reference_dimension, options.reference_points),
    )
    pools = []
    for pool in pooled:
        left, right = (
            Side(_open(files, *asked), key, options.points_per_line)
            for files, asked, key in zip(pool, sides, keys, strict=True)
        )
        if options.trajectory is not None:
            crs = next((crs for file in right.files if (crs := file.crs)), None)
            left = replace(left, files=[_placed(file, options, crs) for file in left.files])
        left.check()
        right.check()
        pools.append((left, right))
    return pools


def open_side(path: Path, options: EvaluateOptions, key: KeyRule | None) -> Side:
    """Open a third labelling, a file or a folder."""
    if not path.exists():
        raise InputError(str(path), "no such file or folder, expected class codes", "check the name")
    side = Side(_open(files_of([path]), None, None), key, options.points_per_line)
    side.check()
    return side


def _placed(file: SideFile, options: EvaluateOptions, crs: str | None) -> SideFile:
    """Return a predicted file whose coordinates come from the drive, which may be the file itself, and its poses."""
    assert options.trajectory is not None
    labels = Path(file.codes.path)
    drive = labels if file.points is None else Path(file.points.path)
    source = placed_source(drive, labels, options.trajectory, options.mount, crs=crs)
    return replace(file, table=None, points=source)


def _pair(one: Path, other: Path, options: EvaluateOptions) -> list[tuple[list[Path], list[Path]]]:
    """Return pairs of files, or one pool of all files if names do not pair and records are matched by a key."""
    try:
        return [([a], [b]) for a, b in pair_files(one, other, allow_missing=options.allow_missing)]
    except InputError:
        if options.match == "order":
            raise
    return [(files_of([one]), files_of([other]))]


def _keys(options: EvaluateOptions) -> tuple[KeyRule | None, KeyRule | None]:
    """Return the key of either side."""
    if options.match.startswith("dimension:"):
        left, _, right = options.match.removeprefix("dimension:").partition("=")
        return KeyRule("dimension", left), KeyRule("dimension", right or left)
    key = {"order": None, "time": KeyRule("time"), "nearest": KeyRule("place", AXES[0])}[options.match]
    return key, key


def _open(files: list[Path], dimension: str | None, points: Path | None) -> list[SideFile]:
    """Open the files of one side, with the points of their labels."""
    if points is None:
        return [SideFile.open(path, dimension, None) for path in files]
    if not points.is_dir():
        if len(files) > 1:
            problem = f"one file of points for {len(files)} files of labels, expected a folder"
            raise ConfigError(str(points), problem, "give the folder with the points of every file, of the same name")
        return [SideFile.open(files[0], dimension, points)]
    named = {stem_of(path): path for path in files_of([points])}
    missing = [path.name for path in files if stem_of(path) not in named]
    if missing:
        problem = f"no points for {', '.join(missing[:4])}, expected a file of the same name but for the suffix"
        raise InputError(str(points), problem, "name the folder of the run's inputs")
    return [SideFile.open(path, dimension, named[stem_of(path)]) for path in files]

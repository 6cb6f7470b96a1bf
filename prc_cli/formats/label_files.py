"""Writers of labels, by suffix: LAS and LAZ with everything else kept, or labels alone; complete outputs or none.

>>> sorted(SUFFIXES)
['.csv', '.las', '.laz', '.npy', '.parquet', '.pcd', '.ply']
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from prc_cli.core.classes import ClassCodes
from prc_cli.core.errors import ConfigError
from prc_cli.core.facts import ClassContexts
from prc_cli.core.files import check_output
from prc_cli.formats.writing.base import LabelWriter
from prc_cli.formats.writing.options import OutputConfig, check_codes
from prc_cli.formats.writing.record import (
    Fingerprint,
    RunRecord,
    fingerprint,
    record_path,
)

__all__ = [
    "SUFFIXES",
    "Fingerprint",
    "LabelWriter",
    "OutputConfig",
    "RunRecord",
    "fingerprint",
    "open_writer",
    "record_path",
]

SUFFIXES = {
    ".las": "point cloud",
    ".laz": "point cloud, compressed",
    ".npy": "class codes, uint8 array",
    ".csv": "table of record, class, name",
    ".parquet": "table of record, class, name",
    ".ply": "cloud of named properties",
    ".pcd": "cloud of named properties",
}
"""Known outputs by suffix."""


def open_writer(  # noqa: PLR0913 - all but the path are named
    path: Path,
    *,
    source: Path,
    source_is_las: bool,
    n_records: int | None,
    points_per_line: int,
    codes: ClassCodes,
    options: OutputConfig,
    overwrite: bool,
    laz_contexts: ClassContexts | None = None,
    user_names: Mapping[int, str] | None = None,
    is_part: bool = False,
) -> LabelWriter:
    """Choose and check a writer; nothing is created before its ``with`` block.

    Parameters
    ----------
    path : Path
        Output; its suffix decides the format (:data:`SUFFIXES`).
    source : Path
        Input file. For LAS and LAZ outputs of a LAS or LAZ input it is read again.
    source_is_las : bool
        Whether the input is LAS or LAZ.
    n_records : int or None
        Number of input records; None if unknown before reading.
    points_per_line : int
        M, shots in a scan line.
    codes : ClassCodes
        ``[classes]``.
    options : OutputConfig
        ``[output]``.
    overwrite : bool
        Whether an existing output may be replaced.
    laz_contexts : ClassContexts, optional
        Kept from reading the LAZ input, to rewrite it faster; the output is the same without.
    user_names : mapping, optional
        Name of every user code that may be written; LAS and LAZ hold them. Default: none.
    is_part : bool
        Only a window of the input is classified: the output holds its records alone.

    Raises
    ------
    ConfigError
        When the suffix is unknown, or a class code is above 31 where ``codes = "below-32"``.
    OutputExistsError, OutputError
        When the output exists, is the input, or its folder is missing or read-only.
    InputError
        When the header of a LAS or LAZ input is damaged.

    Examples
    --------
    >>> open_writer(Path("a.tif"), source=Path("a.bin"), source_is_las=False, n_records=None, points_per_line=4,
    ...             codes=ClassCodes(), options=OutputConfig(), overwrite=False)
    Traceback (most recent call last):
    ...
    prc_cli.core.errors.ConfigError: a.tif: found suffix '.tif', expected one of .csv, .las, .laz, .npy, .parquet, \
.pcd, .ply; choose an output name that ends in one of them
    """
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        problem = f"found suffix {path.suffix!r}, expected one of {', '.join(sorted(SUFFIXES))}"
        raise ConfigError(str(path), problem, "choose an output name that ends in one of them")
    check_codes(codes, options)
    check_output(path, overwrite=overwrite, inputs=(source,))
    check_output(record_path(path), overwrite=overwrite, inputs=(source,))
    if suffix in (".ply", ".pcd"):
        from prc_cli.formats.cloud_writing import CloudBuilder, open_rewriter

        rewriter = open_rewriter(path, codes, options, source, points_per_line, is_part=is_part)
        return rewriter if rewriter is not None else CloudBuilder(path, codes, options)
    if suffix not in (".las", ".laz"):
        from prc_cli.formats.labels.write import LabelFileWriter

        return LabelFileWriter(path, codes, options, n_records, is_part=is_part)
    if source_is_las:
        from prc_cli.formats.las.rewrite import LasRewriter

        contexts = None if is_part else laz_contexts
        return LasRewriter(path, codes, options, source, contexts, user_names, is_part=is_part)
    from prc_cli.formats.las.build import LasBuilder

    return LasBuilder(path, codes, options, points_per_line, user_names)

"""Writers of labels: LAS, LAZ, PLY and PCD with everything else kept, or labels alone; complete outputs or none."""

from __future__ import annotations

from prc_cli.core.errors import ConfigError
from prc_cli.core.files import check_output
from prc_cli.formats.registry import by_suffix
from prc_cli.formats.writing.base import LabelWriter
from prc_cli.formats.writing.options import LabelOutput, check_codes
from prc_cli.formats.writing.record import record_path


def open_writer(output: LabelOutput, *, overwrite: bool) -> LabelWriter:
    """Choose and check a writer; nothing is created before its ``with`` block.

    >>> from pathlib import Path
    >>> from prc_cli.core.classes import ClassCodes
    >>> tif = LabelOutput(path=Path("a.tif"), source=Path("a.bin"), n_records=0, points_per_line=4, codes=ClassCodes())
    >>> open_writer(tif, overwrite=False)
    Traceback (most recent call last):
    ...
    prc_cli.core.errors.ConfigError: a.tif: found suffix '.tif', expected one of .csv, .las, .laz, .npy, .parquet, \
.pcd, .ply; choose an output name that ends in one of them
    """
    path, known = output.path, by_suffix("labels")
    suffix = path.suffix.lower()
    if suffix not in known:
        problem = f"found suffix {path.suffix!r}, expected one of {', '.join(sorted(known))}"
        raise ConfigError(str(path), problem, "choose an output name that ends in one of them")
    check_codes(output.codes, output.options)
    check_output(path, overwrite=overwrite, inputs=(output.source,))
    check_output(record_path(path), overwrite=overwrite, inputs=(output.source,))
    return known[suffix].label_writer(output)

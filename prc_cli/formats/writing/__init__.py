"""Chooses the writer of an output by its suffix, and checks the output before any work is done."""

from __future__ import annotations

from pathlib import Path

from prc_cli.core.errors import ConfigError
from prc_cli.core.files import check_output, suffix_of
from prc_cli.formats.registry import Format, by_suffix
from prc_cli.formats.trajectory import SBET_SUFFIXES
from prc_cli.formats.writing.base import StagedWriter, StreamShape
from prc_cli.formats.writing.columns import LabelOutput, check_codes
from prc_cli.formats.writing.record import record_path

BESIDE = {"trajectory": (".csv", *SBET_SUFFIXES), "labels": (".npy",), "stems": (".csv",)}
"""Suffixes of what a simulated stream may have beside it."""


def open_writer(output: LabelOutput, *, overwrite: bool) -> StagedWriter:
    """Choose and check a writer; nothing is created before its ``with`` block."""
    path, known = output.path, by_suffix("labels")
    suffix = path.suffix.lower()
    if suffix not in known:
        problem = f"found suffix {path.suffix!r}, expected one of {', '.join(sorted(known))}"
        raise ConfigError(str(path), problem, "choose an output name that ends in one of them")
    check_codes(output.codes, output.options)
    check_output(path, overwrite=overwrite, inputs=(output.source,))
    check_output(record_path(path), overwrite=overwrite, inputs=(output.source,))
    return known[suffix].label_writer(output)


def stream_suffix(path: Path) -> str:
    """Return the suffix, which decides the writer."""
    suffix, known = suffix_of(path), by_suffix("streams")
    if suffix not in known:
        problem = f"found suffix {suffix!r}, expected one of {' '.join(known)}"
        raise ConfigError(str(path), problem, "choose an output name that ends in one of them")
    return suffix


def stream_format(path: Path) -> Format:
    """Return what is written under such a name."""
    return by_suffix("streams")[stream_suffix(path)]


def outputs_of(path: Path) -> tuple[Path, ...]:
    """Return all files of a stream output, the run record included."""
    from prc_cli.formats.raw_binary.write import config_path

    beside = (config_path(path),) if stream_format(path).is_dump else ()
    return (path, *beside, record_path(path))


def check_stream_output(path: Path, *, overwrite: bool, inputs: tuple[Path, ...] = ()) -> None:
    """Refuse an output before any work is done."""
    for each in outputs_of(path):
        check_output(each, overwrite=overwrite, inputs=inputs)


def open_stream_writer(path: Path, shape: StreamShape) -> StagedWriter:
    """Choose a writer by the suffix of the output; nothing is created before its ``with`` block."""
    return stream_format(path).stream_writer(path, shape)

"""Chooses the writer of an output by its suffix, and checks the output before any work is done."""

from __future__ import annotations

from pathlib import Path

from prc_cli.core.errors import ConfigError
from prc_cli.core.files import check_output, prepare_outputs, suffix_of
from prc_cli.formats.bags import DATABASE, METADATA
from prc_cli.formats.foreign import output_hint_of
from prc_cli.formats.registry import Format, by_suffix
from prc_cli.formats.trajectory import SBET_SUFFIXES
from prc_cli.formats.writing.base import StagedWriter, StreamShape
from prc_cli.formats.writing.columns import LabelOutput, check_codes
from prc_cli.formats.writing.record import record_path

BESIDE = {"trajectory": (".csv", *SBET_SUFFIXES), "labels": (".npy",), "stems": (".csv",)}
"""Suffixes of the files beside a simulated stream."""


def open_writer(output: LabelOutput, *, overwrite: bool) -> StagedWriter:
    """Choose and check a writer; nothing is created before its ``with`` block."""
    path = output.path
    known = by_suffix("labels")
    suffix = path.suffix.lower()
    if suffix not in known:
        problem = f"found suffix {path.suffix!r}, expected one of {', '.join(sorted(known))}"
        raise ConfigError(str(path), problem, "choose an output name that ends in one of them")
    check_codes(output.codes, output.options)
    check_output(path, overwrite=overwrite, inputs=(output.source.path,))
    check_output(record_path(path), overwrite=overwrite, inputs=(output.source.path,))
    return known[suffix].label_writer(output)


def stream_suffix(path: Path) -> str:
    """Return the suffix of a stream output, which selects the writer."""
    suffix = suffix_of(path)
    known = by_suffix("streams")
    if suffix not in known:
        problem = f"found suffix {suffix!r}, expected one of {' '.join(known)}"
        raise ConfigError(str(path), problem, output_hint_of(suffix))
    return suffix


def stream_format(path: Path) -> Format:
    """Return the format of a stream output."""
    return by_suffix("streams")[stream_suffix(path)]


def outputs_of(path: Path) -> tuple[Path, ...]:
    """Return all files of a stream output, the run record included."""
    from prc_cli.formats.raw_binary.write import config_path

    beside = (config_path(path),) if stream_format(path).is_dump else ()
    return (path, *beside, record_path(path))


def beside_of(path: Path) -> tuple[Path, ...]:
    """Return absent files that an output adds to its folder: metadata of a ROS 2 bag."""
    return (path.with_name(METADATA),) if suffix_of(path) == DATABASE else ()


def prepare_stream_output(
    path: Path,
    *more: Path,
    overwrite: bool,
    inputs: tuple[Path, ...] = (),
    folders: tuple[Path, ...] = (),
) -> None:
    """Prepare the files of a stream output and ``more``.

    See :func:`prc_cli.core.files.prepare_outputs`.
    """
    members = (*more, *outputs_of(path))
    prepare_outputs(
        *members, overwrite=overwrite, inputs=inputs, folders=folders, beside=beside_of(path)
    )


def prepare_label_outputs(*paths: Path, overwrite: bool, inputs: tuple[Path, ...] = ()) -> None:
    """Prepare classified outputs and their records (:func:`prc_cli.core.files.prepare_outputs`)."""
    for path in paths:
        if not path.name:  # "." and "/" have no record
            check_output(path, overwrite=overwrite)
    members = [member for path in paths for member in (path, record_path(path))]
    beside = tuple(member for path in paths for member in beside_of(path))
    prepare_outputs(*members, overwrite=overwrite, inputs=inputs, beside=beside)


def open_stream_writer(path: Path, shape: StreamShape) -> StagedWriter:
    """Choose a writer by the suffix of the output; nothing is created before its ``with`` block."""
    return stream_format(path).stream_writer(path, shape)

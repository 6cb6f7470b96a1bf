"""Classifying one file: the same labels for every format, no files left after failures."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

import prc_cli
from prc_cli.config import load_config
from prc_cli.core.errors import EvidenceError, InputError, OutputExistsError
from prc_cli.core.findings import CHECK_NAMES
from prc_cli.jobs.classify import classify
from tests.street import POINTS_PER_LINE, street, write_npz, write_raw

WITH_M = {"input": {"points_per_line": POINTS_PER_LINE}}


def test_outputs_are_not_overwritten_and_failures_leave_nothing(tmp_path: Path) -> None:
    source = write_raw(tmp_path / "drive.bin", street())
    output = tmp_path / "out" / "labels.npy"
    output.parent.mkdir()
    loaded = load_config(options=WITH_M)
    classify(source, output, loaded)
    before = output.read_bytes()
    with pytest.raises(OutputExistsError):
        classify(source, output, loaded)
    classify(source, output, loaded, overwrite=True)
    assert output.read_bytes() == before
    assert sorted(os.listdir(output.parent)) == ["labels.npy", "labels.npy.prc.json"]

    def stop(n_lines: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        classify(source, output.with_name("other.npy"), loaded, progress=stop)
    assert sorted(os.listdir(output.parent)) == ["labels.npy", "labels.npy.prc.json"]


def test_an_input_that_changes_while_it_is_read_is_refused(tmp_path: Path) -> None:
    source = write_raw(tmp_path / "drive.bin", street())

    def touch(n_lines: int) -> None:
        with source.open("ab") as handle:
            handle.write(b"\0" * 4)

    with pytest.raises(InputError, match="changed while it was read"):
        classify(source, tmp_path / "labels.npy", load_config(options=WITH_M), progress=touch)
    assert os.listdir(tmp_path) == ["drive.bin"]


@pytest.mark.skipif(os.name == "nt", reason="a file has no time of its last change there")
def test_an_input_that_is_edited_in_place_is_refused_though_its_time_was_put_back(tmp_path: Path) -> None:
    """Half of the outputs mixed two inputs under the fingerprint of the first."""
    source = write_raw(tmp_path / "drive.bin", street())
    status = source.stat()

    def edit(n_lines: int) -> None:
        with source.open("rb+") as handle:
            handle.write(b"\0")
        os.utime(source, ns=(status.st_atime_ns, status.st_mtime_ns))

    with pytest.raises(InputError, match="changed while it was read"):
        classify(source, tmp_path / "labels.npy", load_config(options=WITH_M), progress=edit)
    assert os.listdir(tmp_path) == ["drive.bin"]


def test_an_image_in_memory_is_judged_as_a_file_is() -> None:
    image = street()
    shuffled = np.random.default_rng(3).permuted(image, axis=1)
    with pytest.raises(EvidenceError, match="range_m: ranges of neighbouring shots"):
        prc_cli.classify_ranges(shuffled)
    # too few shots to tell
    prc_cli.classify_ranges(shuffled[:80])
    few = street(400)[:, ::2]  # too few columns to measure their angles
    moves = load_config(options={"input": {"accept_doubts": ["standing"]}})
    with pytest.warns(prc_cli.DoubtWarning, match="range_m: method: PRC as published was taken"):
        prc_cli.classify_ranges(few, moves)
    thin = np.full((137, 18_000), np.nan, np.float32)
    thin[:, :POINTS_PER_LINE] = image
    with pytest.warns(prc_cli.DoubtWarning, match="range_m: returns: .*input.accept_doubts = ..returns") as told:
        prc_cli.classify_ranges(thin, load_config(preset="urban"))
    assert told[0].filename == __file__
    for odd in (thin, shuffled):
        accepting = load_config(options={"input": {"accept_doubts": CHECK_NAMES}})
        prc_cli.classify_ranges(odd, accepting)


def test_what_is_unusual_about_a_file_is_told_and_recorded(tmp_path: Path) -> None:
    """A header that promises too few points: the rest is not read, and that is said."""
    source = write_npz(tmp_path / "drive.npz", street())
    built = tmp_path / "drive.las"
    classify(source, built)
    data = bytearray(built.read_bytes())
    n_points = int.from_bytes(data[247:255], "little")
    data[247:255] = (n_points - 1000).to_bytes(8, "little")
    built.write_bytes(data)
    summary = classify(built, tmp_path / "labels.npy")
    assert np.load(tmp_path / "labels.npy").size == n_points - 1000
    assert any("follow the last record the header counts: not read" in notice for notice in summary.record.notices)

"""Classifying one file: the same labels for every format, no files left after failures."""

from __future__ import annotations

import hashlib
import json
import os
from pathlib import Path

import laspy
import numpy as np
import pytest

import prc_cli
from prc_cli.config import load_config
from prc_cli.core.classes import ClassCodes, Label
from prc_cli.core.errors import EvidenceError, InputError, OutputExistsError
from prc_cli.core.findings import CHECK_NAMES
from prc_cli.jobs.classify import classify, classify_ranges, open_stream
from prc_cli.jobs.evaluate import evaluate
from tests.street import N_LINES, POINTS_PER_LINE, angles, street, write_csv, write_npz, write_raw

WITH_M = {"input": {"points_per_line": POINTS_PER_LINE}}
CODES = ClassCodes().lookup()


@pytest.fixture(params=["urban", "forest"])
def preset(request: pytest.FixtureRequest) -> str:
    return str(request.param)


def labels_of(source: Path, output: Path, preset: str, **options: object) -> np.ndarray:
    classify(source, output, load_config(preset=preset, options=options))
    return np.load(output)


def test_every_format_gives_the_same_labels(tmp_path: Path, preset: str) -> None:
    image = street()
    expected = CODES[classify_ranges(image, load_config(preset=preset)).labels].ravel()
    assert len(np.unique(expected)) >= 4
    raw = write_raw(tmp_path / "drive.bin", image)
    assert np.array_equal(labels_of(raw, tmp_path / "raw.npy", preset, **WITH_M), expected)
    for name in ("drive.csv", "drive.csv.gz"):
        text = write_csv(tmp_path / name, image)
        assert np.array_equal(labels_of(text, tmp_path / f"{name}.npy", preset), expected)
    arrays = write_npz(tmp_path / "drive.npz", image)
    assert np.array_equal(labels_of(arrays, tmp_path / "npz.npy", preset), expected)


@pytest.mark.parametrize("suffix", [".las", ".laz"])
def test_a_stream_written_to_las_is_read_back_with_the_same_labels(tmp_path: Path, preset: str, suffix: str) -> None:
    image = street()
    source = write_npz(tmp_path / "drive.npz", image)
    built = tmp_path / f"built{suffix}"
    classify(source, built, load_config(preset=preset))
    again = tmp_path / f"again{suffix}"
    # M and the gaps come back from the file itself
    summary = classify(built, again, load_config(preset=preset))
    assert summary.record.points_per_line == POINTS_PER_LINE
    first, second = laspy.read(built), laspy.read(again)
    present = ~np.isnan(image)
    assert len(first) == len(second) == present.sum()
    expected = CODES[classify_ranges(image, load_config(preset=preset)).labels][present]
    assert np.array_equal(first.classification, expected)
    assert np.array_equal(second.classification, expected)
    for name in first.point_format.dimension_names:
        assert np.array_equal(first[name], second[name]), name
    assert np.array_equal(np.asarray(first["range"], np.float32), image[present])


def test_the_run_is_recorded(tmp_path: Path) -> None:
    image = street()
    source = write_raw(tmp_path / "drive.bin", image)
    loaded = load_config(preset="urban", options=WITH_M)
    summary = classify(source, tmp_path / "labels.npy", loaded)
    stored = json.loads((tmp_path / "labels.npy.prc.json").read_text())
    assert stored == summary.record.as_dict()
    assert stored["input"]["name"] == "drive.bin"
    assert stored["input"]["size"] == image.nbytes
    assert stored["stream"] == {
        "points_per_line": POINTS_PER_LINE,
        "n_lines": N_LINES,
        "n_records": image.size,
        "n_missing": int(np.isnan(image).sum()),
    }
    assert stored["config"]["prc"]["support"]["zeta_s"] == 1.0
    assert str(tmp_path) not in json.dumps(stored)
    assert summary.counts.labels[Label.MISSING] == np.isnan(image).sum()


def test_the_trajectory_of_a_run_is_recorded(tmp_path: Path) -> None:
    np.savez(tmp_path / "drive.npz", range_m=street(), angle_deg=np.rad2deg(angles()), time_s=np.arange(N_LINES) / 48)
    classify(tmp_path / "drive.npz", tmp_path / "drive.las")
    track = tmp_path / "track.csv"
    track.write_text("time,x,y,z\n-1,-8,0,0\n2,16,0,0\n5,40,0,0\n")
    # the scan planes of the built file follow each other at 8 m/s
    loaded = load_config(preset="urban", options={"input": {"range": f"trajectory:{track}"}})
    stored = classify(tmp_path / "drive.las", tmp_path / "labels.npy", loaded).record.as_dict()
    digest = hashlib.sha256(track.read_bytes()).hexdigest()
    assert stored["trajectory"] == {"name": "track.csv", "size": track.stat().st_size, "sha256": digest}
    assert str(tmp_path) not in json.dumps(stored)


def test_the_same_run_gives_the_same_bytes(tmp_path: Path) -> None:
    source = write_npz(tmp_path / "drive.npz", street())
    for suffix in (".npy", ".csv", ".parquet", ".las", ".laz"):
        outputs = [tmp_path / f"{turn}{suffix}" for turn in "ab"]
        for output in outputs:
            classify(source, output)
        assert outputs[0].read_bytes() == outputs[1].read_bytes(), suffix


def test_the_bytes_do_not_depend_on_the_number_of_threads(tmp_path: Path, preset: str) -> None:
    image = street()
    source = write_npz(tmp_path / "drive.npz", image)
    options = {"prc": {"lines_per_block": 20}, "output": {"segment_ids": True}}
    config = load_config(preset=preset, options=options)
    outputs = []
    for threads in (1, 2, 5):
        for suffix in (".csv", ".laz"):
            outputs.append(tmp_path / f"{threads}{suffix}")
            classify(source, outputs[-1], config, threads=threads)
        assert np.array_equal(
            classify_ranges(image, config, threads=threads).labels, classify_ranges(image, config).labels
        )
    for output in outputs[2:]:
        assert output.read_bytes() == (tmp_path / f"1{output.suffix}").read_bytes()


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


def test_progress_counts_every_line(tmp_path: Path) -> None:
    source = write_npz(tmp_path / "drive.npz", street())
    seen: list[int] = []
    classify(source, tmp_path / "labels.npy", load_config(preset="urban"), progress=seen.append)
    assert seen == [99, N_LINES - 99]


def test_evaluate_matches_by_order_and_refuses_unequal_counts(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.array([2, 2, 6, 0, 7], np.uint8))
    np.save(tmp_path / "b.npy", np.array([2, 6, 6, 0, 7], np.uint8))
    matrix = evaluate(tmp_path / "a.npy", tmp_path / "b.npy")
    assert (matrix.n_scored, matrix.n_ignored) == (4, 1)
    np.save(tmp_path / "c.npy", np.array([2], np.uint8))
    with pytest.raises(InputError, match="5 records, but .*c.npy holds 1"):
        evaluate(tmp_path / "a.npy", tmp_path / "c.npy")


def test_the_public_functions_are_those_of_the_pipeline(tmp_path: Path) -> None:
    source = write_npz(tmp_path / "drive.npz", street())
    stream = prc_cli.open_stream(source)
    assert stream.info.points_per_line == POINTS_PER_LINE
    ranges = np.concatenate([block.range_m for block in stream.blocks()])
    # as often as asked
    again = np.concatenate([block.range_m for block in open_stream(source).blocks()])
    assert np.array_equal(ranges, again, equal_nan=True)
    assert np.array_equal(ranges, street(), equal_nan=True)
    with pytest.raises(InputError, match="expected \\(lines, points per line\\)"):
        prc_cli.classify_ranges(np.zeros(5))
    for wrong in ("x", [["a"]], [[1j]], [[object()]]):
        with pytest.raises(InputError, match="expected ranges in metres"):
            prc_cli.classify_ranges(wrong)


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

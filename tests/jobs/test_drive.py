"""Several files of one drive are one stream.

Labels as of the joined file, an output for every file.
"""

from pathlib import Path

import laspy
import numpy as np
import pytest

from prc_cli.config import load_config
from prc_cli.core.errors import ConfigError, InputError, OutputExistsError
from prc_cli.jobs.classify import classify
from prc_cli.jobs.drive import classify_drive
from tests.street import N_LINES, POINTS_PER_LINE, street, write_npz, write_raw

CUTS = (0, 40 * POINTS_PER_LINE + 77, 41 * POINTS_PER_LINE, N_LINES * POINTS_PER_LINE)
"""Files end within a line, and after less than a line."""
URBAN = load_config(preset="prc-2019-urban")
WITH_M = load_config(
    preset="prc-2019-urban", options={"input": {"points_per_line": POINTS_PER_LINE}}
)


def cut_raw(tmp_path: Path) -> tuple[Path, list[Path]]:
    whole = write_raw(tmp_path / "drive.bin", street())
    ranges = np.fromfile(whole, "<f4")
    parts = [tmp_path / f"drive_{i}.bin" for i in range(3)]
    for part, start, stop in zip(parts, CUTS[:-1], CUTS[1:], strict=True):
        ranges[start:stop].tofile(part)
    return whole, parts


def cut_laz(tmp_path: Path, gap_s: float = 0.0) -> tuple[Path, list[Path]]:
    """A LAZ of the street, and three files of its records; the last begins so much later."""
    whole = tmp_path / "drive.laz"
    classify(write_npz(tmp_path / "drive.npz", street()), whole, URBAN)
    las = laspy.read(whole)
    las.classification[:] = 0
    las.gps_time = 100.0 + np.arange(len(las)) * 1e-5
    cuts = [0, len(las) // 3 + 5, len(las) // 2, len(las)]
    las.gps_time[cuts[2] :] += gap_s
    las.write(whole)
    parts = [tmp_path / f"drive_{i}.laz" for i in range(3)]
    for part, start, stop in zip(parts, cuts[:-1], cuts[1:], strict=True):
        piece = laspy.LasData(las.header, las.points[start:stop].copy())
        piece.write(part)
    return whole, parts


def test_classes_of_parts_are_those_of_the_joined_laz(tmp_path):
    whole, parts = cut_laz(tmp_path)
    classify(whole, tmp_path / "whole.laz", URBAN)
    expected = np.asarray(laspy.read(tmp_path / "whole.laz").classification)
    summaries = list(classify_drive(parts, tmp_path / "out", URBAN, threads=1))
    assert [summary.output.name for summary in summaries] == [part.name for part in parts]
    written = [laspy.read(summary.output) for summary in summaries]
    assert np.array_equal(
        np.concatenate([np.asarray(las.classification) for las in written]), expected
    )
    for las, part in zip(written, parts, strict=True):
        assert np.array_equal(las.gps_time, laspy.read(part).gps_time)
    assert len(np.unique(expected)) >= 4


def test_a_gap_of_time_begins_a_stream_of_its_own(tmp_path):
    _, parts = cut_laz(tmp_path, gap_s=7.0)
    summaries = list(classify_drive(parts, tmp_path / "out", URBAN))
    apart = (
        "a stream of its own begins with this file: it begins 7.000 s after the end of the "
        "file before"
    )
    assert [apart in summary.record.notices for summary in summaries] == [False, False, True]
    classify(parts[2], tmp_path / "alone.laz", URBAN)
    alone = np.asarray(laspy.read(tmp_path / "alone.laz").classification)
    assert np.array_equal(np.asarray(laspy.read(summaries[2].output).classification), alone)


def test_what_is_refused(tmp_path):
    _, parts = cut_raw(tmp_path)
    image = write_npz(tmp_path / "image.npz", street())
    with pytest.raises(InputError, match="image.npz: contains whole scans"):
        list(classify_drive([image, *parts], tmp_path / "out", WITH_M))
    with pytest.raises(ConfigError, match="two inputs have this output"):
        list(classify_drive([parts[0], parts[0]], tmp_path / "out", WITH_M))
    with pytest.raises(ConfigError, match="needs a single file"):
        window = load_config(preset="prc-2019-urban", options={"input": {"only_lines": "0:9"}})
        list(classify_drive(parts, tmp_path / "out", window))
    list(classify_drive(parts, tmp_path / "out", WITH_M))
    with pytest.raises(OutputExistsError, match="exists already"):
        list(classify_drive(parts, tmp_path / "out", WITH_M))

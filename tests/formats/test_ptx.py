"""PTX and echo pulse files."""

import tracemalloc
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pytest

from prc_cli.core.blocks import join
from prc_cli.core.errors import PrcError
from prc_cli.core.stream import ScanBlock, ScanStream
from prc_cli.formats.echopulse import EchoPulseSource
from prc_cli.formats.input import Input
from prc_cli.formats.options import InputConfig
from prc_cli.formats.organised import e57_read, ptx
from prc_cli.formats.organised.ptx import PtxStream
from prc_cli.streams.open import open_input
from tests.cli.conftest import Prc
from tests.formats.cloud_files import pulse_folder
from tests.formats.organised_files import (
    Array,
    Scan,
    e57_fields,
    grid_points,
    ptx_header,
    ptx_rows,
    ptx_scan,
    reordered,
    turn_x,
    write_e57,
    write_text,
)

AUTO = InputConfig()


def scans_of(stream: ScanStream) -> list[ScanBlock]:
    """One block a scan; every scan's blocks follow one another and the last says so."""
    scans: dict[int, list[ScanBlock]] = {}
    for block in stream.blocks():
        parts = scans.setdefault(block.scanner, [])
        assert block.first_line == sum(part.n_lines for part in parts)
        assert not any(part.is_last for part in parts)
        parts.append(block)
    assert all(parts[-1].is_last for parts in scans.values())
    return [join(scans[scanner]) for scanner in sorted(scans)]


def refused(path: Path, config: InputConfig = AUTO) -> str:
    """The error of opening and reading, always one line, without the folder."""
    with pytest.raises(PrcError) as caught:
        scans_of(PtxStream(path, config))
    message = str(caught.value)
    assert "\n" not in message
    return message.replace(f"{path.parent}/", "")


def expected(points: Array) -> tuple[Array, Array]:
    """Ranges and coordinates of points in the sensor's frame."""
    xyz = points[..., :3].copy()
    xyz[~xyz.any(axis=-1)] = np.nan
    return np.sqrt((xyz**2).sum(axis=-1)).astype(np.float32), xyz.astype(np.float32)


def equal(a: Any, b: Array) -> bool:
    return np.array_equal(a, b, equal_nan=True)


def test_columns_are_lines_and_zeros_are_missing(tmp_path):
    points = grid_points(9, 7)
    stream = open_input(Input.of(write_text(tmp_path / "a.PTX", ptx_scan(points))), AUTO)
    (block,) = scans_of(stream)
    info = stream.info
    assert (info.format, info.n_records, info.n_lines, info.points_per_line) == ("PTX", 63, 9, 7)
    assert info.facts.notes == ()
    ranges, xyz = expected(points)
    assert equal(block.range_m, ranges)
    assert equal(block.xyz_m, xyz)
    assert equal(block.record, np.arange(63).reshape(9, 7))
    intensity = (points[..., 3] * 65535).astype(np.float32)
    intensity[np.isnan(ranges)] = np.nan
    assert equal(block.intensity, intensity)
    assert block.tally.n_records == 63
    assert block.tally.n_not_positive == 0


SCAN = ptx_scan(grid_points(8, 6))


@pytest.mark.parametrize(
    "old, new",
    [
        ("\n", "\r\n"),
        (SCAN + SCAN, SCAN + SCAN + "\n \n\r\n\n"),
        (SCAN + SCAN, (SCAN + SCAN)[:-1]),
        (SCAN + SCAN, SCAN + "\n\n" + SCAN),
        (" ", " \t "),
        (SCAN + SCAN, "\ufeff" + SCAN + SCAN),
        ("\n0.", "\n+0."),
        (" 0.5000\n", " 5.000e-1\n"),
    ],
)
def test_how_the_text_is_written_changes_nothing(tmp_path, old, new):
    text = (SCAN + SCAN).replace(old, new)
    (scan, _) = scans_of(PtxStream(write_text(tmp_path / "a.ptx", SCAN + SCAN), AUTO))
    blocks = scans_of(PtxStream(write_text(tmp_path / "b.ptx", text), AUTO))
    assert len(blocks) == 2
    for block in blocks:
        assert equal(block.range_m, scan.range_m)
        assert equal(block.intensity, np.asarray(scan.intensity))


def test_a_last_column_cut_short_is_padded_if_told(tmp_path):
    points = grid_points(4, 5, missing=0)
    text = ptx_header(4, 5) + ptx_rows(points.reshape(-1, 4)[:18])
    path = write_text(tmp_path / "a.ptx", text)
    assert "ends after 18 points" in refused(path)
    assert "partial_line" in refused(path)
    stream = PtxStream(path, InputConfig(partial_line="pad"))
    (block,) = scans_of(stream)
    assert stream.info.n_records == 18
    assert np.isnan(block.range_m[3, 3:]).all()
    assert block.records()[3].tolist() == [15, 16, 17, -1, -1]
    assert any("lacks 2 shots" in item.why for item in stream.info.assumptions)
    short = write_text(tmp_path / "b.ptx", ptx_header(4, 5) + ptx_rows(points.reshape(-1, 4)[:14]))
    assert "ends after 14 points" in refused(short, InputConfig(partial_line="pad"))


GOOD = ptx_scan(grid_points(4, 5, missing=0))


@pytest.mark.parametrize(
    "text, parts",
    {
        "too few": (
            GOOD[: GOOD[:-1].rfind("\n") + 1],
            ("line 29", "ends after 19 points", "4 columns x 5 rows = 20"),
        ),
        "too many": (
            GOOD + "1 2 3 0.5\n",
            ("line 31", "'1 2 3 0.5'", "line 1", "4 columns x 5 rows = 20 points"),
        ),
        "too few before a scan": (
            GOOD.replace("5\n", "6\n", 1) + GOOD,
            ("line 31", "next scan begins after 20 points", "line 1 says 4 columns x 6 rows = 24"),
        ),
        "too few, far before the end": (
            GOOD.replace("4\n5\n", "4\n7\n", 1) + GOOD * 3,
            ("line 31", "after 20 points"),
        ),
        "a blank line": (
            GOOD.replace("\n", "\n\n", 15).replace("\n\n", "\n", 13),
            ("a blank line", "expected 4"),
        ),
        "no number": (GOOD[:-20] + "x" + GOOD[-19:], ("line 30", "expected a number")),
        "a row too short": (
            GOOD[: GOOD[:-1].rfind(" ")] + "\n",
            ("line 30", "found 3 numbers", "point 20"),
        ),
        "two numbers": (ptx_header(1, 1) + "1 2\n", ("line 11", "found 2 numbers")),
        "not PTX": ("hello\n" * 30, ("line 1", "'hello'", "number of columns")),
        "header cut short": (
            "\n".join(GOOD.splitlines()[:6]),
            ("line 6", "found ''", "expected 4 numbers"),
        ),
        "header not finite": (
            GOOD.replace("1.000000000", "nan", 1),
            ("line 4", "expected 3 numbers"),
        ),
        "stretched": (
            ptx_scan(grid_points(2, 2), rotation=0.001 * np.eye(3)),
            ("line 7", "no rotation"),
        ),
        "mirrored": (
            ptx_scan(grid_points(2, 2), rotation=np.diag([1.0, 1, -1])),
            ("line 7", "no rotation"),
        ),
        "huge rows": (ptx_header(10, 10**15) + "1 2 3 1\n", ("line 2", "at most 10000000")),
        "huge columns": (ptx_header(10**17, 10) + "1 2 3 1\n", ("line 1", "at most 10000000")),
        "large, not there": (
            ptx_header(10**6, 10**6) + "1 2 3 1\n",
            ("ends after 1 points", "= 1000000000000"),
        ),
        "negative": (ptx_header(-4, 5) + "1 2 3 1\n", ("line 1", "'-4'")),
        "header alone": (ptx_header(4, 5), ("line 11", "found 0 numbers")),
    }.values(),
)
def test_a_file_that_lies_is_refused_in_one_line(tmp_path, text, parts):
    message = refused(write_text(tmp_path / "a.ptx", text))
    for part in parts:
        assert part in message


def test_a_window_of_lines_is_taken_from_every_scan(tmp_path):
    text = 2 * ptx_scan(grid_points(9, 7)) + ptx_scan(grid_points(5, 7))
    path = write_text(tmp_path / "a.ptx", text)
    blocks = open_input(Input.of(path), InputConfig(only_lines="4:6")).blocks()
    taken = [(block.scanner, block.first_line, block.n_lines) for block in blocks]
    assert taken == [(0, 4, 2), (1, 4, 2), (2, 4, 1)]


def test_a_file_that_shrinks_while_it_is_read_is_an_error(tmp_path):
    path = write_text(tmp_path / "a.ptx", GOOD)
    stream = PtxStream(path, AUTO)
    path.write_bytes(path.read_bytes()[:500])
    with pytest.raises(PrcError, match=r"fewer points|numbers, expected"):
        scans_of(stream)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["ptx", "e57", "e57 row by row"])
def test_memory_does_not_grow_with_the_file(tmp_path, monkeypatch, kind):
    monkeypatch.setattr("prc_cli.formats.organised.scans.CHUNK_SHOTS", 2048)
    monkeypatch.setattr(e57_read, "CHUNK_POINTS", 1024)
    monkeypatch.setattr(ptx, "BLOCK_BYTES", 1 << 15)
    peaks = []
    for n_lines in (100, 100, 1000):  # the first one imports
        points = grid_points(n_lines, 64)
        if kind == "ptx":
            path = write_text(tmp_path / "a.ptx", ptx_scan(points, rotation=turn_x(2)))
        else:
            fields = e57_fields(points)
            if kind == "e57 row by row":
                fields = reordered(fields, np.argsort(fields["rowIndex"], kind="stable"))
            path = write_e57(tmp_path / "a.e57", [Scan(fields)])
        tracemalloc.start()
        assert sum(block.n_lines for block in open_input(Input.of(path), AUTO).blocks()) > 0
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[2] < 1.3 * peaks[1] + 50_000


ECHOES = "echo-float32-range.bin"


def test_a_shot_without_return_that_meets_another_is_no_return(capsys, tmp_path):
    path = pulse_folder(tmp_path / "p")
    angles = path.with_name("pulse-float32-theta.bin")
    theta = np.fromfile(angles, "<f4")
    empty = np.flatnonzero(np.fromfile(path, np.uint8) == 0)[60]
    theta[empty] = theta[empty - 1]
    theta.tofile(angles)
    echoes = np.sort(np.fromfile(path.with_name(ECHOES), "<f4"))
    for command in ("convert", "classify --preset prc-2019-urban"):
        output = tmp_path / f"{command[:7]}.laz"
        assert Prc(capsys)(command, path, output).code in (0, 4)  # 4: such echoes are no street
        np.testing.assert_array_equal(np.sort(laspy.read(output)["range"]), echoes)


@pytest.mark.data
def test_the_standing_car(real_data):
    folder = real_data / "echopulse"
    path = folder / "pulse-uint8-n_echo.bin"
    stream = open_input(Input.of(path), AUTO)
    block = join(list(stream.blocks()))
    count = np.fromfile(path, np.uint8)
    assert stream.info.points_per_line == 2917
    # of 291 970, shots that met another one
    assert abs(np.isfinite(block.range_m).sum() - np.count_nonzero(count)) <= 438
    assert block.tally.n_collisions <= 438
    assert EchoPulseSource(path).n_records == np.maximum(count, 1).sum()
    seen = np.concatenate([block.range_m.ravel(), block.extra.range_m])
    ranges = np.sort(np.fromfile(folder / ECHOES, "<f4"))
    np.testing.assert_array_equal(np.sort(seen[np.isfinite(seen)])[-1000:], ranges[-1000:])

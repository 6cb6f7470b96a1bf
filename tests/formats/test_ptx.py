"""PTX and echo pulse files."""

import tracemalloc
from typing import Any

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
from tests.formats.cloud_files import pulse_folder
from tests.formats.organised_files import (
    Array,
    Scan,
    e57_fields,
    grid_points,
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


GOOD = ptx_scan(grid_points(4, 5, missing=0))


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


def test_a_window_of_lines_is_taken_from_every_scan(tmp_path):
    scans = [grid_points(9, 7), grid_points(9, 7), grid_points(5, 7)]
    path = write_text(tmp_path / "a.ptx", "".join(map(ptx_scan, scans)))
    blocks = [*open_input(Input.of(path), InputConfig(only_lines="4:6")).blocks()]
    assert [(block.scanner, block.first_line) for block in blocks] == [(0, 4), (1, 4), (2, 4)]
    for block, points in zip(blocks, scans, strict=True):
        assert equal(block.range_m, expected(points[4:6])[0])


def test_a_shot_without_return_that_meets_another_costs_no_echo(tmp_path):
    path = pulse_folder(tmp_path / "p")
    angles = path.with_name("pulse-float32-theta.bin")
    theta = np.fromfile(angles, "<f4")
    empty = np.flatnonzero(np.fromfile(path, np.uint8) == 0)[60]
    theta[empty] = theta[empty - 1]
    theta.tofile(angles)
    block = join([*open_input(Input.of(path), AUTO).blocks()])
    ranges = np.append(block.range_m[np.isfinite(block.range_m)], block.extra.range_m)
    echoes = np.fromfile(path.with_name("echo-float32-range.bin"), "<f4")
    np.testing.assert_array_equal(np.sort(ranges), np.sort(echoes))

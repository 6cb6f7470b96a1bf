"""Round trips: a stream written in another format and read back is the same stream, as far as the
format holds it."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from prc_cli.config import LoadedConfig, load_config
from prc_cli.core.blocks import join
from prc_cli.core.errors import OutputError
from prc_cli.core.stream import ScanBlock
from prc_cli.jobs.classify import open_stream
from prc_cli.jobs.convert import convert
from tests.clouds import write_las
from tests.street import LINE_HZ, POINTS_PER_LINE, angles, street

CELLS = (".csv", ".csv.gz", ".csv.zst", ".npz", ".bin")


def config(path: Path | None = None, preset: str | None = None, **inputs: Any) -> LoadedConfig:
    beside = None if path is None or path.suffix != ".bin" else path.with_name(f"{path.name}.toml")
    return load_config(
        beside, preset, {"input": {key.rstrip("_"): value for key, value in inputs.items()}}
    )


def scans(path: Path, loaded: LoadedConfig) -> dict[int, ScanBlock]:
    """Every scanner's lines as one block."""
    parts: dict[int, list[ScanBlock]] = {}
    for block in open_stream(path, loaded).blocks():
        parts.setdefault(block.scanner, []).append(block)
    return {scanner: join(blocks) for scanner, blocks in parts.items()}


def same_bits(left: Any, right: Any) -> bool:
    kind = {4: np.uint32, 8: np.uint64}[left.dtype.itemsize]
    gone = np.isnan(left)
    same = (left.view(kind) == right.view(kind)) | gone
    return bool(np.array_equal(gone, np.isnan(right)) and same.all())


@pytest.fixture
def drive(tmp_path):
    """One scanner, everything that a range image can hold."""
    image = street()
    rng = np.random.default_rng(5)
    # bits that no decimal of a few digits has
    image *= rng.uniform(0.99999, 1.00001, image.shape).astype(np.float32)
    angle = angles()
    xyz = np.stack([image * 0.0, image * np.sin(angle), -image * np.cos(angle)], axis=-1).astype(
        np.float32
    )
    shots = np.arange(image.size).reshape(image.shape)
    times = 302_400.0 + shots / (LINE_HZ * POINTS_PER_LINE)
    intensity = rng.integers(0, 65536, image.shape).astype(np.float32)
    path = tmp_path / "drive.npz"
    np.savez(
        path, range_m=image, angle_deg=np.rad2deg(angle), time_s=times, xyz=xyz, intensity=intensity
    )
    return path


@pytest.mark.parametrize("suffix", CELLS)
def test_a_format_of_cells_gives_the_same_blocks_back(drive, tmp_path, suffix):
    out = tmp_path / f"out{suffix}"
    convert(drive, out)
    (before,) = scans(drive, config()).values()
    (after,) = scans(out, config(out)).values()
    assert same_bits(before.range_m, after.range_m)
    assert same_bits(before.time_s, after.time_s)
    assert same_bits(before.intensity, after.intensity)
    assert np.array_equal(before.records(), after.records())
    assert after.angle_rad is not None
    turn = 2 * np.pi
    assert np.abs((after.angle_rad - before.angle_rad + np.pi) % turn - np.pi).max() < 1e-11
    if suffix == ".npz":
        assert same_bits(before.xyz_m, after.xyz_m)


def two_scanners(path: Path) -> Path:
    """Two scanners of different M, a missing line, gaps, and shots of several returns.

    Interleaved in the file.
    """
    rng = np.random.default_rng(7)
    rows = []
    for line in range(12):
        for scanner, m in ((3, 20), (8, 33)):
            if line == 5:
                continue
            for column in range(m):
                time = 100.0 + line + column / 64
                n = int(rng.integers(0, 4)) if 0 < column < m - 1 else 1
                distances = np.sort(rng.uniform(2.0, 60.0, n).astype(np.float32))
                for number, distance in enumerate(distances, 1):
                    strength = int(rng.integers(1, 60_000))
                    rows.append(
                        (time, line, column, distance, scanner, number, n, strength, column % 7)
                    )
    time_s, *cells, source, number, n_returns, intensity, code = (
        np.array(column) for column in zip(*rows, strict=True)
    )
    line, column, range_m = (
        values.astype(kind) for values, kind in zip(cells, ("u4", "u4", "f4"), strict=True)
    )
    xyz = np.stack([500_000.0 + range_m, 6_860_000.0 + column, -range_m / 3], axis=1)
    return write_las(
        path,
        xyz,
        code,
        extra={"range": range_m, "scan_line": line, "column": column},
        gps_time=time_s,
        point_source_id=source,
        return_number=number,
        number_of_returns=n_returns,
        intensity=intensity,
    )


@pytest.mark.parametrize("suffix", [".csv", ".laz"])
def test_scanners_missing_lines_and_further_returns(tmp_path, suffix):
    source = two_scanners(tmp_path / "two.las")
    out = tmp_path / f"out{suffix}"
    loaded = config(scanner="point_source_id")
    if suffix == ".laz":  # through a table, since LAS to LAS copies bytes
        convert(source, tmp_path / "two.csv", loaded)
        source = tmp_path / "two.csv"
    summary = convert(source, out, loaded)
    assert any("--scanner point_source_id" in notice for notice in summary.record.notices)
    before = scans(source, loaded)
    after = scans(out, loaded)
    assert sorted(before) == sorted(after) == [3, 8]
    for scanner, block in before.items():
        m = block.points_per_line
        again = after[scanner].range_m[:, :m]
        assert same_bits(block.range_m, np.ascontiguousarray(again))
        assert np.isnan(again[5]).all()
        assert np.isnan(after[scanner].range_m[:, m:]).all()
        for name in ("line", "column", "range_m"):
            order = [
                np.lexsort((b.extra.range_m, b.extra.column, b.extra.line))
                for b in (block, after[scanner])
            ]
            left = getattr(block.extra, name)
            right = getattr(after[scanner].extra, name)
            assert np.array_equal(left[order[0]], right[order[1]])
        assert after[scanner].points_per_line == m
    is_reported = any("scanner 3: 20, scanner 8: 33" in loss for loss in summary.losses)
    assert is_reported == (suffix == ".laz")


def _several(tmp_path: Path) -> tuple[Path, LoadedConfig]:
    return two_scanners(tmp_path / "two.las"), config(scanner="point_source_id")


@pytest.mark.parametrize("suffix", [".npz", ".npy", ".bin"])
def test_several_scanners_need_a_format_that_tells_them_apart(tmp_path, suffix):
    source, loaded = _several(tmp_path)
    with pytest.raises(
        OutputError, match="found scanners 3 and 8, expected one: .* write .csv, .laz or .parquet"
    ):
        convert(source, tmp_path / f"out{suffix}", loaded)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["two.las"]

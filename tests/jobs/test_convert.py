"""Round trips: a stream written in another format and read back is the same stream, as far as the
format holds it."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from prc_cli.config import LoadedConfig, load_config
from prc_cli.core.blocks import join
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


@pytest.mark.parametrize("suffixes", [(".las",), (".csv",), (".csv", ".laz")])
def test_every_return_of_two_scanners_stays_in_its_cell(tmp_path, suffixes):
    """Of different M, with a missing line, shots without return and further returns."""
    rng = np.random.default_rng(7)
    widths = {3: 20, 8: 33}
    lines = [line for line in range(12) if line != 5]
    cells = [(k, line, column) for line in lines for k in widths for column in range(widths[k])]
    n_returns = rng.integers(0, 4, len(cells))
    n_returns[-60:] = 1
    scanner, line, column = np.repeat(cells, n_returns, axis=0).T
    number = np.concatenate([np.arange(n) + 1 for n in n_returns])
    range_m = rng.uniform(2, 60, len(line)).astype(np.float32)
    xyz = np.stack([range_m, column, -range_m], axis=1)
    path = write_las(
        tmp_path / "in.las",
        xyz,
        np.full(len(xyz), 2),
        extra={"range": range_m, "scan_line": line.astype("u4"), "column": column.astype("u4")},
        gps_time=100 + line + column / 64,
        point_source_id=scanner,
        return_number=number,
        number_of_returns=np.repeat(n_returns, n_returns),
    )
    for suffix in suffixes:
        convert(path, tmp_path / f"out{suffix}", config(scanner="point_source_id"))
        path = tmp_path / f"out{suffix}"
    blocks = scans(path, config(scanner="point_source_id"))
    assert {k: block.points_per_line for k, block in blocks.items()} == widths
    for k, block in blocks.items():
        at_line, at_column = np.nonzero(np.isfinite(block.range_m))
        main = np.column_stack([at_line, at_column, block.range_m[at_line, at_column]])
        extra = np.column_stack([block.extra.line, block.extra.column, block.extra.range_m])
        returns = np.column_stack([line, column, range_m])[scanner == k]
        assert sorted([*main.tolist(), *extra.tolist()]) == sorted(returns.tolist())

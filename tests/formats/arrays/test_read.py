"""Range images: shapes, arrays beside the ranges, and every kind of wrong array."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from prc_cli.core.blocks import join
from prc_cli.core.errors import InputError
from prc_cli.core.stream import ScanBlock, ScanStream
from prc_cli.formats.arrays.read import ArrayStream
from prc_cli.formats.options import InputConfig
from tests.clouds import seen

AUTO = InputConfig()


def image(n_lines: int = 7, m: int = 5) -> np.ndarray[Any, Any]:
    ranges = np.random.default_rng(2).uniform(1, 90, (n_lines, m)).astype(np.float32)
    ranges[1, 2] = np.nan
    return ranges


def whole(stream: ScanStream) -> ScanBlock:
    """The stream as one block; a typed parameter, so that mypy holds ArrayStream to the
    protocol."""
    blocks = list(stream.blocks())
    assert [block.first_line for block in blocks] == list(
        np.cumsum([0] + [b.n_lines for b in blocks])[:-1]
    )
    assert all(b.range_m.flags.c_contiguous and b.range_m.dtype == np.float32 for b in blocks)
    return join(blocks)


def save(folder: Path, array: np.ndarray[Any, Any], name: str = "scan.npy") -> Path:
    path = folder / name
    np.save(path, array)
    return path


@pytest.mark.parametrize("chunk", [1, 200])
@pytest.mark.parametrize("clue", ["xyz", "angles", "M"])
@pytest.mark.parametrize("order", ["C", "F"])
def test_rows_that_are_rings_are_exchanged(tmp_path, chunk, clue, order):
    """Rings x azimuth was taken for lines: PRC, or refused."""
    elevation = np.deg2rad(np.linspace(-25, 2, 16))
    azimuth = np.linspace(0, 2 * np.pi, 90)
    ranges = (np.arange(16 * 90).reshape(16, 90) / 100 + 2).astype(np.float32)
    xyz = seen(ranges, azimuth, elevation[:, None])
    beside = {"xyz": {"xyz": xyz}, "angles": {"zenith_deg": 90 - np.rad2deg(elevation)}, "M": {}}
    arrays = {"range_m": ranges, "intensity": 2 * ranges, **beside[clue]}
    path = tmp_path / "a.npz"
    np.savez(path, **{name: np.asarray(value, order=order) for name, value in arrays.items()})
    rules = InputConfig(points_per_line=16 if clue == "M" else None)
    stream = ArrayStream(path, rules, chunk_shots=chunk)
    assert (stream.info.n_lines, stream.info.points_per_line) == (90, 16)
    block = whole(stream)
    np.testing.assert_array_equal(block.range_m, ranges.T)
    np.testing.assert_array_equal(block.intensity, 2 * ranges.T)
    np.testing.assert_array_equal(ranges.ravel()[block.records()], ranges.T)
    assert any(assumption.key == "input.lines" for assumption in stream.info.assumptions)
    if clue == "xyz":
        np.testing.assert_array_equal(block.xyz_m, xyz.transpose(1, 0, 2).astype(np.float32))


# --- damaged files


def test_a_file_that_shrinks_while_it_is_read(tmp_path):
    path = save(tmp_path, np.ones((40_000, 5), np.float32))
    blocks = ArrayStream(path, AUTO, chunk_shots=5000).blocks()
    next(blocks)
    path.write_bytes(path.read_bytes()[:-100_000])
    with pytest.raises(InputError, match=r"the numbers end in row 35000, expected 40000 rows"):
        list(blocks)


def test_a_file_that_changes_between_opening_and_reading(tmp_path):
    path = save(tmp_path, image())
    stream = ArrayStream(path, AUTO)
    save(tmp_path, image(8))
    with pytest.raises(InputError, match="the array has changed since the file was opened"):
        whole(stream)

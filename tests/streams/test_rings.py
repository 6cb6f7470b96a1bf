"""Frames of rings."""

from typing import Any

import numpy as np
import pytest

from prc_cli.config import resolve
from prc_cli.core.errors import InputError
from prc_cli.core.frame import turning
from prc_cli.core.types import I64
from prc_cli.formats.frame import is_frame
from prc_cli.formats.input import Input
from prc_cli.formats.options import InputConfig
from prc_cli.streams.open import open_input
from prc_cli.streams.rings import open_rings
from tests.clouds import seen
from tests.streams.record_lists import MemorySource, Whole, read

N_RINGS = 16
N_LINES = 360
ELEVATION = np.deg2rad(np.linspace(3.0, -24.0, N_RINGS))


def frame(
    seed: int = 0,
    *,
    begin_deg: float = 0.5,
    way: int = 1,
    missing: float = 0.1,
    upwards: bool = False,
) -> tuple[dict[str, Any], I64, I64]:
    """Return the records of a frame, ring after ring, with the line and the ring from below of
    each."""
    rng = np.random.default_rng(seed)
    ring, line = np.divmod(np.arange(N_RINGS * N_LINES), N_LINES)
    from_top = N_RINGS - 1 - ring if upwards else ring
    azimuth = np.deg2rad(begin_deg + way * line * 360 / N_LINES) + np.deg2rad(
        rng.normal(0, 0.05, len(line))
    )
    elevation = ELEVATION[from_top] + np.deg2rad(rng.normal(0, 0.1, len(line)))
    range_m = rng.uniform(3.0, 60.0, len(line))
    keep = rng.random(len(line)) >= missing
    # a long gap in every ring, and a ring that begins late
    keep &= ~((line > 100) & (line < 130)) & ~((ring == 5) & (line < 40))
    records = {
        **dict(zip("xyz", seen(range_m, azimuth, elevation).T, strict=True)),
        "intensity": rng.uniform(0, 1, len(line)).astype(np.float32),
    }
    return (
        {name: value[keep] for name, value in records.items()},
        line[keep],
        N_RINGS - 1 - from_top[keep],
    )


def opened(records: dict[str, Any], chunk_records: int = 1000, **keys: Any) -> Whole:
    return read(
        open_rings(MemorySource(records, chunk_records), InputConfig(lines="rings", **keys))
    )


def cells(whole: Whole, n_records: int) -> tuple[I64, I64]:
    """Return line and column of every record, -1 where it has no cell of its own."""
    line = np.full(n_records, -1)
    column = np.full(n_records, -1)
    where = np.argwhere(whole.record >= 0)
    line[whole.record[whole.record >= 0]], column[whole.record[whole.record >= 0]] = where.T
    return line, column


@pytest.mark.parametrize("way", [1, -1])
@pytest.mark.parametrize("begin_deg", [0.5, 90.0, -179.6, 37.0])
@pytest.mark.parametrize("upwards", [False, True])
def test_every_record_finds_its_cell(way, begin_deg, upwards):
    records, true_line, true_column = frame(3, way=way, begin_deg=begin_deg, upwards=upwards)
    whole = opened(records, points_per_line=N_RINGS, azimuth_step=1.0)
    assert whole.range_m.shape == (N_LINES, N_RINGS)
    assert whole.tally.n_collisions == 0
    line, column = cells(whole, len(true_line))
    assert np.array_equal(column, true_column)
    # where the turn begins is a matter of half a line
    shift = np.bincount(line - true_line + N_LINES).argmax() - N_LINES
    off = line - true_line - shift
    assert np.mean(off == 0) > 0.97
    assert np.abs(off).max() <= 1
    xyz = np.concatenate([block.xyz_m for block in whole.blocks if block.xyz_m is not None])
    range_m = np.sqrt(records["x"] ** 2 + records["y"] ** 2 + records["z"] ** 2)
    np.testing.assert_allclose(whole.range_m[line, column], range_m, rtol=1e-6)
    np.testing.assert_allclose(xyz[line, column, 2], records["z"], rtol=1e-6)
    intensity = np.concatenate(
        [block.intensity for block in whole.blocks if block.intensity is not None]
    )
    assert np.array_equal(intensity[line, column], records["intensity"])
    assert np.array_equal(np.isnan(whole.range_m), whole.record < 0)


@pytest.mark.filterwarnings("error")
def test_any_records_become_a_frame_or_are_refused_in_one_line():
    rng = np.random.default_rng(9)
    n_read = 0
    refusals = []
    for _ in range(60):
        n = int(rng.integers(0, 400))
        n_turns = float(rng.uniform(0, 9))
        azimuth = np.linspace(0, 2 * np.pi * n_turns, n) + rng.normal(
            0, rng.choice([0.0, 0.01, 1.0]), n
        )
        scale = 10.0 ** float(rng.integers(-30, 30))
        xyz = np.stack([np.cos(azimuth), np.sin(azimuth), -0.02 * azimuth], axis=1) * scale
        xyz[rng.random(n) < 0.05] = rng.choice([0.0, np.nan, np.inf])
        try:
            whole = opened(dict(zip("xyz", xyz.T, strict=True)), int(rng.integers(1, 100)))
        except InputError as refusal:
            refusals.append(str(refusal))
            continue
        n_read += 1
        # rows of NaN are shots without return, all others have a cell or are counted
        n_missing = np.count_nonzero(np.isnan(xyz).any(axis=1))
        n_in_cells = np.count_nonzero(whole.record >= 0)
        assert n_in_cells + len(whole.extras) + whole.tally.n_unplaced + n_missing == n
    assert min(n_read, len(refusals)) > 8
    assert not any("\n" in message for message in refusals)


def test_a_frame_in_column_order_is_told_in_a_dump(tmp_path, real_data):
    source = Input.of(real_data / "ouster" / "rellis_frame000104.ply").records()
    assert source is not None
    names = ("x", "y", "z", "intensity")
    chunks = [np.stack([chunk.values[name] for name in names], 1) for chunk in source.chunks(names)]
    np.concatenate(chunks).astype("<f4").tofile(tmp_path / "frame.bin")
    assert is_frame(tmp_path / "frame.bin")
    scan, loaded = resolve(tmp_path / "frame.bin")
    with pytest.raises(
        InputError, match=r"turn 1\.0 times .*column after column, a frame needs the ring"
    ):
        open_input(scan, loaded.config.input)


@pytest.mark.parametrize("has_rings", [True, False])
def test_a_frame_on_other_axes_has_the_cells_of_its_own(has_rings):
    """Pitched by 6 degrees, z from the ground.

    Cells are those of the scanner, coordinates those of the input.
    """
    records, _, ring = frame()
    if has_rings:
        records["ring"] = ring
    n = len(ring)
    wanted = cells(opened(records), n)
    xyz_m = np.stack([records[axis] for axis in "xyz"], axis=1)
    elsewhere = xyz_m @ turning(np.deg2rad([0.0, 6.0, 0.0])) + [0.0, 0.0, 1.8]
    whole = opened({**records, **dict(zip("xyz", elsewhere.T, strict=True))})
    filled = cells(whole, n)
    assert (filled[1] == wanted[1]).mean() > 0.999
    # azimuths begin where the turned x axis is
    assert (np.abs(filled[0] - wanted[0]) <= 1).mean() > 0.97
    assert whole.blocks[0].frame is not None
    assert whole.blocks[0].frame.lean_deg == pytest.approx(6.0, abs=0.1)

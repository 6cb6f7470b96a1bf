"""Blocks of k lines with look-ahead do not depend on the blocks of the input."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from prc_cli.core.blocks import cut, look_ahead_lines, regroup
from prc_cli.core.stream import ExtraReturns, ReadTally, ScanBlock


def stream(
    n_lines: int,
    m: int,
    *,
    scanner: int = 0,
    dense: bool = False,
) -> ScanBlock:
    """Return a whole stream as one block; every value tells its cell."""
    rng = np.random.default_rng(n_lines * 1000 + m)
    flat = np.arange(n_lines * m, dtype=np.float64).reshape(n_lines, m)
    line = np.sort(rng.integers(0, n_lines, 2 * n_lines)).astype(np.int32)
    column = rng.integers(0, m, len(line)).astype(np.int32)
    return ScanBlock(
        first_line=0,
        range_m=(flat + 1).astype(np.float32),
        record=None if dense else flat.astype(np.int64) * 3,
        scanner=scanner,
        time_s=flat / 7,
        xyz_m=np.stack([flat, -flat, 2 * flat], axis=-1).astype(np.float32),
        intensity=(flat + 0.5).astype(np.float32),
        angle_rad=np.linspace(0, 1, m),
        extra=ExtraReturns(
            line,
            column,
            (line * m + column + 0.25).astype(np.float32),
            np.arange(len(line)) + 10_000,
        ),
    )


def pieces(block: ScanBlock, sizes: list[int]) -> Iterator[ScanBlock]:
    """Cut a stream into blocks of the given sizes (repeated), each with a tally of one
    collision."""
    first = 0
    turn = 0
    while first < block.n_lines:
        stop = min(first + sizes[turn % len(sizes)], block.n_lines)
        yield replace(cut(block, first, stop), tally=ReadTally(n_collisions=1))
        first = stop
        turn = turn + 1


def check(blocks: list[ScanBlock], whole: ScanBlock, k: int) -> None:
    """Compare with blocks cut straight out of the whole."""
    assert [block.n_lines for block in blocks[:-1]] == [k] * (len(blocks) - 1)
    assert 1 <= blocks[-1].n_lines <= k
    ahead = look_ahead_lines(whole.points_per_line)
    for i, block in enumerate(blocks):
        lines = slice(i * k, i * k + block.n_lines)
        assert block.first_line == i * k
        assert block.scanner == whole.scanner
        assert np.array_equal(block.range_m, whole.range_m[lines])
        assert block.range_m.flags.c_contiguous
        assert np.array_equal(block.records(), whole.records()[lines])
        for name in ("time_s", "xyz_m", "intensity"):
            assert np.array_equal(getattr(block, name), getattr(whole, name)[lines]), name
        assert block.angle_rad is whole.angle_rad
        assert block.next_m is not None
        assert np.array_equal(block.next_m, whole.range_m[lines.stop : lines.stop + ahead])
        inside = (whole.extra.line >= lines.start) & (whole.extra.line < lines.stop)
        assert np.array_equal(block.extra.line, whole.extra.line[inside] - lines.start)
        assert np.array_equal(block.extra.column, whole.extra.column[inside])
        assert np.array_equal(block.extra.range_m, whole.extra.range_m[inside])
        assert np.array_equal(block.extra.record, whole.extra.record[inside])


@given(
    n_lines=st.integers(1, 40),
    m=st.integers(1, 7),
    k=st.integers(1, 12),
    sizes=st.lists(st.integers(1, 15), min_size=1, max_size=5),
    dense=st.booleans(),
)
def test_any_cut_gives_the_same_blocks(
    n_lines,
    m,
    k,
    sizes,
    dense,
):
    whole = stream(n_lines, m, dense=dense)
    parts = list(pieces(whole, sizes))
    blocks = list(regroup(iter(parts), k))
    check(blocks, whole, k)
    assert sum((block.tally for block in blocks), ReadTally()) == ReadTally(n_collisions=len(parts))

"""Blocks in threads and one after the other give the same bytes, for any number of threads."""

from __future__ import annotations

import numpy as np
import pytest

from prc_cli.core.errors import InputError
from prc_cli.core.stream import ScanBlock
from prc_cli.core.types import F32, I64, U8
from prc_cli.methods.base import Wanted
from prc_cli.methods.prc import pipeline
from prc_cli.methods.prc.pipeline import Prc, PrcParams
from prc_cli.methods.run import run_blocks
from tests.methods.prc.streams import (
    random_params,
    random_stream,
    run_stream,
)


def run_threads(
    stream: F32,
    params: PrcParams,
    threads: int,
    *,
    segments: bool,
) -> tuple[U8, list[I64 | None]]:
    blocks = iter([ScanBlock(0, stream)])
    labelled = list(
        run_blocks(blocks, Prc(params), threads=threads, wanted=Wanted(segments=segments))
    )
    return np.concatenate([item.labels for item in labelled]), [item.segments for item in labelled]


@pytest.mark.slow
@pytest.mark.parametrize("threads", [1, 2, 5])
def test_threads_change_nothing(threads: int) -> None:
    for seed in range(120):
        rng = np.random.default_rng(9000 + seed)
        params = random_params(rng)
        stream = random_stream(rng)
        expected, segments = run_stream(stream, params)
        labels, ids = run_threads(stream, params, threads, segments=True)
        np.testing.assert_array_equal(labels, expected)
        np.testing.assert_array_equal(
            np.concatenate([part for part in ids if part is not None]), segments
        )
        labels, ids = run_threads(stream, params, threads, segments=False)
        np.testing.assert_array_equal(labels, expected)
        assert ids == [None] * len(ids)


@pytest.mark.parametrize("stage", ["background", "identify", "count_smooth", "urban"])
def test_error_in_any_stage_is_the_one_that_is_seen(
    monkeypatch: pytest.MonkeyPatch, stage: str
) -> None:
    """A block that fails before, in, between and after the turns.

    The blocks before it come out, nobody waits.
    """
    stream = np.full((60, 40), 20.0, np.float32)
    stream[33, 7] = 5.0
    plain = getattr(pipeline, stage)
    calls: list[None] = []

    def fails(*arguments: object) -> object:
        calls.append(None)
        if len(calls) == 4:
            raise MemoryError(stage)
        return plain(*arguments)

    monkeypatch.setattr(pipeline, stage, fails)
    n_found = 0
    with pytest.raises(MemoryError, match=stage):
        for _ in run_blocks(
            iter([ScanBlock(0, stream)]), Prc(PrcParams(lines_per_block=6)), threads=3
        ):
            n_found += 1
    assert n_found <= 5, "blocks are begun in order, and calls of a stage nearly so"


def test_blocks_that_do_not_fit_are_refused() -> None:
    blocks = [ScanBlock(0, np.ones((4, 5), np.float32)), ScanBlock(4, np.ones((5, 4), np.float32))]
    with pytest.raises(InputError, match=r"found an array of shape \(\d, 4\)"):
        list(run_blocks(iter(blocks), Prc(PrcParams(lines_per_block=2)), threads=2))

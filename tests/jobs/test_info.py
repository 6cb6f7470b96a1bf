"""What ``prc info`` finds beyond the header."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from prc_cli.core.stream import ScanBlock
from prc_cli.jobs import info


def test_counts_are_those_of_all_blocks_and_the_median_that_of_the_first_shots(
    monkeypatch,
):
    monkeypatch.setattr(info, "SAMPLE_SHOTS", 100)
    image = np.random.default_rng(1).uniform(1, 9, (30, 7)).astype(np.float32)
    image[::2, 2] = np.nan
    image[29, 6] = 0.5
    time_s = 0.01 * np.arange(30.0)[:, None] + np.zeros(7)
    blocks = [
        ScanBlock(
            first, image[first : first + 6], time_s=time_s[first : first + 6], scanner=scanner
        )
        for first, scanner in ((0, 1), (6, 2), (12, 1), (18, 1), (24, 1))
    ]
    stream: Any = SimpleNamespace(blocks=lambda: blocks, info=SimpleNamespace(line_hz=None))
    facts, sample = info._measure(stream, with_ranges=True)
    ours = np.concatenate([image[:6], image[12:]]).ravel()
    np.testing.assert_array_equal(sample, ours[:100])
    assert (facts.n_lines, facts.n_shots, facts.n_missing) == (30, 210, 15)
    assert facts.scanners == (1, 2)
    expected = (0.5, np.nanmedian(ours[:100]), np.nanmax(image))
    np.testing.assert_allclose(facts.range_m, expected)
    assert facts.line_hz == pytest.approx(100.0)
    facts, sample = info._measure(stream, with_ranges=False)
    assert (facts.range_m, facts.correlation, sample) == (None, None, None)

"""Streams of few lines are told, and where all shots are in one line no rule has found the
lines."""

import numpy as np
import pytest

from prc_cli.core.findings import Verdict
from prc_cli.core.stream import ScanBlock, StreamInfo
from prc_cli.formats.options import InputConfig
from prc_cli.streams.evidence.checks import check_few_lines
from prc_cli.streams.evidence.watch import watched


@pytest.mark.parametrize(
    "n_lines, n_shots, verdict",
    [
        (1, 55_313, Verdict.AGAINST),
        (1, 2_000, Verdict.DOUBTFUL),
        (23, 50_000, Verdict.DOUBTFUL),
        (24, 50_000, Verdict.FINE),
        (3, 900, None),
    ],
)
def test_few_lines_are_told(n_lines, n_shots, verdict):
    verdicts = [finding.verdict for finding in check_few_lines(n_lines, n_shots)]
    assert verdicts == ([] if verdict is None else [verdict])


class OneBlock:
    info = StreamInfo("drive.npz", "array", 500, None, None)

    def blocks(self) -> list[ScanBlock]:
        return [ScanBlock(0, np.full((10, 500), 5.0, np.float32), is_last=True)]


@pytest.mark.parametrize("inputs, is_told", [({}, True), ({"first": "10lines"}, False)])
def test_a_window_may_be_short(inputs, is_told):
    stream = watched(OneBlock(), InputConfig(**inputs))
    assert len(list(stream.blocks())) == 1
    assert ("few-lines" in {finding.check for finding in stream.observed.findings}) == is_told

"""Streams as rows and as new LAS files: every return once, whatever its class."""

from dataclasses import replace

import laspy
import numpy as np

from prc_cli.core.classes import NO_CODE
from prc_cli.core.stream import ExtraReturns
from prc_cli.formats.registry import by_suffix
from prc_cli.formats.testing import example
from prc_cli.formats.writing.rows import stream_rows
from tests.formats.common import run_record

LAS = by_suffix("streams")[".las"]


def test_rows_do_not_depend_on_how_lines_are_cut():
    item, _ = example(LAS)
    places = np.array([[0, 0], [1, 11], [1, 11], [2, 4], [4, 11]], np.int32)
    extra = ExtraReturns(
        places[:, 0], places[:, 1], np.arange(1, 6, dtype=np.float32), np.arange(5)
    )
    item = replace(item, block=replace(item.block, extra=extra), extra_codes=np.arange(5))
    whole = stream_rows(item, slice(0, 5))
    parts = [stream_rows(item, slice(first, first + 1)) for first in range(5)]
    for name, values in whole.items():
        np.testing.assert_array_equal(np.concatenate([part[name] for part in parts]), values)
    shot = (whole["line"] == 1) & (whole["column"] == 11)
    chosen_m = float(item.block.range_m[1, 11])
    assert whole["range_m"][shot].tolist() == [np.float32(chosen_m), 2.0, 3.0]
    assert whole["return_number"][shot].tolist() == [3, 1, 2]
    assert whole["number_of_returns"][shot].tolist() == [3, 3, 3]
    assert whole["class"][shot].tolist() == [2, 1, 2]
    assert len(whole["line"]) == item.block.range_m.size + 5


def test_codes_that_a_byte_cannot_hold_are_lost_and_counted(tmp_path):
    item, shape = example(LAS)
    place = np.flatnonzero(np.isfinite(item.block.range_m))[:5]
    codes = np.full(item.block.range_m.shape, 2)
    codes.flat[place] = 0, 255, 256, -5, NO_CODE
    with LAS.stream_writer(tmp_path / "o.las", shape) as writer:
        writer.add_item(replace(item, codes=codes))
        record = writer.finish(run_record())
        assert "; ".join(writer.losses).startswith("2 class codes outside 0 to 255")
    written = laspy.read(tmp_path / "o.las").classification
    assert np.asarray(written)[:5].tolist() == [0, 255, 1, 1, 1]
    counts = {count.code: count.count for count in record.classes}
    assert counts == {0: 1, 255: 1, 1: 3, 2: len(written) - 5}

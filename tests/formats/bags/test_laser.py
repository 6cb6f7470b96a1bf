"""Laser scans whose beams change, and lines in parts: all beams lie on one grid of angles."""

from pathlib import Path

import numpy as np

from prc_cli.core.blocks import join
from prc_cli.core.stream import ScanBlock
from prc_cli.formats.bags.read import BagStream
from prc_cli.formats.options import InputConfig
from tests.formats.bags import recordings as made

STEP = 3.0 / (made.M - 1)


def read_parts(
    folder: Path, parts: list[tuple[np.ndarray, dict[str, float]]]
) -> tuple[BagStream, ScanBlock]:
    """Read a bag with a message for every part."""
    sent = []
    for number, (range_m, changes) in enumerate(parts):
        time_ns = made.START_NS + number * made.PERIOD_NS
        message = made.laser(made.STORES[1], time_ns, range_m, **changes)
        sent.append(made.Sent("/scan", "sensor_msgs/msg/LaserScan", time_ns, message))
    stream = BagStream(made.write_bag(folder / "a.bag", sent), InputConfig())
    return stream, join(list(stream.blocks()))


def clean(range_m: np.ndarray) -> np.ndarray:
    return np.where((range_m >= 0.1) & (range_m < 100.0), range_m, np.nan)


def test_a_first_angle_that_is_a_step_off_moves_the_columns(tmp_path):
    ranges = made.ranges()
    _, block = read_parts(
        tmp_path, [(row, {"angle_min": -1.5 + STEP * (k % 2)}) for k, row in enumerate(ranges)]
    )
    assert block.points_per_line == made.M + 1
    np.testing.assert_array_equal(block.range_m[0::2, :-1], clean(ranges[0::2]))
    np.testing.assert_array_equal(block.range_m[1::2, 1:], clean(ranges[1::2]))


def test_parts_of_a_line_join(tmp_path):
    ranges = made.ranges()
    ranges[:, :2] = 0.1, 100.0
    parts = []
    for row in ranges:
        parts += [(row[k : k + 10], {"angle_min": -1.5 + STEP * k}) for k in range(0, made.M, 10)]
    stream, block = read_parts(tmp_path, parts)
    np.testing.assert_array_equal(block.range_m, clean(ranges))
    assert stream.info.n_lines is None
    assert "4 messages are a line of 40 beams" in stream.info.facts.notes[0]
    assert block.time_s is not None
    assert np.allclose(np.diff(block.time_s[:, ::10], axis=1), made.PERIOD_NS * 1e-9, atol=1e-6)
    assert block.tally.n_unplaced == 0

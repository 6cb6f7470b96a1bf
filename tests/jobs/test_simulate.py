"""Simulated scans as files: every format gives back stream and reference, for any number of
threads."""

import tracemalloc
from typing import Any

import numpy as np
import pytest

from prc_cli.core.blocks import join
from prc_cli.core.errors import ConfigError
from prc_cli.core.stream import LabelledBlock, ScanBlock
from prc_cli.jobs.simulate import simulate
from prc_cli.simulation.settings import Kind, Settings, load_settings, open_simulation

SCANNER: dict[str, Any] = {"points_per_line": 240, "line_hz": 20.0}
LINES = 70


def small(kind: Kind, **options: Any) -> Settings:
    """A scan of a few thousand shots; more lines than are simulated together."""
    table: dict[str, Any] = {"seed": 3, "sight_m": 30.0, "lines": LINES, "scanner": SCANNER}
    if kind == "street-scan":
        table["scanner"] = {"points_per_line": 120, "azimuth_step_deg": 360 / LINES}
    return load_settings(kind, options=table | options)


def whole(items: list[LabelledBlock]) -> tuple[ScanBlock, Any]:
    return join([item.block for item in items]), np.concatenate([item.labels for item in items])


def same(left: Any, right: Any) -> bool:
    return np.array_equal(left, right, equal_nan=True)


@pytest.fixture(scope="module")
def drive():
    return whole(list(open_simulation("street", small("street"), threads=1).scan.labelled_blocks()))


@pytest.mark.parametrize("lines", [1, 7, 64, 1000])
def test_neither_blocks_nor_threads_change_anything(drive, lines):
    scan = open_simulation("street", small("street"), threads=2).scan
    items = list(scan.labelled_blocks(lines))
    assert max(item.block.n_lines for item in items) == min(lines, 64)
    block, labels = whole(items)
    assert same(labels, drive[1])
    for name in ("range_m", "time_s", "intensity"):
        assert same(getattr(block, name), getattr(drive[0], name))
    assert [item.block.is_last for item in items] == [False] * (len(items) - 1) + [True]
    with pytest.raises(ConfigError, match="found 0, expected at least 1 line"):
        next(scan.blocks(0))


@pytest.mark.slow
def test_memory_does_not_grow_with_the_length(tmp_path):
    def peak(lines: int) -> int:
        settings = small("street", lines=lines, trajectory={"stop_every_m": 0.0, "speed_m_s": 1.0})
        tracemalloc.start()
        simulate("street", tmp_path / "a.npz", settings, threads=1, overwrite=True)
        peak_bytes = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return peak_bytes

    peak(LINES)
    assert peak(12 * LINES) < 1.5 * peak(4 * LINES)


def test_a_frame_that_nobody_knows_is_refused(tmp_path):
    pytest.importorskip("pyproj")
    with pytest.raises(ConfigError, match="drive.laz: .*'EPSG:99999' cannot be used"):
        simulate("street", tmp_path / "drive.laz", small("street", frame={"crs": "EPSG:99999"}))

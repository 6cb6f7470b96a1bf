"""Labels do not depend on the lines per block: on a street, a push-broom strip and a turning scanner."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from prc_cli.core.classes import Label
from prc_cli.core.stream import ScanBlock
from prc_cli.core.types import F32, F64, U8
from prc_cli.jobs.classify import label_blocks
from prc_cli.methods.fused.pipeline import FusedParams
from prc_cli.simulation.settings import load_settings, open_simulation

MOST = 0.001
"""Share of the labels that may change: everywhere none but in slow drives."""


def labels(range_m: F32, beam_rad: F64, k: int) -> U8:
    block = ScanBlock(0, range_m, beam_rad=beam_rad, is_last=True)
    return np.concatenate([item.labels for item in label_blocks(iter([block]), FusedParams(lines_per_block=k))])


def changed(range_m: F32, beam_rad: F64, *sizes: int) -> list[float]:
    """Return the share of the labels that change with the lines per block."""
    whole = labels(range_m, beam_rad, len(range_m))
    assert len(np.unique(whole)) > 5
    return [float((labels(range_m, beam_rad, k) != whole)[whole != Label.MISSING].mean()) for k in sizes]


@pytest.mark.parametrize("scanner", ["photon-80", "sick-push-broom"])
def test_on_a_street(scanner: str) -> None:
    """With range noise that is measured anew along the way, and cars that are found by lines on both sides."""
    options = {"seed": 5, "lines": 150, "scanner": {"name": scanner, "noise_m": 0.012, "points_per_line": 361}}
    scan = open_simulation("street", load_settings("street", options=options), threads=1).scan
    blocks = list(scan.blocks())
    angle_rad, down_rad = blocks[0].angle_rad, scan.info.down_rad
    assert angle_rad is not None
    assert down_rad is not None
    beam_rad = (angle_rad - down_rad + np.pi) % (2 * np.pi) - np.pi
    assert changed(np.concatenate([block.range_m for block in blocks]), beam_rad, 1, 16, 37, 128) == [0] * 4


@pytest.mark.data
def test_on_a_push_broom_strip(real_data: Path) -> None:
    """Some of its lines are so close together that every second one is a stream of its own."""
    table = np.genfromtxt(real_data / "oakland" / "oakland_2.csv.gz", delimiter=",", skip_header=1, usecols=(0, 2, 3))
    n_lines = len(np.unique(table[:, 0]))
    range_m = table[:, 2].reshape(n_lines, -1).astype(np.float32)
    beam_rad = np.deg2rad(table[: range_m.shape[1], 1])
    assert max(changed(range_m, beam_rad, 1, 16)) < MOST

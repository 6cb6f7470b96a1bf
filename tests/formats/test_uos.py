"""Scans of 3DTK: centimetres, y up."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from prc_cli.core.blocks import join
from prc_cli.formats.options import InputConfig
from prc_cli.streams.open import open_input

RULES: dict[str, Any] = {"points_per_line": 2, "range": "sensor-xyz"}


def test_centimetres_with_y_up_become_metres_with_z_up(tmp_path: Path) -> None:
    path = tmp_path / "scan000.3d"
    path.write_text("100 200 300\n0 3.1e-5 50\n-1 -2 -3\n0 0 3270\n")
    block = join(list(open_input(path, InputConfig(**RULES, max_range=32.0)).blocks()))
    assert block.xyz_m is not None
    np.testing.assert_allclose(block.xyz_m[0, 0], [1, 3, 2])
    np.testing.assert_allclose(block.range_m, [[np.sqrt(14), 0.5], [np.sqrt(14) / 100, np.nan]], rtol=1e-6)


@pytest.mark.data
def test_the_sample_of_3dtk(real_data: Path) -> None:
    rules = InputConfig(points_per_line=360, range="sensor-xyz", max_range=32.7)
    stream = open_input(real_data / "organised" / "scan000.3d", rules)
    block = join(list(stream.blocks()))
    assert block.range_m.shape == (226, 360)
    assert np.isnan(block.range_m).sum() == 1481
    assert np.nanmax(block.range_m) < 32.7

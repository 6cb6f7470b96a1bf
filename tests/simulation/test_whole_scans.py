"""Whole simulated drives and static scans: classes, their shares and positions."""

from __future__ import annotations

import numpy as np
import pytest

from prc_cli.core.classes import Label
from tests.simulated import drive_arrays, drive_scan, static_arrays, static_scan

KNOWN_STATIC = {
    Label.MISSING, Label.UNCLASSIFIED, Label.NOISE, Label.GROUND, Label.HORIZONTAL, Label.CURB, Label.VERTICAL,
    Label.VEGETATION, Label.CAR,
}  # fmt: skip
KNOWN_DRIVE = (KNOWN_STATIC - {Label.HORIZONTAL, Label.VERTICAL}) | {Label.BUILDING, Label.POLE}


def test_the_beginning_does_not_depend_on_the_length() -> None:
    for make in (drive_scan, lambda n, m, seed: static_scan(125.12 / m, 1.0, seed, turn=float(n))):
        short = [item for item in make(70, 180, 4).labelled_blocks(70) if item.block.first_line < 64]
        long = [item for item in make(140, 180, 4).labelled_blocks(70) if item.block.first_line < 64]
        assert [item.labels.tobytes() for item in short] == [item.labels.tobytes() for item in long]
        assert [item.block.range_m.tobytes() for item in short] == [item.block.range_m.tobytes() for item in long]


@pytest.mark.parametrize("kind", ["drive", "static"])
def test_what_every_scan_keeps(kind: str) -> None:
    is_drive = kind == "drive"
    for seed in (1, 2):
        block, labels = drive_arrays(130, 360, seed) if is_drive else static_arrays(0.5, 3.0, seed)
        scanner = (drive_scan(1, 360, seed) if is_drive else static_scan(0.5, 3.0, seed)).scanner
        assert np.array_equal(np.isnan(block.range_m), labels == Label.MISSING)
        seen = ~np.isnan(block.range_m)
        assert block.range_m[seen].min() >= scanner.min_range_m
        assert block.range_m[seen].max() <= scanner.max_range_m
        assert {Label(one) for one in np.unique(labels)} <= (KNOWN_DRIVE if is_drive else KNOWN_STATIC)
        if block.xyz_m is not None:
            assert np.allclose(np.linalg.norm(block.xyz_m[seen], axis=1), block.range_m[seen], rtol=1e-6)
            assert np.isnan(block.xyz_m[~seen]).all()

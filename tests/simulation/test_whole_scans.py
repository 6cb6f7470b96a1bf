"""Whole simulated drives and static scans: classes, their shares and positions."""

from __future__ import annotations

import numpy as np
import pytest

from prc_cli.core.classes import Label
from prc_cli.simulation.settings import load_settings, open_simulation
from prc_cli.simulation.street.plan import ROAD_HALF_M
from prc_cli.simulation.street.road import LANE_M
from tests.simulated import HEIGHT_M, drive_arrays, drive_scan, static_arrays, static_scan

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


def test_shares_of_drives() -> None:
    labels = np.concatenate([drive_arrays(300, 720, seed)[1] for seed in (1, 2)])
    share = np.bincount(labels.ravel(), minlength=len(Label)) / labels.size
    assert 0.1 < share[Label.MISSING] < 0.45
    assert share[Label.GROUND] > 0.3
    assert share[Label.BUILDING] > 0.1
    assert share[Label.VEGETATION] > 0.03
    assert share[Label.CAR] > 0.01
    assert 0.01 < share[Label.NOISE] < 0.1
    assert share[Label.CURB] > 0.001
    assert share[Label.POLE] + share[Label.UNCLASSIFIED] > 0.0005


def test_shares_of_static_scans() -> None:
    scans = [static_arrays(0.5, 2.0, seed)[1] for seed in (2, 3)]
    labels = np.concatenate(scans)
    missing = labels == Label.MISSING
    assert 0.25 < missing.mean() < 0.65
    assert missing[:, -40:].mean() > 0.8  # sky
    share = np.bincount(labels[~missing], minlength=len(Label)) / np.count_nonzero(~missing)
    for label, low, high in (
        (Label.GROUND, 0.3, 0.65),
        (Label.VERTICAL, 0.1, 0.5),
        (Label.VEGETATION, 0.03, 0.3),
        (Label.CAR, 0.01, 0.25),
        (Label.HORIZONTAL, 0.03, 0.25),
        (Label.CURB, 0.002, 0.03),
        (Label.NOISE, 0.0005, 0.02),
    ):
        assert low < share[label] < high, label.name


def test_road_and_curb_lie_where_they_should() -> None:
    """A straight and level street, seen from a tripod in it."""
    scene = {"curves": 0, "hills": 0, "name": "residential"}
    options = {"seed": 8, "scene": scene, "scanner": {"azimuth_step_deg": 1.0}}
    scan = open_simulation("street-scan", load_settings("street-scan", options=options), with_world=True).scan
    items = list(scan.simulated())
    labels = np.concatenate([item.labelled.labels for item in items])
    xyz = np.concatenate([item.labelled.block.xyz_m for item in items if item.labelled.block.xyz_m is not None])
    world = np.concatenate([item.world_m for item in items if item.world_m is not None])
    world[..., 1] += LANE_M  # the way that is driven lies at 0
    near = np.hypot(xyz[..., 0], xyz[..., 1]) < 6.0
    assert np.median(xyz[..., 2][near & (labels == Label.GROUND)]) == pytest.approx(-HEIGHT_M, abs=0.06)
    close = np.abs(xyz[..., 0]) < 10.0
    curb = world[close & (labels == Label.CURB)]
    assert len(curb) > 200
    # a few belong to a side street
    assert np.quantile(np.abs(np.abs(curb[:, 1]) - ROAD_HALF_M), 0.9) < 0.05
    assert 0.05 < np.ptp(curb[:, 2]) < 0.25
    sidewalk = close & (labels == Label.HORIZONTAL) & (np.abs(world[..., 1]) < ROAD_HALF_M + 1.5)
    sidewalk &= np.abs(world[..., 1]) > ROAD_HALF_M
    assert np.median(world[sidewalk][:, 2]) > np.quantile(curb[:, 2], 0.9) - 0.03

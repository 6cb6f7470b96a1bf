"""Heights above the ground, of every method that has one."""

from dataclasses import replace

import numpy as np
import pytest

from prc_cli.config import load_config
from prc_cli.core.stream import ScanBlock
from prc_cli.jobs.classify import classify
from prc_cli.methods.fused.confidence import true_heights
from tests.methods.fused.street_lines import BEAM, BUILDING, GROUND, HEIGHT_M, results, street_lines


@pytest.mark.parametrize("preset", ["fused", "fused-forest", "street-scan"])
def test_heights_are_those_above_the_road(preset):
    ranges, kind = street_lines(150)
    above_m = results(preset, "above_m", ranges)
    assert above_m.dtype == np.float32
    assert (np.isnan(above_m) == np.isnan(ranges)).mean() > 0.999
    expected = HEIGHT_M - ranges * np.cos(BEAM)
    road = (kind == GROUND) & np.isfinite(above_m) & (np.abs(expected) < 0.05)
    assert np.quantile(np.abs(above_m - expected)[road], 0.99) < 0.08
    facade = (kind == BUILDING) & np.isfinite(above_m)
    facade[50:100] = False  # behind the car
    assert (
        np.quantile(np.abs(above_m - expected)[facade], 0.9) < 0.16
    )  # the sidewalk before it is 0.12 m higher


def test_a_leaning_plane_has_true_heights():
    ranges = street_lines(20)[0]
    up = -ranges * np.cos(BEAM) * 0.8
    xyz = np.stack(
        [np.sqrt(np.maximum(ranges**2 - up**2, 0)), np.zeros_like(up), up], axis=-1
    ).astype(np.float32)
    block = ScanBlock(0, ranges, xyz_m=xyz, beam_rad=BEAM)
    above = np.where(np.arange(ranges.size).reshape(ranges.shape), np.float32(2.0), np.float32(1e9))
    true_m = true_heights(above, block)
    assert np.isnan(true_m[0, 0])
    np.testing.assert_allclose(true_m[1:], 1.6, rtol=1e-5)
    np.testing.assert_array_equal(true_heights(above, replace(block, xyz_m=None))[1:], above[1:])


def test_prc_has_none(tmp_path):
    np.savez(tmp_path / "s.npz", range_m=street_lines(140)[0], angle_deg=np.rad2deg(BEAM))
    config = load_config(preset="prc-2019-urban", options={"output": {"stages": True}})
    classify(tmp_path / "s.npz", tmp_path / "o.csv", config)
    heading = (tmp_path / "o.csv").read_text().splitlines()[0]
    assert heading == "record,class,name,critical_zeta_p,critical_zeta_s"


def test_a_stream_may_begin_amid_a_line_below_eaves():
    ranges = street_lines(60)[0]
    degrees = np.rad2deg(BEAM)
    ranges[0] = np.where((degrees > 100) & (degrees < 110), -0.3 / np.cos(BEAM), np.nan)
    above_m = results("fused", "above_m", ranges)[1:, np.abs(degrees) < 45]
    assert np.nanquantile(np.abs(above_m), 0.9) < 0.1

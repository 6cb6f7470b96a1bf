"""Straight down in the real scans, and the lines of the real frame."""

from __future__ import annotations

from pathlib import Path

import laspy
import numpy as np
import pytest

from prc_cli.config import LoadedConfig, load_config
from prc_cli.core.stream import ScanStream
from prc_cli.core.types import F64
from prc_cli.jobs.classify import classify, open_stream
from prc_cli.jobs.evaluate import evaluate
from prc_cli.streams.beams import with_beams
from tests.profiler import jakarto, jakarto_input, scanner_positions, write_trajectory
from tests.streams.beam_lines import is_strictly_monotone
from tests.streams.record_lists import read

pytestmark = pytest.mark.data

ROOT = Path(__file__).resolve().parents[2]


def opened(source: Path, loaded: LoadedConfig) -> ScanStream:
    return with_beams(open_stream(source, loaded), loaded.config.input)


def beams_of(stream: ScanStream) -> F64:
    beam = next(iter(stream.blocks())).beam_rad
    assert beam is not None
    assert is_strictly_monotone(beam)
    return beam


@pytest.mark.parametrize("strip", [1, 2, 3])
def test_oakland_counts_its_angles_from_nadir(real_data: Path, strip: int) -> None:
    source = real_data / "oakland" / f"oakland_{strip}.csv.gz"
    stream = opened(source, load_config())
    assert stream.info.down_rad == pytest.approx(0.0, abs=np.deg2rad(0.15))
    beam, angle = beams_of(stream), stream.info.angle_rad
    assert angle is not None
    assert np.abs(beam - angle).max() < np.deg2rad(0.15)


def test_profiler_with_a_trajectory(real_data: Path, tmp_path: Path) -> None:
    source, recovered = jakarto(real_data)
    las = laspy.read(source)
    write_trajectory(tmp_path / "drive.csv", scanner_positions(las, recovered))
    stream = opened(source, load_config(options={"input": jakarto_input(tmp_path / "drive.csv")}))
    along = np.rad2deg(np.unwrap(beams_of(stream)))
    step = np.diff(along)
    # the whole circle, evenly but for what rounded times do to the columns
    assert abs(along[-1] - along[0]) == pytest.approx(360.0, abs=0.5)
    assert np.median(np.abs(step)) == pytest.approx(360 / 5099, rel=0.02)
    assert np.abs(step).max() < 1.0
    # its plane leans over by more than a third of a right angle: heights fall with the cosine of the beam, times that
    # of the lean
    for block in stream.blocks():
        assert block.xyz_m is not None
        assert block.beam_rad is not None
        below = -block.xyz_m[..., 2] / block.range_m
        fall = np.cos(block.beam_rad)
        lean = float(np.nanmedian((below / fall)[:, np.abs(fall) > 0.5]))
        assert np.rad2deg(np.arccos(lean)) == pytest.approx(38.7, abs=1.5)
        assert np.nanpercentile(np.abs(below - lean * fall), 95) < 0.02


def test_kitti_frame(real_data: Path, tmp_path: Path) -> None:
    source = real_data / "kitti" / "000000.bin"
    loaded = load_config(ROOT / "sample_configs" / "kitti_frame.toml")
    stream = opened(source, loaded)
    assert stream.info.points_per_line == 64
    assert stream.info.n_lines == pytest.approx(2198, abs=3)
    elevation = np.rad2deg(np.abs(beams_of(stream))) - 90
    assert elevation[0] < -22
    assert 1.5 < elevation[-1] < 3
    whole = read(stream)
    # shots of other azimuths in a line: no more than two steps off
    xyz = np.concatenate([block.xyz_m for block in whole.blocks if block.xyz_m is not None])
    azimuth = np.rad2deg(np.arctan2(xyz[..., 1], xyz[..., 0]))
    middle = np.rad2deg(2 * np.pi * (np.arange(len(xyz)) + 0.5) / len(xyz))[:, None]
    off = np.abs((azimuth - middle + 180) % 360 - 180)
    assert np.nanpercentile(off, 95) < 2 * 360 / len(xyz)
    assert whole.tally.n_collisions < 0.004 * 124_668
    assert whole.tally.n_unplaced == 0
    # rings of the road in front, which the scanner sees without a gap, are without gaps
    assert np.mean(np.isnan(whole.range_m[:, 24:32])) < 0.03
    summary = classify(source, tmp_path / "labels.npy", loaded)
    assert summary.counts.n_lines == stream.info.n_lines
    labels = np.load(tmp_path / "labels.npy")
    assert len(labels) == 124_668
    assert np.all(labels > 0)
    matrix = evaluate(tmp_path / "labels.npy", real_data / "kitti" / "000000.label", "semantic_kitti")
    assert matrix.counts.sum() + matrix.n_ignored == 124_668


def test_a_mirror_that_sweeps_while_the_head_turns(real_data: Path, tmp_path: Path) -> None:
    text = (ROOT / "docs" / "formats.md").read_text()
    recipe = next(part for part in text.split("```toml\n") if 'lines = "elevation:20"' in part).split("```")[0]
    (tmp_path / "recipe.toml").write_text(recipe)
    stream = opened(real_data / "organised" / "car_cloud401.csv", load_config(tmp_path / "recipe.toml"))
    assert stream.info.points_per_line == 253
    beams_of(stream)

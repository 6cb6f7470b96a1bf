"""What ``prc info`` finds beyond the header."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from prc_cli.config import load_config
from prc_cli.core.errors import OrderError
from prc_cli.core.stream import ScanBlock
from prc_cli.formats.input import Input
from prc_cli.formats.options import InputConfig
from prc_cli.jobs import info
from prc_cli.jobs.info import inspect
from prc_cli.streams.open import open_input
from tests.clouds import seen
from tests.formats.organised_files import ptx_scan, write_text
from tests.streams.evidence.test_estimates import drive


def upright(n_lines: int = 5, m: int = 40) -> np.ndarray:
    """Return points (lines, M, 4) of a scanner that turns, in lines from below to above."""
    azimuth = np.deg2rad(10.0 * np.arange(n_lines))[:, None]
    elevation = np.deg2rad(np.linspace(-60, 60, m))[None]
    length = 8.0 + 3.0 * np.sin(elevation)
    xyz = seen(length, azimuth, elevation)
    return np.concatenate([xyz, np.full((n_lines, m, 1), 0.5)], axis=-1)


def test_a_later_scan_that_is_refused_is_the_verdict(tmp_path):
    """A stream of scans is read to its end, as any of them may have no vertical direction."""
    sound = upright(30, 40)
    level = upright(40, 40).transpose(1, 0, 2)
    loaded = load_config(preset="street-scan")
    good = inspect(write_text(tmp_path / "a.ptx", ptx_scan(sound) + ptx_scan(sound)), loaded)
    assert good.problem == ""
    bad = inspect(write_text(tmp_path / "b.ptx", ptx_scan(sound) + ptx_scan(level)), loaded)
    assert bad.problem.startswith("no vertical direction known: the lines do not rise")
    assert bad.facts is not None


def test_rates_are_measured_after_sorting(tmp_path):
    """'--sort-by-time', and then 'no steady rates'."""
    time_s, _, column = drive(50.0, 300, 60)
    height = 2 + np.sin(column / 30)
    order = np.random.default_rng(0).permutation(len(time_s))
    rows = np.column_stack([time_s, height, height])
    np.savetxt(
        tmp_path / "tile.csv",
        rows[order],
        delimiter=",",
        header="time,range,z",
        comments="",
        fmt="%.9f",
    )
    np.savetxt(
        tmp_path / "drive.csv", rows, delimiter=",", header="time,range,z", comments="", fmt="%.9f"
    )
    expected = inspect(tmp_path / "drive.csv", load_config()).rates
    assert "--sort-by-time" in inspect(tmp_path / "tile.csv", load_config()).hint
    inspection = inspect(
        tmp_path / "tile.csv", load_config(options={"input": {"order": "sort-time"}})
    )
    assert inspection.rates == expected
    assert inspection.rates is not None


@pytest.mark.parametrize("input_options", [{}, {"range": "origin:0,0,0", "points_per_line": 10}])
def test_a_tile_without_times_has_lost_its_order(tmp_path, input_options):
    """It was told to give M and a place of the scanner, and then labelled."""
    np.savetxt(
        tmp_path / "tile.csv",
        np.random.default_rng(0).normal(size=(50, 3)),
        delimiter=",",
        header="x,y,z",
        comments="",
    )
    inspection = inspect(tmp_path / "tile.csv", load_config(options={"input": input_options}))
    assert inspection.problem.startswith("the file has no times, scan lines or ranges")
    assert "--trust-order" in inspection.hint
    with pytest.raises(OrderError, match="the order of the shots is lost"):
        open_input(Input.of(tmp_path / "tile.csv"), InputConfig(**input_options))
    if input_options:
        open_input(Input.of(tmp_path / "tile.csv"), InputConfig(order="trust", **input_options))


def test_counts_are_those_of_all_blocks_and_the_median_that_of_the_first_shots(
    monkeypatch,
):
    monkeypatch.setattr(info, "SAMPLE_SHOTS", 100)
    image = np.random.default_rng(1).uniform(1, 9, (30, 7)).astype(np.float32)
    image[::2, 2] = np.nan
    image[29, 6] = 0.5
    time_s = 0.01 * np.arange(30.0)[:, None] + np.zeros(7)
    blocks = [
        ScanBlock(
            first, image[first : first + 6], time_s=time_s[first : first + 6], scanner=scanner
        )
        for first, scanner in ((0, 1), (6, 2), (12, 1), (18, 1), (24, 1))
    ]
    stream: Any = SimpleNamespace(blocks=lambda: blocks, info=SimpleNamespace(line_hz=None))
    facts, sample = info._measure(stream, with_ranges=True)
    ours = np.concatenate([image[:6], image[12:]]).ravel()
    np.testing.assert_array_equal(sample, ours[:100])
    assert (facts.n_lines, facts.n_shots, facts.n_missing) == (30, 210, 15)
    assert facts.scanners == (1, 2)
    expected = (0.5, np.nanmedian(ours[:100]), np.nanmax(image))
    np.testing.assert_allclose(facts.range_m, expected)
    assert facts.line_hz == pytest.approx(100.0)
    facts, sample = info._measure(stream, with_ranges=False)
    assert (facts.range_m, facts.correlation, sample) == (None, None, None)

"""What ``prc info`` finds beyond the header."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from prc_cli.config import load_config
from prc_cli.jobs.info import inspect
from tests.formats.organised_files import ptx_scan, write_text


def upright(n_lines: int = 5, m: int = 40) -> np.ndarray:
    """Return points (lines, M, 4) of a scanner that turns, in lines from below to above."""
    azimuth, elevation = np.deg2rad(10.0 * np.arange(n_lines))[:, None], np.deg2rad(np.linspace(-60, 60, m))[None]
    length = 8.0 + 3.0 * np.sin(elevation)
    flat = length * np.cos(elevation)
    xyz = [flat * np.cos(azimuth), flat * np.sin(azimuth), length * np.sin(elevation) + 0 * azimuth]
    return np.stack([*xyz, np.full((n_lines, m), 0.5)], axis=-1)


def test_a_later_scan_that_is_refused_is_the_verdict(tmp_path: Path) -> None:
    """A stream of scans is read to its end, as any of them may have no vertical direction."""
    sound, level = upright(30, 40), upright(40, 40).transpose(1, 0, 2)
    loaded = load_config(preset="street-scan")
    good = inspect(write_text(tmp_path / "a.ptx", ptx_scan(sound) + ptx_scan(sound)), loaded)
    assert good.problem == ""
    bad = inspect(write_text(tmp_path / "b.ptx", ptx_scan(sound) + ptx_scan(level)), loaded)
    assert bad.problem.startswith("no vertical direction known: the lines do not rise")
    assert bad.facts is not None

"""Streams written as bags: simulated, classified and compared with their own classes."""

import numpy as np
import pytest

from prc_cli.config import load_config
from prc_cli.core.blocks import join
from prc_cli.core.errors import ConfigError, OutputError, PrcError
from prc_cli.formats.bags.read import BagStream
from prc_cli.formats.options import InputConfig
from prc_cli.jobs.convert import convert
from prc_cli.jobs.simulate import Beside, simulate
from prc_cli.simulation.settings import load_settings

WALK = {"scanner": {"points_per_line": 400}, "lines": 200, "trajectory": {"stop_every_m": 0.0}}
SUFFIXES = (".bag", ".mcap", ".db3")


def test_what_no_message_can_hold(tmp_path):
    with pytest.raises(ConfigError, match="a scan from a tripod"):
        simulate(
            "street-scan", tmp_path / "a.bag", load_settings("street-scan", options={"lines": 9})
        )
    with pytest.raises(ConfigError, match="which it holds itself"):
        settings = load_settings("street", options=WALK)
        simulate("street", tmp_path / "a.bag", settings, beside=Beside(labels=tmp_path / "a.npy"))
    arrays = {"range_m": np.full((6, 300), 5.0, "f4")}
    angle = np.linspace(-1.0, 1.0, 300)
    for name, beside, message in (
        ("uneven.npz", {"angle_rad": angle**3, "time_s": np.arange(6.0)}, "uneven steps"),
        ("timeless.npz", {"angle_rad": angle}, "no times"),
    ):
        np.savez(tmp_path / name, **arrays, **beside)
        with pytest.raises(OutputError, match=message):
            convert(tmp_path / name, tmp_path / "a.bag", load_config())
    assert sorted(path.name for path in tmp_path.iterdir()) == ["timeless.npz", "uneven.npz"]


@pytest.mark.parametrize("value", [np.nan, -5.0, 1e12])
@pytest.mark.parametrize("suffix", SUFFIXES)
def test_times_that_no_message_can_have_are_refused(tmp_path, suffix, value):
    source = tmp_path / "in.npz"
    times = np.arange(6.0)
    times[3] = value
    ranges = np.full((6, 300), 5.0, "f4")
    np.savez(source, range_m=ranges, angle_rad=np.linspace(-1.0, 1.0, 300), time_s=times)
    with pytest.raises(PrcError):
        convert(source, tmp_path / f"o{suffix}", load_config(options={"input": {"order": "trust"}}))
    assert [path.name for path in tmp_path.iterdir() if not path.name.startswith("in.")] == []


@pytest.mark.parametrize("suffix", [".bag", ".mcap"])
def test_a_spinning_scanner_becomes_clouds(tmp_path, suffix):
    scanner = {"name": "vlp-32c", "azimuth_step_deg": 1.4, "line_hz": 2570.0}
    settings = load_settings("street", options={"scanner": scanner, "duration_s": 0.2, "seed": 5})
    simulate("street", tmp_path / "spin.npz", settings)
    convert(tmp_path / "spin.npz", tmp_path / f"a{suffix}", load_config())
    ranges = join(list(BagStream(tmp_path / f"a{suffix}", InputConfig()).blocks())).range_m
    expected = np.load(tmp_path / "spin.npz")["range_m"]
    np.testing.assert_allclose(
        np.sort(ranges[np.isfinite(ranges)]), np.sort(expected[np.isfinite(expected)]), rtol=1e-5
    )

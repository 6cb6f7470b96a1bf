"""Streams written as bags: simulated, classified and compared with their own classes."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from prc_cli.cli import cli
from prc_cli.config import load_config
from prc_cli.core.errors import ConfigError, OutputError, PrcError
from prc_cli.formats.bags.read import BagStream
from prc_cli.formats.options import InputConfig
from prc_cli.jobs.convert import convert
from prc_cli.jobs.simulate import Beside, simulate
from prc_cli.simulation.settings import load_settings
from tests.runner import runner

SPIN = {
    "scanner": {"name": "vlp-32c", "azimuth_step_deg": 1.4, "line_hz": 2570.0},
    "duration_s": 0.3,
    "seed": 5,
}
WALK = {"scanner": {"points_per_line": 400}, "lines": 200, "trajectory": {"stop_every_m": 0.0}}
SUFFIXES = (".bag", ".mcap", ".db3")


def whole(path: Path) -> dict[str, np.ndarray]:
    blocks = list(BagStream(path, InputConfig()).blocks())
    names = ("range_m", "time_s", "intensity")
    return {name: np.concatenate([getattr(block, name) for block in blocks]) for name in names}


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_simulated_scanner_is_classified_and_compared(tmp_path: Path, suffix: str) -> None:
    bag = tmp_path / f"spin{suffix}"
    labels = tmp_path / "labels.npy"
    made = simulate("street", bag, load_settings("street", options=SPIN))
    done = runner().invoke(cli, ["classify", str(bag), str(labels), "-q"])
    assert done.exit_code in (0, 4), done.output
    compared = runner().invoke(cli, ["evaluate", str(labels), str(bag), "--json"])
    assert compared.exit_code == 0, compared.output
    scores = json.loads(compared.stdout)
    assert scores["match"]["n_matched"] == made.counts.n_shots
    assert scores["classes"]["ground"]["recall"] > 0.8
    assert scores["classes"]["building"]["recall"] > 0.4


def test_an_archive_of_a_spinning_scanner_is_in_order(tmp_path: Path) -> None:
    simulate("street", tmp_path / "spin.npz", load_settings("street", options=SPIN))
    done = runner().invoke(cli, ["info", str(tmp_path / "spin.npz")])
    assert "yes, rings can classify it" in done.output
    convert(tmp_path / "spin.npz", tmp_path / "again.bag", load_config())
    expected = np.load(tmp_path / "spin.npz")["range_m"]
    ranges = whole(tmp_path / "again.bag")["range_m"]
    assert np.count_nonzero(~np.isnan(ranges)) == np.count_nonzero(~np.isnan(expected))


def test_what_no_message_can_hold(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="a scan from a tripod"):
        simulate(
            "street-scan", tmp_path / "a.bag", load_settings("street-scan", options={"lines": 9})
        )
    with pytest.raises(ConfigError, match="which it holds itself"):
        settings = load_settings("street", options=WALK)
        simulate("street", tmp_path / "a.bag", settings, beside=Beside(labels=tmp_path / "a.npy"))
    n = 6
    m = 300
    angle = np.linspace(-1.0, 1.0, m) ** 3
    np.savez(
        tmp_path / "uneven.npz",
        range_m=np.full((n, m), 5.0, "f4"),
        angle_rad=angle,
        time_s=np.arange(n * 1.0),
    )
    with pytest.raises(OutputError, match="uneven steps"):
        convert(tmp_path / "uneven.npz", tmp_path / "a.bag", load_config())
    np.savez(
        tmp_path / "timeless.npz",
        range_m=np.full((n, m), 5.0, "f4"),
        angle_rad=np.linspace(-1.0, 1.0, m),
    )
    with pytest.raises(OutputError, match="no times"):
        convert(tmp_path / "timeless.npz", tmp_path / "a.bag", load_config())
    assert sorted(path.name for path in tmp_path.iterdir()) == ["timeless.npz", "uneven.npz"]


def with_times(folder: Path, change: Callable[[np.ndarray], None]) -> Path:
    """An archive of lines of a profiler with other times."""
    path = folder / "in.npz"
    simulate("street", path, load_settings("street", options={**WALK, "lines": 30}))
    arrays = dict(np.load(path))
    change(arrays["time_s"])
    np.savez(path, **arrays)
    return path


@pytest.mark.parametrize("value", [np.nan, -5.0, 1e12])
@pytest.mark.parametrize("suffix", SUFFIXES)
def test_times_that_no_message_can_have_are_refused(
    tmp_path: Path, suffix: str, value: float
) -> None:
    def change(time_s: np.ndarray) -> None:
        time_s[7] = value

    source = with_times(tmp_path, change)
    with pytest.raises(PrcError):
        convert(source, tmp_path / f"o{suffix}", load_config(options={"input": {"order": "trust"}}))
    assert [path.name for path in tmp_path.iterdir() if not path.name.startswith("in.")] == []

"""What convert writes is read by classify to the same labels, in every format and of every scanner
with rings."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from prc_cli.cli import cli
from prc_cli.config import load_config
from prc_cli.jobs.classify import classify
from prc_cli.jobs.convert import convert
from prc_cli.streams.order import fire_in_turns
from prc_cli.streams.ranges import is_in_plane
from tests.runner import runner

DURATION_S = "0.05"


@pytest.fixture(scope="module", params=["vlp-16", "vlp-32c", "hdl-64e"])
def drive(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short drive, with its labels beside it."""
    path = tmp_path_factory.mktemp(request.param) / "drive.npz"
    options = ["--scanner", request.param, "--duration", DURATION_S, "--seed", "3", "-q"]
    result = runner().invoke(cli, ["simulate", "street", str(path), *options])
    assert result.exit_code == 0, result.output
    classify(path, path.with_suffix(".npy"), load_config(preset="rings"))
    return path


@pytest.mark.parametrize("suffix", [".ply", ".pcd", ".csv", ".mcap"])
def test_labels_do_not_depend_on_the_format(drive: Path, suffix: str, tmp_path: Path) -> None:
    if suffix == ".mcap" and drive.parent.name.startswith("vlp-32c"):
        pytest.skip("columns of a bag are firings: cells of staggered rings differ")
    path = tmp_path / f"drive{suffix}"
    convert(drive, path, load_config())
    classify(path, tmp_path / "labels.npy", load_config(preset="rings"))
    wanted = np.load(drive.with_suffix(".npy")).ravel()
    found = np.load(tmp_path / "labels.npy").ravel()
    np.testing.assert_array_equal(found, wanted)


def test_rings_that_fire_in_turns_are_in_order() -> None:
    time_s = np.arange(40) * 0.1 + np.tile([0.0, 2.0, 1.0, 3.0], 10)
    ring = np.tile(np.arange(4), 10)
    assert fire_in_turns(time_s, ring)
    assert not fire_in_turns(time_s[::-1], ring)
    assert not fire_in_turns(np.sort(time_s), ring)


def test_shots_of_a_slant_profiler_lie_in_a_plane() -> None:
    angle = np.linspace(-2.0, 2.0, 50)
    slant = {"x": 0.1 * np.cos(angle), "y": np.sin(angle), "z": -np.cos(angle)}
    assert is_in_plane(slant)

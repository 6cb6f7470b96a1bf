"""What convert writes is read by classify to the same labels, in every format, for every method."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from prc_cli.cli import cli
from prc_cli.config import resolve
from prc_cli.core.types import I64, U8
from prc_cli.formats.registry import by_suffix
from prc_cli.streams.open import open_input
from prc_cli.streams.order import fire_in_turns
from prc_cli.streams.ranges import is_in_plane
from tests.runner import runner

DRIVES = {
    "vlp-16": ("rings", "street --scanner vlp-16 --duration 0.05"),
    "vlp-32c": ("rings", "street --scanner vlp-32c --duration 0.05"),
    # offsets of rings that are no whole columns
    "uneven": (
        "rings",
        "street --scanner vlp-32c --duration 0.05 --set scanner.azimuth_step_deg=0.17",
    ),
    "hdl-64e": ("rings", "street --scanner hdl-64e --duration 0.05"),
    "profiler": ("prc", "street --scanner sick-push-broom --duration 2"),
    "angles": ("fused", "street --scanner sick-push-broom --duration 2"),
    "tripod": (
        "sequential-angle",
        "street-scan --set scanner.points_per_line=250 --set scanner.azimuth_step_deg=2",
    ),
}
"""Method, and what is simulated for it."""
CANNOT = {
    ".parquet": "rings prc fused sequential-angle",  # for other programs
    ".npy": "rings fused sequential-angle",  # ranges only
    # a cloud has rings, which a tripod has not
    ".bag": "sequential-angle",
    ".db3": "sequential-angle",
    ".mcap": "sequential-angle",
}
"""Methods by formats that cannot hold what the method reads."""
ROUNDED = (".las", ".laz")
"""Formats that round coordinates, angles and intensities, and say so."""
LEAST_SAME = 0.995
"""Share of equal labels behind rounded values."""
SUFFIXES = sorted(by_suffix("streams"))


@pytest.fixture(scope="module", params=DRIVES)
def drive(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short scan."""
    path = tmp_path_factory.mktemp(request.param) / f"{request.param}.npz"
    kind, *options = DRIVES[request.param][1].split()
    run("simulate", kind, str(path), *options, "--seed", "3")
    return path


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_labels_do_not_depend_on_the_format(drive: Path, suffix: str, tmp_path: Path) -> None:
    method = DRIVES[drive.stem][0]
    if method in CANNOT.get(suffix, "").split():
        pytest.skip(f"{suffix} cannot hold what {method} reads")
    path = tmp_path / f"drive{suffix}"
    run("convert", str(drive), str(path))
    labels = labels_of_cells(path, method)
    expected = labels_of_cells(drive, method)
    # records of LAS are returns
    has_record = labels >= 0
    assert has_record[expected > 0].all()
    is_same = labels[has_record] == expected[has_record]
    is_exact = suffix not in ROUNDED or method in ("prc", "fused")
    assert is_same.mean() >= (1.0 if is_exact else LEAST_SAME)


def run(*arguments: str) -> None:
    """Run a command; warnings about the labels are no failure."""
    result = runner().invoke(cli, [*arguments, "-q"])
    assert result.exit_code in (0, 4), result.output


def labels_of_cells(path: Path, method: str) -> I64:
    """Classify a scan; return the label of every cell, line by line, -1 = no record."""
    output = path.with_name(f"{path.name}.labels.npy")
    if not output.exists():
        run("classify", str(path), str(output), "--method", method)
    labels: U8 = np.load(output).ravel()
    scan, loaded = resolve(path)
    stream = open_input(scan, loaded.config.input)
    record = np.concatenate([block.records().ravel() for block in stream.blocks()])
    return np.where(record >= 0, labels[record].astype(np.int64), -1)


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

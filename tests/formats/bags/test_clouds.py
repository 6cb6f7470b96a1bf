"""Clouds whose times are those of packets, whose rings have odd numbers, whose lasers fire
together."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from prc_cli.core.blocks import join
from prc_cli.core.errors import InputError
from prc_cli.core.stream import ScanBlock
from prc_cli.formats.bags.read import BagStream
from prc_cli.formats.options import InputConfig
from prc_cli.streams.filters import ordered
from prc_cli.streams.stream import Stream
from tests.formats.bags import recordings as made

N_LINES = 400
N_RINGS = 8
TURN_LINES = 200
TYPE = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("ring", "<u2"), ("time", "<f4")])


def shots(seed: int = 5) -> dict[str, np.ndarray]:
    """Two turns of a scanner whose rings fire together, 1.8 degrees from column to column.

    a fifth did not return.
    """
    rng = np.random.default_rng(seed)
    column, ring = (
        index.ravel()
        for index in np.meshgrid(np.arange(N_LINES), np.arange(N_RINGS), indexing="ij")
    )
    range_m = rng.uniform(5, 6, N_LINES * N_RINGS)
    range_m[rng.random(len(range_m)) < 0.2] = np.nan
    azimuth = -column * 2 * np.pi / TURN_LINES
    elevation = np.deg2rad(-14 + 4 * ring)
    flat = range_m * np.cos(elevation)
    xyz = np.stack(
        [flat * np.cos(azimuth), flat * np.sin(azimuth), range_m * np.sin(elevation)], axis=1
    )
    return {
        "column": column,
        "ring": ring,
        "range": range_m,
        "xyz": xyz,
        "time": column * 0.1 / TURN_LINES,
    }


def record(path: Path, drive: dict[str, np.ndarray], numbers: np.ndarray) -> Path:
    """Write a message a turn with the points that returned, ring after ring."""
    sent = []
    for first in range(0, N_LINES, TURN_LINES):
        use = np.flatnonzero(
            (drive["column"] // TURN_LINES == first // TURN_LINES) & np.isfinite(drive["range"])
        )
        use = use[np.argsort(drive["ring"][use], kind="stable")]
        table = np.zeros(len(use), TYPE)
        for axis, name in enumerate("xyz"):
            table[name] = drive["xyz"][use, axis]
        table["ring"] = numbers[drive["ring"][use]]
        after_s = first * 0.1 / TURN_LINES
        table["time"] = drive["time"][use] - after_s
        start_ns = made.START_NS + round(after_s * 1e9)
        sent.append(
            made.Sent(
                "/points", "sensor_msgs/msg/PointCloud2", start_ns, made.cloud(2, start_ns, table)
            )
        )
    return made.write_mcap(path, sent)


def read(path: Path) -> ScanBlock:
    # the order of the times is judged, too
    return join(list(ordered(Stream.of(BagStream(path, InputConfig())), "require").blocks()))


def test_two_scanners_in_one_cloud_are_refused(tmp_path: Path) -> None:
    drive = shots()
    turned = {**drive, "xyz": drive["xyz"] @ np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])}
    both = {name: np.concatenate([values, turned[name]]) for name, values in drive.items()}
    with pytest.raises(InputError, match="each with azimuths all around"):
        read(record(tmp_path / "a.mcap", both, np.arange(N_RINGS)))


@pytest.mark.parametrize(
    ("numbers", "note"),
    [
        (np.arange(8), ""),
        (1 + np.arange(8), ""),
        (4 * np.arange(8), "in steps of 4"),
        (2 + 8 * np.arange(8), "steps"),
        (np.array([0, 1, 5, 9, 20, 21, 40, 90]), "in their order"),
    ],
)
def test_numbers_of_rings_may_have_gaps(tmp_path: Path, numbers: np.ndarray, note: str) -> None:
    drive = shots()
    path = tmp_path / "a.mcap"
    stream = BagStream(record(path, drive, numbers), InputConfig())
    block = join(list(stream.blocks()))
    np.testing.assert_allclose(block.range_m, drive["range"].reshape(N_LINES, N_RINGS), rtol=1e-5)
    assert note in " ".join(stream.info.facts.notes)

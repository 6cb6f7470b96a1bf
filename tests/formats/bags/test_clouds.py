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


def record(path: Path, shots: dict[str, np.ndarray]) -> Path:
    return made.write_mcap(path, made.clouds(shots, made.kind_of("time", "f4"), every=200))


def read(path: Path) -> ScanBlock:
    # the order of the times is judged, too
    return join(list(ordered(Stream.of(BagStream(path, InputConfig())), "require").blocks()))


def test_two_scanners_in_one_cloud_are_refused(tmp_path: Path) -> None:
    drive = made.drive(400, together=True)
    turned = {**drive, "xyz": drive["xyz"] @ np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])}
    both = {name: np.concatenate([values, turned[name]]) for name, values in drive.items()}
    with pytest.raises(InputError, match="each with azimuths all around"):
        read(record(tmp_path / "a.mcap", both))


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
    drive = made.drive(400, together=True)
    path = tmp_path / "a.mcap"
    stream = BagStream(record(path, {**drive, "ring": numbers[drive["ring"]]}), InputConfig())
    block = join(list(stream.blocks()))
    np.testing.assert_allclose(block.range_m, drive["range"].reshape(400, 8), rtol=1e-5)
    assert note in " ".join(stream.info.facts.notes)

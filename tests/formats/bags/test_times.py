"""Clouds of bags: numbers of rings, units of times, pauses, times out of place, repeats, points
without ring or time."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from prc_cli.core.blocks import join
from prc_cli.core.stream import ScanBlock
from prc_cli.formats.bags.read import BagStream
from prc_cli.formats.options import InputConfig
from tests.formats.bags import recordings as made


def messages(shots: dict[str, np.ndarray], change: Any = None, **options: Any) -> list[made.Sent]:
    """A cloud a turn, in the order of the shots."""
    kind = made.kind_of("time", "f8")
    options |= {"every": 200, "version": 1, "by_ring": False}
    return made.clouds(shots, kind, change=change, **options)


def read_cloud(folder: Path, sent: list[made.Sent], **changes: Any) -> tuple[BagStream, ScanBlock]:
    path = made.write_bag(folder / "a.bag", sent)
    stream = BagStream(path, InputConfig(**changes))
    return stream, join(list(stream.blocks()))


def check_cloud(
    folder: Path, shots: dict[str, np.ndarray], sent: list[made.Sent], **changes: Any
) -> tuple[BagStream, ScanBlock]:
    """Read messages whose every shot must be in its cell."""
    stream, block = read_cloud(folder, sent, **changes)
    np.testing.assert_allclose(block.range_m, shots["range"].reshape(-1, 8), rtol=1e-5)
    return stream, block


def in_unit(unit: float, kind: str, *, is_absolute: bool = False) -> Any:
    """Points whose times are stored in another unit."""

    def change(points: np.ndarray, stamp_s: float) -> np.ndarray:
        dtype = [
            (name, kind if name == "time" else points.dtype[name])
            for name in points.dtype.names or ()
        ]
        changed = points.astype(dtype)
        time = (points["time"] + (stamp_s if is_absolute else 0.0)) / unit
        changed["time"] = np.rint(time) if kind[0] in "iu" else time
        return changed

    return change


@pytest.mark.parametrize(
    "change",
    [
        in_unit(1e-3, "f4"),
        in_unit(1e-6, "f4"),
        in_unit(1e-9, "f4"),
        in_unit(1e-6, "u4"),
        in_unit(1e-9, "u4"),
        in_unit(0.1, "f4"),
        in_unit(1e-3, "f8", is_absolute=True),
        in_unit(1e-6, "f8", is_absolute=True),
        in_unit(1.0, "f8", is_absolute=True),
    ],
)
def test_the_turn_shows_the_unit_of_the_times(tmp_path, change):
    shots = made.drive(600)
    _, block = check_cloud(tmp_path, shots, messages(shots, change))
    assert block.time_s is not None
    assert np.ptp(block.time_s) == pytest.approx(0.3, abs=1e-3)


def test_the_unit_may_be_told(tmp_path):
    shots = made.drive(400)
    sent = messages(shots, in_unit(1e-6, "f4"))
    stream, _ = check_cloud(tmp_path, shots, sent, time_unit="us")
    assert "in us (input.time_unit)" in stream.info.facts.notes[0]


@pytest.mark.parametrize("pause_s", [5.0, 80.0, 4000.0])
def test_a_pause_is_lines_without_returns(tmp_path, pause_s):
    shots = made.drive(600)
    stream, block = read_cloud(tmp_path, messages(shots, pause_s=pause_s))
    wanted = shots["range"].reshape(600, 8)
    n = 1000 if pause_s > 50 else 10_000
    assert block.n_lines == 600 + n
    np.testing.assert_allclose(block.range_m[np.r_[0:200, 200 + n : 600 + n]], wanted, rtol=1e-5)
    assert ("a pause" in stream.info.facts.notes[0]) == (pause_s > 50)


def test_times_out_of_place_cost_only_their_own_points(tmp_path):
    shots = made.drive(800)
    rng = np.random.default_rng(3)

    def late(points: np.ndarray, _: float) -> np.ndarray:
        points["time"][rng.random(len(points)) < 0.004] += 0.1
        return points

    _, block = read_cloud(tmp_path, messages(shots, late))
    wanted = shots["range"].reshape(800, 8)
    is_same = np.isclose(block.range_m[:800], wanted, rtol=1e-5) | np.isnan(wanted)
    assert is_same.mean() > 0.98
    assert block.tally.n_unplaced < 0.01 * block.tally.n_records


def test_a_first_message_with_wild_times_does_not_end_the_drive(tmp_path):
    shots = made.drive(800)
    number = iter(range(9))

    def wild(points: np.ndarray, _: float) -> np.ndarray:
        if next(number) == 0:
            points["time"][len(points) * 7 // 10 :] += 3.6
        return points

    _, block = read_cloud(tmp_path, messages(shots, wild))
    np.testing.assert_allclose(
        block.range_m[200:790], shots["range"].reshape(800, 8)[200:790], rtol=1e-5
    )


def test_empty_points_may_have_no_time(tmp_path):
    shots = made.drive(400)
    absolute = in_unit(1.0, "f8", is_absolute=True)

    def organised(points: np.ndarray, stamp_s: float) -> np.ndarray:
        filled = np.zeros(2 * len(points), absolute(points, stamp_s).dtype)
        filled[: len(points)] = absolute(points, stamp_s)
        for axis in "xyz":
            filled[axis][len(points) :] = np.nan
        return filled

    _, block = check_cloud(tmp_path, shots, messages(shots, organised))
    assert block.tally.n_unplaced == 0


def test_a_message_that_comes_twice_is_read_once_and_said(tmp_path):
    shots = made.drive(600)
    sent = messages(shots)
    again = messages(shots)
    for number, message in enumerate(again):
        message.message.header.seq = number + 7
    stream, block = check_cloud(tmp_path, shots, [*sent, *again])
    assert stream.info.facts.repeated.startswith("3 of 6 messages")
    assert block.tally.n_records == 2 * np.isfinite(shots["range"]).sum()


def test_points_without_times_lie_in_columns_of_their_azimuth(tmp_path):
    shots = made.drive(600)

    def bare(points: np.ndarray, _: float) -> np.ndarray:
        names = ["x", "y", "z", "intensity", "ring"]
        return points[names].astype([(name, points.dtype[name]) for name in names])

    stream, block = read_cloud(tmp_path, messages(shots, bare))
    assert "have no times" in stream.info.facts.notes[0]
    assert abs(block.n_lines - 600) < 6
    assert (
        np.isfinite(block.range_m).sum() + len(block.extra)
        > 0.99 * np.isfinite(shots["range"]).sum()
    )


@pytest.mark.parametrize(
    "numbers, note",
    [
        (1 + np.arange(8), ""),
        (4 * np.arange(8), "in steps of 4"),
        (2 + 8 * np.arange(8), "steps"),
        (np.array([0, 1, 5, 9, 20, 21, 40, 90]), "in their order"),
    ],
)
def test_numbers_of_rings_may_have_gaps(tmp_path, numbers, note):
    drive = made.drive(400, together=True)
    stream, _ = check_cloud(tmp_path, drive, messages({**drive, "ring": numbers[drive["ring"]]}))
    assert note in " ".join(stream.info.facts.notes)

"""A trajectory against the path that was found: its clock, its lever arm, its coordinates."""

import re
from dataclasses import replace

import numpy as np
import pytest

from prc_cli.core.types import F64
from prc_cli.streams.registered.comparison import Comparison, Positions, compare
from prc_cli.streams.registered.path import ScannerPath

ARM = np.array([0.6, -0.3, 1.1])


def drive(time_s: F64, *, even: bool = False) -> tuple[F64, F64]:
    """Positions (n, 3) and axes (n, 3, 3) of a vehicle that turns and changes its speed, or does
    not."""
    turns = 0.0 if even else 1.0
    heading = turns * (0.02 * time_s + 0.5 * np.sin(0.1 * time_s))
    step_m = (8.0 + turns * 2.0 * np.sin(0.3 * time_s)) * (time_s[1] - time_s[0])
    x, y = (np.cumsum(step_m * part) for part in (np.cos(heading), np.sin(heading)))
    zero = 0.0 * time_s
    ones = 1.0 + 0.0 * time_s
    forward = np.stack([np.cos(heading), np.sin(heading), zero], axis=1)
    left = np.stack([-np.sin(heading), np.cos(heading), zero], axis=1)
    up = np.stack([zero, zero, ones], axis=1)
    place = np.stack([x, y, 0.02 * x], axis=1) + np.array([383_000.0, 6_670_000.0, 20.0])
    return place, np.stack([forward, left, up], axis=2)


def tile_and_drive(*, arm: F64 = ARM, even: bool = False) -> tuple[ScannerPath, Positions]:
    """The path of a tile of ten seconds, and the trajectory of three minutes that it is of."""
    time_s = np.arange(0.0, 180.0, 0.01)
    place, frame = drive(time_s, even=even)
    part = slice(6000, 7000)
    noise = np.random.default_rng(1).normal(0.0, 0.002, (1000, 3))
    scanner = place[part] + np.einsum("nij,j->ni", frame[part], arm) + noise
    path = ScannerPath(
        0,
        time_s[part],
        scanner,
        np.full((1000, 3), 0.002),
        frame[part],
        frame[part][:, :, 0],
        np.zeros(1000, np.int64),
    )
    return path, Positions(time_s, place)


def moved(
    trajectory: Positions, *, clock_s: float = 0.0, by_m: tuple[float, ...] = (0, 0, 0)
) -> Positions:
    return replace(
        trajectory, time_s=trajectory.time_s + clock_s, xyz_m=trajectory.xyz_m + np.array(by_m)
    )


def test_the_true_trajectory_is_left_as_it_is():
    path, trajectory = tile_and_drive(arm=np.zeros(3))
    comparison = compare(path, trajectory)
    assert (comparison.clock_s, comparison.misfit) == (0.0, "")
    assert comparison.lever_length_m < 0.001
    assert comparison.distance_m < 0.01


def test_an_even_straight_drive_tells_no_clock_and_says_so():
    path, trajectory = tile_and_drive(even=True)
    comparison = compare(path, trajectory)
    assert not comparison.tells_clock
    assert comparison.clock_s == 0.0
    assert comparison.lever_m == pytest.approx(ARM, abs=0.02)


def test_orientations_give_the_lever_arm_on_the_axes_of_the_vehicle():
    path, trajectory = tile_and_drive()
    _, frame = drive(trajectory.time_s)
    # the scanner stands across
    across = replace(path, frame=path.frame[:, :, [1, 2, 0]])
    assert compare(across, replace(trajectory, frame=frame)).lever_m == pytest.approx(ARM, abs=0.01)
    assert compare(across, trajectory).lever_m == pytest.approx(ARM[[1, 2, 0]], abs=0.01)


@pytest.mark.parametrize(
    "change, words",
    [
        (lambda drive: replace(drive, xyz_m=drive.xyz_m[:, [1, 0, 2]]), "x and y are swapped"),
        (lambda drive: replace(drive, xyz_m=drive.xyz_m / 0.3048), "unit is feet"),
        (
            lambda drive: moved(drive, by_m=(-300_000.0, 40.0, 0.0)),
            "moved by x 300,000.*throughout",
        ),
        (
            lambda drive: moved(drive, by_m=(-300_000.0, 40.0, 0.0), clock_s=20.0),
            "same shape.*x 300,000",
        ),
        (lambda drive: moved(drive, by_m=(0.0, 0.0, 18.5)), "heights differ by -17.4"),
        (lambda drive: Positions(drive.time_s, drive.xyz_m * 1e-5), "degrees"),
        (
            lambda drive: Positions(
                drive.time_s, 90.0 * np.sin(np.outer(drive.time_s, [0.3, 0.41, 0])) + 400.0
            ),
            "another d",
        ),
        (lambda drive: Positions(drive.time_s[:300], drive.xyz_m[:300]), "less than half"),
    ],
)
def test_other_coordinates_and_other_drives_are_named(change, words):
    path, trajectory = tile_and_drive()
    comparison: Comparison = compare(path, change(trajectory))  # type: ignore[operator]
    assert re.search(words, comparison.misfit), comparison.misfit

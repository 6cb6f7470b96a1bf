"""Parts of the reader of E57, compared with plain ones."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from prc_cli.core.errors import InputError
from prc_cli.core.types import I64
from prc_cli.formats.organised import e57_read as read
from prc_cli.formats.organised.e57_read import CARTESIAN, SPHERICAL, E57Stream
from prc_cli.formats.organised.scans import Pose, ScanShape, in_turn


def stream() -> Any:
    """Return a reader that has opened nothing."""
    found = E57Stream.__new__(E57Stream)
    found._path = Path("scan.e57")
    found._spare_cells = read.SPARE_CELLS
    return found


@pytest.mark.parametrize("seed", range(6))
def test_rotations_are_those_of_the_quaternion(seed: int) -> None:
    rng = np.random.default_rng(seed)
    w, x, y, z = quaternion = rng.normal(size=4) if seed else np.array([0.0, 0.6, 0.0, 0.8])
    quaternion *= rng.uniform(0.95, 1.05) / np.linalg.norm(quaternion)
    pose = stream()._pose(SimpleNamespace(index=3, quaternion=tuple(quaternion)))
    points = rng.normal(size=(9, 3))
    np.testing.assert_allclose(pose.apply(points), Rotation.from_quat([x, y, z, w]).apply(points), atol=1e-12)
    np.testing.assert_array_equal(stream()._pose(SimpleNamespace(quaternion=None)).apply(points), points)


def test_a_rotation_that_is_none_is_told() -> None:
    with pytest.raises(InputError) as refused:
        stream()._pose(SimpleNamespace(index=3, quaternion=(0.5, 0.25, 0.0, -0.125)))
    assert str(refused.value) == (
        "scan.e57: scan 3: the pose's rotation is (0.5, 0.25, 0, -0.125), expected a quaternion of length 1; export "
        "the scan again"
    )


@pytest.mark.parametrize("seed", range(8))
def test_indices_are_counted_as_one_by_one(seed: int) -> None:
    rng = np.random.default_rng(seed)
    column = rng.integers(-5 - seed, 9, 60).astype(np.float64)
    if seed % 2:
        column.sort()
    row = rng.integers(3, 20, 60).astype(np.float64)
    tally = read._IndexTally("scan.e57")
    for rows, columns in zip(np.array_split(row, seed + 1), np.array_split(column, seed + 1), strict=True):
        tally.add(rows, columns)
    low, high = int(column.min()), int(column.max())
    assert tally.rows == (row.min(), row.max())
    assert tally.columns == (low, high)
    assert tally.counts.tolist() == [int(np.sum(column == one)) for one in range(low, high + 1)]
    assert tally.in_order is (seed % 2 == 1)


def test_order_is_judged_across_chunks() -> None:
    for second, expected in (([2.0, 3.0], True), ([1.9, 3.0], False), ([3.0, 2.0], False)):
        tally = read._IndexTally("scan.e57")
        tally.add(np.zeros(2), np.array([1.0, 2.0]))
        tally.add(np.zeros(2), np.floor(np.array(second)))
        assert tally.in_order is expected


@pytest.mark.parametrize("name", ["rowIndex", "columnIndex"])
def test_indices_that_no_scanner_has(name: str) -> None:
    limit = read.MAX_POINTS_PER_LINE if name == "rowIndex" else read.MAX_LINES
    plain = np.array([4.0, 4.0])

    def add(index: np.ndarray) -> read._IndexTally:
        tally = read._IndexTally("scan.e57: scan 0")
        tally.add(index if name == "rowIndex" else plain, plain if name == "rowIndex" else index)
        return tally

    found = add(np.array([7.0, 6.0 + limit]))
    assert (found.rows if name == "rowIndex" else found.columns) == (7, 6 + limit)
    with pytest.raises(
        InputError, match=f"scan 0: found {name} from 7 to {7 + limit}, expected at most {limit} of them"
    ):
        add(np.array([7.0, 7.0 + limit]))
    for odd, shown in (
        (0.5, "0.5 to 4"),
        (float(2**52), "4 to 4.5036e.15"),
        (-float(2**52), "-4.5036e.15 to 4"),
        (np.nan, "nan to nan"),
    ):
        with pytest.raises(InputError, match=f"found {name} from {shown}, expected whole numbers"):
            add(np.array([4.0, odd]))
    far = float(2**52 - 1)
    assert (add(np.array([far, far])).rows if name == "rowIndex" else add(np.array([far, far])).columns) == (far, far)


@pytest.mark.parametrize(
    ("bounds", "expected"),
    [(((2, 4), (5, 9)), False), (((2, 5), (5, 9)), True), (((1, 4), (5, 9)), True), (((2, 4), (5, 8)), True),
     (((2, 4), (4, 9)), True), (None, False)],
)  # fmt: skip
def test_bounds_that_differ(bounds: Any, expected: bool) -> None:
    shape = ScanShape(0, 5, 3, 15, 0)
    table: Any = SimpleNamespace(bounds=bounds)
    one = read._Scan(table, shape, 2, 5, np.full(5, 3), True, Pose.none())
    assert one.bounds_differ is expected
    assert not replace(one, shape=ScanShape(0, 0, 0, 0, 0)).bounds_differ


def test_scans_whose_bounds_differ_are_noted() -> None:
    for n, shown in ((1, "0"), (10, "0, 1, 2, 3, 4, 5, 6, 7, 8, 9"), (11, "0, 1, 2, 3, 4, 5, 6, 7, 8, 9, ...")):
        one = stream()
        one._scans = [SimpleNamespace(shape=SimpleNamespace(scanner=k), bounds_differ=k < n) for k in range(12)]
        assert one._notes() == [
            f"the header's index bounds do not fit the points of scan {shown}: the points' own are taken"
        ]
    one._scans = []
    assert one._notes() == []


def test_coordinates_equal_the_formulas() -> None:
    rng = np.random.default_rng(1)
    values = rng.normal(size=(3, 30))
    values[:, 3], values[1:, 4] = 0.0, 0.0
    turn = Pose(Rotation.from_rotvec([0.3, -0.4, 1.0]).as_matrix(), np.zeros(3))
    xyz, length = read._coordinates(dict(zip(CARTESIAN, values, strict=True)), turn, cartesian=True)
    np.testing.assert_allclose(xyz, values.T @ turn.rotation)
    np.testing.assert_allclose(length, [np.nan if k == 3 else np.linalg.norm(values[:, k]) for k in range(30)])
    values[1, 5], values[2, 6] = np.inf, np.nan
    with np.errstate(invalid="ignore"):
        xyz, length = read._coordinates(dict(zip(SPHERICAL, values, strict=True)), Pose.none(), cartesian=False)
    for k, (r, azimuth, elevation) in enumerate(values.T.tolist()):
        if k in (3, 5, 6):
            assert np.isnan(length[k])
        else:
            flat = r * np.cos(elevation)
            expected = (flat * np.cos(azimuth), flat * np.sin(azimuth), r * np.sin(elevation))
            np.testing.assert_allclose(xyz[k], expected)
            assert length[k] == r


def test_intensities_are_scaled_by_the_limits() -> None:
    table: Any = SimpleNamespace(intensity_limits=(-1.0, 3.0))
    assert read._scaled(np.array([-1.0, 0.0, 3.0]), table).tolist() == [0.0, 16383.75, 65535.0]
    table.intensity_limits = None
    assert read._scaled(np.array([-1.0, 7.0]), table).tolist() == [-1.0, 7.0]


def points(line: I64) -> np.ndarray:
    found = np.zeros(len(line), read._POINT)
    found["line"], found["record"] = line, np.arange(len(line))
    return found


@pytest.mark.parametrize("n_chunks", [1, 2, 7])
@pytest.mark.parametrize("lines", [1, 3, 20])
def test_points_come_in_groups_of_lines(n_chunks: int, lines: int) -> None:
    line = np.random.default_rng(2).integers(0, 20, 150)
    line[line == 7] = 8
    for is_sorted in (True, False):
        every = points(np.sort(line) if is_sorted else line)
        starts = range(0, 20, lines)
        edges = np.append(0, np.cumsum([np.count_nonzero(line // lines == k) for k in range(len(starts))]))
        parts = iter(np.array_split(every, n_chunks))
        short = InputError("scan.e57", "too few points")
        sizes = np.diff(edges).tolist()
        found = list(in_turn(parts, sizes, short) if is_sorted else read._scattered(parts, edges, lines))
        assert len(found) == len(starts)
        for k, group in enumerate(found):
            assert group["record"].tolist() == every["record"][every["line"] // lines == k].tolist()


def test_points_that_changed_meanwhile_are_refused() -> None:
    with pytest.raises(InputError, match="the points changed while they were read"):
        list(read._scattered(iter([points(np.array([0, 1, 1]))]), np.array([0, 2, 3]), 1))


@pytest.mark.parametrize(
    ("bounds", "expected"),
    [
        (None, (10, 4, 0, 0)), (((0, 5), (-1, 10)), (12, 6, 0, -1)), (((0, 2), (0, 9)), (10, 4, 0, 0)), (((1, 9),
        (0, 9)), (10, 4, 0, 0)),
        (((0, 9), (0, 8)), (10, 4, 0, 0)), (((0, 9), (1, 9)), (10, 4, 0, 0)),
        # 40 points fill at most 40 000 cells
        (((0, 3), (0, 9_999)), (10_000, 4, 0, 0)), (((0, 3), (0, 10_000)), (10, 4, 0, 0)),
    ],
)  # fmt: skip
def test_a_survey_takes_bounds_that_fit(bounds: Any, expected: tuple[int, int, int, int]) -> None:
    row, column = (one.ravel().astype(float) for one in np.mgrid[:4, :10])
    table: Any = SimpleNamespace(
        index=2, n_points=40, bounds=bounds, quaternion=None, fields=("rowIndex", "columnIndex", *CARTESIAN)
    )
    file: Any = SimpleNamespace(chunks=lambda *_: iter([{"rowIndex": row, "columnIndex": column}]))
    found = stream()._survey(file, table, 77)
    n_lines, m, _, first_column = expected
    assert (found.shape.n_lines, found.shape.points_per_line, found.first_row, found.first_column) == expected
    assert (found.shape.first_record, found.shape.n_records, found.in_order) == (77, 40, False)
    at = -first_column
    assert found.counts.tolist() == [4 if at <= k < at + 10 else 0 for k in range(n_lines)]
    assert found.shape.n_cells == n_lines * m

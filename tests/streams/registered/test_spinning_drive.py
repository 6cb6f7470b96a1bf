"""Clouds of spinning scanners as streams."""

from dataclasses import replace

import numpy as np
import pytest

from prc_cli.core.findings import Verdict
from prc_cli.core.stream import ScanBlock
from prc_cli.formats.input import Input
from prc_cli.formats.options import InputConfig
from prc_cli.streams.open import open_input
from prc_cli.streams.registered.evidence import PathFigures, judge
from prc_cli.streams.registered.resection import masked_median
from prc_cli.streams.registered.scanner_paths import scanner_paths
from prc_cli.streams.registered.spinning_drive import _PassCounts, judge_rings
from tests.formats.builders import of_points, write_csv
from tests.streams.registered.spinning_clouds import spinning_cloud, station

EVEN = np.arange(-15.0, 16.0, 2.0)
AHEAD = np.array([1.2, -1.2, 3.6, -3.6] * 4)


def test_a_shuffled_cloud_becomes_lines_of_firings_and_columns_of_rings(tmp_path):
    points = spinning_cloud(EVEN, AHEAD, duration_s=0.6)
    order = np.argsort(points.xyz_m[:, 0])
    columns = of_points(points.xyz_m[order], time=points.time_s[order])
    path = write_csv(tmp_path / "cloud.csv", columns)
    stream = open_input(Input.of(path), InputConfig(range="points"))
    blocks: list[ScanBlock] = list(stream.blocks())
    range_m = np.concatenate([block.range_m for block in blocks])
    record = np.concatenate([block.record for block in blocks])
    assert stream.info.points_per_line == 16
    line, column = np.nonzero(record >= 0)
    place = order[record[line, column]]
    assert len(place) > 0.995 * len(points.time_s)
    assert np.mean(points.ring[place] == column) > 0.999
    assert len(np.unique(line - points.line[place])) == 1
    assert np.nanmedian(np.abs(range_m[line, column] - points.range_m[place])) < 0.005
    drive = stream.drive
    assert drive is not None
    (path,) = scanner_paths(drive)
    assert path.time_s[[0, -1]].tolist() == [
        points.time_s.min().round(9),
        points.time_s.max().round(9),
    ]
    off_m = np.abs(path.xyz_m - station(path.time_s))
    assert np.median(off_m) < 0.02, off_m
    assert off_m.max() < 0.2, off_m
    assert np.isfinite(path.sigma_m).all()


def test_a_path_reaches_from_the_first_point_to_the_last():
    time_s = np.array([1.0, 2.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    station = np.stack([2.0 * time_s, 0.0 * time_s, 0.0 * time_s], axis=1)
    axis = np.stack([0.1 * time_s, 0.0 * time_s, 1.0 + 0.0 * time_s], axis=1)
    counts = _PassCounts([time_s], [station], axis=[axis], points_s=[0.5, 7.0])
    path = counts.path(3, 4)
    assert path.time_s.tolist() == [0.5, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]
    assert path.axis[:, 0].tolist() == [0.1, *(0.1 * time_s)[[0, 1, 3, 4, 5, 6, 6]]]
    np.testing.assert_allclose(path.xyz_m[:, 0], 2.0 * path.time_s)
    # only beyond the windows is it uncertain
    assert (path.sigma_m > 0)[:, 0].tolist() == [True, *6 * [False], True]
    # there the speed may change by 4 m/s2
    assert path.sigma_m[[0, -1], 0] == pytest.approx([0.5, 2.0])
    inside = _PassCounts([time_s], [station], axis=[axis], points_s=[2.0, 4.0]).path(0, 0)
    assert inside.time_s.tolist() == [2.0, 3.0, 4.0]


def test_rings_that_points_lie_between_are_doubted_then_refused():
    verdicts = [judge_rings(share).verdict for share in (0.99, 0.8, 0.4)]
    assert verdicts == [Verdict.FINE, Verdict.DOUBTFUL, Verdict.AGAINST]


def test_medians_of_rows_leave_out_what_has_no_weight():
    values = np.array([[5.0, 1.0, 9.0, 2.0], [4.0, 3.0, 2.0, 1.0], [7.0, 0.0, 0.0, 0.0], [8.0] * 4])
    weight = np.array([[1, 1, 1, 0], [0.5, 2, 1, 3], [1, 0, 0, 0], [0] * 4], np.float64)
    # of an even number the lower one
    assert masked_median(values, weight).tolist() == [5.0, 2.0, 7.0, np.inf]


SOUND = PathFigures(
    *(0.0, 60.0, 600.0, 10.0, 12.0, 0.01, 0.95, 1.0, 0.0, 0.02, 0.05),
    *(100.0, 100.0, 1e5, 1000, 2.0, (0.0, 60.0)),
)


@pytest.mark.parametrize(
    "name, values, problem",
    [
        ("residual_m", (0.03, 0.031, 0.16), "m off their beams"),
        ("share_on_beam", (0.81, 0.79, 0.39), "are on no beam"),
        ("share_in_front", (0.98, 0.96, 0.69), "are behind the scanner"),
        ("top_speed_m_s", (45.0, 45.1, 91.0), "the scanner moves at"),
        ("share_bridged", (0.2, 0.21, 0.91), "do not show the place"),
        ("share_holes", (0.15, 0.16, 0.76), "are empty"),
        ("n_unplaced", (10, 11, 501), "no path fits"),
    ],
)
def test_figures_of_a_path_are_fine_then_doubted_then_refused(name, values, problem):
    verdicts = (Verdict.FINE, Verdict.DOUBTFUL, Verdict.AGAINST)
    for value, verdict in zip(values, verdicts, strict=True):
        n_unplaced = int(value) if name == "n_unplaced" else 0
        passed = SOUND if n_unplaced else replace(SOUND, start_s=7.0, **{name: value})
        (finding,) = judge("a.las", [SOUND, passed], n_unplaced, 1000)
        assert finding.verdict is verdict
        if verdict is not Verdict.FINE:
            assert problem in finding.problem
            assert finding.problem.startswith("7.0 s: ") != bool(n_unplaced)

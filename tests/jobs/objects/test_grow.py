"""Runs become objects, line by line."""

import numpy as np
import pytest

from prc_cli.core.classes import Label
from prc_cli.core.stream import LabelledBlock, ScanBlock
from prc_cli.core.types import F32, F64, U8
from prc_cli.jobs.objects.grow import Grower, Rule, ScanObject, runs_of

BEAM: F64 = np.deg2rad(np.linspace(60, 120, 121))
RULES = {Label.STEM: Rule(0.3, 2.0, 2, 4, 0.5), Label.CURB: Rule(0.3, 0.2, 1, 1, most_lines=10)}


def item(
    labels: U8,
    range_m: F32,
    first_line: int = 0,
    xyz: bool = False,
) -> LabelledBlock:
    block = ScanBlock(first_line, range_m, beam_rad=BEAM)
    above = (2.0 - range_m * np.cos(BEAM)).astype(np.float32)
    return LabelledBlock(block, labels, np.empty(0, np.uint8), above_m=above)


def grown(
    labels: U8,
    range_m: F32,
    cut: int = 1000,
    registered: F64 | None = None,
) -> list[ScanObject]:
    """Grow the objects of an image that arrives in blocks of ``cut`` lines."""
    grower = Grower(3, RULES)
    objects = []
    for start in range(0, len(labels), cut):
        rows = slice(start, start + cut)
        part = item(labels[rows], range_m[rows], start)
        block_registered = None if registered is None else registered[rows]
        by_line: dict[int, list[object]] = {}
        for run in runs_of(part, tuple(RULES), block_registered):
            by_line.setdefault(run.last_line, []).append(run)
        for line, runs in by_line.items():
            objects += grower.add(runs, line)  # type: ignore[arg-type]
        objects += grower.add((), start + len(labels[rows]))
    return [*objects, *grower.finish()]


def scene() -> tuple[U8, F32]:
    """Two stems at 5 and 8 m, the first behind a leaf and a gap of a line."""
    labels = np.full((30, len(BEAM)), Label.VEGETATION, np.uint8)
    range_m = np.full(labels.shape, 12.0, np.float32)
    across = 1 / np.sin(BEAM)
    for lines, metres in (((2, 3, 5, 6), 5.0), ((15, 16, 17), 8.0)):
        for line in lines:
            labels[line, 20:100] = Label.STEM
            range_m[line, 20:100] = (metres * across)[20:100]
    labels[3, 55:65] = Label.VEGETATION
    range_m[3, 55:65] = 3.0
    return labels, range_m


@pytest.mark.parametrize("cut", [1, 4, 30])
def test_stems_are_told_once_each(cut):
    labels, range_m = scene()
    first, second = grown(labels, range_m, cut)
    assert (first.kind, first.first_line, first.last_line) == ("stem", 2, 6)
    assert (first.first_column, first.last_column, first.scanner) == (20, 99, 3)
    assert first.n_shots == 4 * 80 - 10
    assert first.side_m == pytest.approx(5.0, abs=1e-5)
    assert first.width_m == pytest.approx(0.0, abs=1e-5)
    assert first.nearest_m == pytest.approx(5.0, abs=1e-3)
    assert first.angle_deg == pytest.approx(90.0, abs=0.6)
    assert (second.first_line, second.side_m) == (15, pytest.approx(8.0, abs=1e-5))
    low = 2.0 - 8.0 / np.tan(BEAM[20])
    high = 2.0 - 8.0 / np.tan(BEAM[99])
    assert (second.base_m, second.top_m) == (
        pytest.approx(low, abs=1e-4),
        pytest.approx(high, abs=1e-4),
    )
    assert second.height_m == pytest.approx(high - low, abs=1e-4)
    assert np.isnan(first.x)


def test_small_things_and_far_lines_are_not_joined():
    labels, range_m = scene()
    labels[:, :] = np.where(labels == Label.STEM, labels, Label.GROUND)
    labels[6:12] = Label.GROUND
    labels[15:18, 22:] = Label.GROUND
    # the first is there still, the second is too low
    assert [(stem.first_line, stem.last_line) for stem in grown(labels, range_m)] == [(2, 5)]


def test_long_objects_are_cut_and_lines_are_counted_from_the_first():
    labels = np.full((25, len(BEAM)), Label.CURB, np.uint8)
    range_m = np.tile(3.0 / np.sin(BEAM), (25, 1)).astype(np.float32)
    labels[:, 3:] = Label.GROUND
    curbs = grown(labels, range_m, 7)
    assert [(curb.first_line, curb.last_line) for curb in curbs] == [(0, 9), (10, 19), (20, 24)]


def test_two_parts_become_one_where_they_meet():
    labels = np.full((4, len(BEAM)), Label.GROUND, np.uint8)
    range_m = np.tile(3.0 / np.sin(BEAM), (4, 1)).astype(np.float32)
    labels[0:2, 5:15] = labels[0:2, 60:80] = Label.CURB
    labels[2:, 5:80] = Label.CURB
    (curb,) = grown(labels, range_m)
    assert (curb.first_line, curb.n_shots) == (0, 2 * 30 + 2 * 75)


def test_coordinates_are_the_middle_of_the_known_ones():
    labels, range_m = scene()
    xyz = np.zeros((*labels.shape, 3))
    xyz[..., 0] = 100.0
    xyz[..., 1] = np.arange(len(labels))[:, None]
    xyz[..., 2] = np.nan
    xyz[3:, :, 2] = 7.0
    first, _ = grown(labels, range_m, 4, xyz)
    assert (first.x, first.z) == (100.0, 7.0)
    assert first.y == pytest.approx((70 * 3 + 80 * 5 + 80 * 6) / 230)


def test_runs_end_at_jumps_other_classes_and_gaps():
    labels = np.full((1, len(BEAM)), Label.STEM, np.uint8)
    range_m = np.full(labels.shape, 4.0, np.float32)
    labels[0, 10:13] = Label.GROUND  # three shots are too many
    labels[0, 30:32] = Label.GROUND  # two are not
    range_m[0, 50:] = 6.0
    labels[0, 70:] = Label.CURB
    runs = list(runs_of(item(labels, range_m), (Label.STEM, Label.CURB)))
    assert [run.columns for run in runs] == [(0, 9), (13, 49), (50, 69), (70, 120)]
    assert [run.n for run in runs] == [10, 35, 20, 51]
    assert not list(runs_of(item(labels, range_m), (Label.CAR,)))


@pytest.mark.parametrize("n_lines, n_stems", [(2, 1), (3, 2)])
def test_a_gap_is_bridged_up_to_the_limit_of_its_rule(n_lines, n_stems):
    labels, range_m = scene()
    lines = [15, 16, *[0] * n_lines, 15, 16]
    assert len(grown(labels[lines], range_m[lines])) == n_stems

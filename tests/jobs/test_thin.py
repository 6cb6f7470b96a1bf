"""Thinned streams: dropped shots become missing, others stay unchanged, and all are counted."""

from fractions import Fraction

import laspy
import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from prc_cli.core.stream import ExtraReturns, ScanBlock
from prc_cli.formats.writing.base import NO_CODE, StreamItem
from prc_cli.jobs.classify import classify
from prc_cli.jobs.thin import parse_rules, thin
from prc_cli.jobs.thin.rules import choose, keep_by_pattern, keep_by_spacing, without
from tests.street import street, write_npz


@given(st.integers(0, 30), st.integers(1, 30), st.integers(0, 10**6))
def test_a_share_is_exact_along_every_line(part, whole, line):
    share = Fraction(min(part, whole), whole)
    columns = np.arange(share.denominator * 5)
    kept = keep_by_pattern(np.full(len(columns), line), columns, share)
    assert kept.sum() == share.numerator * 5
    for start in range(len(columns) - share.denominator):  # evenly: in every window of a period
        assert kept[start : start + share.denominator].sum() == share.numerator


@given(st.lists(st.floats(0, 100), min_size=1, max_size=60), st.floats(0.1, 20))
def test_spacing_against_a_plain_loop(places, spacing):
    position = np.array(places)[None, :, None]
    chosen = np.ones((1, len(places)), np.bool_)
    wanted = []
    last = np.inf
    for place in places:
        taken = bool((place - last) ** 2 >= spacing**2)
        wanted.append(taken)
        last = place if taken else last
    assert keep_by_spacing(position, chosen, spacing)[0].tolist() == wanted


def test_further_returns_have_the_share_of_their_class_or_follow_their_main_return():
    line, column = np.indices((6, 20))
    cells = np.arange(0, 120, 3)
    extra = ExtraReturns(*np.divmod(cells, 20), np.full(40, 9, "f4"), np.arange(120, 160))
    angle_rad = np.arange(20) / 5
    block = ScanBlock(7, np.full((6, 20), 5, "f4"), angle_rad=angle_rad, extra=extra)
    codes = np.where(column % 2, 2, 6)
    extra_codes = np.resize([2, 5, 6, 6], 40)
    rules = parse_rules(["ground=1/3"], ["building=3.5"])
    kept, kept_extra = choose(StreamItem(block, codes, extra_codes), rules)
    thinned_ground = keep_by_pattern(line + 7, column, Fraction(1, 3))
    beam = 5.0 * np.stack([np.cos(angle_rad), np.sin(angle_rad)], axis=-1)
    apart = keep_by_spacing(np.tile(beam, (6, 1, 1)), codes == 6, 3.5)
    np.testing.assert_array_equal(kept, np.where(codes == 2, thinned_ground, apart))
    follows = np.choose(
        np.resize([0, 1, 2, 2], 40), [thinned_ground.flat[cells], True, kept.flat[cells]]
    )
    np.testing.assert_array_equal(kept_extra, follows)


def test_the_nearest_further_return_takes_the_place_of_a_dropped_one():
    extra = ExtraReturns(
        np.zeros(3, np.int32),
        np.array([1, 1, 2], np.int32),
        np.array([9, 7, 8], "f4"),
        np.array([3, 4, 5]),
        np.array([1, 2, 3], "f4"),
    )
    range_m = np.full((1, 3), 5, "f4")
    xyz_m = np.eye(3, dtype="f4")[None] * 5
    block = ScanBlock(0, range_m, xyz_m=xyz_m, intensity=range_m, extra=extra)
    item = StreamItem(block, np.array([[2, 2, 2]]), np.array([5, 6, 64]))
    left = without(item, np.array([[True, False, False]]), np.array([True, True, False]))
    np.testing.assert_array_equal(left.block.range_m, [[5, 7, np.nan]])
    np.testing.assert_array_equal(left.block.intensity, [[5, 2, np.nan]])
    np.testing.assert_array_equal(left.block.xyz_m, [[[5, 0, 0], [0, 7, 0], [np.nan] * 3]])
    np.testing.assert_array_equal(left.codes, [[2, 6, NO_CODE]])
    assert left.block.extra.record.tolist() == [3]
    assert left.extra_codes.tolist() == [5]


def test_las_keeps_every_field_of_what_stays(tmp_path):
    classify(write_npz(tmp_path / "drive.npz", street()), tmp_path / "drive.laz")
    summary = thin(tmp_path / "drive.laz", tmp_path / "thin.laz", parse_rules(["ground=1/4"]))
    before = laspy.read(tmp_path / "drive.laz")
    after = laspy.read(tmp_path / "thin.laz")
    code = np.asarray(before.classification)
    quarter = (before.column.astype(int) + 2 * before.scan_line.astype(int)) % 4 == 0
    stays = (code != 7) & ((code != 2) | quarter)
    assert 0 < (stays & (code == 2)).sum() < (code == 2).sum()
    np.testing.assert_array_equal(after.points.array, before.points.array[stays])
    assert [(item.n_input, item.n_kept) for item in summary.classes] == [
        ((code == item.code).sum(), (stays & (code == item.code)).sum()) for item in summary.classes
    ]
    header = after.header
    assert list(header.number_of_points_by_return[:2]) == [stays.sum(), 0]
    np.testing.assert_allclose(header.mins, after.xyz.min(axis=0), atol=1e-9)
    np.testing.assert_allclose(header.maxs, after.xyz.max(axis=0), atol=1e-9)

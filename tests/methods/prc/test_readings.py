"""Readings of the paper that a small case by hand shows; ``paper.py`` states all of them."""

from typing import Any

import numpy as np
import pytest

from prc_cli.core.classes import Label
from prc_cli.core.types import F32, Mask
from prc_cli.methods.prc.components_loops import carry_labels, join_and_fill
from prc_cli.methods.prc.pipeline import PrcParams
from prc_cli.methods.prc.support import (
    BackgroundParams,
    SupportParams,
    background,
    stream_window,
    support,
    window_reach,
)
from tests.methods.prc.streams import run_stream

nan = np.nan


def window_of(image: F32) -> F32:
    """A whole stream as a window."""
    return stream_window(np.full(window_reach(image.shape[1]), nan, dtype=np.float32), image, None)


def support_of(image: F32, **params: Any) -> Mask:
    return support(window_of(image), image.shape[1], SupportParams(**params))


def wall(n_lines: int = 5, width: int = 20) -> F32:
    return np.full((n_lines, width), 20.0, dtype=np.float32)


@pytest.mark.parametrize(
    "in_line, beside, rounding, is_supported",
    [
        (3, 2, "ceil", True),
        (2, 2, "ceil", False),
        (3, 1, "ceil", False),
        (2, 2, "floor", True),
        (3, 1, "floor", False),
    ],
)
def test_a_third_of_the_neighbours_is_3_of_8_and_2_of_6(in_line, beside, rounding, is_supported):
    image = wall()
    image[2, 6:15] = 50, 60, 70, 80, 20, 90, 100, 110, 120
    image[1, 9:12] = image[3, 9:12] = 50
    image[2, 6 : 6 + in_line] = image[3, 9 : 9 + beside] = 20
    assert support_of(image, rounding=rounding)[2, 10] == is_supported


def test_ranges_that_differ_by_exactly_zeta_do_not_agree():
    stripes = wall()
    stripes[:, ::2] += 1.0
    stripes[[1, 3], 10] = 20.0  # beside the shot, none is nearer than 1 m
    assert not support_of(stripes, zeta_s=1.0)[2, 10]
    assert support_of(stripes, zeta_s=1.0001)[2, 10]


def test_at_the_ends_absent_and_missing_neighbours_do_not_count():
    assert not support_of(wall(1)).any()
    assert support_of(wall(2)).all()
    missing = np.full((5, 20), nan, dtype=np.float32)
    assert not support_of(missing, rho_c=0.1, rounding="floor").any()
    missing[2, 9:12] = 20.0
    assert not support_of(missing, zeta_s=1e9, zeta_p=1e9).any()


UP = (20.0, 20.1, 20.2, 20.3, 20.4)
DOWN = UP[::-1]
FLAT = (20.0,) * 5
STEP = (20.0, 20.0, 5.0, 5.0, 5.0)


@pytest.mark.parametrize(
    "form, line, expected",
    [
        ("centred", UP, "....."),
        ("centred", DOWN, "....."),
        ("centred", FLAT, "....."),
        ("centred", STEP, ".##.."),
        ("literal", UP, "....."),
        ("literal", DOWN, ".###."),
        ("literal", FLAT, ".###."),
        ("abs", DOWN, "....."),
        ("abs", FLAT, ".###."),
        ("guard", FLAT, "....."),
        ("guard", STEP, ".##.."),
        # beside a missing shot nothing is marked
        ("centred", (20, 5, nan, 5, 20), "....."),
        # alpha is 0.25: a quarter of the way up a rise of 1 m is background, a little more is not
        ("centred", (20, 20.25, 21), ".#."),
        ("centred", (20, 20.2500019, 21), "..."),
        ("literal", (20, 20.75, 21), ".#."),
        # (1/2 - alpha) d_c = 12.5 mm
        ("centred", (20, 20.013, 20), ".#."),
        ("centred", (20, 20.012, 20), "..."),
        ("guard", (20, 20.013, 20), "..."),
    ],
)
def test_shots_of_a_supported_line_where_equation_9_does_not_hold(form, line, expected):
    image = np.array([line], dtype=np.float32)
    marked = background(window_of(image), ~np.isnan(image), BackgroundParams(form=form, alpha=0.25))
    assert "".join(".#"[mark] for mark in marked[0].astype(int)) == expected


@pytest.mark.parametrize(
    "picture, components",
    [
        (["#.", ".#"], [[1, 0], [0, 2]]),  # diagonal pixels are apart
        (["#.#", "#.#"], [[1, 0, 2], [1, 0, 2]]),  # columns do not wrap
        (["#o#"], [[1, 1, 2]]),  # of equals the smallest
        (["#o#", "..#", "..#"], [[1, 2, 2], [0, 0, 2], [0, 0, 2]]),  # the most frequent
        (["#ooo#"], [[1, 1, 0, 2, 2]]),  # holes do not see each other filled
        (["#.", ".o"], [[1, 0], [0, 1]]),  # diagonal neighbours fill
    ],
)
def test_components_and_their_holes(picture, components):
    """``#`` is a supported shot, ``o`` one of the background."""
    shots = np.array([[*line] for line in picture])
    assert join_and_fill(shots != ".", shots == "o")[0].tolist() == components


@pytest.mark.parametrize(
    "first, last, labels",
    [
        ([1, 1, 1, 0], [7, 7, 7, 0], [7]),
        ([1, 1, 1, 0], [7, 7, 0, 7], [0]),  # two votes, the third is in another column
        ([1] * 7, [5, 5, 5, 9, 9, 9, 9], [9]),  # most votes
        ([1] * 6, [9, 9, 9, 5, 5, 5], [5]),  # of equals the older
        ([1] * 6, [5, 5, 7, 7, 8, 8], [0]),  # too few of each do not add up
        ([1, 1, 1, 0, 2, 2, 2], [7] * 7, [7, 7]),  # both pieces of a fork
    ],
)
def test_votes_for_the_labels_of_the_line_before(first, last, labels):
    taken = carry_labels(np.array(first, np.int32), np.array(last, np.int64), max(first), 3)
    assert taken[1:].tolist() == labels


def test_a_fork_keeps_its_label_on_all_pieces_or_on_the_largest():
    stream = wall(6, 21)
    stream[3:, 9] = nan
    for forks, expected in (("all", {1}), ("largest", {1, 2})):
        params = {"lines_per_block": 3, "components": {"forks": forks}, "surfaces": {"area": 20}}
        _, segments = run_stream(stream, PrcParams.model_validate(params))
        assert {*segments[3:, :9].flat} == {max(expected)}
        assert {*segments[3:, 10:].flat} == {1}


def test_the_area_is_counted_in_the_block_alone():
    """A long segment that only just reaches into a block is small there."""
    stream = wall(6, 20)
    stream[3:, 8:] = nan
    params = {"lines_per_block": 3, "surfaces": {"area": 30, "gamma": 0}}
    labels, _ = run_stream(stream, PrcParams.model_validate(params))
    assert (labels[:3] == Label.GROUND).all()
    assert (labels[3:, :8] == Label.VEGETATION).all()


@pytest.mark.parametrize("lines_per_block, expected", [(6, Label.VEGETATION), (20, Label.GROUND)])
def test_a_short_last_block_asks_for_an_area_in_proportion(lines_per_block, expected):
    """60 pixels against 100, or against 100 * 6 / 20 = 30."""
    params = {"lines_per_block": lines_per_block, "surfaces": {"area": 100}}
    labels, _ = run_stream(wall(6, 10), PrcParams.model_validate(params))
    assert (labels == expected).all()

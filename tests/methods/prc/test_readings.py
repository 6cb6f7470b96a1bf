"""One small hand-written case for every reading of the paper."""

from __future__ import annotations

import numpy as np
import pytest

from prc_cli.core.classes import Label
from prc_cli.core.config import build
from prc_cli.core.types import F32, I64, U8, Mask
from prc_cli.methods.prc.components import Components, ComponentsParams, identify, join
from prc_cli.methods.prc.components_loops import carry_labels
from prc_cli.methods.prc.pipeline import PrcParams, PrcState, initial_state
from prc_cli.methods.prc.support import (
    BackgroundParams,
    SupportParams,
    background,
    stream_window,
    support,
    window_reach,
)
from prc_cli.methods.prc.support_loops import support_mask
from prc_cli.methods.prc.surfaces import (
    Surfaces,
    SurfacesParams,
    area_threshold,
    find_small,
    surfaces,
)
from prc_cli.methods.prc.urban import (
    ForestParams,
    Totals,
    UrbanParams,
    count_smooth,
    find_ground,
    forest,
    urban,
)
from tests.methods.prc.streams import run_blocks, segments_of, trace_block

nan = np.nan


def window_of(image: list[list[float]] | F32) -> F32:
    """A whole stream as a window."""
    array = np.array(image, dtype=np.float32)
    return stream_window(np.full(window_reach(array.shape[1]), nan, dtype=np.float32), array, None)


def support_of(image: list[list[float]] | F32, **params: float | str) -> Mask:
    return support(window_of(image), np.array(image).shape[1], SupportParams.model_validate(params))


def background_of(line: list[float], **params: float | str) -> list[int]:
    """G of a single line that is supported wherever there is a range."""
    image = np.array([line], dtype=np.float32)
    marked = background(window_of(image), ~np.isnan(image), BackgroundParams.model_validate(params))
    return [int(mark) for mark in marked[0]]


def h_of(image: list[list[int]], ids: list[int] | None = None, next_id: int = 0) -> Components:
    """Component image with its ids; by default the component numbers themselves."""
    array = np.array(image, dtype=np.int32)
    segment_ids = np.arange(array.max() + 1) if ids is None else np.array(ids, dtype=np.int64)
    pixels = np.bincount(array.ravel(), minlength=len(segment_ids)) * (
        np.arange(len(segment_ids)) > 0
    )
    next_id = next_id or int(segment_ids.max()) + 1
    return Components(array, pixels, segment_ids, first_new_id=next_id, next_id=next_id)


def components(
    supported: Mask,
    holes: Mask,
    last_line: I64,
    next_id: int,
    params: ComponentsParams,
) -> Components:
    return identify(join(supported, holes), last_line, next_id, params)


def split(
    h: Components,
    area: float,
    gamma: int = 0,
    supported: Mask | None = None,
) -> Surfaces:
    params = SurfacesParams(gamma=gamma)
    shots = h.image > 0 if supported is None else supported
    return surfaces(shots, h, find_small(h, area), params, with_patches=True)


def label_urban(v: Surfaces, totals: Totals, params: UrbanParams) -> tuple[U8, Totals]:
    """Labels of a block without missing shots."""
    last_line = np.where(v.smooth[-1], v.components.ids[v.components.image[-1]], 0)
    ground, after = find_ground(v.components, count_smooth(v), last_line, totals, params)
    return urban(window_of(np.ones(v.supported.shape, np.float32)), v, ground), after


def label_forest(
    missing: Mask,
    supported: Mask,
    smooth: Mask,
    params: ForestParams,
) -> U8:
    image = np.where(missing, np.float32(nan), np.float32(1))
    v = Surfaces(supported, h_of(supported.astype(int).tolist()), supported & ~smooth, None, 0)
    return forest(window_of(image), v, params)


def wall(n_lines: int = 5, width: int = 20, far: float = 20.0) -> F32:
    return np.full((n_lines, width), far, dtype=np.float32)


class TestReading1Counts:
    """Counts compare as real numbers.

    3 of 8 in the line and 2 of 6 beside it; floor gives 2 and 2.
    """

    @pytest.mark.parametrize(
        ("agreeing", "rounding", "expected"), [(3, "ceil", 1), (2, "ceil", 0), (2, "floor", 1)]
    )
    def test_in_slice(self, agreeing: int, rounding: str, expected: int) -> None:
        image = wall()
        image[2, 6:15] = 50, 60, 70, 80, 20, 90, 100, 110, 120
        image[2, 6 : 6 + agreeing] = 20
        assert support_of(image, rounding=rounding)[2, 10] == expected

    @pytest.mark.parametrize(
        ("agreeing", "rounding", "expected"), [(2, "ceil", 1), (1, "ceil", 0), (1, "floor", 0)]
    )
    def test_adjacent(self, agreeing: int, rounding: str, expected: int) -> None:
        image = wall()
        image[1, 9:12] = image[3, 9:12] = 50
        image[3, 9 : 9 + agreeing] = 20
        assert support_of(image, rounding=rounding)[2, 10] == expected


class TestReading2Strictness:
    """Range differences below zeta agree, equal ones do not.

    Area A is smooth; eq. 9 holds strictly.
    """

    def test_difference_of_exactly_zeta_does_not_agree(self) -> None:
        stripes = wall()
        stripes[:, ::2] += (
            # every other shot agrees in the line: 4; beside it only those at the same column: 2
            1.0
        )
        assert support_of(stripes, zeta_s=1.0, zeta_p=1.0)[2, 10]
        stripes[[1, 3], 10] = 20.0  # now none beside it is nearer than 1.0
        assert not support_of(stripes, zeta_s=1.0, zeta_p=1.0)[2, 10]
        assert support_of(stripes, zeta_s=1.0001, zeta_p=1.0)[2, 10]

    def test_area_of_exactly_a_is_smooth(self) -> None:
        h = h_of([[1, 1, 1, 0, 2, 2]])
        assert split(h, area=3).smooth[0].tolist() == [True, True, True, False, False, False]
        assert split(h, area=3.001).smooth.sum() == 0

    def test_ratio_of_exactly_alpha_is_background(self) -> None:
        # alpha 0.25: a shot a quarter of the way up a rise of 1 m
        assert background_of([20, 20.25, 21], alpha=0.25) == [0, 1, 0]
        assert background_of([20, 20.2500019, 21], alpha=0.25) == [0, 0, 0]
        assert background_of([20, 20.75, 21], alpha=0.25, form="literal") == [0, 1, 0]


def test_reading_3_neighbours_go_by_flat_index() -> None:
    """The first shot of a line sees the end of the line before, the last one the line after
    next."""
    image = wall(4, 10, far=50)
    image[:, ::3] += 100 * np.arange(4)[:, None]  # nothing agrees by chance
    image = np.arange(40, dtype=np.float32).reshape(4, 10) * 10
    image[2, 0] = image[1, 7] = image[1, 8] = image[1, 9] = 7.0  # in the line: i - 1 .. i - 3
    image[3, 0] = image[0, 9] = 7.0  # beside: i + M, and i - M - 1, two lines up
    assert support_of(image)[2, 0]
    image[0, 9] = 700.0
    assert not support_of(image)[2, 0]


def test_a_shot_does_not_support_itself() -> None:
    """With one shot a line the flat index i + M - 1 is i itself."""
    alone = window_of([[5.0], [50.0], [90.0], [20.0], [70.0]])
    assert not support_mask(alone, 5, 1, 1.0, 1.0, 0, 1).any()


class TestReading4BlockEdges:
    """Support and background belong to the stream; at its ends absent neighbours do not count."""

    def test_step_at_the_block_boundary_is_seen_from_both_sides(self) -> None:
        stream = wall(6, 12)
        stream[3:] = 5.0  # shot (2, 11) and shot (3, 0) are a step apart
        for k in (1, 3, 6):
            traces = [trace for trace, _ in run_blocks(stream, PrcParams(lines_per_block=k))]
            g = np.concatenate([trace.background for trace in traces])
            assert np.argwhere(g).tolist() == [[2, 11], [3, 0]]

    def test_thresholds_stay_at_the_ends(self) -> None:
        # a lone line has nothing beside it; of two lines every shot sees at least two shots of the
        # other
        assert not support_of(wall(1)).any()
        assert support_of(wall(2)).all()


class TestReading5Missing:
    """Missing shots never support, are never supported, have no class and are background."""

    def test_missing_shots_do_not_support_each_other(self) -> None:
        image = np.full((5, 20), nan, dtype=np.float32)
        assert not support_of(image).any()
        assert not support_of(
            image, rho_c=0.1, rounding="floor"
        ).any()  # even where no neighbour is needed

    def test_missing_shots_do_not_support_others(self) -> None:
        image = np.full((5, 20), nan, dtype=np.float32)
        image[2, 10] = image[2, 9] = image[2, 11] = 20.0
        assert not support_of(image, zeta_s=1e9, zeta_p=1e9).any()

    def test_missing_shots_cut_components(self) -> None:
        image = wall(3, 21)
        image[:, 10] = nan
        trace, _ = trace_block(image, None, initial_state(21), PrcParams())
        h = trace.components.to_segments()
        assert (h[0, 0], h[0, 10], h[0, 20]) == (1, 0, 2)
        assert (trace.labels[:, 10] == Label.MISSING).all()


class TestReading6BackgroundBesideMissing:
    """Beside a missing or absent shot nothing is marked; ranges of noise neighbours are used."""

    @pytest.mark.parametrize("form", ["centred", "literal", "abs", "guard"])
    def test_beside_missing(self, form: str) -> None:
        assert background_of([20, 5, nan, 5, 20], form=form) == [0, 0, 0, 0, 0]

    def test_noise_neighbours_count(self) -> None:
        image = np.array([[20, 20, 5, 20, 20]], dtype=np.float32)
        supported = np.array([[1, 1, 0, 1, 1]], dtype=bool)
        assert background(window_of(image), supported, BackgroundParams()).tolist() == [
            [False, True, False, True, False]
        ]


class TestEquation9:
    """What the four forms mark (B2)."""

    RAMP_UP = (20.0, 20.1, 20.2, 20.3, 20.4)
    RAMP_DOWN = RAMP_UP[::-1]
    FLAT = (20.0,) * 5
    STEP = (20.0, 20.0, 5.0, 5.0, 5.0)

    @pytest.mark.parametrize(
        ("form", "line", "expected"),
        [
            ("centred", RAMP_UP, [0, 0, 0, 0, 0]),
            ("centred", RAMP_DOWN, [0, 0, 0, 0, 0]),
            ("centred", FLAT, [0, 0, 0, 0, 0]),
            ("centred", STEP, [0, 1, 1, 0, 0]),
            ("literal", RAMP_UP, [0, 0, 0, 0, 0]),
            ("literal", RAMP_DOWN, [0, 1, 1, 1, 0]),
            ("literal", FLAT, [0, 1, 1, 1, 0]),
            ("abs", RAMP_DOWN, [0, 0, 0, 0, 0]),
            ("abs", FLAT, [0, 1, 1, 1, 0]),
            ("guard", FLAT, [0, 0, 0, 0, 0]),
            ("guard", STEP, [0, 1, 1, 0, 0]),
        ],
    )
    def test_form(self, form: str, line: tuple[float, ...], expected: list[int]) -> None:
        assert background_of(list(line), form=form) == expected

    def test_below_d_c_centred_marks_a_deviation_of_a_centimetre_and_guard_does_not(self) -> None:
        # (1/2 - alpha) d_c = 0.2 * 0.05 = 1 cm
        assert background_of([20, 20.011, 20]) == [0, 1, 0]
        assert background_of([20, 20.009, 20]) == [0, 0, 0]
        assert background_of([20, 20.011, 20], form="guard") == [0, 0, 0]

    def test_centred_equals_literal_on_ascents_of_d_c_and_more(self) -> None:
        rng = np.random.default_rng(9)
        for _ in range(300):
            before = rng.uniform(1, 50)
            after = before + rng.uniform(0.0501, 3)
            here = rng.uniform(before - 1, after + 1)
            line = [before, here, after]
            assert background_of(line) == background_of(line, form="literal")


class TestReading7Components:
    """Four neighbours, and the first column is not beside the last one."""

    def test_diagonal_pixels_are_apart(self) -> None:
        s = np.array([[1, 0], [0, 1]], dtype=bool)
        h = components(s, np.zeros_like(s), np.zeros(2, np.int64), 1, ComponentsParams())
        assert h.image.tolist() == [[1, 0], [0, 2]]

    def test_columns_do_not_wrap(self) -> None:
        s = np.array([[1, 0, 1], [1, 0, 1]], dtype=bool)
        h = components(s, np.zeros_like(s), np.zeros(3, np.int64), 1, ComponentsParams())
        assert h.image.tolist() == [[1, 0, 2], [1, 0, 2]]


class TestReading8HoleFilling:
    """One pass over all holes at once: most frequent of 8 neighbours, of equals the smallest."""

    @staticmethod
    def fill(s: list[list[int]], g: list[list[int]]) -> list[list[int]]:
        supported = np.array(s, dtype=bool)
        holes = np.array(g, dtype=bool)
        width = supported.shape[1]
        image = components(supported, holes, np.zeros(width, np.int64), 1, ComponentsParams()).image
        return image.tolist()  # type: ignore[no-any-return]

    def test_most_frequent(self) -> None:
        # component 2 has more of the 8 neighbours than component 1
        assert self.fill([[1, 1, 1], [0, 1, 1], [0, 0, 1]], [[0, 1, 0], [0, 1, 0], [0, 0, 0]]) == [
            [1, 2, 2],
            [0, 2, 2],
            [0, 0, 2],
        ]

    def test_tie_goes_to_the_smallest(self) -> None:
        assert self.fill([[1, 1, 1]], [[0, 1, 0]]) == [[1, 1, 2]]

    def test_holes_do_not_see_each_other_filled(self) -> None:
        assert self.fill([[1, 1, 1, 1, 1]], [[0, 1, 1, 1, 0]]) == [[1, 1, 0, 2, 2]]

    def test_diagonal_neighbours_count(self) -> None:
        assert self.fill([[1, 0], [0, 1]], [[0, 0], [0, 1]]) == [[1, 0], [0, 1]]


def test_reading_9_background_that_nobody_takes_back_is_non_smooth() -> None:
    """It joins the small segments, so that every supported shot ends up in one of the two sets."""
    s = np.array([[1, 1, 1, 1, 0, 1, 1]], dtype=bool)
    v = split(h_of([[1, 1, 1, 1, 0, 0, 0]]), area=4, supported=s)
    assert v.smooth.tolist() == [[True] * 4 + [False] * 3]
    assert v.to_segments().tolist() == [[1, 1, 1, 1, 0, 2, 2]]


class TestReading10Votes:
    """Same column, most votes, three or more, of equals the older.

    Forks share; joined segments take one label.
    """

    @staticmethod
    def carry(first: list[int], last: list[int], min_votes: int = 3) -> list[int]:
        n = max(first)
        taken = carry_labels(np.array(first, np.int32), np.array(last, np.int64), n, min_votes)
        return taken[1:].tolist()  # type: ignore[no-any-return]

    def test_three_votes_are_enough_and_two_are_not(self) -> None:
        assert self.carry([1, 1, 1, 0], [7, 7, 7, 0]) == [7]
        assert self.carry([1, 1, 1, 0], [7, 7, 0, 7]) == [0]

    def test_most_votes_win(self) -> None:
        assert self.carry([1] * 7, [5, 5, 5, 9, 9, 9, 9]) == [9]

    def test_tie_goes_to_the_older(self) -> None:
        assert self.carry([1] * 6, [9, 9, 9, 5, 5, 5]) == [5]

    def test_fork_keeps_the_label_on_both_sides(self) -> None:
        assert self.carry([1, 1, 1, 0, 2, 2, 2], [7] * 7) == [7, 7]

    @staticmethod
    def identified(image: list[list[int]], forks: str) -> list[list[int]]:
        """Segments of an image below a line of the label 7."""
        shots = np.array(image, dtype=np.bool_)
        last_line = np.full(shots.shape[1], 7)
        params = ComponentsParams.model_validate({"forks": forks})
        h = components(shots, np.zeros_like(shots), last_line, 8, params)
        return h.to_segments().tolist()  # type: ignore[no-any-return]

    def test_only_the_largest_piece_keeps_the_label_if_asked(self) -> None:
        image = [[1, 1, 1, 0, 1, 1, 1], [0, 0, 0, 0, 1, 1, 1]]
        assert self.identified(image, "all") == [[7, 7, 7, 0, 7, 7, 7], [0, 0, 0, 0, 7, 7, 7]]
        assert self.identified(image, "largest") == [[8, 8, 8, 0, 7, 7, 7], [0, 0, 0, 0, 7, 7, 7]]

    def test_of_equal_pieces_the_first_keeps_the_label(self) -> None:
        assert self.identified([[1, 1, 1, 0, 1, 1, 1]], "largest") == [[7, 7, 7, 0, 8, 8, 8]]

    def test_votes_in_another_column_do_not_count(self) -> None:
        assert self.carry([0, 0, 0, 1, 1, 1], [7, 7, 7, 0, 0, 0]) == [0]

    def test_votes_below_the_limit_do_not_add_up(self) -> None:
        assert self.carry([1] * 6, [5, 5, 7, 7, 8, 8]) == [0]

    def test_joined_segment_takes_one_label_and_history_stays(self) -> None:
        stream = wall(6, 21)
        stream[:3, 10] = nan
        traces = run_blocks(
            stream, build(PrcParams, {"lines_per_block": 3, "surfaces": {"area": "auto"}}, "test")
        )
        assert np.unique(segments_of(traces[0][0])).tolist() == [0, 1, 2]
        assert np.unique(segments_of(traces[1][0])).tolist() == [1]

    def test_only_smooth_labels_vote(self) -> None:
        stream = wall(4, 30)
        stream[:, 12] = nan  # 12 columns are too small for area 30, 17 are not
        params = build(
            PrcParams, {"lines_per_block": 2, "surfaces": {"area": 30, "gamma": 0}}, "test"
        )
        (first, after), (second, _) = run_blocks(stream, params)
        assert after.link.last_line.tolist() == [0] * 13 + [2] * 17
        assert np.unique(segments_of(first)[:, :12]).tolist() == [3]
        assert np.unique(segments_of(second)[:, 13:]).tolist() == [2]
        assert segments_of(second)[0, 0] > 3

    def test_new_ids_come_in_the_order_of_the_components(self) -> None:
        s = np.array([[1, 0, 1, 1, 1, 0, 1]], dtype=bool)
        last = np.array([0, 0, 4, 4, 4, 0, 0])
        h = components(s, np.zeros_like(s), last, 9, ComponentsParams())
        assert h.ids.tolist() == [0, 9, 4, 10]
        assert h.next_id == 11


class TestReading11Order:
    """Fill, then votes, then areas."""

    def test_filled_shots_vote_too(self) -> None:
        s = np.array([[1, 1, 1]], dtype=bool)
        g = np.array([[0, 0, 1]], dtype=bool)
        h = components(s, g, np.array([7, 7, 7]), 8, ComponentsParams())
        assert h.ids.tolist() == [0, 7]

    def test_pieces_of_a_fork_are_measured_together(self) -> None:
        pieces = h_of([[1, 1, 1, 0, 2, 2, 2]], ids=[0, 7, 7])
        assert split(pieces, area=6).smooth.sum() == 6
        strangers = h_of([[1, 1, 1, 0, 2, 2, 2]], ids=[0, 7, 8])
        assert split(strangers, area=6).smooth.sum() == 0


def test_reading_12_area_is_counted_in_the_block_alone() -> None:
    """A long segment that only just reaches into a block is small there."""
    stream = wall(6, 20)
    stream[3:, 8:] = nan
    params = build(PrcParams, {"lines_per_block": 3, "surfaces": {"area": 30, "gamma": 0}}, "test")
    (first, after), (second, _) = run_blocks(stream, params)
    assert (first.labels == Label.GROUND).all()
    assert (after.link.last_line == 1).all()
    assert (second.labels[:, :8] == Label.VEGETATION).all()


class TestReading13Dilation:
    """Smooth shots under the dilated image become non-smooth.

    Noise stays noise, missing stays missing.
    """

    def test_smooth_shots_are_covered(self) -> None:
        h = h_of([[1, 1, 1, 1, 1, 0, 2]])
        assert split(h, area=5, gamma=1).smooth[0].tolist() == [True] * 5 + [False] * 2
        v = split(h, area=5, gamma=3)
        assert v.to_segments().tolist() == [[1, 1, 1, 3, 3, 0, 3]]

    def test_noise_under_it_stays_noise(self) -> None:
        h = h_of([[1, 1, 1, 0, 0, 2]])
        v = split(h, area=3, gamma=2)
        assert v.to_segments().tolist() == [[1, 1, 1, 0, 0, 3]]
        assert v.to_patches().tolist() == [[0, 0, 0, 3, 3, 3]]
        labels, _ = label_urban(v, Totals.none(), UrbanParams())
        assert labels[0, 3:5].tolist() == [Label.NOISE, Label.NOISE]

    def test_patches_join_across_smooth_and_noise(self) -> None:
        v = split(h_of([[2, 0, 1, 1, 1, 0, 3]], next_id=4), area=3, gamma=3)
        assert v.to_segments().tolist() == [[4, 0, 4, 4, 4, 0, 4]]


def test_reading_14_outside_of_the_image_is_background() -> None:
    """Nothing grows in from the border."""
    v = split(h_of([[1, 1], [1, 1]]), area=4, gamma=5)
    assert v.smooth.all()


def test_reading_15_patches_have_ids_of_their_own_in_every_block() -> None:
    rng = np.random.default_rng(4)
    stream = rng.choice(np.array([5.0, 5.02, 9.0], np.float32), (30, 20))
    params = build(PrcParams, {"lines_per_block": 5, "surfaces": {"area": 8}}, "test")
    seen: set[int] = set()
    for trace, _ in run_blocks(stream, params):
        patches = set(np.unique(trace.surfaces.to_patches()).tolist()) - {0}
        h = set(np.unique(trace.components.to_segments()).tolist()) - {0}
        assert patches
        assert not patches & h
        assert not patches & seen
        seen |= patches | h


class TestReading16Ground:
    """The ground is the smooth segment with most shots over the blocks seen.

    a variant looks at one block.
    """

    @staticmethod
    def label(
        ids: list[int],
        image: list[list[int]],
        totals: Totals,
        ground: str,
    ) -> tuple[list[int], Totals]:
        h = h_of(image, ids=ids)
        labels, after = label_urban(
            split(h, area=1), totals, UrbanParams.model_validate({"ground": ground})
        )
        return labels[0].tolist(), after

    def test_running_total_outweighs_a_large_facade(self) -> None:
        totals = Totals(np.array([3], np.int64), np.array([100], np.int64))
        labels, after = self.label([0, 3, 4], [[1, 2, 2, 2]], totals, "running-total")
        assert labels == [Label.GROUND] + [Label.BUILDING] * 3
        assert (after.ids.tolist(), after.counts.tolist()) == ([3, 4], [101, 3])
        labels, after = self.label([0, 3, 4], [[1, 2, 2, 2]], totals, "block")
        assert labels == [Label.BUILDING] + [Label.GROUND] * 3
        assert after.counts.tolist() == [101, 3]

    def test_tie_goes_to_the_older(self) -> None:
        for image in ([[1, 1, 2, 2]], [[2, 2, 1, 1]]):
            labels, _ = self.label([0, 9, 4], image, Totals.none(), "running-total")
            assert labels == [Label.GROUND if c == 2 else Label.BUILDING for c in image[0]]

    def test_segments_that_are_not_here_cannot_be_the_ground(self) -> None:
        totals = Totals(np.array([1, 2], np.int64), np.array([1000, 5], np.int64))
        labels, after = self.label([0, 2], [[1, 1]], totals, "running-total")
        assert labels == [Label.GROUND] * 2
        assert after.ids.tolist() == [2]

    def test_totals_are_kept_for_what_reaches_the_last_line(self) -> None:
        _, after = self.label([0, 5, 6], [[1, 1, 2], [0, 0, 2]], Totals.none(), "running-total")
        assert (after.ids.tolist(), after.counts.tolist()) == ([6], [2])

    def test_pieces_of_a_fork_are_ground_together(self) -> None:
        labels, _ = self.label(
            [0, 5, 6, 5], [[1, 2, 2, 2, 3, 3, 3]], Totals.none(), "running-total"
        )
        assert labels == [Label.GROUND] + [Label.BUILDING] * 3 + [Label.GROUND] * 3

    def test_without_smooth_shots_there_is_no_ground(self) -> None:
        h = h_of([[1, 0, 2]])
        labels, after = label_urban(split(h, area=5), Totals.none(), UrbanParams())
        assert labels.tolist() == [[Label.VEGETATION, Label.NOISE, Label.VEGETATION]]
        assert not len(after.ids)


class TestReading17ForestGround:
    """Every tenth column decides for ten.

    More than a third of all k lines must be smooth; noise is overwritten.
    """

    @staticmethod
    def label(smooth: list[int], width: int, **params: bool | float) -> list[list[int]]:
        """Six lines of noise and one missing shot, column 0 smooth where told."""
        mask = np.zeros((6, width), dtype=bool)
        mask[: len(smooth), 0] = np.array(smooth, dtype=bool)
        missing = np.zeros_like(mask)
        missing[5, 1] = True
        return label_forest(missing, mask, mask, ForestParams.model_validate(params)).tolist()  # type: ignore[no-any-return]

    def test_exactly_a_third_is_not_ground(self) -> None:
        assert self.label([1, 1], 12)[0] == [Label.STEM] + [Label.NOISE] * 11

    def test_more_than_a_third_is_ground_for_ten_columns_noise_included(self) -> None:
        labels = self.label([1, 1, 1], 12)
        assert labels[0] == [Label.GROUND] * 10 + [Label.NOISE] * 2
        assert labels[4] == [Label.GROUND] * 10 + [Label.NOISE] * 2
        assert labels[5][1] == Label.MISSING

    def test_noise_can_be_kept(self) -> None:
        labels = self.label([1, 1, 1], 12, noise_in_ground_columns=False)
        assert labels[0] == [Label.GROUND] + [Label.NOISE] * 11

    def test_last_group_may_be_short(self) -> None:
        mask = np.ones((3, 23), dtype=bool)
        mask[:, 10] = False
        labels = label_forest(~mask, mask, mask, ForestParams())
        assert (labels == Label.GROUND).all(axis=0).tolist() == [True] * 10 + [False] * 10 + [
            True
        ] * 3

    def test_missing_stays_missing(self) -> None:
        image = wall(9, 20)
        image[4, 5] = nan
        params = build(PrcParams, {"environment": "forest"}, "test")
        labels = trace_block(image, None, initial_state(20), params)[0].labels
        assert labels[4, 5] == Label.MISSING
        assert (np.delete(labels.ravel(), 85) == Label.GROUND).all()


def test_reading_18_forest_classes() -> None:
    s = np.array([[1, 1, 0, 0]], dtype=bool)
    smooth = np.array([[0, 1, 0, 0]], dtype=bool)
    labels = label_forest(np.zeros_like(s), s, smooth, ForestParams())
    assert labels.tolist() == [[Label.VEGETATION, Label.STEM, Label.NOISE, Label.NOISE]]


class TestReading19LastBlock:
    """A block cut short by the end of the stream asks for an area in proportion."""

    def test_threshold_is_a_real_number(self) -> None:
        assert area_threshold(SurfacesParams(area=30), 10, 99, 2154) == pytest.approx(
            3.0303, abs=1e-4
        )

    @pytest.mark.parametrize(
        ("lines_per_block", "expected"), [(6, Label.VEGETATION), (20, Label.GROUND)]
    )
    def test_small_segment_in_a_short_block(self, lines_per_block: int, expected: Label) -> None:
        params = build(
            PrcParams, {"lines_per_block": lines_per_block, "surfaces": {"area": 100}}, "test"
        )
        labels = trace_block(wall(6, 10), None, initial_state(10), params)[0].labels
        assert (labels == expected).all()  # 60 pixels against 100, or against 100 * 6 / 20 = 30


def test_state_is_an_explicit_value() -> None:
    state = initial_state(5)
    assert isinstance(state, PrcState)
    with pytest.raises(AttributeError):
        state.link = state.link  # type: ignore[misc]
    again: I64 = initial_state(5).link.last_line
    assert again is not state.link.last_line

"""Comparison with a registered reference by coordinates: tolerance, shift, gaps and noise."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from itertools import combinations, pairwise
from pathlib import Path

import numpy as np

from prc_cli.core.errors import ConfigError, InputError
from prc_cli.core.threads import ordered
from prc_cli.core.types import F64, I64, Mask
from prc_cli.evaluation.scores import LOST, NOISE
from prc_cli.formats.las.vlrs import same_crs, short_crs
from prc_cli.formats.writing.disk import scratch_file
from prc_cli.jobs.evaluate.counts import Compared, Counts, Plan
from prc_cli.jobs.evaluate.cuts import Area, Cover, Ground, Trees
from prc_cli.jobs.evaluate.options import PLACE_BY_POSES, EvaluateOptions
from prc_cli.matching.join import CODE, Columns, JoinTally, columns_of
from prc_cli.matching.keys import AXES
from prc_cli.matching.nearest import Cloud, Nearest, fit_of, nearest_join, nearest_of
from prc_cli.matching.shift import shift_of, shift_text
from prc_cli.matching.sides import FILE, SECONDS, UNKNOWN, Side

GROUND = "ground"
STEM = "stem"
REACHES = 8.0
"""Up to this many tolerances, shots without partner are compared with the spacing there."""
CLEAR = 1.5
"""Shots without partner beyond this many tolerances are noise: no thinning reaches so far.

Nearer shots are estimated: noise is assumed as dense as in the next tolerance, down to the
tolerance, and from there thinner towards the surface. In all these are as many shots as the next
tolerance has.
"""
_OVERLAP_M = 0.5
"""Tiles that overlap by less have one edge, rounded [m]."""
_DEGREES_SPAN = 0.1
_AROUND_M = 2.0
MOSTLY = 0.4
"""A reference was thinned at random if more of the shots without partner are within its spacing."""
_GAP_SHARE = 0.002
"""Gaps with a larger share of the predicted shots are reported."""


class Registered:
    """Pairs of a prediction and its registered reference, and the notes about them."""

    def __init__(
        self,
        left: Side,
        right: Side,
        options: EvaluateOptions,
        counts: Counts,
    ) -> None:
        self._sides = left, right
        self._options = options
        self._counts = counts
        self._mapping = counts.mapping
        self._area = None if options.inside is None else Area(options.inside)
        self._trees = None if options.trees is None else Trees.read(options.trees)
        self._heights = options.height is not None or self._trees is not None
        self._ground = Ground()
        self._bounds: dict[int, tuple[F64, F64]] = {}
        self.tolerance = options.tolerance or 0.0
        self.n_cut = self.n_beside = self._n_left_out = 0
        self._is_thinned = self._is_narrow = False
        self._noise = dict.fromkeys(
            (
                "reference",
                "predicted",
                "agreed",
                "sparse",
                "sparse_agreed",
                "estimated",
                "estimated_agreed",
            ),
            0,
        )
        names = self._mapping.names("reference")
        asked = (
            (options.unmatched == NOISE, NOISE, "--unmatched noise"),
            (self._heights, GROUND, "heights"),
            (self._trees is not None, STEM, "--trees"),
        )
        for is_needed, name, option in asked:
            if is_needed and name not in names:
                problem = (
                    f"{option} needs a class {name!r} in [reference], found {', '.join(names)}"
                )
                raise ConfigError(
                    "class mapping",
                    problem,
                    f"add {name} = [...] to it, with no codes if it has none",
                )

    def pairs(self, plan: Plan, tally: JoinTally, third: Side | None) -> Iterator[Compared]:
        """Yield the predicted shots with the class of the nearest reference point, tile by tile."""
        left, right = self._sides
        check_crs((left, right, *([third] if third else [])), self._counts)
        timed = (SECONDS,) if all(SECONDS in side.dimensions for side in (left, right)) else ()
        names = tuple(dict.fromkeys((CODE, *AXES, *plan.predicted, *timed)))
        others = tuple(dict.fromkeys((CODE, *AXES, *plan.reference, *timed, FILE)))
        with ExitStack() as stack:
            files = [stack.enter_context(scratch_file("matching")) for _ in range(3)]
            sides = (
                self._predicted(left, names),
                self._reference(right, others, keep_file=FILE in plan.reference),
            )
            predicted, reference = ordered(lambda k: Cloud(sides[k], files[k]), range(2), threads=2)
            reference_squares, _ = reference.squares()
            self._cover = Cover(*predicted.squares(), reference_squares)
            self._check(predicted, reference)
            third_cloud = None
            if third is not None:
                third_cloud = Cloud(columns_of(third, (CODE, *AXES), sort=False), files[2])
            reach = REACHES * self.tolerance if self._options.unmatched == NOISE else None
            for tile in nearest_join(predicted, reference, self.tolerance, tally, reach):
                yield from self._compared(tile, plan, third_cloud)

    def _predicted(self, side: Side, names: tuple[str, ...]) -> Iterator[Columns]:
        for columns in columns_of(side, names, sort=False, with_record=False):
            if self._area is not None:
                inside = self._area.holds(columns["x"], columns["y"])
                self.n_cut += len(inside) - int(np.count_nonzero(inside))
                columns = {name: values[inside] for name, values in columns.items()}
            yield columns

    def _reference(
        self, side: Side, names: tuple[str, ...], *, keep_file: bool
    ) -> Iterator[Columns]:
        for columns in columns_of(side, names, sort=False, with_record=False):
            if self._area is not None:
                columns = self._around(columns)
            if not len(columns["x"]):
                continue
            # a chunk is of one file
            index = int((columns[FILE] if keep_file else columns.pop(FILE))[0])
            low, high = self._bounds.get(index, (np.full(2, np.inf), np.full(2, -np.inf)))
            xy = columns["x"], columns["y"]
            self._bounds[index] = (
                np.minimum(low, [v.min() for v in xy]),
                np.maximum(high, [v.max() for v in xy]),
            )
            rows = self._mapping.class_indices(columns[CODE], "reference")
            if self._heights:
                ground = rows == self._mapping.names("reference").index(GROUND)
                self._ground.add(*(columns[axis][ground] for axis in AXES))
            yield columns

    def _around(self, columns: Columns) -> Columns:
        """Return the reference points near the area; count the points outside it."""
        assert self._area is not None
        x = columns["x"]
        y = columns["y"]
        x0, y0, x1, y1 = self._area.bounds
        near = (
            (x >= x0 - _AROUND_M)
            & (x <= x1 + _AROUND_M)
            & (y >= y0 - _AROUND_M)
            & (y <= y1 + _AROUND_M)
        )
        self.n_beside += len(x) - int(np.count_nonzero(self._area.holds(x, y)))
        return {name: values[near] for name, values in columns.items()}

    def _check(self, predicted: Cloud, reference: Cloud) -> None:
        """Refuse clouds that do not overlap, choose the tolerance, and note shift and overlaps."""
        left, right = self._sides
        if not predicted.n and self._area is not None and self.n_cut:
            problem = f"none of the {self.n_cut:,} predicted shots is in {self._options.inside}"
            raise InputError(left.path, problem, "give the area in the coordinates of the points")
        if not predicted.n or not reference.n:
            return
        _refuse_apart(left.path, predicted, right.path, reference)
        if self._heights and self._ground.is_empty:
            problem = "no point has the class ground, expected some to measure heights from"
            raise InputError(right.path, problem, "check the class mapping")
        fit = fit_of(predicted, reference)
        self._is_thinned = fit is not None and fit.sparse > MOSTLY
        if self._options.tolerance is None and fit is not None:
            self.tolerance = fit.tolerance_m
            self._counts.note(
                f"tolerance {self.tolerance:g} m, beyond which few more partners are found "
                f"(median distance of the clouds {fit.spread_m:.3f} m, "
                f"spacing of the reference {fit.spacing_m:.3f} m); --max-distance sets another"
            )
        elif self._options.tolerance is None:
            self.tolerance = 1.0
        self._is_narrow = fit is None or self.tolerance < fit.tolerance_m
        shift = shift_of(predicted, reference)
        if shift is not None:
            self._counts.note(
                f"the reference is shifted {shift_text(shift)} against the prediction: "
                "register both with one trajectory before you trust these scores"
            )
        for sentence in self._overlaps():
            self._counts.note(sentence)

    def _overlaps(self) -> Iterator[str]:
        overlaps = []
        for (first, (low, high)), (second, (low2, high2)) in combinations(
            sorted(self._bounds.items()), 2
        ):
            width, depth = np.minimum(high, high2) - np.maximum(low, low2)
            if min(width, depth) > _OVERLAP_M:
                overlaps.append((width * depth, width, depth, first, second))
        if overlaps:
            _, width, depth, first, second = max(overlaps)
            names = [Path(self._sides[1].files[index].codes.path).name for index in (first, second)]
            pairs = f" ({len(overlaps)} such pairs)" if len(overlaps) > 1 else ""
            yield (
                f"reference files overlap: {names[0]} and {names[1]} "
                f"by {width:.1f} m x {depth:.1f} m{pairs}; "
                "every predicted shot is compared with one point all the same"
            )

    def _compared(self, tile: Nearest, plan: Plan, third: Cloud | None) -> Iterator[Compared]:
        """Yield the shots of a tile that are scored."""
        partner = tile.partner_index >= 0
        # shots without partner where the reference has points, or in the area of the options
        covered = np.zeros(len(partner), np.bool_)
        xy = [tile.left[axis][~partner] for axis in "xy"]
        covered[~partner] = self._cover.holds(*xy) | (self._area is not None)
        chosen = partner
        if self._options.unmatched == NOISE:
            chosen = partner | (covered & ~(tile.sparse & self._is_thinned))
            self._n_left_out += int(np.count_nonzero(covered & ~chosen))
        shots = {name: values[chosen] for name, values in tile.left.items()}
        points_at = tile.partner_index[chosen]
        sparse = tile.sparse[chosen]
        distance = tile.distance[chosen]
        codes = np.zeros(len(points_at), np.int64)
        paired = points_at >= 0
        codes[paired] = tile.right[CODE][points_at[paired]]
        rows = np.full(len(points_at), UNKNOWN)
        rows[paired] = self._mapping.class_indices(codes[paired], "reference")
        names = self._mapping.names("reference")
        if self._options.unmatched == NOISE:
            rows[~paired] = names.index(NOISE)
        if self._heights:
            height = self._ground.heights(shots)
            if self._trees is not None:
                rows[self._trees.holds(shots, height)] = names.index(STEM)
            if self._options.height is not None:
                low, high = self._options.height
                # ground points scatter around their height of 0
                kept = (height >= (low - self.tolerance if low <= 0.0 else low)) & (height <= high)
                self._counts.note(
                    f"{{n}} predicted shots are not from {low:g} to {high:g} m above ground: "
                    "not scored",
                    int(np.count_nonzero(~kept)),
                )
                shots = {n: v[kept] for n, v in shots.items()}
                points_at = points_at[kept]
                rows = rows[kept]
                sparse = sparse[kept]
                distance = distance[kept]
        self._count_noise(
            shots, rows, sparse & (points_at < 0), np.where(points_at < 0, distance, 0.0)
        )
        yield Compared(
            shots,
            _taken(tile.right, points_at, plan.reference),
            rows,
            self._thirds(shots, tile, third),
        )

    def _count_noise(
        self,
        shots: Columns,
        rows: I64,
        sparse: Mask,
        distance: F64,
    ) -> None:
        """Count noise in the reference and in the prediction.

        ``distance`` [m] is to the nearest reference point, and 0 for shots with a partner.
        """
        if self._options.unmatched != NOISE:
            return
        names = self._mapping.names("predicted")
        column = self._mapping.class_indices(shots[CODE], "predicted")
        is_noise = column == (names.index(NOISE) if NOISE in names else len(names))
        noise = (rows == self._mapping.names("reference").index(NOISE)) & (column >= 0)
        clear = noise & (distance > CLEAR * self.tolerance)
        n = np.where(clear, 1 + (distance <= (CLEAR + 1) * self.tolerance), 0)
        for name, mask in (
            ("reference", noise),
            ("predicted", is_noise & (rows >= 0)),
            ("agreed", noise & is_noise),
            ("sparse", sparse & noise),
            ("sparse_agreed", sparse & noise & is_noise),
        ):
            self._noise[name] += int(np.count_nonzero(mask))
        self._noise["estimated"] += int(n.sum())
        self._noise["estimated_agreed"] += int(n[is_noise].sum())

    def _thirds(self, shots: Columns, tile: Nearest, third: Cloud | None) -> I64 | None:
        if third is None:
            return None
        columns, distance, points_at, _ = nearest_of(shots, third, tile.box, self.tolerance)
        near = np.isfinite(distance)
        codes = np.full(len(near), LOST if self._options.unmatched == NOISE else UNKNOWN)
        codes[near] = columns[CODE][points_at[near]]
        return codes

    def report(self, tally: JoinTally) -> None:
        """Note the shots that were left out, and how sure the noise is."""
        note = self._counts.note
        n_left = max(tally.n_left, 1)
        note(f"{{n}} predicted shots are outside {self._options.inside}: not scored", self.n_cut)
        gap = self._cover.largest_gap()
        if gap is not None and gap[0] > _GAP_SHARE * n_left:
            x0, y0, x1, y1 = gap[1]
            note(
                f"the reference has no points at x {x0:g} to {x1:g}, y {y0:g} to {y1:g}, "
                f"where {gap[0]:,} predicted shots lie: a tile may be missing"
            )
        lone = tally.n_left - tally.n_pairs
        outside = self._cover.n_outside
        share = f"({lone / n_left:.1%}) have no partner within {self.tolerance:g} m"
        if self._options.unmatched != NOISE:
            note(
                f"{{n}} predicted shots {share}: not scored; "
                "--unmatched noise counts them as noise",
                lone,
            )
            return
        note(
            f"{{n}} predicted shots {share}: noise in the reference, as far as it covers the plan",
            lone,
        )
        if self._area is None:
            note("{n} of these lie beside the reference: not scored", outside)
        self._note_noise()

    def _note_noise(self) -> None:
        # some of the noise may be shots whose partner was thinned away
        if self._is_thinned:
            self._counts.note(
                "{n} of these lie no farther from the reference than its points there from each "
                "other, as most do: it was thinned, so they are not scored",
                self._n_left_out,
            )
            return
        noise_counts = self._noise
        sure = noise_counts["agreed"] - noise_counts["sparse_agreed"]
        noise = noise_counts["reference"] - noise_counts["sparse"]
        recalls = (
            noise_counts["agreed"] / max(noise_counts["reference"], 1),
            sure / max(noise, 1),
        )
        n_predicted = max(noise_counts["predicted"], 1)
        precisions = (noise_counts["agreed"] / n_predicted, sure / n_predicted)
        self._counts.note(
            "{n} of these lie no farther from the reference than its points there from each "
            "other, so that thinning may have taken their partner: "
            f"noise recall {min(recalls):.3f} to {max(recalls):.3f} "
            f"and precision {min(precisions):.3f} to {max(precisions):.3f}",
            noise_counts["sparse"],
        )
        if self._is_narrow:
            return
        recall = noise_counts["estimated_agreed"] / max(noise_counts["estimated"], 1)
        precision = min(noise_counts["estimated_agreed"] / max(noise_counts["predicted"], 1), 1.0)
        self._counts.note(
            "noise close to the reference estimated from that beyond "
            f"{CLEAR * self.tolerance:.2g} m: "
            f"noise recall {recall:.3f}, precision {precision:.3f}"
        )


def _taken(right: Columns, points_at: I64, names: tuple[str, ...]) -> Columns:
    # columns of the partners; NaN or UNKNOWN without a partner
    columns: Columns = {}
    for name in names:
        values = (
            right[name][points_at]
            if len(right[name])
            else np.zeros(len(points_at), right[name].dtype)
        )
        unknown = np.nan if values.dtype.kind == "f" else UNKNOWN
        columns[name] = np.where(points_at >= 0, values, unknown)
    return columns


def _refuse_apart(
    predicted_path: str, predicted: Cloud, reference_path: str, reference: Cloud
) -> None:
    """Refuse coordinates in degrees, swapped axes and clouds in other places."""
    _refuse_degrees(predicted_path, predicted)
    _refuse_degrees(reference_path, reference)
    low = reference.low[:2]
    high = reference.high[:2]
    if (predicted.low[:2] <= high).all() and (low <= predicted.high[:2]).all():
        return
    places = [
        f"x {cloud.low[0]:.9g} to {cloud.high[0]:.9g}, y {cloud.low[1]:.9g} to {cloud.high[1]:.9g}"
        for cloud in (reference, predicted)
    ]
    problem = f"{places[0]}, but {predicted_path} has {places[1]}: nothing overlaps"
    hint = f"check that both are registered in one system; {PLACE_BY_POSES}"
    if (predicted.low[:2] <= high[::-1]).all() and (low[::-1] <= predicted.high[:2]).all():
        hint = "x and y are swapped in one of them"
    raise InputError(reference_path, problem, hint)


def _refuse_degrees(path: str, cloud: Cloud) -> None:
    span = cloud.high - cloud.low
    if (np.abs(cloud.high[:2]) > 180.0).any() or span[:2].max() >= _DEGREES_SPAN or span[2] <= 1.0:
        return
    problem = (
        f"x {cloud.low[0]:.7g} to {cloud.high[0]:.7g}, y {cloud.low[1]:.7g} to {cloud.high[1]:.7g} "
        f"with heights over {span[2]:.0f} m: coordinates in degrees, expected metres"
    )
    raise InputError(path, problem, "project them first")


def check_crs(sides: tuple[Side, ...], counts: Counts) -> None:
    """Refuse coordinates of different systems."""
    named = [(file.codes.path, crs) for side in sides for file in side.files if (crs := file.crs)]
    for (path, crs), (other_path, other_crs) in pairwise(named):
        if not same_crs(crs, other_crs):
            problem = (
                f"coordinates in {short_crs(crs)}, but {other_path} has {short_crs(other_crs)}"
            )
            raise InputError(
                path, problem, "reproject one of them, or match by time or by a dimension"
            )
    if len(named) < sum(len(side.files) for side in sides):
        counts.note("not every file names its coordinate system: taken to be the same")

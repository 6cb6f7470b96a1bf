"""A registered reference, compared by place.

How it lies on the prediction, what it lacks, what that means.
"""

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
"""Shots without partner are compared with the spacing of the reference up to this many tolerances."""
CLEAR = 1.5
"""From this many tolerances on, shots without partner are noise: no thinning reaches so far.

Nearer, noise is taken to
be as dense as in the next tolerance, down to the tolerance, and to thin out evenly from there to
the surface: in all as many shots as that next tolerance holds."""
_OVERLAP_M = 0.5
"""Tiles that overlap by less are cut at one edge and rounded."""
_DEGREES_SPAN = 0.1
_AROUND_M = 2.0
MOSTLY = 0.4
"""Where more of the shots without partner lie within the spacing of the reference, it was thinned at random."""
_GAP_SHARE = 0.002


class Registered:
    """Pairs of one prediction and its reference, and what is noted about them."""

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
        for wanted, name, option in asked:
            if wanted and name not in names:
                problem = (
                    f"{option} needs a class {name!r} in [reference], found {', '.join(names)}"
                )
                raise ConfigError(
                    "class mapping",
                    problem,
                    f"add {name} = [...] to it, with no codes if it has none",
                )

    def pairs(self, plan: Plan, tally: JoinTally, third: Side | None) -> Iterator[Compared]:
        """Yield the predicted shots with the class of their nearest reference point, tile by tile."""
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
            ours, theirs = ordered(lambda k: Cloud(sides[k], files[k]), range(2), threads=2)
            self._cover = Cover(ours.squares(), theirs.squares())
            self._check(ours, theirs)
            beside = (
                None
                if third is None
                else Cloud(columns_of(third, (CODE, *AXES), sort=False), files[2])
            )
            reach = REACHES * self.tolerance if self._options.unmatched == NOISE else None
            for item in nearest_join(ours, theirs, self.tolerance, tally, reach):
                yield from self._compared(item, plan, beside)

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
        """Return the reference points that can be partners of shots in the area.

        Count those inside.
        """
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

    def _check(self, ours: Cloud, theirs: Cloud) -> None:
        """Refuse clouds that cannot lie on each other, note how they do, and choose the tolerance."""
        left, right = self._sides
        if not ours.n and self._area is not None and self.n_cut:
            problem = f"none of the {self.n_cut:,} predicted shots is in {self._options.inside}"
            raise InputError(left.path, problem, "give the area in the coordinates of the points")
        if not ours.n or not theirs.n:
            return
        _refuse_apart((left.path, ours), (right.path, theirs))
        if self._heights and self._ground.is_empty:
            raise InputError(
                right.path,
                "no point has the class ground, expected some to measure heights from",
                "check the class mapping",
            )
        fit = fit_of(ours, theirs)
        self._is_thinned = fit is not None and fit.sparse > MOSTLY
        if self._options.tolerance is None and fit is not None:
            self.tolerance = fit.tolerance_m
            self._counts.note(
                f"tolerance {self.tolerance:g} m, beyond which few more partners are found (median distance of the "
                f"clouds {fit.spread_m:.3f} m, spacing of the reference {fit.spacing_m:.3f} m); --max-distance sets "
                "another"
            )
        elif self._options.tolerance is None:
            self.tolerance = 1.0
        self._is_narrow = fit is None or self.tolerance < fit.tolerance_m
        shift = shift_of(ours, theirs)
        if shift is not None:
            self._counts.note(
                f"the reference is shifted {shift_text(shift)} against the prediction: register both with one "
                "trajectory before you trust these scores"
            )
        for sentence in self._overlaps():
            self._counts.note(sentence)

    def _overlaps(self) -> Iterator[str]:
        found = []
        for (one, (low, high)), (other, (low2, high2)) in combinations(
            sorted(self._bounds.items()), 2
        ):
            width, depth = np.minimum(high, high2) - np.maximum(low, low2)
            if min(width, depth) > _OVERLAP_M:
                found.append((width * depth, width, depth, one, other))
        if found:
            _, width, depth, one, other = max(found)
            names = [Path(self._sides[1].files[index].codes.path).name for index in (one, other)]
            more = f" ({len(found)} such pairs)" if len(found) > 1 else ""
            yield (
                f"reference files overlap: {names[0]} and {names[1]} by {width:.1f} m x {depth:.1f} m{more}; every "
                "predicted shot is compared with one point all the same"
            )

    def _compared(self, item: Nearest, plan: Plan, third: Cloud | None) -> Iterator[Compared]:
        """Yield the shots of a tile that are scored."""
        partner = item.to >= 0
        # which shots without partner lie where the reference covers the plan, or in the area that
        # is given
        covered = np.zeros(len(partner), np.bool_)
        place = [item.left[axis][~partner] for axis in "xy"]
        covered[~partner] = self._cover.holds(*place) | (self._area is not None)
        chosen = partner
        if self._options.unmatched == NOISE:
            chosen = partner | (covered & ~(item.sparse & self._is_thinned))
            self._n_left_out += int(np.count_nonzero(covered & ~chosen))
        one = {name: values[chosen] for name, values in item.left.items()}
        to = item.to[chosen]
        sparse = item.sparse[chosen]
        apart = item.distance[chosen]
        codes = np.zeros(len(to), np.int64)
        paired = to >= 0
        codes[paired] = item.right[CODE][to[paired]]
        rows = np.full(len(to), UNKNOWN)
        rows[paired] = self._mapping.class_indices(codes[paired], "reference")
        names = self._mapping.names("reference")
        if self._options.unmatched == NOISE:
            rows[~paired] = names.index(NOISE)
        if self._heights:
            height = self._ground.heights(one)
            if self._trees is not None:
                rows[self._trees.holds(one, height)] = names.index(STEM)
            if self._options.height is not None:
                low, high = self._options.height
                # the ground itself scatters by as much around its height of 0
                kept = (height >= (low - self.tolerance if low <= 0.0 else low)) & (height <= high)
                self._counts.note(
                    f"{{n}} predicted shots are not from {low:g} to {high:g} m above ground: not scored",
                    int(np.count_nonzero(~kept)),
                )
                one = {n: v[kept] for n, v in one.items()}
                to = to[kept]
                rows = rows[kept]
                sparse = sparse[kept]
                apart = apart[kept]
        self._count_noise(one, rows, sparse & (to < 0), np.where(to < 0, apart, 0.0))
        yield Compared(
            one, _taken(item.right, to, plan.reference), rows, self._thirds(one, item, third)
        )

    def _count_noise(
        self,
        one: Columns,
        rows: I64,
        sparse: Mask,
        apart: F64,
    ) -> None:
        """Count what is noise in the reference and what is called so.

        ``apart`` is 0 for shots with a partner.
        """
        if self._options.unmatched != NOISE:
            return
        names = self._mapping.names("predicted")
        column = self._mapping.class_indices(one[CODE], "predicted")
        said = column == (names.index(NOISE) if NOISE in names else len(names))
        noise = (rows == self._mapping.names("reference").index(NOISE)) & (column >= 0)
        clear = noise & (apart > CLEAR * self.tolerance)
        n = np.where(clear, 1 + (apart <= (CLEAR + 1) * self.tolerance), 0)
        for name, mask in (
            ("reference", noise),
            ("predicted", said & (rows >= 0)),
            ("agreed", noise & said),
            ("sparse", sparse & noise),
            ("sparse_agreed", sparse & noise & said),
        ):
            self._noise[name] += int(np.count_nonzero(mask))
        self._noise["estimated"] += int(n.sum())
        self._noise["estimated_agreed"] += int(n[said].sum())

    def _thirds(self, one: Columns, item: Nearest, third: Cloud | None) -> I64 | None:
        if third is None:
            return None
        theirs, distance, found, _ = nearest_of(one, third, item.box, self.tolerance)
        near = np.isfinite(distance)
        codes = np.full(len(near), LOST if self._options.unmatched == NOISE else UNKNOWN)
        codes[near] = theirs[CODE][found[near]]
        return codes

    def report(self, tally: JoinTally) -> None:
        """Note what was left out, and how sure the noise is."""
        note = self._counts.note
        n_left = max(tally.n_left, 1)
        note(f"{{n}} predicted shots are outside {self._options.inside}: not scored", self.n_cut)
        gap = self._cover.largest_gap()
        if gap is not None and gap[0] > _GAP_SHARE * n_left:
            x0, y0, x1, y1 = gap[1]
            note(
                f"the reference has no points at x {x0:g} to {x1:g}, y {y0:g} to {y1:g}, where {gap[0]:,} predicted "
                "shots lie: a tile may be missing"
            )
        lone = tally.n_left - tally.n_pairs
        outside = self._cover.n_outside
        share = f"({lone / n_left:.1%}) have no partner within {self.tolerance:g} m"
        if self._options.unmatched != NOISE:
            note(
                f"{{n}} predicted shots {share}: not scored; --unmatched noise counts them as noise",
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
        """Note how much the noise depends on shots whose partner may only have been thinned away."""
        if self._is_thinned:
            self._counts.note(
                "{n} of these lie no farther from the reference than its points there from each other, as most do: it "
                "was thinned, so they are not scored",
                self._n_left_out,
            )
            return
        found = self._noise
        sure = found["agreed"] - found["sparse_agreed"]
        noise = found["reference"] - found["sparse"]
        spans = [
            f"{name} {min(both):.3f} to {max(both):.3f}"
            for name, both in (
                (
                    "recall",
                    [
                        a / b if b else 0.0
                        for a, b in ((found["agreed"], found["reference"]), (sure, noise))
                    ],
                ),
                ("precision", [a / max(found["predicted"], 1) for a in (found["agreed"], sure)]),
            )
        ]
        self._counts.note(
            "{n} of these lie no farther from the reference than its points there from each other, so that thinning "
            f"may have taken their partner: noise {' and '.join(spans)}",
            found["sparse"],
        )
        if self._is_narrow:
            return
        recall = found["estimated_agreed"] / max(found["estimated"], 1)
        precision = min(found["estimated_agreed"] / max(found["predicted"], 1), 1.0)
        self._counts.note(
            f"noise close to the reference estimated from that beyond {CLEAR * self.tolerance:.2g} m: noise recall "
            f"{recall:.3f}, precision {precision:.3f}"
        )


def _taken(right: Columns, to: I64, names: tuple[str, ...]) -> Columns:
    """Return columns of the partners, unknown where there is none."""
    found: Columns = {}
    for name in names:
        values = right[name][to] if len(right[name]) else np.zeros(len(to), right[name].dtype)
        unknown = np.nan if values.dtype.kind == "f" else UNKNOWN
        found[name] = np.where(to >= 0, values, unknown)
    return found


def _refuse_apart(left: tuple[str, Cloud], right: tuple[str, Cloud]) -> None:
    """Refuse coordinates in degrees, swapped axes and clouds at other places."""
    spans = [cloud.high - cloud.low for _, cloud in (left, right)]
    for (path, cloud), span in zip((left, right), spans, strict=True):
        if (
            (np.abs(cloud.high[:2]) <= (180.0, 180.0)).all()
            and span[:2].max() < _DEGREES_SPAN
            and span[2] > 1.0
        ):
            problem = f"x {cloud.low[0]:.7g} to {cloud.high[0]:.7g}, y {cloud.low[1]:.7g} to {cloud.high[1]:.7g} with "
            problem += f"heights over {span[2]:.0f} m: coordinates in degrees, expected metres"
            raise InputError(path, problem, "project them first")
    (_, ours) = left
    (path, theirs) = right
    if (ours.low[:2] <= theirs.high[:2]).all() and (theirs.low[:2] <= ours.high[:2]).all():
        return
    swapped = theirs.low[1::-1], theirs.high[1::-1]
    is_swapped = bool((ours.low[:2] <= swapped[1]).all() and (swapped[0] <= ours.high[:2]).all())
    places = [
        f"x {c.low[0]:.9g} to {c.high[0]:.9g}, y {c.low[1]:.9g} to {c.high[1]:.9g}"
        for c in (theirs, ours)
    ]
    problem = f"{places[0]}, but {left[0]} has {places[1]}: nothing overlaps"
    hint = (
        "x and y are swapped in one of them"
        if is_swapped
        else f"check that both are registered in one system; {PLACE_BY_POSES}"
    )
    raise InputError(path, problem, hint)


def check_crs(sides: tuple[Side, ...], counts: Counts) -> None:
    """Refuse coordinates of different systems."""
    named = [(file.codes.path, crs) for side in sides for file in side.files if (crs := file.crs)]
    for (path, crs), (other_path, other) in pairwise(named):
        if not same_crs(crs, other):
            problem = f"coordinates in {short_crs(crs)}, but {other_path} has {short_crs(other)}"
            raise InputError(
                path, problem, "reproject one of them, or match by time or by a dimension"
            )
    if len(named) < sum(len(side.files) for side in sides):
        counts.note("not every file names its coordinate system: taken to be the same")

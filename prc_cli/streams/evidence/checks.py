"""Asks all checks of what was seen of a stream, and those of its ranges and counts."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from prc_cli.core.findings import Finding, Verdict
from prc_cli.core.stream import FAR_M
from prc_cli.core.types import F32
from prc_cli.formats.ranges import KEY
from prc_cli.methods.rings.pipeline import is_fan
from prc_cli.streams.agreement import ANGLES, CONTRADICTED, MOST_OFF
from prc_cli.streams.evidence.cones import check_cones
from prc_cli.streams.evidence.figures import Seen, figures_of, most_turned, without_lonely
from prc_cli.streams.evidence.geometry import check_angle_step, check_down, check_height
from prc_cli.streams.evidence.line_limits import LEAST_LINES
from prc_cli.streams.evidence.lines import (
    check_columns_along,
    check_dropouts,
    check_line_length,
    check_line_order,
    check_noise,
    check_shot_order,
)
from prc_cli.streams.evidence.table import verdict_of

MANY = 0.01
"""Share of records that are lost or share a cell: more give a warning."""
MANY_OF_RINGS = 0.05
"""The same share for cells in frames of rings.

Shots of a ring stray in azimuth, and where they
meet, are labelled like further returns."""
MOST = 0.2
"""Share of records from which an input is refused."""
LEAST_RECORDS = 100
"""Fewer records are not judged."""
NEAR_M = 0.02
"""Least median range of a scanner [m]: less are millimetres read as metres, or no ranges."""
NARROW = 2.0
"""The longest ranges of a scanner are more than twice the shortest."""
LEAST_MEDIAN_M = 0.15
"""Least median range that a unit is offered for [m]."""
NOTHING_ELSE = 0.95
"""Where nearly all ranges are equal nothing was measured, or the scan was made up."""
CODE_M = 0.03
MIN_RANGE_M = 0.05
"""No scanner on a vehicle measures ranges below the first [m]; the second leaves them out."""
CODED = 0.01
"""Share of ranges that are equal to the largest: chance gives one in thousands."""
HIGH_M = 150.0
FAR_MEDIAN_M = 5000.0
"""Median ranges that are doubtful, and that not even an aircraft has [m]: 3 to 20 m are usual."""
COUNTED = 0.01
"""Share of ranges beyond any scanner from which numbers are misread."""
LEAST_RETURNS = 0.02
"""Share of shots with a range below which lines and columns, or ranges, are probably wrong."""
COARSE_M = 0.03
ROUNDED_DIGITS = 4
LEAST_ROUNDED = 5000
ALL_ROUNDED = 0.98
"""Steps of rounded ranges [m].

Scanners state them to 1 to 10 mm; thresholds on surfaces begin at a few centimetres.
"""
LEAST_RETURNED = 1000
LEAST_RING_LINES = 32
"""With fewer returns, or lines, rings are not counted."""
MOST_COUNTED = 1 << 16
"""Ranges that the median is taken of."""


def check_thinned(dropped: str) -> tuple[Finding, ...]:
    """Check whether the file is one that shots were left out of.

    ``dropped`` is what its run record says.
    """
    if not dropped:
        return ()
    hint = "classify the original file, then thin it"
    return (
        Finding(
            "thinned",
            Verdict.DOUBTFUL,
            dropped,
            "every shot, because classes depend on neighbours",
            hint,
        ),
    )


LEAST_SHOTS = 1000
"""Streams of fewer shots are pieces that nobody classifies for their labels."""
LONGEST_LINE = 10_000
"""Shots of a stream of one line, from which on no rule has found its lines."""


def check_few_lines(n_lines: int, n_shots: int) -> Iterator[Finding]:
    """Check whether the stream has lines enough to judge it, or any lines at all."""
    if n_shots < LEAST_SHOTS:
        return
    measured = (
        f"{n_lines} scan lines, too few to judge"
        if n_lines > 1
        else f"all {n_shots:,} shots are in one scan line"
    )
    is_lineless = n_lines <= 1 and n_shots >= LONGEST_LINE
    hint = (
        "name all files of the drive; or find the lines in another way: "
        "--lines dimension:NAME, time:HZ or elevation:DEG, or -M"
    )
    verdict = verdict_of(doubtful=n_lines < LEAST_LINES, against=is_lineless)
    yield Finding("few-lines", verdict, measured, f"at least {LEAST_LINES} lines", hint)


def check_coordinates(seen: Seen) -> Finding | None:
    """Check whether x, y, z agree with ranges and scan angles, as the setup compared them."""
    reasons = {
        assumption.value: assumption.why
        for assumption in seen.info.assumptions
        if assumption.key.startswith(ANGLES)
    }
    if CONTRADICTED not in reasons:
        return None
    measured = reasons[CONTRADICTED].replace(
        "range", f"the range {seen.info.facts.range_name!r}", 1
    )
    hint = (
        "give --range dimension:NAME, trajectory:FILE or origin:X,Y,Z; "
        f"if only angles are wrong: --set {ANGLES}=measured"
    )
    expected = f"at most {MOST_OFF:.0%}"
    return Finding(
        "coordinates", Verdict.DOUBTFUL, measured, expected, hint, f"--set {ANGLES}=measured"
    )


def check_collisions(seen: Seen) -> Finding | None:
    """Check whether every shot has a cell of its own."""
    share = _share(seen, seen.tally.n_collisions)
    if share is None:
        return None
    of_rings = any(assumption.key == "input.azimuth_step" for assumption in seen.info.assumptions)
    measured = f"{share:.1%} of the records are in the cell of another shot"
    hint = "check --lines, --columns and -M; several scanners in one file: --scanner DIMENSION"
    if of_rings:
        hint = (
            "write one frame per file; "
            "or give the angle between lines: --set input.azimuth_step=DEGREES"
        )
    many = MANY_OF_RINGS if of_rings else MANY
    return Finding(
        "collisions",
        verdict_of(doubtful=share > many, against=share > MOST),
        measured,
        f"at most {many:.0%}",
        hint,
    )


def check_unplaced(seen: Seen) -> Finding | None:
    """Check whether every record has a cell."""
    share = _share(seen, seen.tally.n_unplaced)
    if share is None:
        return None
    measured = f"{share:.1%} of the records have no cell and stay unclassified"
    hint = "check --lines, --columns and -M; if the recording started again: split the file there"
    facts = seen.info.facts
    if "lines" in facts.refuses and not facts.has_line_times:
        # a frame has no start to split it at
        hint = f"points that do not follow the azimuth of their ring: {facts.remedy}"
    return Finding(
        "unplaced",
        verdict_of(doubtful=share > MANY, against=share > MOST),
        measured,
        f"at most {MANY:.0%}",
        hint,
    )


def check_left_out(seen: Seen) -> Finding | None:
    """Check whether lines contain all their shots, if columns are by order."""
    by_order = any(
        assumption.key == "input.columns" and assumption.value == "order"
        for assumption in seen.info.assumptions
    )
    tally = seen.tally
    # the first and the last line may be cut
    n_lacking = seen.n_shots - tally.n_records + tally.n_extra_returns - 2 * seen.points_per_line
    share = _share(seen, max(n_lacking, 0))
    if share is None or not by_order or seen.n_shots <= tally.n_records - tally.n_extra_returns:
        return None
    measured = f"columns are by order, but lines lack {share:.1%} of the shots of the longest line"
    hint = (
        "find the columns in another way: --columns time:HZ (shots per second), "
        "dimension:NAME or angle"
    )
    return Finding(
        "left-out", verdict_of(doubtful=share > MANY), measured, f"at most {MANY:.0%}", hint
    )


def _share(seen: Seen, count: int) -> float | None:
    n_records = seen.tally.n_records or seen.n_shots
    return count / n_records if n_records >= LEAST_RECORDS else None


def check_returns(seen: Seen) -> Finding | None:
    """Check whether the shots have returns."""
    if seen.n_shots < LEAST_RECORDS:
        return None
    share = 1 - seen.n_missing / seen.n_shots
    measured = f"{share:.2%} of the shots have a range"
    hint = "check --range, input.max_range, the layout, and --columns and -M"
    return Finding(
        "returns",
        verdict_of(doubtful=share < LEAST_RETURNS),
        measured,
        f"at least {LEAST_RETURNS:.0%}",
        hint,
    )


def check_other_readers(seen: Seen) -> Finding | None:
    """Check whether the usual library reads the file, too."""
    if not seen.info.facts.refused:
        return None
    measured = f"laspy refuses the header or its VLRs ({seen.info.facts.refused})"
    hint = (
        "a LAS or LAZ output copies them: "
        "copy the input from the archive again, or write another format"
    )
    return Finding(
        "other-readers", Verdict.DOUBTFUL, measured, "a file that other programs read", hint
    )


def check_unread(seen: Seen) -> Finding | None:
    """Check whether the header counts all records."""
    if not seen.info.facts.unread:
        return None
    hint = (
        "they get no labels; repair the header, for example with LAStools: lasinfo -i FILE -repair"
    )
    return Finding(
        "unread", Verdict.DOUBTFUL, seen.info.facts.unread, "a header that counts all records", hint
    )


def check_missing_code(seen: Seen) -> Finding | None:
    """Check whether the largest range is a code for no return."""
    known = _known_ranges(seen)
    if len(known) < LEAST_RECORDS:
        return None
    if (near := _near_codes(known)) is not None:
        return near
    longest = float(known.max())
    share = float(np.mean(known == longest))
    measured = f"{share:.1%} of the ranges are {longest:.6g} m, the largest of all"
    others = known[known < longest]
    is_code = (
        CODED < share < NOTHING_ELSE and len(others) > 0 and longest > 2 * float(np.median(others))
    )
    option = f"--set input.max_range={np.nextafter(np.float32(longest), np.float32(0)):.9g}"
    hint = (
        f"if it means no return: {option}; else the scene is larger than the range of the scanner"
    )
    return Finding(
        "missing-code",
        verdict_of(doubtful=is_code),
        measured,
        f"at most {CODED:.0%}",
        hint,
        option if is_code else "",
    )


def _near_codes(known: F32) -> Finding | None:
    """Return the warning that very short ranges are error codes.

    None if there are few, or hardly others.
    """
    is_near = known < CODE_M
    share = float(np.mean(is_near))
    others = known[~is_near]
    if not CODED < share < NOTHING_ELSE or float(np.median(others)) < LEAST_MEDIAN_M:
        return None
    measured = (
        f"{share:.1%} of the ranges are below {CODE_M:g} m, "
        f"at most {float(known[is_near].max()):.3g} m"
    )
    option = f"--set input.min_range={MIN_RANGE_M:g}"
    hint = f"scanners write error codes as such ranges: {option}"
    return Finding("missing-code", Verdict.DOUBTFUL, measured, f"at most {CODED:.0%}", hint, option)


def _known_ranges(seen: Seen) -> F32:
    """Return some of the ranges of the sample, in the order of the stream."""
    parts = [window.range_m.ravel() for window in seen.windows]
    shots = np.concatenate(parts) if parts else np.empty(0, np.float32)
    known: F32 = shots[np.isfinite(shots)]
    return known[:: max(len(known) // MOST_COUNTED, 1)]


def check_rounding(seen: Seen) -> Finding | None:
    """Check whether the ranges are finer than the thresholds of the methods."""
    known = _known_ranges(seen).astype(np.float64)
    if len(known) < LEAST_ROUNDED:
        return None
    steps = np.diff(np.unique(np.round(known, ROUNDED_DIGITS)))
    steps = steps[steps > COARSE_M / 2]
    # of ranges that are not rounded, hardly any two neighbours are that far apart
    step = float(steps.min(initial=np.inf))
    off = known / step - np.round(known / step)
    is_rounded = np.isfinite(step) and float(np.mean(np.abs(off) < 0.02)) > ALL_ROUNDED
    measured = (
        f"all ranges are multiples of {step:.3g} m"
        if is_rounded
        else "the steps of the ranges are smaller than any threshold"
    )
    hint = "use a file with ranges that are not rounded; check the scale of the layout"
    return Finding(
        "rounding",
        verdict_of(doubtful=is_rounded and step > COARSE_M),
        measured,
        f"steps of at most {COARSE_M:g} m",
        hint,
    )


def check_ranges(seen: Seen) -> Finding | None:
    """Check whether the ranges are numbers that a scanner can measure."""
    known = _known_ranges(seen)
    if len(known) < LEAST_RECORDS:
        return None
    far = float(np.mean(known > FAR_M))
    median = float(np.median(known))
    measured = (
        f"the median range is {median:.4g} m, "
        f"and {far:.2%} of the ranges are beyond {FAR_M / 1000:g} km"
    )
    expected = f"{NEAR_M:g} to {HIGH_M:g} m, and at most {COUNTED:.0%} that far"
    hint = (
        "check the layout (byte order, types, scale, "
        "header bytes), and --range with its coordinate system"
    )
    option = ""
    low, high = np.percentile(known, [5, 95])
    # a place that is seen from far away has about one range
    is_far_off = median > HIGH_M and bool(high < NARROW * low)
    if is_far_off:
        hint = (
            "x, y, z seem not to be relative to the scanner: "
            "--range origin:X,Y,Z or trajectory:FILE"
        )
    for unit, scale in (("millimetres", 0.001), ("kilometres", 1000.0)):
        if (
            not is_far_off
            and not LEAST_MEDIAN_M <= median <= HIGH_M
            and LEAST_MEDIAN_M <= scale * median <= HIGH_M
        ):
            option = f"--set {KEY}={scale:g}"
            hint = f"if they are {unit}: {option}; else {hint}"
    is_against = not NEAR_M <= median <= FAR_MEDIAN_M or far > MOST
    is_doubtful = far > COUNTED or median > HIGH_M
    return Finding(
        "ranges",
        verdict_of(doubtful=is_doubtful, against=is_against),
        measured,
        expected,
        hint,
        option,
    )


BY_PLACE = ("units", "down", "angle-step")
"""Checks that a wrong trajectory fails first of all."""
LATE = "check the trajectory: input.trajectory_time_offset, its frame and its lever arm"
OTHER_UNIT = "if in another unit: "


def ask_all(seen: Seen) -> Iterator[Finding]:
    """Run every check of a scanner, the gravest faults first.

    A check without enough data gives no finding.
    """
    is_along_path = any(
        assumption.key == "input.range" and assumption.value.startswith("trajectory")
        for assumption in seen.info.assumptions
    )
    for finding in _known(*_findings_of_ranges(seen)):
        if not is_along_path or finding.check not in BY_PLACE:
            yield finding
        elif finding.check == "units" and finding.option:
            yield replace(finding, hint=f"{LATE}; {OTHER_UNIT}{finding.option}", option="")
        else:
            yield replace(finding, hint=LATE, option="")
    yield from _known(
        check_collisions(seen), check_unplaced(seen), check_left_out(seen), check_returns(seen)
    )
    yield from _known(check_unread(seen), check_other_readers(seen))


def _findings_of_ranges(seen: Seen) -> Iterator[Finding | None]:
    yield (ranges := check_ranges(seen))
    if _is_against(ranges):
        return
    yield check_rounding(seen)
    yield check_missing_code(seen)
    figures = raw = figures_of(seen.windows)
    if _is_not_fine(check_shot_order(figures)) or _is_not_fine(check_line_order(seen, figures)):
        # flakes, drops and fog are like none of the shots around
        clear = without_lonely(seen.windows)
        figures = figures if clear is None else figures_of(clear)
    yield (order := check_shot_order(figures))
    if _is_against(order):
        return
    if not seen.has_rings and not seen.info.facts.has_fitted_lines:
        # the length of rings and of fitted lines is known
        turned = most_turned(seen.windows)
        yield (length := check_line_length(seen, figures, turned))
        if _is_against(length):
            return
        yield (columns := check_columns_along(seen, turned))
        if _is_against(columns):
            return
    yield check_line_order(seen, figures)
    yield check_noise(seen, raw)
    yield check_dropouts(raw)
    yield check_few_rings(seen)
    if seen.has_rings or (seen.beam_rad is not None and is_fan(seen.beam_rad)):
        # the method for rings finds the ground itself, also between walls and below a ceiling
        yield check_cones(seen)
        return
    yield (height := check_height(seen))
    if not _is_against(height):
        yield check_coordinates(seen)
        yield check_down(seen)
        yield check_angle_step(seen)


def check_few_rings(seen: Seen) -> Finding | None:
    """Check whether as many rings return as the method tells classes by."""
    if (
        not seen.least_rings
        or seen.n_shots - seen.n_missing < LEAST_RETURNED
        or seen.n_lines < LEAST_RING_LINES
    ):
        return None
    n = int(
        np.count_nonzero(
            np.any([np.isfinite(window.range_m).any(axis=0) for window in seen.windows], axis=0)
        )
    )
    hint = (
        "expect missing cars and far walls; labels of ground, vegetation and noise are not affected"
    )
    verdict = verdict_of(doubtful=n < seen.least_rings)
    return Finding("few-rings", verdict, f"{n} rings", f"at least {seen.least_rings}", hint)


def _known(*findings: Finding | None) -> Iterator[Finding]:
    return (finding for finding in findings if finding is not None)


def _is_not_fine(finding: Finding | None) -> bool:
    return finding is not None and finding.verdict is not Verdict.FINE


def _is_against(finding: Finding | None) -> bool:
    return finding is not None and finding.verdict is Verdict.AGAINST

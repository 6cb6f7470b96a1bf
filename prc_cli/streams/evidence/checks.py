"""Asks all checks of what was seen of a stream.

``prc info``, the run record, ``--accept-doubt`` and the page "How prc knows" use the names of the table.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from prc_cli.core.findings import CHECK_NAMES, Finding, Verdict
from prc_cli.streams.evidence.cells import (
    check_collisions,
    check_left_out,
    check_missing_code,
    check_other_readers,
    check_ranges,
    check_returns,
    check_rounding,
    check_unplaced,
)
from prc_cli.streams.evidence.figures import figures_of, most_turned
from prc_cli.streams.evidence.geometry import GEOMETRY_CHECKS, check_angle_step, check_down, check_height
from prc_cli.streams.evidence.lines import (
    check_columns_along,
    check_dropouts,
    check_line_length,
    check_line_order,
    check_noise,
    check_shot_order,
)
from prc_cli.streams.evidence.result import RESULT_CHECKS
from prc_cli.streams.evidence.seen import Seen
from prc_cli.streams.evidence.table import INPUT_CHECKS, Check

CHECKS: tuple[Check, ...] = tuple(
    sorted((*INPUT_CHECKS, *GEOMETRY_CHECKS, *RESULT_CHECKS), key=lambda one: CHECK_NAMES.index(one.name))
)
"""All checks, in the order in which they are reported."""

BY_PLACE = ("units", "down", "angle-step")
"""Checks that a wrong trajectory fails first of all."""
LATE = "look at the trajectory: its clock (input.trajectory_time_offset), its frame and its lever arm"


def ask_all(seen: Seen) -> Iterator[Finding]:
    """Ask every check of a scanner that was seen, the gravest faults first; a check that cannot tell finds nothing."""
    along = any(one.key == "input.range" and one.value.startswith("trajectory") for one in seen.info.assumptions)
    for finding in _known(*_of_ranges(seen)):
        yield replace(finding, hint=LATE, option="") if along and finding.check in BY_PLACE else finding
    yield from _known(check_collisions(seen), check_unplaced(seen), check_left_out(seen), check_returns(seen))
    yield from _known(check_other_readers(seen))


def _of_ranges(seen: Seen) -> Iterator[Finding | None]:
    """Ask about ranges, shots, lines and angles, each only if those before it can be true."""
    yield (ranges := check_ranges(seen))
    if _is_against(ranges):
        return
    yield check_rounding(seen)
    yield check_missing_code(seen)
    figures = figures_of(seen.windows)
    yield (order := check_shot_order(figures))
    if _is_against(order):
        return
    turned = most_turned(seen.windows)
    yield (length := check_line_length(seen, figures, turned))
    if _is_against(length):
        return
    yield (columns := check_columns_along(seen, turned))
    if _is_against(columns):
        return
    yield check_line_order(seen, figures)
    yield check_noise(seen, figures)
    yield check_dropouts(figures)
    yield (height := check_height(seen))
    if not _is_against(height):
        yield check_down(seen)
        yield check_angle_step(seen)


def _known(*findings: Finding | None) -> Iterator[Finding]:
    return (finding for finding in findings if finding is not None)


def _is_against(finding: Finding | None) -> bool:
    return finding is not None and finding.verdict is Verdict.AGAINST

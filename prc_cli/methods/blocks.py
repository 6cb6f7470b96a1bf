"""Shape check shared by the classifiers that work on blocks of k lines."""

from __future__ import annotations

from prc_cli.core.errors import InputError
from prc_cli.core.types import F32

WHERE = "block of ranges"


def check_block(
    range_m: F32, next_m: F32 | None, points_per_line: int, lines_per_block: int, *, columns: str, key: str
) -> None:
    """Refuse arrays that cannot be the next block of a stream.

    ``range_m`` (lines, M) float32, metres; ``next_m`` (lines, M) float32, metres.
    """
    for array in (range_m,) if next_m is None else (range_m, next_m):
        if array.ndim != 2 or array.shape[1] != points_per_line:
            problem = f"found an array of shape {array.shape}, expected (lines, {points_per_line}){columns}"
            raise InputError(WHERE, problem, "check points_per_line")
    if not 1 <= len(range_m) <= lines_per_block:
        problem = f"found {len(range_m)} lines, expected 1 to {lines_per_block}"
        raise InputError(WHERE, problem, f"cut the stream into blocks of {key} lines")

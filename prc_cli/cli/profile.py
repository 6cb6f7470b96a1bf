"""``--profile``: time per stage, as a table on stderr and for ``--json``."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from prc_cli.cli.report import console, table_of
from prc_cli.core.profile import Profile, StageTime, peak_memory

REST = "all else"
"""Time outside all stages: threads of libraries, passing on of blocks, the run record."""
_WAITING = "waiting"
_NO_RATE = (REST, "loading compiled loops", "opening")
_NEGLIGIBLE_S = 1e-5


def profile_of(profile: Profile, n_shots: int, threads: int) -> dict[str, Any]:
    """Return an ended profile as plain values; ``threads`` are those that classify ``n_shots``."""
    return {
        "wall_s": profile.wall_s,
        "cpu_s": profile.cpu_s,
        "threads": threads,
        "shots": n_shots,
        "peak_memory_bytes": peak_memory(),
        "stages": [
            {
                "name": found.name,
                "wall_s": found.wall_s,
                "cpu_s": found.cpu_s,
                "share_of_cpu": found.cpu_s / profile.cpu_s if profile.cpu_s else 0.0,
                "mshots_per_cpu_s": _rate(found, n_shots),
                "calls": found.calls,
            }
            for found in _rows(profile)
        ],
    }


def print_profile(profile: Profile, n_shots: int, threads: int) -> None:
    """Print a profile, the most expensive stage first."""
    shown = profile_of(profile, n_shots, threads)
    headings = ("stage", "wall s", "CPU s", "of CPU", "M/s of a core")
    table = table_of("where the time went", *headings, no_wrap=True)
    for row in shown["stages"]:
        wall = "" if row["name"] == REST else f"{row['wall_s']:.3f}"
        rate = "" if row["mshots_per_cpu_s"] is None else f"{row['mshots_per_cpu_s']:.3g}"
        table.add_row(row["name"], wall, f"{row['cpu_s']:.3f}", f"{row['share_of_cpu']:.1%}", rate)
    console().print(table)
    peak = shown["peak_memory_bytes"]
    memory = "" if peak is None else f", {peak / 2**20:.0f} MiB of memory at most"
    console().print(
        f"{shown['wall_s']:.3f} s by the clock, {shown['cpu_s']:.3f} s of processor time on "
        f"{threads} thread{'s' * (threads > 1)}{memory}; what ran at the same time adds up to more than the clock",
        soft_wrap=True,
    )


def _rows(profile: Profile) -> Iterator[StageTime]:
    """Yield stages by cost, then those that wait, then the rest of the process's time."""
    stages = profile.stages()
    is_waiting = [found.name.startswith(_WAITING) for found in stages]
    yield from sorted((found for found, waits in zip(stages, is_waiting, strict=True) if not waits), key=_cost)
    rest = profile.cpu_s - sum(found.cpu_s for found in stages)
    yield StageTime(REST, 0.0, max(rest, 0.0), 0)
    yield from (found for found, waits in zip(stages, is_waiting, strict=True) if waits)


def _cost(found: StageTime) -> float:
    return -found.cpu_s


def _rate(found: StageTime, n_shots: int) -> float | None:
    """Million shots per second of processor time; None where that has no meaning."""
    if found.name.startswith(_WAITING) or found.name in _NO_RATE or found.cpu_s < _NEGLIGIBLE_S:
        return None
    return n_shots / found.cpu_s / 1e6

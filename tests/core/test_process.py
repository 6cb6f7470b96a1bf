"""What a process says of its memory and time, and how it is interrupted."""

import time

from prc_cli.core.profile import peak_memory, profiling, timed


def burn(seconds: float) -> None:
    end = time.thread_time() + seconds
    while time.thread_time() < end:
        pass


def test_a_stage_inside_another_is_not_counted_twice():
    with profiling() as profile, timed("outer"):
        burn(0.02)
        with timed("inner"):
            burn(0.05)
    stages = {stage_time.name: stage_time for stage_time in profile.stages()}
    assert stages["inner"].cpu_s >= 0.05
    assert stages["outer"].cpu_s >= 0.02
    assert sum(stage_time.cpu_s for stage_time in stages.values()) <= profile.cpu_s
    assert stages["outer"].wall_s + stages["inner"].wall_s <= profile.wall_s


def test_the_peak_of_memory_is_that_of_a_process_with_an_interpreter():
    peak = peak_memory()
    assert peak is None or 5 << 20 < peak < 1 << 40

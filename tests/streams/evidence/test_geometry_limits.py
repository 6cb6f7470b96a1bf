"""Checks of the geometry at their limits, on guesses and fits that are made up; and the fits themselves."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from prc_cli.core.findings import Finding, Verdict
from prc_cli.core.stream import StreamInfo
from prc_cli.core.types import F32, F64
from prc_cli.streams.angle_step import AngleStep
from prc_cli.streams.down import DownGuess
from prc_cli.streams.evidence import geometry
from prc_cli.streams.evidence.figures import Seen, Window
from prc_cli.streams.evidence.geometry import check_angle_step, check_down, check_height

FINE, DOUBTFUL, AGAINST = Verdict.FINE, Verdict.DOUBTFUL, Verdict.AGAINST
BEAM: F64 = np.deg2rad(np.arange(-90.0, 90.0, 1.0))
STREET: F32 = np.where(np.abs(BEAM) < 1.2, 2.0 / np.cos(BEAM), np.nan).astype(np.float32)


def seen(n_windows: int = 1, **more: Any) -> Seen:
    windows = tuple(Window(100 * k, np.tile(STREET, (20, 1))) for k in range(n_windows))
    info = StreamInfo("a.npy", "array", len(BEAM), None, None, cos_tilt=more.pop("cos_tilt", 1.0))
    return Seen(info, 0, windows, **{"angle_rad": BEAM + 1.0, "beam_rad": BEAM, **more})


def told(found: Finding | None) -> tuple[Verdict, str]:
    assert found is not None
    return found.verdict, found.sentence()


def deg(degrees: float, rival: float | None = None, ratio: float = math.inf, depth_m: float = 2.0) -> DownGuess:
    return DownGuess(math.radians(degrees), depth_m, None if rival is None else math.radians(rival), ratio)


@pytest.fixture
def guesses(monkeypatch: pytest.MonkeyPatch) -> list[DownGuess | None]:
    """The guess for all lines, then those for every window."""
    found: list[DownGuess | None] = []

    def guess(beam_rad: F64, range_m: F32, *, is_coarse: bool = False) -> DownGuess | None:
        assert beam_rad.shape == range_m.shape[1:]
        # scaled to 2 m
        assert 1.9 < np.nanmin(range_m * np.cos(beam_rad)[None] if beam_rad is not BEAM else range_m) < 2.1
        assert len(range_m) in ((16,) if is_coarse else (20, 60, 64))
        return found.pop(0)

    monkeypatch.setattr(geometry, "guess_down", guess)
    return found


@pytest.mark.parametrize(
    ("off_deg", "verdict"),
    [
        (10.9, FINE),
        (-10.9, FINE),
        (11.1, DOUBTFUL),
        (-19.9, DOUBTFUL),
        (20.1, AGAINST),
        (-180.0, AGAINST),
        (352.0, FINE),
    ],
)
def test_down_is_judged_by_the_angle(guesses: list[DownGuess | None], off_deg: float, verdict: Verdict) -> None:
    guesses.append(deg(off_deg, 95.4, 3.14))
    off = min(abs(off_deg), 360 - abs(off_deg))
    # the scan angle of straight down is 1 rad, 57.3 deg
    nadir = round(math.degrees(math.remainder(1.0 + math.radians(off_deg), 2 * math.pi)))
    assert told(check_down(seen())) == (
        verdict,
        f"down: level ground is {off:.0f} deg from straight down (runner-up at 95 deg, 3.1 times weaker), expected "
        "within 11 deg of the direction in use"
        + (f"; give input.nadir, or where the ground is right --set input.nadir={nadir}" if verdict else ""),
    )


def test_scan_angles_may_run_the_other_way(guesses: list[DownGuess | None]) -> None:
    guesses.extend([deg(30.0), deg(30.0), deg(30.4)])
    assert told(check_down(seen(angle_rad=1.0 - BEAM)))[1].endswith("--set input.nadir=27")
    assert told(check_down(seen(angle_rad=None)))[1].endswith("or coordinates relative to the scanner with z up")
    # between two beams
    assert told(check_down(seen(angle_rad=-BEAM)))[1].endswith("--set input.nadir=-30")


@pytest.mark.parametrize(
    ("n_windows", "n_off", "is_told"),
    [(4, 2, True), (4, 1, False), (3, 3, False), (11, 2, True), (12, 2, False), (12, 3, True)],
)
def test_windows_that_look_elsewhere(
    guesses: list[DownGuess | None], n_windows: int, n_off: int, is_told: bool
) -> None:
    guesses.extend([deg(1.0), *[deg(-41.0)] * n_off, *[deg(39.0), None, deg(90.0, 0.0, 1.4), *[deg(0.0)] * 12]])
    verdict, said = told(check_down(seen(n_windows)))
    assert verdict is (DOUBTFUL if is_told else FINE)
    assert (said == (
        f"down: level ground is elsewhere in {n_off} of {n_windows} samples along the drive, expected within 11 deg of "
        "the direction in use; check whether the scanner was moved, or parts of the file are of another scanner"
    )) is is_told  # fmt: skip


@pytest.mark.parametrize(
    ("factor", "off", "verdict"),
    [
        (1.0, 0.005, FINE), (1.079, 0.005, FINE), (0.921, 0.005, FINE),
        (1.081, 0.005, DOUBTFUL), (0.919, 0.005, DOUBTFUL),
        # three times the uncertainty
        (1.149, 0.05, FINE), (1.151, 0.05, DOUBTFUL),
        (1.59, 0.05, DOUBTFUL), (1.61, 0.05, AGAINST), (0.63, 0.05, DOUBTFUL), (0.62, 0.05, AGAINST),
    ],
)  # fmt: skip
def test_angle_step(monkeypatch: pytest.MonkeyPatch, factor: float, off: float, verdict: Verdict) -> None:
    step = AngleStep(math.radians(factor), off, 100)
    monkeypatch.setattr(geometry, "measure_step", lambda _: step)
    said = f"the ranges show {factor:.2f} times the angle from shot to shot that is in use ({factor:.4g} deg, known to "
    hint = "; check the angles of the shots: input.angle_step, and -M where it was computed from M" if verdict else ""
    assert told(check_angle_step(seen())) == (
        verdict,
        f"angle-step: {said}{off:.1%}), expected 0.92 to 1.08{hint}",
    )
    assert check_angle_step(seen(beam_rad=None)) is None
    # uneven beams, and a single one
    assert check_angle_step(seen(beam_rad=np.sign(BEAM) * BEAM**2)) is None
    assert check_angle_step(seen(beam_rad=BEAM[:1])) is None
    monkeypatch.setattr(geometry, "measure_step", lambda _: None)
    assert check_angle_step(seen()) is None


@pytest.mark.parametrize(("off", "verdict"), [(0.03, FINE), (0.031, DOUBTFUL)])
def test_a_measured_step_that_is_uncertain_is_a_doubt(
    monkeypatch: pytest.MonkeyPatch, off: float, verdict: Verdict
) -> None:
    monkeypatch.setattr(geometry, "measure_step", lambda _: AngleStep(math.radians(1.0), off, 100))
    one = seen()
    found = told(check_angle_step(replace(one, info=replace(one.info, angles_off=off))))
    assert found[0] is verdict
    if verdict:
        assert found[1].startswith("angle-step: the angles were measured from the ranges to ± 3.1%: 1 deg a shot")
        assert found[1].endswith("--set input.angle_start=0 --set input.angle_step=DEG")


@pytest.mark.parametrize(
    ("depth_m", "verdict"),
    [(0.099, AGAINST), (0.1, DOUBTFUL), (0.399, DOUBTFUL), (0.4, FINE), (5.0, FINE), (5.01, DOUBTFUL),
     (50.0, DOUBTFUL), (50.1, AGAINST)],
)  # fmt: skip
@pytest.mark.parametrize("is_blind", [False, True])
def test_height(
    guesses: list[DownGuess | None], monkeypatch: pytest.MonkeyPatch, depth_m: float, verdict: Verdict, is_blind: bool
) -> None:
    monkeypatch.setattr(geometry, "_scale", lambda *_: 1.0)
    # half of it remains below a plane that leans by 60 deg
    guesses.append(deg(-19.9 if not is_blind else 120.0, depth_m=2.0 * depth_m))
    one = seen(cos_tilt=0.5, beam_rad=None if is_blind else BEAM, angle_rad=BEAM)
    limits = "0.3 to 6" if is_blind else "0.4 to 5"
    if is_blind and depth_m in (0.399, 5.01):
        verdict = FINE
    # the unit in which the depth would be usual
    scale = "=0.01" if depth_m >= 50.0 else "=0.3048" if depth_m > 5.0 else ""
    unit = f"--set input.range_scale{scale}" if scale else "input.range_scale"
    hint = f"; check the unit of the ranges, which are taken for metres: {unit}" if verdict else ""
    said = f"units: the scanner is {depth_m:.3g} m above the ground, expected {limits} m{hint}"
    assert told(check_height(one)) == (verdict, said)

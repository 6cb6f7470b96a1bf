"""Every check of a stream at its limits."""

import math
from dataclasses import replace
from math import inf, nan
from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike

from prc_cli.core.findings import Finding, Verdict
from prc_cli.core.stream import ReadTally, StreamInfo
from prc_cli.core.types import F32, F64
from prc_cli.streams.angle_step import AngleStep
from prc_cli.streams.down import DownGuess
from prc_cli.streams.evidence import geometry, lines
from prc_cli.streams.evidence.checks import (
    check_collisions,
    check_missing_code,
    check_returns,
    check_unplaced,
)
from prc_cli.streams.evidence.figures import Figures, Seen, Window
from prc_cli.streams.evidence.geometry import check_angle_step, check_down, check_height
from prc_cli.streams.evidence.lines import check_line_length, check_line_order, check_shot_order
from prc_cli.streams.evidence.periods import PeriodEstimate

FINE = Verdict.FINE
DOUBTFUL = Verdict.DOUBTFUL
AGAINST = Verdict.AGAINST
USUAL = Figures(
    random=2.0,
    shot=(0.02, 0.04),
    line=(0.02, 0.03, 0.04, 0.05),
    reversed_line=1.5,
    moved=(0.1, 0.5),
    noise_m=0.004,
    roughness=0.001,
    again=0.3,
    lonely_missing=0.01,
    n_between=1000,
)
M = 100
LENGTHS = range(M - 4, M + 5)


def seen(n_lines: int = 24, m: int = M, n_rows: int = 2, **more: float) -> Seen:
    windows = (Window(0, np.ones((n_rows, m), np.float32)),)
    return Seen(StreamInfo("a.npy", "array", m, None, None), 0, windows, n_lines=n_lines, **more)  # type: ignore[arg-type]


def verdict_of(finding: Finding | None) -> tuple[Verdict, str]:
    return answer_of(finding)[:2]


def answer_of(finding: Finding | None) -> tuple[Verdict, str, str]:
    assert finding is not None
    return finding.verdict, finding.sentence(), finding.option


@pytest.mark.parametrize(
    "shot, ratio, verdict",
    [
        (0.58, "0.29 times ", FINE),
        (0.6, "0.3 times ", DOUBTFUL),
        (1.38, "0.69 times ", DOUBTFUL),
        (1.4, "0.7 times ", AGAINST),
        (2.0, "", AGAINST),
    ],
)
def test_shot_order(shot, ratio, verdict):
    # the second neighbour is more like a shot than the first, but not by half
    assert answer_of(check_shot_order(replace(USUAL, shot=(shot, shot / 2)))) == (
        verdict,
        f"shot-order: ranges of neighbouring shots differ {ratio}as much as those of "
        "random shots, expected "
        "below 0.3; check the layout (byte order, types, header bytes), or sort the shots "
        "by firing order",
        "",
    )


@pytest.fixture
def folds(monkeypatch):
    """How alike lines far apart are with every length that is tried; no other may be."""
    likeness = dict.fromkeys(LENGTHS, 0.6)
    monkeypatch.setattr(lines, "fold", lambda _, points_per_line: likeness[points_per_line])
    monkeypatch.setattr(
        lines,
        "estimate_points_per_line",
        lambda range_m: PeriodEstimate(None, 0.0, range_m.size, ""),
    )
    return likeness


LIKE = (
    "line-length: neighbouring lines differ {} times as much as random shots, expected below 0.12"
)
CHECK_M = "; check -M and --lines, and whether lines and columns are exchanged"


@pytest.mark.parametrize(
    "line, ratio, verdict",
    [
        (0.02, "0.01", FINE),
        (0.238, "0.12", FINE),
        (0.24, "0.12", DOUBTFUL),
        (0.79, "0.4", DOUBTFUL),
        (0.8, "0.4", AGAINST),
    ],
)
def test_lines_that_are_alike(
    folds,
    line,
    ratio,
    verdict,
):
    assert len(folds) == 9
    # lines farther on are more alike, but not by half
    figures = replace(USUAL, line=(line, line / 2, line / 2, line / 2))
    assert answer_of(check_line_length(seen(), figures, None)) == (
        verdict,
        LIKE.format(ratio) + (CHECK_M if verdict else ""),
        "",
    )


@pytest.mark.parametrize(
    "here, there, verdict",
    [
        (0.6, 0.58, FINE),
        (0.63, 0.6, DOUBTFUL),
        (0.71, 0.6, DOUBTFUL),
        (0.6, 0.5, AGAINST),
        (0.6, 0.0, FINE),
        (nan, 0.1, FINE),
    ],
)
@pytest.mark.parametrize("better", [M - 4, M - 1, M + 1, M + 4])
def test_another_length_that_agrees_better(
    folds,
    here,
    there,
    verdict,
    better,
):
    folds.update({**dict.fromkeys(LENGTHS, 0.79), M: here, better: there})
    answer = answer_of(check_line_length(seen(), USUAL, None))
    assert answer[0] is verdict
    if verdict:
        assert answer[1:] == (
            f"line-length: along the stream, lines of {better} shots agree "
            f"{here / there:.2g} times better than lines of "
            f"100, expected no length that agrees better by 1.05; give -M {better}",
            f"-M {better}",
        )


ORDER = "lines far apart differ {} times as much as neighbouring lines, expected at least 1.6"


@pytest.mark.parametrize(
    "far, ratio, verdict",
    [
        (0.4802, "1.6", FINE),
        (0.4798, "1.6", DOUBTFUL),
        (0.4202, "1.4", DOUBTFUL),
        (0.4198, "1.4", AGAINST),
        (0.9, "3", FINE),
    ],
)
def test_line_order(far, ratio, verdict):
    figures = replace(USUAL, moved=(0.3, far), roughness=0.02)
    assert answer_of(check_line_order(seen(24), figures)) == (
        verdict,
        f"line-order: {ORDER.format(ratio)}; sort the lines by time of scan; "
        "in dense snow or fog, accept the check",
        "",
    )


@pytest.mark.parametrize(
    "roughness, far, n_lines, name, verdict",
    [
        (0.0201, 0.3, 200, "standing", DOUBTFUL),
        (0.0201, 0.3, 199, "standing", FINE),
        (0.0201, 0.48, 200, "standing", FINE),
        (0.0199, 0.3, 200, "line-order", AGAINST),
        (nan, 0.3, 200, "standing", DOUBTFUL),
        (inf, 0.3, 200, "standing", DOUBTFUL),
    ],
)
def test_standing(
    roughness,
    far,
    n_lines,
    name,
    verdict,
):
    finding = check_line_order(seen(n_lines), replace(USUAL, moved=(0.3, far), roughness=roughness))
    assert finding is not None
    assert (finding.check, finding.verdict) == (name, verdict)
    if name == "standing":
        assert finding.sentence() == (
            f"standing: {ORDER.format('1' if far == 0.3 else '1.6')} in 200 lines or more; "
            "the platform does not move: remove such stretches"
        )


def counted(ranges: ArrayLike = (), **more: Any) -> Seen:
    row: F32 = np.asarray(ranges, np.float32).reshape(1, -1)
    windows = (Window(0, row),) if row.size else ()
    return Seen(StreamInfo("a.npy", "array", 10, None, None), 0, windows, **more)


@pytest.mark.parametrize(
    "n, verdict, share",
    [
        (0, FINE, "0.0%"),
        (10, FINE, "1.0%"),
        (11, DOUBTFUL, "1.1%"),
        (200, DOUBTFUL, "20.0%"),
        (201, AGAINST, "20.1%"),
    ],
)
def test_lost_and_meeting_records(n, verdict, share):
    scan = counted(tally=ReadTally(n_records=1000, n_collisions=n, n_unplaced=n), n_shots=7)
    assert verdict_of(check_collisions(scan)) == (
        verdict,
        f"collisions: {share} of the records are in the cell of another shot, expected at "
        "most 1%; check --lines, "
        "--columns and -M; several scanners in one file: --scanner DIMENSION",
    )
    assert verdict_of(check_unplaced(scan)) == (
        verdict,
        f"unplaced: {share} of the records have no cell and stay unclassified, expected "
        "at most 1%; check --lines, "
        "--columns and -M; if the recording started again: split the file there",
    )


@pytest.mark.parametrize(
    "n_shots, n_missing, verdict, share",
    [
        (100, 0, FINE, "100.00%"),
        (100, 98, FINE, "2.00%"),
        (1000, 981, DOUBTFUL, "1.90%"),
        (400, 400, DOUBTFUL, "0.00%"),
    ],
)
def test_returns(
    n_shots,
    n_missing,
    verdict,
    share,
):
    assert verdict_of(check_returns(counted(n_shots=n_shots, n_missing=n_missing))) == (
        verdict,
        f"returns: {share} of the shots have a range, expected at least 2%; check --range, "
        "input.max_range, the layout, "
        "and --columns and -M",
    )
    assert check_returns(counted(n_shots=99, n_missing=99)) is None


@pytest.mark.parametrize(
    "n, usual_m, verdict",
    [(10, 20.0, FINE), (11, 20.0, DOUBTFUL), (50, 50.0, FINE), (50, 49.9, DOUBTFUL)],
)
def test_the_largest_range_as_a_code(n, usual_m, verdict):
    finding = check_missing_code(counted(np.where(np.arange(1000) < n, 100.0, usual_m)))
    option = "--set input.max_range=99.9999924"
    assert verdict_of(finding) == (
        verdict,
        f"missing-code: {n / 10:.1f}% of the ranges are 100 m, the largest of all, "
        "expected at most 1%; if it means no return: "
        f"{option}; else the scene is larger than the range of the scanner",
    )
    assert finding is not None
    assert finding.option == (option if verdict else "")


BEAM: F64 = np.deg2rad(np.arange(-90.0, 90.0, 1.0))
STREET: F32 = np.where(np.abs(BEAM) < 1.2, 2.0 / np.cos(BEAM), np.nan).astype(np.float32)


def shots(n_windows: int = 1, **more: Any) -> Seen:
    windows = tuple(Window(100 * k, np.tile(STREET, (20, 1))) for k in range(n_windows))
    info = StreamInfo("a.npy", "array", len(BEAM), None, None, cos_tilt=more.pop("cos_tilt", 1.0))
    return Seen(info, 0, windows, **{"angle_rad": BEAM + 1.0, "beam_rad": BEAM, **more})


def deg(
    degrees: float,
    rival: float | None = None,
    ratio: float = math.inf,
    depth_m: float = 2.0,
) -> DownGuess:
    return DownGuess(
        math.radians(degrees), depth_m, None if rival is None else math.radians(rival), ratio
    )


@pytest.fixture
def guesses(monkeypatch):
    """The guess for all lines, then those for every window."""
    answers: list[DownGuess | None] = []

    def guess(beam_rad: F64, range_m: F32, *, is_coarse: bool = False) -> DownGuess | None:
        assert beam_rad.shape == range_m.shape[1:]
        # scaled to 2 m
        assert (
            1.9
            < np.nanmin(range_m * np.cos(beam_rad)[None] if beam_rad is not BEAM else range_m)
            < 2.1
        )
        assert len(range_m) in ((16,) if is_coarse else (20, 60, 64))
        return answers.pop(0)

    monkeypatch.setattr(geometry, "guess_down", guess)
    return answers


@pytest.mark.parametrize(
    "off_deg, verdict",
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
def test_down_is_judged_by_the_angle(guesses, off_deg, verdict):
    guesses.append(deg(off_deg, 95.4, 3.14))
    off = min(abs(off_deg), 360 - abs(off_deg))
    # the scan angle of straight down is 1 rad, 57.3 deg
    nadir = round(math.degrees(math.remainder(1.0 + math.radians(off_deg), 2 * math.pi)))
    assert verdict_of(check_down(shots())) == (
        verdict,
        f"down: level ground is {off:.0f} deg from straight down (runner-up at 95 deg, 3.1 "
        "times weaker), expected "
        "within 11 deg of the direction in use"
        + (
            f"; give input.nadir; if that is the ground: --set input.nadir={nadir}"
            if verdict
            else ""
        ),
    )


@pytest.mark.parametrize(
    "factor, off, verdict",
    [
        (1.0, 0.005, FINE),
        (1.079, 0.005, FINE),
        (0.921, 0.005, FINE),
        (1.081, 0.005, DOUBTFUL),
        (0.919, 0.005, DOUBTFUL),
        # three times the uncertainty
        (1.149, 0.05, FINE),
        (1.151, 0.05, DOUBTFUL),
        (1.59, 0.05, DOUBTFUL),
        (1.61, 0.05, AGAINST),
        (0.63, 0.05, DOUBTFUL),
        (0.62, 0.05, AGAINST),
    ],
)
def test_angle_step(
    monkeypatch,
    factor,
    off,
    verdict,
):
    step = AngleStep(math.radians(factor), off, 100)
    monkeypatch.setattr(geometry, "measure_step", lambda _: step)
    said = (
        f"the ranges show {factor:.2f} times the angle from shot to shot in use "
        f"({factor:.4g} deg, known to "
    )
    hint = "; check the angles of the shots (input.angle_step) and -M"
    hint += "; to use the measured angles: --set input.angles=measured"
    hint = hint if verdict else ""
    assert verdict_of(check_angle_step(shots())) == (
        verdict,
        f"angle-step: {said}{off:.1%}), expected 0.92 to 1.08{hint}",
    )
    assert check_angle_step(shots(beam_rad=None)) is None
    # uneven beams, and a single one
    assert check_angle_step(shots(beam_rad=np.sign(BEAM) * BEAM**2)) is None
    assert check_angle_step(shots(beam_rad=BEAM[:1])) is None
    monkeypatch.setattr(geometry, "measure_step", lambda _: None)
    assert check_angle_step(shots()) is None


@pytest.mark.parametrize(
    "depth_m, verdict",
    [
        (0.099, AGAINST),
        (0.1, DOUBTFUL),
        (0.399, DOUBTFUL),
        (0.4, FINE),
        (5.0, FINE),
        (5.01, DOUBTFUL),
        (50.0, DOUBTFUL),
        (50.1, AGAINST),
    ],
)
@pytest.mark.parametrize("is_blind", [False, True])
def test_height(
    guesses,
    monkeypatch,
    depth_m,
    verdict,
    is_blind,
):
    monkeypatch.setattr(geometry, "_scale", lambda *_: 1.0)
    # half of it remains below a plane that leans by 60 deg
    guesses.append(deg(-19.9 if not is_blind else 120.0, depth_m=2.0 * depth_m))
    scan = shots(cos_tilt=0.5, beam_rad=None if is_blind else BEAM, angle_rad=BEAM)
    limits = "0.3 to 6" if is_blind else "0.4 to 5"
    if is_blind and depth_m in (0.399, 5.01):
        verdict = FINE
    # the unit in which the depth would be usual
    scale = "=0.01" if depth_m >= 50.0 else "=0.3048" if depth_m > 5.0 else ""
    unit = f"--set input.range_scale{scale}" if scale else "input.range_scale"
    hint = f"; check the unit of the ranges, assumed to be metres: {unit}" if verdict else ""
    said = f"units: the scanner is {depth_m:.3g} m above the ground, expected {limits} m{hint}"
    assert verdict_of(check_height(scan)) == (verdict, said)

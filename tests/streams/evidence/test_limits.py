"""Checks of shots and lines at their limits, on figures that are made up."""

from __future__ import annotations

from dataclasses import replace
from math import inf, nan

import numpy as np
import pytest

from prc_cli.core.findings import Finding, Verdict
from prc_cli.core.stream import ScanBlock, StreamInfo
from prc_cli.core.types import F32
from prc_cli.streams.evidence import lines
from prc_cli.streams.evidence.figures import Figures, LineSample, Seen, Turned, Window, figures_of
from prc_cli.streams.evidence.lines import (
    check_columns_along,
    check_dropouts,
    check_line_length,
    check_line_order,
    check_noise,
    check_shot_order,
    is_shifted,
)
from prc_cli.streams.evidence.periods import PeriodEstimate
from tests.street import street

FINE, DOUBTFUL, AGAINST = Verdict.FINE, Verdict.DOUBTFUL, Verdict.AGAINST
USUAL = Figures(
    random=2.0, shot=(0.02, 0.04), line=(0.02, 0.03, 0.04, 0.05), reversed_line=1.5,
    moved=(0.1, 0.5), noise_m=0.004, roughness=0.001, again=0.3, lonely_missing=0.01, n_between=1000,
)  # fmt: skip
M = 100
LENGTHS = range(M - 4, M + 5)


def seen(n_lines: int = 24, m: int = M, n_rows: int = 2, **more: float) -> Seen:
    windows = (Window(0, np.ones((n_rows, m), np.float32)),)
    return Seen(StreamInfo("a.npy", "array", m, None, None), 0, windows, n_lines=n_lines, **more)  # type: ignore[arg-type]


def told(found: Finding | None) -> tuple[Verdict, str, str]:
    assert found is not None
    return found.verdict, found.sentence(), found.option


@pytest.mark.parametrize(
    ("shot", "ratio", "verdict"),
    [
        (0.58, "0.29 times ", FINE),
        (0.6, "0.3 times ", DOUBTFUL),
        (1.38, "0.69 times ", DOUBTFUL),
        (1.4, "0.7 times ", AGAINST),
        (2.0, "", AGAINST),
    ],
)
def test_shot_order(shot: float, ratio: str, verdict: Verdict) -> None:
    # the second neighbour is more like a shot than the first, but not by half
    assert told(check_shot_order(replace(USUAL, shot=(shot, shot / 2)))) == (
        verdict,
        f"shot-order: ranges of neighbouring shots differ {ratio}as much as those of random shots, expected "
        "below 0.3; check the layout (byte order, types, header bytes), or sort the shots as they were fired",
        "",
    )


@pytest.fixture
def folds(monkeypatch: pytest.MonkeyPatch) -> dict[int, float]:
    """How alike lines far apart are with every length that is tried; no other may be."""
    found = dict.fromkeys(LENGTHS, 0.6)
    monkeypatch.setattr(lines, "fold", lambda _, points_per_line: found.get(points_per_line, 0.6))
    monkeypatch.setattr(lines, "estimate_points_per_line", lambda range_m: PeriodEstimate(None, 0.0, range_m.size, ""))
    return found


LIKE = "line-length: neighbouring lines differ {} times as much as random shots, expected below 0.12"
CHECK_M = "; check -M and --lines, and whether lines and columns are exchanged"


@pytest.mark.parametrize(
    ("line", "ratio", "verdict"),
    [
        (0.02, "0.01", FINE),
        (0.238, "0.12", FINE),
        (0.24, "0.12", DOUBTFUL),
        (0.79, "0.4", DOUBTFUL),
        (0.8, "0.4", AGAINST),
    ],
)
def test_lines_that_are_alike(folds: dict[int, float], line: float, ratio: str, verdict: Verdict) -> None:
    assert len(folds) == 9
    # lines farther on are more alike, but not by half
    figures = replace(USUAL, line=(line, line / 2, line / 2, line / 2))
    assert told(check_line_length(seen(), figures, None)) == (
        verdict, LIKE.format(ratio) + (CHECK_M if verdict else ""), "",
    )  # fmt: skip


@pytest.mark.parametrize(("step", "word"), [(2, "2nd"), (3, "3rd"), (4, "4th")])
def test_lines_of_several_scanners(step: int, word: str) -> None:
    line = [0.4, 0.4, 0.4, 0.4]
    line[step - 1] = 0.19
    expected = (
        AGAINST,
        f"line-length: a line is like the {word} line after it, not the next, expected lines of M = 100 shots that are "
        f"alike; give -M {100 * step} if lines are longer, or split several scanners with --scanner",
        f"-M {100 * step}",
    )
    assert told(check_line_length(seen(), replace(USUAL, line=tuple(line), reversed_line=0.381), None)) == expected
    zigzag = told(check_line_length(seen(), replace(USUAL, line=tuple(line), reversed_line=0.38), None))
    if step == 2:
        expected = (
            AGAINST,
            "line-length: every second line runs the other way, expected lines scanned the same way; reverse every "
            "second line",
            "",
        )
    assert zigzag == expected


@pytest.mark.parametrize("m", [180 * times for times in (2, 3, 4, 5, 7, 9, 10, 34)] + [541, 90, 60, 36, 20])
def test_a_multiple_or_a_part_of_the_line_length(m: int) -> None:
    """M is 180; the last multiple leaves four lines, which are too few for every other check."""
    flat = street().ravel()
    n_lines = len(flat) // m
    sample = LineSample(m)
    sample.add(ScanBlock(0, flat[: n_lines * m].reshape(n_lines, m)))
    one = Seen(StreamInfo("a.npy", "array", m, None, None), 0, sample.windows(), n_lines=n_lines)
    found = check_line_length(one, figures_of(one.windows), None)
    assert found is not None
    assert found.verdict is AGAINST
    assert found.option == "-M 180"


@pytest.mark.parametrize(
    ("here", "there", "verdict"),
    [
        (0.6, 0.58, FINE),
        (0.63, 0.6, DOUBTFUL),
        (0.71, 0.6, DOUBTFUL),
        (0.6, 0.5, AGAINST),
        (0.6, 0.0, FINE),
        (nan, 0.1, FINE),
    ],
)
@pytest.mark.parametrize("other", [M - 4, M - 1, M + 1, M + 4])
def test_another_length_that_agrees_better(
    folds: dict[int, float], here: float, there: float, verdict: Verdict, other: int
) -> None:
    folds.update({**dict.fromkeys(LENGTHS, 0.79), M: here, other: there})
    found = told(check_line_length(seen(), USUAL, None))
    assert found[0] is verdict
    if verdict:
        assert found[1:] == (
            f"line-length: along the stream lines of {other} shots agree {here / there:.2g} times better than lines of "
            f"100, expected no length that agrees better by 1.05; give -M {other}",
            f"-M {other}",
        )


@pytest.mark.parametrize(
    ("line", "here", "period", "strength", "is_told"),
    [
        (0.24, 0.6, 105, 0.5, True), (0.24, 0.6, 95, 0.5, True), (0.24, 0.6, 104, 0.5, False),
        (0.24, 0.6, 96, 0.5, False),
        (0.24, 0.6, 105, 0.49, False), (0.23, 0.6, 105, 0.9, False), (0.02, 0.8, 207, 0.9, True),
        (0.02, 0.79, 207, 0.9, False), (0.02, nan, 207, 0.9, True), (0.02, 0.9, None, 0.9, False),
    ],
)  # fmt: skip
def test_the_ranges_tell_another_length(
    folds: dict[int, float], monkeypatch: pytest.MonkeyPatch, line: float, here: float, period: int | None,
    strength: float, is_told: bool,
) -> None:  # fmt: skip
    folds.update(dict.fromkeys(LENGTHS, here))
    asked = []

    def estimate(range_m: F32) -> PeriodEstimate:
        asked.append(len(range_m))
        return PeriodEstimate(period, strength, 0, "")

    monkeypatch.setattr(lines, "estimate_points_per_line", estimate)
    one = replace(seen(), windows=tuple(Window(0, np.ones((n, M), np.float32)) for n in (2, 5, 3)))
    found = told(check_line_length(one, replace(USUAL, line=(line,) * 4), None))
    assert (found == (
        AGAINST,
        f"line-length: the ranges repeat after {period} shots, not after 100, expected lines of M = 100 shots that are "
        f"alike; give -M {period}",
        f"-M {period}",
    )) is is_told  # fmt: skip
    assert asked == [5 * M]
    if is_told:
        assert told(check_line_length(replace(one, windows=()), replace(USUAL, line=(line,) * 4), None)) != found


@pytest.mark.parametrize(
    ("share", "gain", "distance", "n_places", "expected"),
    [
        (0.3, 0.64, 60, 1, True), (-0.3, 0.45, 60, 1, True), (0.3, 0.44, 60, 1, True), (0.3, 0.65, 60, 1, False),
        (0.3, 0.1, 60, 2, False),
        # a wrong M by up to 4 would shift as much, within 12 of 1000 shots
        (0.3, 0.1, 300, 1, False), (0.3, 0.1, 150, 1, False), (0.3, 0.1, 100, 1, False), (0.3, 0.1, 75, 1, False),
        (0.3, 0.1, 288, 1, False), (0.3, 0.1, 287, 1, True), (0.3, 0.1, 312, 1, False), (0.3, 0.1, 313, 1, True),
    ],
)  # fmt: skip
def test_a_shift_at_a_single_place(share: float, gain: float, distance: int, n_places: int, expected: bool) -> None:
    turned = Turned(480, share, gain, distance, n_places)
    assert is_shifted(turned, 1000) is expected
    found = told(check_columns_along(seen(m=1000), turned))
    if expected:
        said = (
            f"columns-along: before line 480 all columns shift by 300 shots ({gain:.2g} times the difference), "
            "expected at least 0.65 times; shots were lost or added there: split the file, or restore them"
        )
    else:
        said = (
            "columns-along: no single shift of all columns makes places along the stream differ less than "
            f"{gain:.2g} times, expected at least 0.65 times"
        )
    verdict = FINE if not expected else AGAINST if gain < 0.45 else DOUBTFUL
    assert found == (verdict, said, "")


ORDER = "lines far apart differ {} times as much as neighbouring lines, expected at least 1.6"


@pytest.mark.parametrize(
    ("far", "ratio", "verdict"),
    [
        (0.4802, "1.6", FINE),
        (0.4798, "1.6", DOUBTFUL),
        (0.4202, "1.4", DOUBTFUL),
        (0.4198, "1.4", AGAINST),
        (0.9, "3", FINE),
    ],
)
def test_line_order(far: float, ratio: str, verdict: Verdict) -> None:
    figures = replace(USUAL, moved=(0.3, far), roughness=0.02)
    assert told(check_line_order(seen(24), figures)) == (
        verdict,
        f"line-order: {ORDER.format(ratio)}; put the lines into the order in which they were scanned",
        "",
    )


@pytest.mark.parametrize(
    ("roughness", "far", "n_lines", "name", "verdict"),
    [
        (0.0201, 0.3, 200, "standing", DOUBTFUL), (0.0201, 0.3, 199, "standing", FINE),
        (0.0201, 0.48, 200, "standing", FINE),
        (0.0199, 0.3, 200, "line-order", AGAINST), (nan, 0.3, 200, "standing", DOUBTFUL),
        (inf, 0.3, 200, "standing", DOUBTFUL),
    ],
)  # fmt: skip
def test_standing(roughness: float, far: float, n_lines: int, name: str, verdict: Verdict) -> None:
    found = check_line_order(seen(n_lines), replace(USUAL, moved=(0.3, far), roughness=roughness))
    assert found is not None
    assert (found.check, found.verdict) == (name, verdict)
    if name == "standing":
        assert found.sentence() == (
            f"standing: {ORDER.format('1' if far == 0.3 else '1.6')} in 200 lines or more; the platform stands: cut "
            "such stretches out, or accept them"
        )


@pytest.mark.parametrize(("noise_m", "verdict"), [(0.012, FINE), (0.0121, DOUBTFUL)])
def test_range_noise(noise_m: float, verdict: Verdict) -> None:
    assert told(check_noise(seen(most_noise_m=0.012), replace(USUAL, noise_m=noise_m))) == (
        verdict,
        "range-noise: ranges have noise of about 0.012 m, expected at most 0.012 m; the thresholds of this method are "
        "for less: widen them (prc calibrate), or take another method",
        "",
    )


@pytest.mark.parametrize(("share", "verdict"), [(0.085, FINE), (0.0851, DOUBTFUL)])
def test_dropouts(share: float, verdict: Verdict) -> None:
    assert told(check_dropouts(replace(USUAL, lonely_missing=share))) == (
        verdict,
        "dropouts: 8.5% of the shots amid smooth surfaces are missing, expected at most 8.5%; check whether records "
        "were lost or filtered out; isolated gaps cost classes at their edges",
        "",
    )

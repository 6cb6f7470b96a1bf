"""Checks of the labels."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from prc_cli.config import load_config
from prc_cli.core.classes import Label
from prc_cli.core.findings import LABEL_CHECKS, Finding, Verdict
from prc_cli.core.stream import LabelledBlock, ScanBlock, cut
from prc_cli.core.types import F32, F64, U8
from prc_cli.jobs.classify import label_blocks
from prc_cli.methods.base import UsualLabels
from prc_cli.streams.evidence.result import (
    MAX_SCANNERS,
    ResultWatch,
    _percent,
    _Sample,
    check_labels,
)
from tests.methods.fused.street_lines import BEAM, street_lines
from tests.simulated import drive_arrays

NO_EXTRA = np.empty(0, np.uint8)
LABEL_OF_KIND = np.array(
    [0, Label.GROUND, Label.BUILDING, Label.VEGETATION, Label.NOISE, Label.UNCLASSIFIED, 0],
    np.uint8,
)
NAMES = set(LABEL_CHECKS)


def usual_of(preset: str) -> UsualLabels:
    return load_config(preset=preset).config.classifier.method().usual


STREET = usual_of("fused")


def street(n_lines: int = 128) -> tuple[F32, U8]:
    """A street in every fifth column, with the labels that it should get."""
    range_m, kind = street_lines(n_lines)
    return range_m[:, ::5], LABEL_OF_KIND[kind[:, ::5]]


ANGLE = BEAM[::5]


def asked(
    range_m: F32,
    labels: U8,
    beam_rad: F64 | None = ANGLE,
    usual: UsualLabels = STREET,
    angle_rad: F64 | None = ANGLE,
) -> dict[str, Finding]:
    watch = ResultWatch(usual)
    block = ScanBlock(0, range_m, beam_rad=beam_rad, angle_rad=angle_rad)
    watch.see(LabelledBlock(block, labels, NO_EXTRA))
    findings = {finding.check: finding for finding in watch.findings()}
    assert set(findings) <= NAMES
    return findings


def doubted(findings: dict[str, Finding]) -> set[str]:
    return {name for name, finding in findings.items() if finding.verdict > Verdict.FINE}


@pytest.mark.parametrize("preset", ["fused", "street-scan"])
@pytest.mark.parametrize(
    ("columns", "is_fine"), [((0, 20), True), ((0, 0), False), ((60, 100), False)]
)
def test_a_scanner_that_sees_nothing_below_it(
    columns: tuple[int, int], is_fine: bool, preset: str
) -> None:
    """Of all around, a tenth must be ground that is lower than the scanner."""
    range_m = np.full((64, 100), 8.0, np.float32)
    labels = np.full(range_m.shape, Label.BUILDING, np.uint8)
    labels[:, slice(*columns)] = Label.GROUND
    findings = asked(range_m, labels, np.deg2rad(np.linspace(70, 120, 100)), usual_of(preset))
    assert ("ground-below" not in doubted(findings)) == is_fine


@pytest.mark.parametrize(
    ("preset", "share", "verdict"),
    [
        ("urban", 0.4, Verdict.FINE),
        ("urban", 0.6, Verdict.DOUBTFUL),
        ("urban", 0.9, Verdict.AGAINST),
        ("forest", 0.94, Verdict.FINE),
        ("forest", 0.97, Verdict.DOUBTFUL),
        ("forest", 1.0, Verdict.AGAINST),
        ("fused", 0.15, Verdict.FINE),
        ("fused", 0.3, Verdict.DOUBTFUL),
        ("fused", 0.5, Verdict.AGAINST),
        ("fused-forest", 0.15, Verdict.FINE),
        ("fused-forest", 0.3, Verdict.DOUBTFUL),
    ],
)
def test_noise_of_every_method(preset: str, share: float, verdict: Verdict) -> None:
    labels = np.where(
        np.random.default_rng(1).random((64, 100)) < share, Label.NOISE, Label.GROUND
    ).astype(np.uint8)
    findings = asked(np.full(labels.shape, 3.0, np.float32), labels, None, usual_of(preset))
    assert findings["noise-share"].verdict is verdict


@pytest.mark.parametrize("preset", ["fused", "fused-forest", "street-scan"])
@pytest.mark.parametrize(("lines", "is_fine"), [((200, 215), True), ((200, 330), False)])
def test_ground_that_vanishes(preset: str, lines: tuple[int, int], is_fine: bool) -> None:
    range_m, labels = street(512)
    rows = labels[slice(*lines)]
    rows[rows == Label.GROUND] = Label.BUILDING
    findings = asked(range_m, labels, usual=usual_of(preset))
    assert ("classes-along" not in doubted(findings)) == is_fine
    if not is_fine:
        first, last = (
            int(number)
            for number in findings["classes-along"].found.split("lines ")[1].split(" to ")
        )
        assert abs(first - lines[0]) <= 32
        assert abs(last - lines[1]) <= 32
        assert f"--only {first}:" in findings["classes-along"].hint


def test_level_surfaces_below_and_above_leave_it_open_where_up_is() -> None:
    range_m, labels = street()
    watch = ResultWatch(usual_of("rings"))
    block = ScanBlock(0, range_m)
    watch.see(LabelledBlock(block, labels, NO_EXTRA, is_up_assumed=True))
    down = next(finding for finding in watch.findings() if finding.check == "down")
    assert down.verdict is Verdict.DOUBTFUL
    assert down.option == "--set rings.up=z"
    assert "--set rings.up=-z" in down.hint


@given(cuts=st.sets(st.integers(1, 2499), max_size=12), off_deg=st.sampled_from([0.0, 15.0]))
def test_findings_do_not_depend_on_the_blocks(cuts: set[int], off_deg: float) -> None:
    range_m, labels = MANY
    whole = ScanBlock(0, range_m, beam_rad=ANGLE[::4] - np.deg2rad(off_deg), angle_rad=ANGLE[::4])
    undivided = ResultWatch(STREET)
    many = ResultWatch(STREET)
    undivided.see(LabelledBlock(whole, labels, NO_EXTRA))
    for start, stop in pairwise([0, *sorted(cuts), len(labels)]):
        many.see(LabelledBlock(cut(whole, start, stop), labels[start:stop], NO_EXTRA))
    assert many.findings() == undivided.findings()
    assert doubted({finding.check: finding for finding in undivided.findings()}) == (
        {"ground-lean"} if off_deg else set()
    )


def _many() -> tuple[F32, U8]:
    range_m, labels = street(500)
    return np.tile(range_m[:, ::4], (5, 1)), np.tile(labels[:, ::4], (5, 1))


MANY = _many()


def test_the_worst_of_several_scanners_stands() -> None:
    range_m, labels = street()
    watch = ResultWatch(STREET)
    for scanner in range(MAX_SCANNERS + 2):
        off = 0.2 if scanner in (2, MAX_SCANNERS) else 0.0
        block = ScanBlock(0, range_m, scanner=scanner, beam_rad=ANGLE - off)
        watch.see(LabelledBlock(block, labels, NO_EXTRA))
    findings = {finding.check: finding for finding in watch.findings()}
    assert doubted(findings) == {"ground-lean"}
    assert findings["ground-lean"].found.startswith("scanner 2: the ground leans by 1")
    assert findings["ground-below"].found.startswith("scanner 0: ")


@pytest.mark.parametrize(
    ("off_deg", "is_fine"), [(0.0, True), (15.0, False), (45.0, False), (180.0, False)]
)
def test_a_simulated_street_with_down_told_wrong(off_deg: float, is_fine: bool) -> None:
    params = load_config(preset="fused").config.classifier
    block, _ = drive_arrays(160, 600, 5)
    assert block.angle_rad is not None
    beam_rad = (block.angle_rad + np.deg2rad(off_deg) + np.pi) % (2 * np.pi) - np.pi
    watch = ResultWatch(params.method().usual)
    for item in label_blocks(iter([replace(block, beam_rad=beam_rad)]), params):
        watch.see(item)
    assert (not doubted({finding.check: finding for finding in watch.findings()})) == is_fine


FINE = Verdict.FINE
DOUBTFUL = Verdict.DOUBTFUL
AGAINST = Verdict.AGAINST
USUAL = UsualLabels(0.25, 0.5, 0.25, (Label.GROUND,), 0.5, 0.5, 0.25, 5.0, 0.25)
G, B, N, U, C, V = (
    int(one)
    for one in (
        Label.GROUND,
        Label.BUILDING,
        Label.NOISE,
        Label.UNCLASSIFIED,
        Label.CURB,
        Label.VEGETATION,
    )
)
EVEN_BEAMS: F64 = np.deg2rad(np.linspace(-75.0, 75.0, 50))


def sample(
    range_m: F32,
    labels: U8,
    beam: F64 | None = EVEN_BEAMS,
    angle: F64 | None = EVEN_BEAMS,
) -> _Sample:
    return _Sample(np.arange(len(labels)) * 3 + 6, range_m, labels, beam, angle)


def verdicts(kept: _Sample, usual: UsualLabels = USUAL) -> dict[str, tuple[Verdict, str]]:
    return {
        finding.check: (finding.verdict, finding.sentence())
        for finding in check_labels(kept, usual)
    }


def slow_answers(kept: _Sample, usual: UsualLabels) -> dict[str, tuple[Verdict, str]]:  # noqa: C901, PLR0912, PLR0915
    """Answer shot by shot: what is found, without what is expected."""
    assert kept.beam_rad is not None
    n = dict.fromkeys(
        ("there", "noise", "without", "below", "level", "near", "under", "solid", "far"), 0
    )
    leans = []
    stretches = np.zeros((len(kept.labels) // 16, 4))
    for row, (ranges, labels) in enumerate(
        zip(kept.range_m.tolist(), kept.labels.tolist(), strict=True)
    ):
        ground: list[tuple[float, float]] = []
        sides: dict[bool, list[tuple[bool, float]]] = {True: [], False: []}
        counts = np.zeros(4)
        for range_m, label, beam in zip(ranges, labels, kept.beam_rad.tolist(), strict=True):
            is_there = label != 0
            is_noise = label == N
            is_down = abs(beam) < math.radians(60)
            is_solid = is_there and not is_noise
            n["there"] += is_there
            n["noise"] += is_noise
            n["without"] += label == U
            n["solid"] += is_solid
            n["far"] += is_solid and range_m > usual.reach_m
            n["below"] += is_solid and is_down
            n["level"] += is_solid and is_down and label in usual.level
            counts += (
                is_solid and is_down and label in usual.level,
                is_solid and is_down,
                is_noise,
                is_there,
            )
            if is_solid and is_down and range_m < 20.0:
                is_ground = label in (G, C)
                up = -range_m * math.cos(beam)
                sides[beam < 0].append((is_ground, up))
                if is_ground:
                    ground.append((range_m * math.sin(beam), up))
        if len(ground) >= 8:
            x, y = np.array(ground).T
            if x.var() > 0.09:
                leans.append(float(((x - x.mean()) * (y - y.mean())).mean() / x.var()))
        for side in sides.values():
            heights = sorted(up for is_ground, up in side if is_ground)
            if len(heights) >= 3:
                middle = heights[len(heights) // 2]
                n["near"] += len(side)
                n["under"] += sum(not is_ground and up < middle - 1.0 for is_ground, up in side)
        if row // 16 < len(stretches):
            stretches[row // 16] += counts
    answers = {}
    without = n["without"] / n["there"]
    noise = n["noise"] / n["there"]
    if without > usual.unclassified_share and noise <= usual.noise_share:
        answers["noise-share"] = DOUBTFUL, f"{_percent(without)} of the returns have no class"
    else:
        verdict = (
            AGAINST
            if noise > usual.garbage_share
            else DOUBTFUL
            if noise > usual.noise_share
            else FINE
        )
        answers["noise-share"] = verdict, f"{_percent(noise)} of the returns are noise"
    if usual.reach_m > 0:
        share = n["far"] / n["solid"]
        verdict = DOUBTFUL if share < 0.01 else FINE
        answers["indoors"] = (
            verdict,
            f"{_percent(share)} of the returns are farther than {usual.reach_m:g} m",
        )
    share = n["level"] / n["below"]
    answers["ground-below"] = (
        DOUBTFUL if share < usual.level_share else FINE,
        f"{_percent(share)} of the returns within 60 deg of down are ground",
    )
    if len(leans) >= 32:
        lean = abs(math.degrees(math.atan(np.median(leans))))
        answers["ground-lean"] = (
            DOUBTFUL if lean > usual.lean_deg else FINE,
            f"the ground leans by {lean:.2f} deg across the lines",
        )
    share = n["under"] / n["near"]
    answers["below-ground"] = (
        DOUBTFUL if share > usual.below_share else FINE,
        (
            f"{_percent(share)} of the returns within 20 m and 60 deg of down are more than 1 "
            "m below the ground"
        ),
    )
    pooled = np.array([stretches[i : i + 3].sum(axis=0) for i in range(len(stretches) - 2)])
    known = pooled[:, 1] >= 375
    ground_shares = [a / b for a, b in pooled[known, :2]]
    usually = float(np.quantile(ground_shares, 0.75)) if ground_shares else 0.0
    gone = [
        bool(k) and a / b < usual.vanished_share * usually
        for (a, b, _, _), k in zip(pooled, known, strict=True)
    ]
    noisy = [d >= 375 and c / d > usual.noise_share for _, _, c, d in pooled]
    solid = [d - c for _, _, c, d in pooled]
    least = 0.8 * float(
        np.median([n for n, bad in zip(solid, noisy, strict=True) if not bad] or [np.inf])
    )
    bare = [bad and n < least for n, bad in zip(solid, noisy, strict=True)]
    answers["classes-along"] = FINE, "ground and noise are even along the stream"
    for bad, said, verdict in (
        (gone, "hardly any ground", DOUBTFUL),
        (bare, "much noise", DOUBTFUL),
        (noisy, "much noise between complete surfaces", FINE),
    ):
        runs = [
            (i, j) for i in range(len(bad)) for j in range(i + 1, len(bad) + 1) if all(bad[i:j])
        ]
        first, last = max(runs, key=lambda run: (run[1] - run[0], -run[0]), default=(0, 0))
        if 0 < last - first < len(bad):
            start = kept.line[first * 16]
            stop = kept.line[(last + 2) * 16 - 1] + 1
            answers["classes-along"] = verdict, f"{said} in lines {start} to {stop}"
            break
    return answers


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("preset", ["lax", "usual"])
def test_answers_equal_plain_loops(seed: int, preset: str) -> None:
    rng = np.random.default_rng(seed)
    usual = (
        USUAL
        if preset == "usual"
        else UsualLabels(
            0.4, 0.9, 0.1, (Label.GROUND, Label.CURB), 0.9, 0.1, 0.02, 1.0, 0.6, 4.0 + seed
        )
    )
    shape = (192 + 5 * seed, 50)
    lean = np.tan(np.deg2rad(rng.uniform(-12, 12)))
    range_m = (
        4.0
        / np.maximum(np.cos(EVEN_BEAMS) + lean * np.sin(EVEN_BEAMS), 0.1)
        * rng.normal(1.0, 0.02, shape)
    )
    range_m *= np.where(rng.random(shape) < 0.2, rng.uniform(0.5, 3.0, shape), 1.0)
    chances = np.array([0.1, 0.5, 0.15, 0.05 + 0.012 * seed, 0.05, 0.05, 0.0])
    chances[-1] = 1 - chances.sum()
    labels = rng.choice(np.array([0, G, B, N, U, C, V], np.uint8), shape, p=chances)
    stretch = slice(20 * (seed % 4), 20 * (seed % 4) + 90)
    labels[stretch] = np.where(
        labels[stretch] == (G if seed % 2 else B), N if seed in (2, 6) else V, labels[stretch]
    )
    # few lines show the ground, or few returns
    labels[::7, 5:] = np.where(labels[::7, 5:] == G, B, labels[::7, 5:])
    labels[100:150, 12 + seed :] = 0
    kept = sample(range_m.astype(np.float32), labels)
    answers = {
        name: (verdict, said.split(": ", 1)[1].split(", expected")[0])
        for name, (verdict, said) in verdicts(kept, usual).items()
    }
    assert answers == slow_answers(kept, usual)

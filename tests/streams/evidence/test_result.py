"""Checks of the result after labelling."""

from __future__ import annotations

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
from prc_cli.streams.evidence.result import MAX_LINES, MAX_SCANNERS, ResultWatch
from tests.methods.fused.street_lines import BEAM, street_lines
from tests.simulated import drive_arrays

NO_EXTRA = np.empty(0, np.uint8)
LABEL_OF_KIND = np.array(
    [0, Label.GROUND, Label.BUILDING, Label.VEGETATION, Label.NOISE, Label.UNCLASSIFIED, 0], np.uint8
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
    range_m: F32, labels: U8, beam_rad: F64 | None = ANGLE, usual: UsualLabels = STREET, angle_rad: F64 | None = ANGLE
) -> dict[str, Finding]:
    watch = ResultWatch(usual)
    block = ScanBlock(0, range_m, beam_rad=beam_rad, angle_rad=angle_rad)
    watch.see(LabelledBlock(block, labels, NO_EXTRA))
    found = {one.check: one for one in watch.findings()}
    assert set(found) <= NAMES
    return found


def doubted(found: dict[str, Finding]) -> set[str]:
    return {name for name, one in found.items() if one.verdict > Verdict.FINE}


def test_a_street_is_fine_in_all_checks() -> None:
    found = asked(*street())
    assert set(found) == NAMES - {"few-rings"}
    assert doubted(found) == set()


@pytest.mark.parametrize("off_deg", [-15.0, -10.0, 10.0, 15.0])
def test_ground_that_leans_tells_where_down_is(off_deg: float) -> None:
    found = asked(*street(), beam_rad=ANGLE - np.deg2rad(off_deg))
    assert "ground-lean" in doubted(found)
    nadir = float(found["ground-lean"].hint.split("input.nadir=")[1].split(";")[0])
    assert abs(nadir) < 2.5  # what was told is off by up to 15 deg


def test_without_scan_angles_the_hint_still_says_where_to_look() -> None:
    found = asked(*street(), beam_rad=ANGLE - 0.2, angle_rad=None)
    assert "prc info" in found["ground-lean"].hint


@pytest.mark.parametrize(("share", "is_fine"), [(0.2, True), (0.6, False)])
def test_little_ground_below_the_scanner(share: float, is_fine: bool) -> None:
    range_m, labels = street()
    lost = (labels == Label.GROUND) & (np.random.default_rng(1).random(labels.shape) < share)
    found = asked(range_m, np.where(lost, np.uint8(Label.BUILDING), labels))
    assert ("ground-below" not in doubted(found)) == is_fine


@pytest.mark.parametrize("preset", ["fused", "street-scan"])
@pytest.mark.parametrize(("columns", "is_fine"), [((0, 20), True), ((0, 0), False), ((60, 100), False)])
def test_a_scanner_that_sees_nothing_below_it(columns: tuple[int, int], is_fine: bool, preset: str) -> None:
    """Of all around, a tenth must be ground that is lower than the scanner."""
    range_m = np.full((64, 100), 8.0, np.float32)
    labels = np.full(range_m.shape, Label.BUILDING, np.uint8)
    labels[:, slice(*columns)] = Label.GROUND
    found = asked(range_m, labels, np.deg2rad(np.linspace(70, 120, 100)), usual_of(preset))
    assert ("ground-below" not in doubted(found)) == is_fine


@pytest.mark.parametrize(("n_below", "is_fine"), [(20, True), (60, False)])
def test_things_below_the_ground(n_below: int, is_fine: bool) -> None:
    range_m, labels = street()
    below = np.argsort(np.abs(ANGLE))[:n_below]
    range_m[:, below], labels[:, below] = 5.0, Label.BUILDING
    found = asked(range_m, labels, usual=replace(STREET, level_share=0.1))
    assert ("below-ground" not in doubted(found)) == is_fine


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
    labels = np.where(np.random.default_rng(1).random((64, 100)) < share, Label.NOISE, Label.GROUND).astype(np.uint8)
    found = asked(np.full(labels.shape, 3.0, np.float32), labels, None, usual_of(preset))
    assert found["noise-share"].verdict is verdict


@pytest.mark.parametrize(("far", "is_fine"), [(0, False), (40, False), (80, True)])
def test_rooms_are_no_streets(far: int, is_fine: bool) -> None:
    """One in a hundred of 6400 returns is farther than a room is wide."""
    range_m = np.full((64, 100), 5.9, np.float32)
    range_m.ravel()[:far] = 6.1
    found = asked(range_m, np.full(range_m.shape, Label.GROUND, np.uint8), None)
    assert ("indoors" not in doubted(found)) == is_fine


@pytest.mark.parametrize(("preset", "is_fine"), [("street-scan", False), ("fused", True)])
def test_returns_without_a_class(preset: str, is_fine: bool) -> None:
    """Fused leaves cars and poles without a class, and a full garage is half cars."""
    range_m, labels = street()
    labels[:, ::4] = np.where(labels[:, ::4] == Label.MISSING, 0, Label.UNCLASSIFIED)
    assert ("noise-share" not in doubted(asked(range_m, labels, usual=usual_of(preset)))) == is_fine


@pytest.mark.parametrize("preset", ["fused", "fused-forest", "street-scan"])
@pytest.mark.parametrize(("lines", "is_fine"), [((200, 215), True), ((200, 330), False)])
def test_ground_that_vanishes(preset: str, lines: tuple[int, int], is_fine: bool) -> None:
    range_m, labels = street(512)
    rows = labels[slice(*lines)]
    rows[rows == Label.GROUND] = Label.BUILDING
    found = asked(range_m, labels, usual=usual_of(preset))
    assert ("classes-along" not in doubted(found)) == is_fine
    if not is_fine:
        first, last = (int(one) for one in found["classes-along"].found.split("lines ")[1].split(" to "))
        assert abs(first - lines[0]) <= 32
        assert abs(last - lines[1]) <= 32
        assert f"--only-lines {first}:" in found["classes-along"].hint


def test_noise_in_a_part_of_the_stream() -> None:
    range_m, labels = street(512)
    rows = labels[300:400]
    rows[:, ::2] = np.where(rows[:, ::2] == Label.MISSING, 0, Label.NOISE)
    found = asked(range_m, labels)
    assert doubted(found) == {"classes-along"}
    assert found["classes-along"].found.startswith("much noise in lines ")


@pytest.mark.parametrize("shape", [(1, 9), (31, 2000), (499, 2)])
def test_too_little_to_tell_gives_no_finding(shape: tuple[int, int]) -> None:
    labels = np.full(shape, Label.NOISE, np.uint8)
    assert asked(np.full(shape, 3.0, np.float32), labels, np.linspace(-1, 1, shape[1])) == {}
    assert asked(np.full((64, 100), np.nan, np.float32), np.zeros((64, 100), np.uint8), None) == {}
    assert ResultWatch(STREET).findings() == ()


@given(cuts=st.sets(st.integers(1, 2499), max_size=12), off_deg=st.sampled_from([0.0, 15.0]))
def test_findings_do_not_depend_on_the_blocks(cuts: set[int], off_deg: float) -> None:
    range_m, labels = MANY
    whole = ScanBlock(0, range_m, beam_rad=ANGLE[::4] - np.deg2rad(off_deg), angle_rad=ANGLE[::4])
    one, many = ResultWatch(STREET), ResultWatch(STREET)
    one.see(LabelledBlock(whole, labels, NO_EXTRA))
    for start, stop in pairwise([0, *sorted(cuts), len(labels)]):
        many.see(LabelledBlock(cut(whole, start, stop), labels[start:stop], NO_EXTRA))
    assert many.findings() == one.findings()
    assert doubted({found.check: found for found in one.findings()}) == ({"ground-lean"} if off_deg else set())


def _many() -> tuple[F32, U8]:
    range_m, labels = street(500)
    return np.tile(range_m[:, ::4], (5, 1)), np.tile(labels[:, ::4], (5, 1))


MANY = _many()


def test_the_lines_that_are_kept_are_few_and_even() -> None:
    watch = ResultWatch(STREET)
    for first in range(0, 100_000, 777):
        block = ScanBlock(first, np.full((777, 5), 2.0, np.float32))
        watch.see(LabelledBlock(block, np.full((777, 5), Label.GROUND, np.uint8), NO_EXTRA))
    (kept,) = watch._scanners.values()
    lines = kept.sample().line
    assert MAX_LINES / 2 <= len(lines) <= MAX_LINES
    assert set(np.diff(lines)) == {256}
    assert lines[0] == 0


def test_the_worst_of_several_scanners_stands() -> None:
    range_m, labels = street()
    watch = ResultWatch(STREET)
    for scanner in range(MAX_SCANNERS + 2):
        off = 0.2 if scanner in (2, MAX_SCANNERS) else 0.0
        block = ScanBlock(0, range_m, scanner=scanner, beam_rad=ANGLE - off)
        watch.see(LabelledBlock(block, labels, NO_EXTRA))
    found = {one.check: one for one in watch.findings()}
    assert doubted(found) == {"ground-lean"}
    assert found["ground-lean"].found.startswith("scanner 2: the ground leans by 1")
    assert found["ground-below"].found.startswith("scanner 0: ")


@pytest.mark.parametrize(("off_deg", "is_fine"), [(0.0, True), (15.0, False), (45.0, False), (180.0, False)])
def test_a_simulated_street_with_down_told_wrong(off_deg: float, is_fine: bool) -> None:
    params = load_config(preset="fused").config.classifier
    block, _ = drive_arrays(160, 600, 5)
    assert block.angle_rad is not None
    beam_rad = (block.angle_rad + np.deg2rad(off_deg) + np.pi) % (2 * np.pi) - np.pi
    watch = ResultWatch(params.method().usual)
    for item in label_blocks(iter([replace(block, beam_rad=beam_rad)]), params):
        watch.see(item)
    assert (not doubted({one.check: one for one in watch.findings()})) == is_fine

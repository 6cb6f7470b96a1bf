"""Checks of the labels."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from prc_cli.config import load_config
from prc_cli.core.classes import Label
from prc_cli.core.findings import LABEL_CHECKS, ORDER_CHECKS, Finding, Verdict
from prc_cli.core.stream import LabelledBlock, ScanBlock, cut
from prc_cli.core.types import F32, F64, U8
from prc_cli.formats.options import InputConfig
from prc_cli.methods.base import UsualLabels
from prc_cli.streams.evidence.result import (
    MAX_SCANNERS,
    ResultWatch,
)
from prc_cli.streams.evidence.watch import accepted_by
from tests.methods.fused.street_lines import BEAM, street_lines

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
@pytest.mark.parametrize("columns, is_fine", [((0, 20), True), ((0, 0), False), ((60, 100), False)])
def test_a_scanner_that_sees_nothing_below_it(columns, is_fine, preset):
    """Of all around, a tenth must be ground that is lower than the scanner."""
    range_m = np.full((64, 100), 8.0, np.float32)
    labels = np.full(range_m.shape, Label.BUILDING, np.uint8)
    labels[:, slice(*columns)] = Label.GROUND
    findings = asked(range_m, labels, np.deg2rad(np.linspace(70, 120, 100)), usual_of(preset))
    assert ("ground-below" not in doubted(findings)) == is_fine


@pytest.mark.parametrize(
    "preset, share, verdict",
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
def test_noise_of_every_method(preset, share, verdict):
    labels = np.where(
        np.random.default_rng(1).random((64, 100)) < share, Label.NOISE, Label.GROUND
    ).astype(np.uint8)
    findings = asked(np.full(labels.shape, 3.0, np.float32), labels, None, usual_of(preset))
    assert findings["noise-share"].verdict is verdict


@pytest.mark.parametrize("preset", ["fused", "fused-forest", "street-scan"])
@pytest.mark.parametrize("lines, is_fine", [((200, 215), True), ((200, 330), False)])
def test_ground_that_vanishes(preset, lines, is_fine):
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


def test_level_surfaces_below_and_above_leave_it_open_where_up_is():
    range_m, labels = street()
    watch = ResultWatch(usual_of("rings"))
    block = ScanBlock(0, range_m)
    watch.see(LabelledBlock(block, labels, NO_EXTRA, is_up_assumed=True))
    down = next(finding for finding in watch.findings() if finding.check == "down")
    assert down.verdict is Verdict.DOUBTFUL
    assert down.option == "--set rings.up=z"
    assert "--set rings.up=-z" in down.hint


@given(cuts=st.sets(st.integers(1, 2499), max_size=12), off_deg=st.sampled_from([0.0, 15.0]))
def test_findings_do_not_depend_on_the_blocks(cuts, off_deg):
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


def test_the_worst_of_several_scanners_stands():
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


def without_class(range_m: F32, labels: U8) -> None:
    labels[:, ::2] = np.where(labels[:, ::2] > 0, Label.UNCLASSIFIED, 0)


def in_a_room(range_m: F32, labels: U8) -> None:
    np.minimum(range_m, 5.0, out=range_m)


def with_pits(range_m: F32, labels: U8) -> None:
    pits = labels[:, ::4] == Label.GROUND
    range_m[:, ::4] = np.where(pits, 2.0 * range_m[:, ::4], range_m[:, ::4])
    labels[:, ::4] = np.where(pits, Label.BUILDING, labels[:, ::4])


def in_dust(range_m: F32, labels: U8) -> None:
    labels[200:330] = np.where(labels[200:330] > 0, Label.NOISE, 0)


def in_sunlight(range_m: F32, labels: U8) -> None:
    """Noise in shots that would not return, beside all that is usual."""
    sky = labels[200:330] == 0
    range_m[200:330][sky] = 9.0
    labels[200:330][sky] = Label.NOISE


@pytest.mark.parametrize(
    "spoil, check, verdict, measured",
    [
        (without_class, "noise-share", Verdict.DOUBTFUL, "53 % of the returns have no class"),
        (in_a_room, "indoors", Verdict.DOUBTFUL, "0 % of the returns are farther than 6 m"),
        (
            with_pits,
            "below-ground",
            Verdict.DOUBTFUL,
            "23 % of the returns within 20 m and 60 deg of down are more than 1 m below the ground",
        ),
        (in_dust, "classes-along", Verdict.DOUBTFUL, "much noise in lines 176 to 368"),
        (
            in_sunlight,
            "classes-along",
            Verdict.FINE,
            "much noise between complete surfaces in lines 192 to 336",
        ),
    ],
)
def test_each_check_says_what_it_measured(spoil, check, verdict, measured):
    range_m, labels = street(512)
    spoil(range_m, labels)
    usual = replace(STREET, unclassified_share=0.25)
    finding = asked(range_m, labels, usual=usual)[check]
    assert (finding.verdict, finding.found) == (verdict, measured)
    assert asked(*street(512), usual=usual)[check].found != measured


def test_an_order_that_is_trusted_accepts_its_doubts():
    assert accepted_by(InputConfig(accept_doubts=("path",))) == ("path",)
    trusted = InputConfig(accept_doubts=("path",), order="trust")
    assert accepted_by(trusted) == ("path", *ORDER_CHECKS)

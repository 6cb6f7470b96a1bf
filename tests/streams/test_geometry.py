"""Checks of the geometry against level ground."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from prc_cli.core.findings import Finding, Verdict
from prc_cli.core.stream import ScanBlock, StreamInfo
from prc_cli.core.types import F32, F64
from prc_cli.simulation.settings import load_settings, open_simulation
from prc_cli.streams.down import wrap
from prc_cli.streams.evidence.figures import LineSample, Seen
from prc_cli.streams.evidence.geometry import check_angle_step, check_down, check_height
from tests.methods.fused.street_lines import BEAM, street_lines

STREET = street_lines(200)[0]


def seen(beam_rad: F64, range_m: F32, **more: float) -> Seen:
    sample = LineSample(range_m.shape[1])
    sample.add(ScanBlock(0, range_m))
    info = StreamInfo("drive.npz", "array", range_m.shape[1], None, None, **more)  # type: ignore[arg-type]
    return Seen(info, 0, sample.windows(), angle_rad=beam_rad, beam_rad=wrap(beam_rad.copy()))


def verdict(found: Finding | None) -> Verdict | None:
    return None if found is None else found.verdict


@pytest.fixture(scope="module", params=["photon-80", "sick-push-broom"])
def street(request: pytest.FixtureRequest) -> tuple[F64, F32]:
    """Return beams and ranges of a simulated street."""
    options = {"seed": 8801, "length_m": 25.0, "scanner": {"name": request.param}, "trajectory": {"stop_every_m": 0.0}}
    scan = open_simulation("street", load_settings("street", options=options)).scan
    ranges = np.concatenate([item.block.range_m for item in scan.labelled_blocks()])
    assert scan.info.angle_rad is not None
    return wrap(scan.info.angle_rad - (scan.info.down_rad or 0.0)), ranges


@pytest.mark.parametrize(
    ("off_deg", "expected"),
    [(15, Verdict.DOUBTFUL), (-15, Verdict.DOUBTFUL), (45, Verdict.AGAINST), (180, Verdict.AGAINST)],
)
def test_down_that_is_given_wrong_is_noticed(street: tuple[F64, F32], off_deg: float, expected: Verdict) -> None:
    angle, ranges = street
    found = check_down(replace(seen(angle + np.deg2rad(off_deg), ranges), angle_rad=angle))
    assert found is not None
    assert found.verdict == expected
    # the hint is right on the scale of the scan angles
    nadir = float(found.hint.rpartition("input.nadir=")[2])
    assert abs(nadir) <= 2


@pytest.mark.parametrize(
    ("factor", "expected"),
    [(100.0, Verdict.AGAINST), (0.001, Verdict.AGAINST), (3.2808, Verdict.DOUBTFUL), (2.0, None), (0.5, Verdict.FINE)],
)
def test_ranges_in_another_unit_are_noticed(street: tuple[F64, F32], factor: float, expected: Verdict | None) -> None:
    angle, ranges = street
    found = check_height(seen(angle, ranges * np.float32(factor)))
    assert found is not None
    # a scanner on a truck is twice as high, and a plane that leans adds to it
    assert found.verdict == expected or (expected is None and found.verdict < Verdict.AGAINST)
    # whatever the unit, down is found
    assert verdict(check_down(seen(angle, ranges * np.float32(factor)))) == Verdict.FINE


@pytest.mark.filterwarnings("error")
def test_what_tells_nothing_gives_no_finding() -> None:
    rng = np.random.default_rng(2)
    nothing = [
        np.full((20, len(BEAM)), np.nan, np.float32),
        np.empty((0, len(BEAM)), np.float32),
        rng.uniform(0.1, 80.0, (20, len(BEAM))).astype(np.float32),
        np.where(rng.random((20, len(BEAM))) < 0.02, STREET[:20], np.nan).astype(np.float32),
    ]
    for check in (check_down, check_angle_step, check_height):
        for ranges in nothing:
            assert verdict(check(seen(BEAM, ranges))) in (None, Verdict.FINE)
        if check is not check_height:
            assert check(replace(seen(BEAM, STREET), beam_rad=None)) is None
        assert check(replace(seen(BEAM, STREET), windows=())) is None
        # columns of a single beam
        assert check(seen(np.array([0.1]), np.full((9, 1), 2.0, np.float32))) is None

"""Rings that are cones around z, or are not: coordinates on other axes than the scanner's own."""

import numpy as np
import pytest

from prc_cli.core.findings import Finding, Verdict
from prc_cli.core.frame import turning
from prc_cli.core.stream import ScanBlock, StreamInfo
from prc_cli.core.types import F64
from prc_cli.streams.evidence.cones import ConeSample, check_cones
from prc_cli.streams.evidence.figures import Seen
from tests.clouds import seen

N_LINES = 400
N_RINGS = 32


def ring_shots(width_deg: float) -> F64:
    """Shots of rings over a sector, at ranges of 4 to 30 m, (lines, rings, 3)."""
    azimuth = np.deg2rad(np.linspace(-width_deg / 2, width_deg / 2, N_LINES))[:, None]
    elevation = np.deg2rad(np.linspace(-25.0, 5.0, N_RINGS))
    range_m = np.random.default_rng(5).uniform(4.0, 30.0, (N_LINES, N_RINGS))
    return seen(range_m, azimuth, elevation)


def asked(xyz_m: F64, *, has_rings: bool = True) -> Finding | None:
    range_m = np.linalg.norm(xyz_m, axis=-1).astype(np.float32)
    sample = ConeSample()
    for first in range(0, N_LINES, 90):
        part = slice(first, first + 90)
        sample.add(
            ScanBlock(
                first, range_m[part], xyz_m=xyz_m[part].astype(np.float32), has_rings=has_rings
            )
        )
    info = StreamInfo("a.bag", "bag", N_RINGS, None, None)
    return check_cones(Seen(info, 0, (), has_rings=has_rings, cone_spread_rad=sample.spread_rad()))


@pytest.mark.parametrize("width_deg", [60.0, 200.0])
def test_a_sector_on_other_axes_is_a_doubt(width_deg):
    shots = ring_shots(width_deg)
    pitched = shots @ turning(np.deg2rad([0.0, 6.0, 0.0]))
    lifted = shots + np.array([0.0, 0.0, 1.7])
    for xyz_m, expected in (
        (shots, Verdict.FINE),
        (pitched, Verdict.DOUBTFUL),
        (lifted, Verdict.DOUBTFUL),
    ):
        finding = asked(xyz_m)
        assert finding is not None
        assert finding.verdict is expected


def test_columns_that_are_no_rings_are_not_asked():
    assert asked(ring_shots(60.0) + np.array([0.0, 0.0, 1.7]), has_rings=False) is None

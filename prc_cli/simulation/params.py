"""What can be chosen about the simulated street and its scanner."""

from __future__ import annotations

from pydantic import Field

from prc_cli.core.config import Params


class StreetParams(Params):
    """A car with a 360 degree profiler on its roof drives down a street.

    The defaults are the scanner of Lehtola et al. (2019, III): 48 lines a second of 2154 shots, plane slanted back.
    """

    seed: int = Field(1, ge=0, lt=2**63, description="the same seed gives the same street and the same noise")
    n_lines: int = Field(600, ge=1, le=10**9, description="scan lines")
    points_per_line: int = Field(2154, ge=16, le=100_000, description="M, shots in a scan line")
    line_hz: float = Field(48.0, gt=0, le=1000, description="scan lines a second [Hz]")
    speed_m_s: float = Field(8.33, ge=0, le=60, description="speed of the car [m/s]; 8.33 = 30 km/h")
    slant_deg: float = Field(25.0, ge=-60, le=60, description="tilt of the scan plane: down points back [degrees]")
    height_m: float = Field(2.2, ge=1.0, le=5.0, description="scanner above the road [m]")
    noise_m: float = Field(0.003, ge=0, le=1, description="range noise close by, standard deviation [m]")
    noise_per_m: float = Field(0.00005, ge=0, le=0.1, description="growth of the range noise with range [m/m]")
    background_share: float = Field(0.025, ge=0, le=1, description="shots with a range from anywhere instead")
    mixed_share: float = Field(0.35, ge=0, le=1, description="shots beside an edge that hit both of its sides")
    max_range_m: float = Field(120.0, gt=1, le=10_000, description="largest range the scanner gives [m]")

"""What can be chosen about the simulated static street scan."""

from __future__ import annotations

from pydantic import Field, model_validator

from prc_cli.core.config import Params


class StaticScanParams(Params):
    """A terrestrial scanner on a tripod in a street, one vertical line from low to high after the other.

    The defaults follow the scanner of Stamos et al. (2012, sec. 9), a Leica ScanStation2: 5 mm, 300 m, up to 50 000
    shots a second.
    """

    seed: int = Field(1, ge=0, lt=2**63, description="the same seed gives the same street and the same noise")
    azimuth_step_deg: float = Field(0.115, gt=0, le=90, description="from line to line [degrees]")
    elevation_step_deg: float = Field(0.115, gt=0, le=10, description="from beam to beam [degrees]")
    first_azimuth_deg: float = Field(0.0, ge=0, lt=360, description="of the first line; 0 = along the street [degrees]")
    azimuth_deg: float = Field(360.0, gt=0, le=360, description="the head turns this far, to the left [degrees]")
    lowest_deg: float = Field(-45.0, ge=-89, le=80, description="elevation of the lowest beam [degrees]")
    highest_deg: float = Field(80.0, ge=-80, le=89, description="elevation that no beam exceeds [degrees]")
    height_m: float = Field(1.75, ge=1.0, le=3.0, description="scanner above what it stands on [m]")
    across_m: float = Field(-0.9, ge=-7.0, le=7.0, description="scanner to the left of the crown of the road [m]")
    length_m: float = Field(240.0, ge=20, le=1000, description="length of the built-up street, the scanner amid [m]")
    leaf_m: float = Field(0.05, ge=0, le=1, description="width of a leaf [m]; 0 = every shot meets a leaf of its own")
    moving_cars: int = Field(1, ge=0, le=20, description="cars that drive by while the scanner turns")
    noise_m: float = Field(0.005, ge=0, le=1, description="range noise, standard deviation [m]")
    mixed_share: float = Field(0.15, ge=0, le=1, description="shots beside a small step that hit both of its sides")
    shots_hz: float = Field(50_000.0, gt=0, le=10**7, description="shots a second [Hz]")
    max_range_m: float = Field(300.0, gt=1, le=10_000, description="largest range the scanner gives [m]")

    @model_validator(mode="after")
    def _check_elevations(self) -> StaticScanParams:
        if self.points_per_line < 2:
            problem = "at least two beams between lowest_deg and highest_deg"
            raise ValueError(problem)
        return self

    @property
    def n_lines(self) -> int:
        """Vertical lines of the scan."""
        return max(round(self.azimuth_deg / self.azimuth_step_deg), 1)

    @property
    def points_per_line(self) -> int:
        """M, beams of a line; 0 or fewer where the elevations leave no room for one."""
        return int((self.highest_deg - self.lowest_deg) / self.elevation_step_deg + 1e-9) + 1

"""Scanners as named presets: rotation, beam, ranges.

Sources of the figures. Line rates, M, the dead angle and the slanted planes are those of the
two papers (Lehtola et al. 2019, III; Stamos et al. 2012, sec. 9). Divergence, width of the beam,
ambiguity interval, range noise and rated range follow the makers' data sheets: FARO Focus3D 120
(0.16 mrad, 153.49 m; unfiltered noise 0.6 mm at 10 m and 0.95 mm at 25 m on white, 1.2 and 2.2 mm
on dark) and Photon 80 (0.16 mrad, 3.3 mm, 76 m), Leica ScanStation2 (spot of 4 mm, 50 000 shots a
second, 300 m at 90 %), SICK LMS 2xx (361 readings of 0.5 degrees, 81.92 m at steps of 10 mm). The 1
MHz profiler is no make; its figures are those usual for pulsed mobile profilers. No sheet gives the
noise of the Photon's raw stream at 48 Hz, nor the shares of lost shots, background light and
reflections: these are chosen.

The spinning ones turn ten times a second; rings, rated range, beam and noise are those of the
Velodyne VLP-16, VLP-32C and HDL-64E (whose two halves of 32 rings are spaced evenly here). The
rings of a VLP-32C are staggered as its manual says, those of a VLP-16 are not; an HDL-64E is
measured at the maker's, each differently, and is not staggered here. A line holds the shots that
look one way, as the readers of packets put them, so its rings are fired in different turns.

The dead angle. The raw stream of a profiler holds a shot for every step within the field of view
and none for the dead angle: the Focus3D makes 5040 steps a turn, and 5040 * 305 / 360 = 4270 is the
paper's M. So the columns leave the dead angle out; they do not hold NaN for it.
"""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from pydantic import Field, model_validator

from prc_cli.core.config import Params
from prc_cli.core.types import F64, I64


class Scanner(Params):
    """A scanner and how it is mounted.

    The angle of a column lies in the scan plane, 0 = down, positive to the left [rad]. A profiler's
    plane stands across the drive and is turned by its mount. The head of a static scanner
    (``is_static``), and that of a spinning one (``spins``), turns to the left from line to line,
    and the lines are upright, from low to high: a spinning scanner's line is one firing of all its
    rings.
    """

    is_static: bool = Field(False, description="on a tripod, upright lines; otherwise it is moved")
    spins: bool = Field(
        False, description="moved, and its head turns: a line is one firing of all rings"
    )
    elevations_deg: tuple[float, ...] = Field(
        (),
        description="spinning: elevation of every ring, rising; "
        "none = even steps over the field [degrees]",
    )
    azimuths_deg: tuple[float, ...] = Field(
        (),
        description="spinning: how far every ring looks ahead of the head, in its turn; "
        "none = all alike [degrees]",
    )
    line_hz: float = Field(gt=0, le=1e6, description="scan lines a second [Hz]")
    points_per_line: int = Field(ge=2, le=100_000, description="M, shots in a scan line")
    field_deg: float = Field(
        gt=0, le=360, description="angle that M shots cover; the rest of the turn is dead"
    )
    centre_deg: float = Field(
        0, ge=-180, le=180, description="middle of the line from down; positive = left [degrees]"
    )
    duty: float = Field(
        gt=0, le=1, description="share of the time from line to line in which the shots are made"
    )
    azimuth_step_deg: float = Field(
        0.115, gt=0, le=90, description="the head's turn from line to line [degrees]"
    )
    first_azimuth_deg: float = Field(
        0, ge=-360, le=360, description="of the first line, 0 = x [degrees]"
    )

    slant_deg: float = Field(
        0, ge=-90, le=90, description="mount: tilt of the plane; lower part points back [degrees]"
    )
    heading_deg: float = Field(
        0, ge=-180, le=180, description="mount: turn of the plane to the left [degrees]"
    )
    roll_deg: float = Field(
        0, ge=-180, le=180, description="mount: turn within the plane, left side up [degrees]"
    )
    height_m: float = Field(gt=0, le=20, description="mount: scanner above the ground [m]")

    principle: Literal["cw", "pulsed"] = Field(
        description="phase of a continuous wave, or time of flight of a pulse"
    )
    divergence_mrad: float = Field(ge=0, le=50, description="full angle of the beam [mrad]")
    exit_mm: float = Field(gt=0, le=100, description="width of the beam as it leaves [mm]")
    ambiguity_m: float = Field(
        0, ge=0, le=10_000, description="ranges are known up to multiples of it [m]; 0 = wholly"
    )
    pulse_m: float = Field(
        0.0, ge=0, le=10, description="pulsed: echoes closer than this are one return [m]"
    )
    max_returns: int = Field(1, ge=1, le=4, description="returns of a shot at most")
    min_range_m: float = Field(ge=0.01, le=10, description="smallest range the scanner gives [m]")
    max_range_m: float = Field(gt=1, le=2000, description="largest range the scanner gives [m]")
    half_range_m: float = Field(
        gt=1,
        le=5000,
        description="where half of the shots on a white wall, met squarely, are answered [m]",
    )
    resolution_m: float = Field(gt=0, le=1, description="ranges are multiples of this [m]")

    noise_m: float = Field(ge=0, le=1, description="range noise close by, standard deviation [m]")
    noise_per_m: float = Field(
        ge=0, le=0.1, description="its growth with range on white, met squarely [m/m]"
    )
    noise_spread: float = Field(
        0.05,
        ge=0,
        le=1,
        description="noise as share of the depth that the beam's width spans on a slanted surface",
    )
    lost_share: float = Field(
        0.002, ge=0, le=1, description="shots lost for no reason of the surface"
    )
    edge_m: float = Field(
        0.05, gt=0, le=10, description="smaller steps are no edge that a beam could be split by [m]"
    )
    background_share: float = Field(
        0, ge=0, le=1, description="cw: shots on surfaces with a range from anywhere"
    )
    sky_share: float = Field(
        0, ge=0, le=1, description="cw: shots into the sky with a range from anywhere"
    )
    bright_sky_share: float = Field(0, ge=0, le=1, description="the same where the sky is bright")
    cluster_share: float = Field(
        0, ge=0, le=1, description="cw: shots on surfaces that stray around them"
    )
    cluster_m: float = Field(0.3, gt=0, le=10, description="standard deviation of these [m]")
    pane_share: float = Field(
        0.3, ge=0, le=1, description="shots on glass that the pane itself answers"
    )
    ghost_share: float = Field(
        0.1, ge=0, le=1, description="shots on glass that it mirrors: range beyond the pane"
    )

    leaves_share: float = Field(
        0.4,
        ge=0,
        le=1,
        description="shots on a leaf that also pass by it, where there are several returns",
    )

    @model_validator(mode="after")
    def _check(self) -> Scanner:
        if self.min_range_m >= self.max_range_m:
            problem = "min_range_m below max_range_m"
            raise ValueError(problem)
        if self.pane_share + self.ghost_share > 1.0:
            problem = "pane_share and ghost_share of together at most 1"
            raise ValueError(problem)
        if self.turns and abs(self.centre_deg - 90.0) + self.field_deg / 2.0 > 90.0:
            problem = "elevations of a head that turns within -90 and 90 degrees"
            raise ValueError(problem)
        if self.turns and (self.slant_deg or self.heading_deg):
            problem = "slant_deg and heading_deg 0 for a head that turns: its mount stands upright"
            raise ValueError(problem)
        if self.is_static and self.spins:
            problem = "is_static or spins, not both"
            raise ValueError(problem)
        rings = self.elevations_deg
        if rings and (
            len(rings) != self.points_per_line or list(rings) != sorted(rings) or not self.spins
        ):
            problem = f"{self.points_per_line} rising elevations of a spinning scanner, one a ring"
            raise ValueError(problem)
        if self.azimuths_deg and (len(self.azimuths_deg) != self.points_per_line or not self.spins):
            problem = f"{self.points_per_line} azimuths of a spinning scanner, one a ring"
            raise ValueError(problem)
        return self

    @property
    def turns(self) -> bool:
        """Whether the head turns from line to line."""
        return self.is_static or self.spins

    @property
    def step_rad(self) -> float:
        """Angle from column to column [rad]."""
        return float(np.deg2rad(self.field_deg)) / self.points_per_line

    @property
    def shot_s(self) -> float:
        """Time from shot to shot within a line [s]."""
        return self.duty / self.line_hz / self.points_per_line

    @property
    def late_lines(self) -> I64:
        """Delay of every ring behind the one that looks ahead most, (M,) int64 [lines]."""
        ahead = np.rint(
            np.array(self.azimuths_deg or [0.0] * self.points_per_line) / self.azimuth_step_deg
        )
        late: I64 = (ahead.max() - ahead).astype(np.int64)
        return late

    def azimuth_rad(self, first_line: int, n_lines: int) -> F64:
        """Return the azimuth of the head at every shot of lines, (n_lines, M) float64 [rad]."""
        within = self.spins * self.duty * np.arange(self.points_per_line) / self.points_per_line
        line = np.arange(first_line, first_line + n_lines)[:, None] + self.late_lines + within
        azimuth: F64 = np.deg2rad(self.first_azimuth_deg + self.azimuth_step_deg * line)
        return azimuth

    def angle_rad(self) -> F64:
        """Return the angles of columns in the scan plane, (M,) float64, 0 = down [rad]."""
        if self.elevations_deg:
            return np.deg2rad(90.0 + np.array(self.elevations_deg))
        column = np.arange(self.points_per_line, dtype=np.float64) + 0.5
        angle: F64 = np.deg2rad(self.centre_deg - self.field_deg / 2.0) + column * self.step_rad
        return angle

    def directions(self) -> F64:
        """Return the unit vectors of columns on an even platform, (M, 3) float64."""
        angle = self.angle_rad()
        zero = np.zeros_like(angle)
        if self.turns:
            ahead = np.deg2rad(self.azimuths_deg) if self.azimuths_deg else zero
            return np.stack(
                [np.sin(angle) * np.cos(ahead), np.sin(angle) * np.sin(ahead), -np.cos(angle)],
                axis=1,
            )
        within = angle + np.deg2rad(self.roll_deg)
        slant = np.deg2rad(self.slant_deg)
        heading = np.deg2rad(self.heading_deg)
        down = np.cos(within)
        left = np.sin(within)
        forward = -np.sin(slant) * down
        return np.stack(
            [
                np.cos(heading) * forward - np.sin(heading) * left,
                np.sin(heading) * forward + np.cos(heading) * left,
                -np.cos(slant) * down,
            ],
            axis=1,
        )

    def line_time_s(self, first_line: int, n_lines: int) -> F64:
        """Return the time of the first shot of every line, (n_lines,) float64 [s]."""
        return np.arange(first_line, first_line + n_lines, dtype=np.float64) / self.line_hz

    def changed(self, **values: Any) -> Scanner:
        """Return the scanner with other values for some keys."""
        return Scanner(**{**self.model_dump(), **values})


_FARO_NOISE: dict[str, Any] = {
    "principle": "cw",
    "ambiguity_m": 153.49,
    "noise_m": 0.0003,
    "noise_per_m": 0.00003,
    "min_range_m": 0.6,
    "resolution_m": 0.0001,
    "background_share": 0.008,
    "sky_share": 0.04,
    "bright_sky_share": 0.4,
    "cluster_share": 0.01,
}

SCANNERS: dict[str, Scanner] = {
    # dead angle of 40 degrees up: the paper's road is one patch in the image, so the line does not
    # begin in it
    "photon-80": Scanner(
        line_hz=48.0,
        points_per_line=2154,
        field_deg=320.0,
        duty=320.0 / 360.0,
        slant_deg=25.0,
        height_m=2.6,
        divergence_mrad=0.16,
        exit_mm=3.3,
        max_range_m=76.0,
        half_range_m=120.0,
        **{**_FARO_NOISE, "noise_m": 0.001, "noise_per_m": 0.00006},
    ),
    # dead angle down and the sky amid the line (Lehtola et al. 2019, IV-C); on a backpack
    "focus3d-120": Scanner(
        line_hz=97.0,
        points_per_line=4270,
        field_deg=305.0,
        centre_deg=180.0,
        duty=305.0 / 360.0,
        slant_deg=20.0,
        height_m=2.0,
        divergence_mrad=0.16,
        exit_mm=3.8,
        max_range_m=120.0,
        half_range_m=180.0,
        **_FARO_NOISE,
    ),
    # one side of the street, from down to up. The mirror turns 75 times a second, but half-degree
    # steps take two turns, whose shots interlace: 37.5 lines a second
    "sick-push-broom": Scanner(
        line_hz=37.5,
        points_per_line=361,
        field_deg=180.5,
        centre_deg=90.0,
        duty=0.75,
        height_m=2.0,
        principle="pulsed",
        divergence_mrad=4.4,
        exit_mm=13.0,
        pulse_m=0.5,
        min_range_m=0.3,
        max_range_m=81.91,
        half_range_m=75.0,
        resolution_m=0.01,
        noise_m=0.01,
        noise_per_m=0.0003,
        noise_spread=0.03,
        lost_share=0.005,
    ),
    "profiler-1mhz": Scanner(
        line_hz=200.0,
        points_per_line=5000,
        field_deg=360.0,
        duty=1.0,
        slant_deg=25.0,
        height_m=2.4,
        principle="pulsed",
        divergence_mrad=0.35,
        exit_mm=4.5,
        pulse_m=0.45,
        max_returns=4,
        min_range_m=1.0,
        max_range_m=200.0,
        half_range_m=260.0,
        resolution_m=0.001,
        noise_m=0.003,
        noise_per_m=0.00003,
    ),
    # as Stamos et al. (2012, sec. 9) use it: upright lines from low to high, 50 000 shots a second
    "scanstation2": Scanner(
        is_static=True,
        line_hz=50_000.0 / 1088,
        points_per_line=1088,
        field_deg=125.12,
        centre_deg=107.56,
        duty=1.0,
        azimuth_step_deg=0.115,
        height_m=1.75,
        principle="pulsed",
        divergence_mrad=0.1,
        exit_mm=4.0,
        pulse_m=0.3,
        min_range_m=0.3,
        max_range_m=300.0,
        half_range_m=420.0,
        resolution_m=0.001,
        noise_m=0.004,
        noise_per_m=0.00002,
    ),
}
"""Every preset by name, each with the mount of its paper.

Stamos et al. (2012) give 5 mm as the accuracy of their ScanStation2, and a standard deviation of
the range that is an order of magnitude below 1 cm (footnote 3): one preset has about 5 mm, the
other 1 mm."""
_SPINNING: dict[str, Any] = {
    "spins": True,
    "centre_deg": 90.0,
    "duty": 36.864 / 55.296,
    "azimuth_step_deg": 0.2,
    "line_hz": 18_000.0,
    "height_m": 1.9,
    "principle": "pulsed",
    "divergence_mrad": 3.0,
    "exit_mm": 9.5,
    "pulse_m": 1.0,
    "min_range_m": 0.9,
    "max_range_m": 100.0,
    "half_range_m": 110.0,
    "resolution_m": 0.002,
    "noise_m": 0.015,
    "noise_per_m": 0.0001,
    "lost_share": 0.005,
}
_VLP_32C_ELEVATIONS_DEG = (
      -25.0, -15.639,  -11.31,  -8.843,  -7.254,  -6.148,  -5.333,  -4.667,
       -4.0,  -3.667,  -3.333,    -3.0,  -2.667,  -2.333,    -2.0,  -1.667,
     -1.333,    -1.0,  -0.667,  -0.333,     0.0,   0.333,   0.667,     1.0,
      1.333,   1.667,   2.333,   3.333,   4.667,     7.0,  10.333,    15.0,
)  # fmt: skip
_VLP_32C_AZIMUTHS_DEG = (
     1.4, -1.4,  1.4, -1.4,  1.4, -1.4,  4.2,  1.4,
    -1.4, -4.2,  4.2,  1.4, -1.4, -4.2,  4.2,  1.4,
    -1.4, -4.2,  4.2,  1.4, -1.4, -4.2,  4.2,  1.4,
    -1.4, -4.2,  1.4, -1.4,  1.4, -1.4,  1.4, -1.4,
)  # fmt: skip
"""Rings of the VLP-32C from low to high, as its manual lists them."""
SCANNERS |= {
    "vlp-16": Scanner(points_per_line=16, field_deg=32.0, **_SPINNING),
    "vlp-32c": Scanner(
        points_per_line=32,
        field_deg=40.0,
        elevations_deg=_VLP_32C_ELEVATIONS_DEG,
        azimuths_deg=_VLP_32C_AZIMUTHS_DEG,
        **_SPINNING,
    ),
    "hdl-64e": Scanner(
        points_per_line=64,
        field_deg=26.8,
        elevations_deg=(
            *(round(-24.33 + i / 2, 3) for i in range(32)),
            *(round(-8.33 + i / 3, 3) for i in range(32)),
        ),
        **{
            **_SPINNING,
            "duty": 0.95,
            "azimuth_step_deg": 0.17,
            "line_hz": 21_180.0,
            "max_range_m": 120.0,
            "half_range_m": 130.0,
        },
    ),
}
SCANNERS["scanstation2-1mm"] = SCANNERS["scanstation2"].model_copy(update={"noise_m": 0.001})

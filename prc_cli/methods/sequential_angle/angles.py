"""Signed angles and line angles (Stamos et al. 2012, sec. 3), the basis of all later stages.

The signed angle of a shot is the angle between the vertical and the chord to a later shot: 0 deg up
a wall, 90 deg along the ground, 180 deg down; negative where the line turns back on itself, as in
foliage. The line angle of a shot is the angle between the chord and the beam, plus the beam's
angle; it is constant along a straight line.
"""

from __future__ import annotations

from dataclasses import dataclass

from prc_cli.core.types import F32, I32, U8
from prc_cli.methods.sequential_angle import angles_loops
from prc_cli.methods.sequential_angle.lines import VerticalLines
from prc_cli.methods.sequential_angle.thresholds import ChordThresholds


@dataclass(frozen=True, slots=True, eq=False)
class SignedAngles:
    """The chord that begins at every shot."""

    signed_deg: F32
    """(R, n) float32, sV, signed angle of the chord with the vertical, -180 to 180 [deg].

    NaN where the shot is
    missing or no chord begins."""
    ahead: I32
    """(R, n) int32, beam that the chord ends at; -1 = no chord."""


def signed_angles(lines: VerticalLines, thresholds: ChordThresholds) -> SignedAngles:
    """Measure the signed angle of every shot.

    The chord of a shot goes to the first later valid shot at least ``least_chord_m`` away.
    Missing shots in between are bridged, as crowns are full of gaps. The chord before a shot comes
    from the last earlier valid shot at that distance. Where the two chords point against each other
    the angle is negative; without a chord before, as at the start of a line, it is positive. Shots
    at the same place never make a chord.

    Two shots on the ground, then up a wall; the last one begins no chord:

    >>> import numpy as np
    >>> xyz = np.array([[[4, 0, -2], [5, 0, -2], [6, 0, -2], [6, 0, -1], [6, 0, 0]]], np.float32)
    >>> ranges = np.linalg.norm(xyz, axis=-1)
    >>> beams = np.linspace(1.1, 1.6, 5)[None]
    >>> lines = VerticalLines(ranges, xyz, xyz[..., 0], np.array([5], np.int32), beams)
    >>> found = signed_angles(lines, ChordThresholds().at_noise())
    >>> found.signed_deg
    array([[90., 90.,  0.,  0., nan]], dtype=float32)
    >>> found.ahead
    array([[ 1,  2,  3,  4, -1]], dtype=int32)
    """
    signed_deg, ahead = angles_loops.signed_angles(
        lines.range_m, lines.xyz_m, lines.n_beams, thresholds
    )
    return SignedAngles(signed_deg, ahead)


def angle_differences(signed_deg: F32) -> F32:
    """Subtract from every signed angle the one before it in its row, sD (sec. 7.1).

    ``signed_deg`` (R, n) float32, degrees; returns (R, n) float32, degrees.
    """
    return angles_loops.angle_differences(signed_deg)


def line_angles(lines: VerticalLines, ahead: I32, surface: U8) -> F32:
    """Measure the line angle of every horizontal shot (eq. 2).

    For beams an angle ``a`` apart and ranges r and r', the angle between the chord and the beam to
    its first shot is ``atan2(sin a, cos a - r / r')``: the arc tangent of eq. 2 with its quadrant,
    which chords towards the scanner need. The angle of the beam is added, so that level ground
    gives 90 deg at any height, ground that rises by 3 deg gives 93 deg, and a wall 180 deg. It
    depends on slope, not on height.

    ``ahead`` (R, n) int32; ``surface`` (R, n) uint8; returns (R, n) float32, degrees.
    """
    return angles_loops.line_angles(lines.range_m, ahead, surface, lines.beam_rad)

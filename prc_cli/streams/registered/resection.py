"""Stations of single scan lines, in closed form: known bearings to known points in a plane.

All functions work on many windows of points at once; a window holds about one turn of the beam.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from prc_cli.core.types import F64, Mask

PLANE_ROUNDS = 8
"""Rounds of the robust plane."""
RESECTION_ROUNDS = 8
"""Rounds of the robust resection."""
LEAST_SCALE_M = 0.02
"""Residuals below this are never treated as outliers [m]."""
RESECTION_SCALE_M = 0.1
"""Residual at which the weight of a point in the resection halves [m]."""


@dataclass(frozen=True, slots=True)
class Stations:
    """Station and frame of the beam for ``w`` windows."""

    position_m: F64
    """(w, 3) float64, station in the coordinates of the points [m]."""
    frame: F64
    """(w, 3, 3) float64, columns e1, e2, n: bearing 0, bearing 90 degrees, axis of the turn."""
    residual_m: F64
    """(w,) float64, median distance of the points from their beams, in the plane and across it
    [m]."""
    in_front: F64
    """(w,) float64, share of the points that lie in front of the beam, not behind it."""
    spread_m: F64
    """(w,) float64, spread of the points across their main direction [m]; small on open ground."""

    @property
    def misfit_m(self) -> F64:
        """(w,) float64, the residual, larger if points lie behind the beam [m]."""
        return self.residual_m / np.maximum(self.in_front, 0.05)

    def where(self, use: Mask, others: Stations) -> Stations:
        """Return these stations if ``use`` (w,) is true, else the others."""
        return Stations(
            position_m=np.where(use[:, None], self.position_m, others.position_m),
            frame=np.where(use[:, None, None], self.frame, others.frame),
            residual_m=np.where(use, self.residual_m, others.residual_m),
            in_front=np.where(use, self.in_front, others.in_front),
            spread_m=np.where(use, self.spread_m, others.spread_m),
        )


@dataclass(frozen=True, slots=True)
class Planes:
    """Robust plane through every window."""

    centre_m: F64
    """(w, 3) float64, a point of the plane [m]."""
    axes: F64
    """(w, 3, 3) float64, columns: normal, second and main direction."""
    spread_m: F64
    """(w,) float64, spread along the second direction [m]."""


def fit_planes(xyz_m: F64, weight: F64) -> Planes:
    """Fit a robust plane to every window.

    Parameters
    ----------
    xyz_m
        (w, n, 3) float64, points [m].
    weight
        (w, n) float64, 0 = no point.

    Returns
    -------
    Planes
        By principal components with Cauchy weights on the distance from the plane.
    """
    robust = weight.copy()
    for _ in range(PLANE_ROUNDS):
        total = robust.sum(axis=1)
        centre = np.einsum("wn,wni->wi", robust, xyz_m) / total[:, None]
        offset = xyz_m - centre[:, None, :]
        scatter = np.einsum("wn,wni,wnj->wij", robust, offset, offset)
        variances, axes = np.linalg.eigh(scatter / total[:, None, None])
        distance = np.abs(np.einsum("wni,wi->wn", offset, axes[:, :, 0]))
        scale = np.maximum(2.0 * masked_median(distance, weight), LEAST_SCALE_M)
        robust = weight / (1.0 + (distance / scale[:, None]) ** 2)
    spread = np.sqrt(np.maximum(variances[:, 1], 0.0))
    return Planes(centre, axes, spread)


def resect(
    planes: Planes,
    xyz_m: F64,
    bearing_rad: F64,
    weight: F64,
    sense: int,
) -> Stations:
    """Find the station of every window from bearings in its plane.

    With C and S the cosine and sine of the unknown turn, q a point, a its bearing and v the turned
    station, ``C (q x a) + S (q . a) + (-sin, cos) . v = 0`` is linear and homogeneous: v is
    eliminated, and the smallest eigenvector of a 2 x 2 matrix is (C, S).

    Parameters
    ----------
    planes
        Planes of the windows.
    xyz_m
        (w, n, 3) float64, points [m].
    bearing_rad
        (w, n) float64, bearing of every shot up to a constant of its window [rad].
    weight
        (w, n) float64, 0 = no point.
    sense
        1 or -1: the side of the plane from which the beam turns to the left.

    Returns
    -------
    Stations
        Turned so that most points lie in front of the beam.
    """
    # points in their planes
    main = planes.axes[:, :, 2]
    normal = sense * planes.axes[:, :, 0]
    across = np.cross(normal, main)
    offset = xyz_m - planes.centre_m[:, None, :]
    x = np.einsum("wni,wi->wn", offset, main)
    y = np.einsum("wni,wi->wn", offset, across)

    # the unknowns: cosine and sine of the turn, and the station, turned
    cosine = np.cos(bearing_rad)
    sine = np.sin(bearing_rad)
    of_cosine = x * sine - y * cosine
    of_sine = x * cosine + y * sine
    rows = np.stack([of_cosine, of_sine, -sine, cosine], axis=2)
    robust = weight
    for _ in range(RESECTION_ROUNDS):
        normal_matrix = np.einsum("wn,wni,wnj->wij", robust, rows, rows)
        station_part = normal_matrix[:, 2:, 2:] + 1e-9 * np.eye(2)
        mixed = normal_matrix[:, :2, 2:]
        solved = np.linalg.solve(station_part, np.swapaxes(mixed, 1, 2))
        _, vectors = np.linalg.eigh(normal_matrix[:, :2, :2] - mixed @ solved)
        turn = vectors[:, :, 0]
        turned_station = -np.einsum("wij,wj->wi", solved, turn)
        unknowns = np.concatenate([turn, turned_station], axis=1)
        residual = np.abs(np.einsum("wni,wi->wn", rows, unknowns))
        robust = weight / (1.0 + (residual / RESECTION_SCALE_M) ** 2)

    # the station turned back, and the beams of the shots
    turn_cosine = turn[:, :1]
    turn_sine = turn[:, 1:]
    station_x = turn_cosine * turned_station[:, :1] - turn_sine * turned_station[:, 1:]
    station_y = turn_sine * turned_station[:, :1] + turn_cosine * turned_station[:, 1:]
    beam_x = turn_cosine * cosine - turn_sine * sine
    beam_y = turn_sine * cosine + turn_cosine * sine
    ahead = beam_x * (x - station_x)
    ahead += beam_y * (y - station_y)
    in_front = (weight * (ahead > 0)).sum(axis=1) / weight.sum(axis=1)
    side = np.where(in_front < 0.5, -1.0, 1.0)[:, None]
    first = side * (turn_cosine * main + turn_sine * across)
    second = side * (-turn_sine * main + turn_cosine * across)
    distance = np.abs(np.einsum("wni,wi->wn", offset, normal))
    return Stations(
        position_m=planes.centre_m + station_x * main + station_y * across,
        frame=np.stack([first, second, normal], axis=2),
        residual_m=masked_median(residual, weight) + masked_median(distance, weight),
        in_front=np.maximum(in_front, 1.0 - in_front),
        spread_m=planes.spread_m,
    )


def masked_median(values: F64, weight: F64) -> F64:
    """Return the median of the values with a weight, of every row of (w, n), (w,); inf = none."""
    ordered = np.sort(np.where(weight > 0, values, np.inf), axis=1)
    middle = np.maximum(np.count_nonzero(weight > 0, axis=1) - 1, 0) // 2
    median: F64 = np.take_along_axis(ordered, middle[:, None], axis=1)[:, 0]
    return median

"""The path of the scanner: station and frame over time, smooth, from all lines together.

Knots lie about one turn of the beam apart; between them the station is a straight line and the
frame an even turn. Gauss-Newton minimises, with Cauchy weights, the distance of every point from
its beam (in the scan plane and across it), and the changes of speed and of turn between
neighbouring knots. So neighbours hold a line that has no station of its own, for example on open
ground.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded

from prc_cli.core.types import F64, I64
from prc_cli.streams.registered.resection import masked_median

SPEED_CHANGE_M_S2 = 4.0
"""Usual change of the platform's speed: a car that brakes, a step of a walker [m/s2]."""
TURN_CHANGE_RAD_S2 = 6.0
"""Usual change of the platform's turn: a pot hole, the sway of a walker [rad/s2]."""
SCALES_M = (1.0, 0.3, 0.1, 0.05)
"""Residuals at which the weight of a point halves, by round; later ones follow the residuals
[m]."""
LEAST_SCALE_M = 0.01
MOST_FINE_ROUNDS = 10
STEEPEST = 0.1
"""Steepest cone (tangent); mirrors are off by a few tenths of a degree."""
LONGEST_STEP_M = 3.0
LONGEST_TURN_RAD = 0.3
"""Longer steps of a knot are cut."""
SPEED_S = 0.1
"""Beyond the first and last knot the speed over this time continues [s]."""
STEP_M = 1e-5
"""Steps below this end the rounds [m]."""


@dataclass(frozen=True, slots=True)
class Knots:
    """Station and frame of the beam at ``k`` times."""

    time_s: F64
    """(k,) float64, rising [s]."""
    position_m: F64
    """(k, 3) float64 [m]."""
    frame: F64
    """(k, 3, 3) float64, columns e1, e2, n: bearing 0, bearing 90 degrees, axis of the turn."""

    def relative_turns(self) -> F64:
        """Return the turn from every knot to the next in its own frame, (k - 1, 3) [rad]."""
        return rotation_vectors(np.swapaxes(self.frame[:-1], 1, 2) @ self.frame[1:])


@dataclass(frozen=True, slots=True)
class ScannerPath:
    """Place and axes of one scanner at ``k`` times; straight lines between."""

    scanner: int
    time_s: F64
    """(k,) float64, rising [s]."""
    xyz_m: F64
    """(k, 3) float64 [m]."""
    sigma_m: F64
    """(k, 3) float64, standard deviations [m]."""
    frame: F64
    """(k, 3, 3) float64, axes that stay in the scanner: forward (see :attr:`forward`), left, up."""
    axis: F64
    """(k, 3) float64, axis of the turn."""
    number: I64
    """(k,) int64, number of the pass."""
    forward: str = "along the axis of its turn"
    """The first axis of the frame in words."""


@dataclass(frozen=True, slots=True)
class Observations:
    """Points between neighbouring knots, the same number for each pair."""

    share: F64
    """(k - 1, n) float64, place between the two knots, 0 to 1."""
    xyz_m: F64
    """(k - 1, n, 3) float64 [m]."""
    cosine: F64
    """(k - 1, n) float64, cosine of the bearing of the beam in the frame."""
    sine: F64
    """(k - 1, n) float64, sine of it."""
    weight: F64
    """(k - 1, n) float64, 1 = a point, 0 = filler."""


@dataclass(frozen=True, slots=True)
class Fit:
    """A smooth path and its fit to the points."""

    knots: Knots
    in_plane_m: F64
    """(k - 1, n) float64, distance of every point from its beam in the scan plane [m]."""
    across_m: F64
    """(k - 1, n) float64, the same across the plane [m]."""
    range_m: F64
    """(k - 1, n) float64, distance along the beam; negative behind the scanner [m]."""
    scale_m: float
    """Residual at which the weight of a point halves [m]."""
    sigma_m: F64
    """(k, 3) float64, standard deviation of the stations [m]."""
    slope: float
    """Tangent of the cone on which the beam turns: rise along the axis per metre across it."""


def positions_at(knots_s: F64, position_m: F64, time_s: F64) -> F64:
    """Return positions between knots, (n, 3) [m]; beyond them the speed continues.

    Parameters
    ----------
    knots_s
        (k,) float64, rising [s].
    position_m
        (k, 3) float64 [m].
    time_s
        (n,) float64 [s].
    """
    xyz = np.stack([np.interp(time_s, knots_s, position_m[:, axis]) for axis in range(3)], axis=1)
    n = len(knots_s)
    hop = min(max(round(SPEED_S / float(np.median(np.diff(knots_s)))), 1), n - 1)
    for end, inner in ((0, hop), (n - 1, n - 1 - hop)):
        speed = (position_m[end] - position_m[inner]) / (knots_s[end] - knots_s[inner])
        since = time_s - knots_s[end]
        beyond = since < 0 if end == 0 else since > 0
        xyz[beyond] = position_m[end] + since[beyond, None] * speed
    return xyz


def rotation_vectors(matrices: F64) -> F64:
    """Return the rotation vectors of matrices (k, 3, 3) well below half a turn, (k, 3) [rad]."""
    skew = matrices - np.swapaxes(matrices, 1, 2)
    vector = 0.5 * np.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], axis=1)
    sine = np.linalg.norm(vector, axis=1)
    cosine = 0.5 * (np.trace(matrices, axis1=1, axis2=2) - 1.0)
    angle = np.arctan2(sine, cosine)
    factor = np.where(sine > 1e-12, angle / np.maximum(sine, 1e-12), 1.0)
    turned: F64 = vector * factor[:, None]
    return turned


def rotation_matrices(vectors: F64) -> F64:
    """Return the rotation matrices of rotation vectors (k, 3), (k, 3, 3)."""
    angle = np.linalg.norm(vectors, axis=1)
    axis = vectors / np.maximum(angle, 1e-15)[:, None]
    cross = np.zeros((len(vectors), 3, 3))
    cross[:, 0, 1] = -axis[:, 2]
    cross[:, 0, 2] = axis[:, 1]
    cross[:, 1, 2] = -axis[:, 0]
    cross -= np.swapaxes(cross, 1, 2)
    sine = np.sin(angle)[:, None, None]
    versine = (1.0 - np.cos(angle))[:, None, None]
    matrices: F64 = np.eye(3) + sine * cross + versine * (cross @ cross)
    return matrices


def observe(
    knots_s: F64,
    time_s: F64,
    xyz_m: F64,
    bearing_rad: F64,
    n_points: int,
) -> Observations:
    """Choose points between neighbouring knots, evenly in their order.

    Parameters
    ----------
    knots_s
        (k,) float64, times of the knots [s].
    time_s
        (n,) float64, rising, times of the points [s].
    xyz_m
        (n, 3) float64 [m].
    bearing_rad
        (n,) float64 [rad].
    n_points
        Points between two knots at most.
    """
    border = np.searchsorted(time_s, knots_s)
    begin = border[:-1]
    count = np.diff(border)
    place = np.arange(n_points)[None, :]
    step = np.maximum(count / n_points, 1.0)[:, None]
    index = begin[:, None] + ((place + 0.5) * step).astype(np.int64)
    last = np.maximum(border[1:] - 1, 0)[:, None]
    weight = (index <= last) & (count > 0)[:, None]
    index = np.clip(index, 0, np.minimum(last, len(time_s) - 1))
    share = (time_s[index] - knots_s[:-1, None]) / np.diff(knots_s)[:, None]
    bearing = bearing_rad[index]
    return Observations(
        np.clip(share, 0.0, 1.0),
        xyz_m[index],
        np.cos(bearing),
        np.sin(bearing),
        weight.astype(np.float64),
    )


def smooth(knots: Knots, observed: Observations, slope: float = 0.0) -> Fit:
    """Fit the path, and the cone on which the beam turns, to points.

    Parameters
    ----------
    knots
        A first guess: within some metres and some tenths of a radian.
    observed
        Points between the knots.
    slope
        A first guess of the cone.

    Returns
    -------
    Fit
        The path with its residuals. Its standard deviations are those of the normal equations, for
        the spread that the residuals have.
    """
    centre = knots.position_m.mean(axis=0)
    knots = replace(knots, position_m=knots.position_m - centre)
    observed = replace(observed, xyz_m=observed.xyz_m - centre)
    scale = SCALES_M[0]
    system = _normal_equations(knots, observed, scale, slope)
    for next_scale in (*SCALES_M[1:], *[0.0] * MOST_FINE_ROUNDS):
        step, slope_step = system.solve()
        knots = _stepped(knots, step)
        slope = float(np.clip(slope + slope_step, -STEEPEST, STEEPEST))
        # after the coarse rounds the scale follows the residuals
        scale = next_scale or float(np.clip(3.0 * system.spread_m, LEAST_SCALE_M, SCALES_M[-1]))
        system = _normal_equations(knots, observed, scale, slope)
        if next_scale == 0.0 and np.abs(step[:, 3:]).max() < STEP_M:
            break
    sigma = system.standard_deviations() * max(system.spread_m * 1.4826, 1e-4)
    return Fit(
        replace(knots, position_m=knots.position_m + centre),
        system.in_plane_m,
        system.across_m,
        system.range_m,
        scale,
        sigma,
        slope,
    )


def _stepped(knots: Knots, step: F64) -> Knots:
    # long steps, (k, 6), are cut: they leave the linear range
    length = np.linalg.norm(step[:, 3:], axis=1)
    cut = np.minimum(1.0, LONGEST_STEP_M / np.maximum(length, 1e-12))[:, None]
    turn = np.linalg.norm(step[:, :3], axis=1)
    slow = np.minimum(1.0, LONGEST_TURN_RAD / np.maximum(turn, 1e-12))[:, None]
    return replace(
        knots,
        position_m=knots.position_m + cut * step[:, 3:],
        frame=knots.frame @ rotation_matrices(slow * step[:, :3]),
    )


@dataclass(frozen=True, slots=True)
class _System:
    """Normal equations: six unknowns a knot (turn in the frame, move of the station), one cone."""

    banded: F64
    """(18, 6 k) float64, lower diagonals; see :func:`scipy.linalg.cholesky_banded`."""
    gradient: F64
    """(k, 6) float64."""
    border: F64
    """(k, 6) float64, coupling of the knots with the cone."""
    cone_weight: float
    cone_gradient: float
    in_plane_m: F64
    across_m: F64
    range_m: F64
    spread_m: float
    """Median size of the residuals [m]."""

    def solve(self) -> tuple[F64, float]:
        """Return the steps of the knots (k, 6), and that of the slope of the cone."""
        factor = cholesky_banded(self.banded, lower=True)
        both = np.stack([self.gradient.ravel(), self.border.ravel()], axis=1)
        of_gradient, of_border = cho_solve_banded((factor, True), both).T
        border = self.border.ravel()
        schur = self.cone_weight - float(border @ of_border)
        slope_step = -(self.cone_gradient - float(border @ of_gradient)) / max(schur, 1e-9)
        step: F64 = (-of_gradient - slope_step * of_border).reshape(-1, 6)
        return step, slope_step

    def standard_deviations(self) -> F64:
        """Return the square roots of the inverse's diagonal for the stations, (k, 3)."""
        blocks = inverse_blocks(self.banded)
        return np.sqrt(np.maximum(np.diagonal(blocks, axis1=1, axis2=2)[:, 3:], 0.0))


def _normal_equations(
    knots: Knots,
    observed: Observations,
    scale_m: float,
    slope: float,
) -> _System:
    turn = knots.relative_turns()
    share = observed.share
    # the frame between two knots, by the second order of the small turn
    offset = observed.xyz_m - (
        knots.position_m[:-1, None, :] * (1.0 - share)[:, :, None]
        + knots.position_m[1:, None, :] * share[:, :, None]
    )
    local = offset @ knots.frame[:-1]
    part = share[:, :, None] * turn[:, None, :]
    local = local - np.cross(part, local - 0.5 * np.cross(part, local))
    x = local[:, :, 0]
    y = local[:, :, 1]
    z = local[:, :, 2]
    cosine = observed.cosine
    sine = observed.sine
    range_m = cosine * x + sine * y
    in_plane = cosine * y - sine * x
    across = z - slope * range_m
    usable = observed.weight
    spread = float(np.median(masked_median(np.hypot(in_plane, across), usable)[usable.any(axis=1)]))
    zero = np.zeros_like(x)
    jacobian = np.empty((*x.shape, 2, 6))
    jacobian[:, :, 0, :3] = np.stack([cosine * z, sine * z, -range_m], axis=2)
    jacobian[:, :, 1, :3] = np.stack(
        [-y - slope * sine * z, x + slope * cosine * z, -slope * in_plane], axis=2
    )
    directions = np.stack([sine, -cosine, zero, slope * cosine, slope * sine, zero - 1.0], axis=2)
    directions = directions.reshape(*x.shape, 2, 3)
    small = part[:, :, None, :]
    directions = directions + np.cross(small, directions + 0.5 * np.cross(small, directions))
    jacobian[:, :, :, 3:] = directions @ np.swapaxes(knots.frame[:-1], 1, 2)[:, None]
    residual = np.stack([in_plane, across], axis=2)
    # both distances of a point share one weight: a wrong point is wrong in both
    weight = usable / (1.0 + (in_plane / scale_m) ** 2 + (across / scale_m) ** 2)
    n = len(knots.time_s)
    banded_blocks = np.zeros((n, 3, 6, 6))
    gradient = np.zeros((n, 6))
    border = np.zeros((n, 6))
    flat = jacobian.reshape(len(x), -1, 6)
    flat_residual = residual.reshape(len(x), -1)
    flat_cone = np.stack([zero, -range_m], axis=2).reshape(len(x), -1)
    both = np.repeat(weight, 2, axis=1)
    near = np.repeat(1.0 - share, 2, axis=1)
    far = np.repeat(share, 2, axis=1)
    transposed = np.swapaxes(flat, 1, 2)
    banded_blocks[:-1, 0] += (transposed * (both * near * near)[:, None, :]) @ flat
    banded_blocks[1:, 0] += (transposed * (both * far * far)[:, None, :]) @ flat
    banded_blocks[:-1, 1] += (transposed * (both * near * far)[:, None, :]) @ flat
    gradient[:-1] += (transposed @ (both * near * flat_residual)[:, :, None])[:, :, 0]
    gradient[1:] += (transposed @ (both * far * flat_residual)[:, :, None])[:, :, 0]
    border[:-1] += (transposed @ (both * near * flat_cone)[:, :, None])[:, :, 0]
    border[1:] += (transposed @ (both * far * flat_cone)[:, :, None])[:, :, 0]
    _add_smoothness(banded_blocks, gradient, knots, turn, scale_m)
    cone_weight = float((weight * range_m**2).sum()) + 1.0
    cone_gradient = -float((weight * across * range_m).sum())
    return _System(
        _banded(banded_blocks),
        gradient,
        border,
        cone_weight,
        cone_gradient,
        in_plane,
        across,
        range_m,
        spread,
    )


def _add_smoothness(
    blocks: F64,
    gradient: F64,
    knots: Knots,
    turn: F64,
    scale_m: float,
) -> None:
    """Add the cost of changes of speed and turn, relative to residuals of a point."""
    step = np.diff(knots.time_s)
    before = step[:-1]
    after = step[1:]
    span = 0.5 * (before + after)
    # a change of speed over the mean step, as a length; points count per residual scale of a
    # centimetre
    usual_m = SPEED_CHANGE_M_S2 * span
    usual_rad = TURN_CHANGE_RAD_S2 * span
    noise = min(scale_m, 0.02)
    change = np.concatenate(
        [
            turn[1:] / after[:, None] - turn[:-1] / before[:, None],
            np.diff(np.diff(knots.position_m, axis=0) / step[:, None], axis=0),
        ],
        axis=1,
    )
    usual = np.concatenate(
        [np.repeat(usual_rad[:, None], 3, 1), np.repeat(usual_m[:, None], 3, 1)], axis=1
    )
    weight = (noise / usual) ** 2
    factors = (1.0 / before, -1.0 / before - 1.0 / after, 1.0 / after)
    n = len(knots.time_s)
    diagonal = np.arange(6)
    for i, first in enumerate(factors):
        rows = slice(i, n - 2 + i)
        gradient[rows] += weight * change * first[:, None]
        for j, second in enumerate(factors[i:]):
            blocks[i : n - 2 + i, j, diagonal, diagonal] += weight * (first * second)[:, None]
    # a trace of stiffness, so that no unknown is free
    blocks[:, 0, diagonal, diagonal] += 1e-9


def _banded(blocks: F64) -> F64:
    """Return lower diagonals (18, 6 k); ``blocks[k, j]`` couples knot k with knot k + j."""
    n = len(blocks)
    banded = np.zeros((18, 6 * n))
    for j in range(3):
        for row in range(6):
            for column in range(6):
                diagonal = 6 * j + row - column
                if diagonal < 0:
                    continue
                # element (6 (k + j) + row, 6 k + column); blocks hold [k, k + j] = (column of k,
                # row of k + j)
                banded[diagonal, column::6] = blocks[:, j, column, row]
    return banded


def inverse_blocks(banded: F64) -> F64:
    """Return the diagonal blocks of the inverse of a banded matrix, (k, 6, 6).

    Parameters
    ----------
    banded
        (18, 6 k) float64, lower diagonals of a positive definite matrix whose blocks couple at most
        two knots apart.
    """
    n = banded.shape[1] // 6
    n_pairs = -(-n // 2)
    size = 12 * n_pairs
    wide = np.zeros((24, size + 24))
    wide[:18, : 6 * n] = banded
    wide[0, 6 * n : size] = 1.0
    row, column = np.indices((12, 12))
    start = 12 * np.arange(n_pairs)[:, None, None]
    lower = np.where(row >= column, wide[np.abs(row - column), start + column], 0.0)
    upper = np.where(row < column, wide[np.abs(row - column), start + row], 0.0)
    diagonal = lower + upper
    distance = 12 + row - column
    coupling = np.where(distance < 18, wide[np.minimum(distance, 23), start + column], 0.0)
    pivots = np.empty_like(diagonal)
    steps = np.empty_like(diagonal)
    pivot = diagonal[0]
    for i in range(n_pairs):
        pivots[i] = np.linalg.inv(pivot)
        if i + 1 < n_pairs:
            steps[i] = pivots[i] @ coupling[i].T
            pivot = diagonal[i + 1] - coupling[i] @ steps[i]
    inverse = np.empty_like(diagonal)
    inverse[-1] = pivots[-1]
    for i in range(n_pairs - 2, -1, -1):
        inverse[i] = pivots[i] + steps[i] @ inverse[i + 1] @ steps[i].T
    blocks: F64 = np.stack([inverse[:, :6, :6], inverse[:, 6:, 6:]], axis=1).reshape(-1, 6, 6)
    return blocks[:n]

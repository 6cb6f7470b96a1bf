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
    columns = [np.interp(time_s, knots_s, position_m[:, axis]) for axis in range(3)]
    xyz = np.stack(columns, axis=1)
    last = len(knots_s) - 1
    step_s = float(np.median(np.diff(knots_s)))
    n_steps = min(max(round(SPEED_S / step_s), 1), last)
    for end, inner in ((0, n_steps), (last, last - n_steps)):
        speed = (position_m[end] - position_m[inner]) / (knots_s[end] - knots_s[inner])
        since_s = time_s - knots_s[end]
        beyond = since_s < 0 if end == 0 else since_s > 0
        xyz[beyond] = position_m[end] + since_s[beyond, None] * speed
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
    first = border[:-1, None]
    last = np.maximum(border[1:] - 1, 0)[:, None]
    count = np.diff(border)[:, None]
    step = np.maximum(count / n_points, 1.0)
    place = np.arange(n_points)[None, :]
    index = first + ((place + 0.5) * step).astype(np.int64)
    is_point = (index <= last) & (count > 0)
    index = np.clip(index, 0, np.minimum(last, len(time_s) - 1))
    share = (time_s[index] - knots_s[:-1, None]) / np.diff(knots_s)[:, None]
    bearing = bearing_rad[index]
    return Observations(
        share=np.clip(share, 0.0, 1.0),
        xyz_m=xyz_m[index],
        cosine=np.cos(bearing),
        sine=np.sin(bearing),
        weight=is_point.astype(np.float64),
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
    coarse_scales = SCALES_M[1:]
    for round_ in range(len(coarse_scales) + MOST_FINE_ROUNDS):
        is_coarse = round_ < len(coarse_scales)
        step, slope_step = system.solve()
        knots = _stepped(knots, step)
        slope = float(np.clip(slope + slope_step, -STEEPEST, STEEPEST))
        if is_coarse:
            scale = coarse_scales[round_]
        else:
            scale = float(np.clip(3.0 * system.spread_m, LEAST_SCALE_M, SCALES_M[-1]))
        system = _normal_equations(knots, observed, scale, slope)
        if not is_coarse and np.abs(step[:, 3:]).max() < STEP_M:
            break
    spread = max(system.spread_m * 1.4826, 1e-4)
    return Fit(
        knots=replace(knots, position_m=knots.position_m + centre),
        in_plane_m=system.in_plane_m,
        across_m=system.across_m,
        range_m=system.range_m,
        scale_m=scale,
        sigma_m=system.standard_deviations() * spread,
        slope=slope,
    )


def _stepped(knots: Knots, step: F64) -> Knots:
    """Turn and move knots by steps (k, 6); long ones are cut, since they leave the linear range."""
    turn = step[:, :3]
    move = step[:, 3:]
    turn_rad = np.maximum(np.linalg.norm(turn, axis=1), 1e-12)
    move_m = np.maximum(np.linalg.norm(move, axis=1), 1e-12)
    turn_share = np.minimum(1.0, LONGEST_TURN_RAD / turn_rad)[:, None]
    move_share = np.minimum(1.0, LONGEST_STEP_M / move_m)[:, None]
    return replace(
        knots,
        position_m=knots.position_m + move_share * move,
        frame=knots.frame @ rotation_matrices(turn_share * turn),
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
        gradient = self.gradient.ravel()
        border = self.border.ravel()
        right = np.stack([gradient, border], axis=1)
        of_gradient, of_border = cho_solve_banded((factor, True), right).T
        # the knots are eliminated: one equation is left for the slope
        slope_weight = self.cone_weight - float(border @ of_border)
        slope_gradient = self.cone_gradient - float(border @ of_gradient)
        slope_step = -slope_gradient / max(slope_weight, 1e-9)
        step: F64 = (-of_gradient - slope_step * of_border).reshape(-1, 6)
        return step, slope_step

    def standard_deviations(self) -> F64:
        """Return the square roots of the inverse's diagonal for the stations, (k, 3)."""
        variances = np.diagonal(inverse_blocks(self.banded), axis1=1, axis2=2)[:, 3:]
        return np.sqrt(np.maximum(variances, 0.0))


def _normal_equations(
    knots: Knots,
    observed: Observations,
    scale_m: float,
    slope: float,
) -> _System:
    share = observed.share
    weight_before = (1.0 - share)[:, :, None]
    weight_after = share[:, :, None]
    # points in the frame between two knots, by the second order of the small turn
    station = (
        knots.position_m[:-1, None, :] * weight_before
        + knots.position_m[1:, None, :] * weight_after
    )
    in_frame = (observed.xyz_m - station) @ knots.frame[:-1]
    turn = knots.relative_turns()
    turn_part = share[:, :, None] * turn[:, None, :]
    half_turned = in_frame - 0.5 * np.cross(turn_part, in_frame)
    local = in_frame - np.cross(turn_part, half_turned)
    x = local[:, :, 0]
    y = local[:, :, 1]
    z = local[:, :, 2]

    # distances of the points from their beams
    cosine = observed.cosine
    sine = observed.sine
    range_m = cosine * x + sine * y
    in_plane = cosine * y - sine * x
    across = z - slope * range_m
    usable = observed.weight
    distances = masked_median(np.hypot(in_plane, across), usable)
    spread = float(np.median(distances[usable.any(axis=1)]))
    # both distances of a point share one weight: a wrong point is wrong in both
    weight = usable / (1.0 + (in_plane / scale_m) ** 2 + (across / scale_m) ** 2)

    # how they change with a turn of the frame, a move of the station, and the slope of the cone
    zero = np.zeros_like(x)
    jacobian = np.empty((*x.shape, 2, 6))
    in_plane_by_turn = [cosine * z, sine * z, -range_m]
    across_by_turn = [-y - slope * sine * z, x + slope * cosine * z, -slope * in_plane]
    jacobian[:, :, 0, :3] = np.stack(in_plane_by_turn, axis=2)
    jacobian[:, :, 1, :3] = np.stack(across_by_turn, axis=2)
    in_plane_by_move = [sine, -cosine, zero]
    across_by_move = [slope * cosine, slope * sine, zero - 1.0]
    by_move = np.stack([*in_plane_by_move, *across_by_move], axis=2).reshape(*x.shape, 2, 3)
    turn_of_both = turn_part[:, :, None, :]
    half_turned = by_move + 0.5 * np.cross(turn_of_both, by_move)
    by_move = by_move + np.cross(turn_of_both, half_turned)
    jacobian[:, :, :, 3:] = by_move @ np.swapaxes(knots.frame[:-1], 1, 2)[:, None]

    # the sums: a point between two knots counts for both, by its share
    n_pairs = len(x)
    rows = jacobian.reshape(n_pairs, -1, 6)
    residual = np.stack([in_plane, across], axis=2).reshape(n_pairs, -1)
    by_slope = np.stack([zero, -range_m], axis=2).reshape(n_pairs, -1)
    weight_of_row = np.repeat(weight, 2, axis=1)
    before = np.repeat(1.0 - share, 2, axis=1)
    after = np.repeat(share, 2, axis=1)
    columns = np.swapaxes(rows, 1, 2)

    def weighted_square(weights: F64) -> F64:
        square: F64 = (columns * weights[:, None, :]) @ rows
        return square

    def weighted_sum(weights: F64) -> F64:
        total: F64 = (columns @ weights[:, :, None])[:, :, 0]
        return total

    n = len(knots.time_s)
    blocks = np.zeros((n, 3, 6, 6))
    blocks[:-1, 0] += weighted_square(weight_of_row * before * before)
    blocks[1:, 0] += weighted_square(weight_of_row * after * after)
    blocks[:-1, 1] += weighted_square(weight_of_row * before * after)
    gradient = np.zeros((n, 6))
    gradient[:-1] += weighted_sum(weight_of_row * before * residual)
    gradient[1:] += weighted_sum(weight_of_row * after * residual)
    border = np.zeros((n, 6))
    border[:-1] += weighted_sum(weight_of_row * before * by_slope)
    border[1:] += weighted_sum(weight_of_row * after * by_slope)
    _add_smoothness(blocks, gradient, knots, turn, scale_m)
    return _System(
        banded=_banded(blocks),
        gradient=gradient,
        border=border,
        cone_weight=float((weight * range_m**2).sum()) + 1.0,
        cone_gradient=-float((weight * across * range_m).sum()),
        in_plane_m=in_plane,
        across_m=across,
        range_m=range_m,
        spread_m=spread,
    )


def _add_smoothness(
    blocks: F64,
    gradient: F64,
    knots: Knots,
    turn: F64,
    scale_m: float,
) -> None:
    """Add the cost of changes of speed and turn, relative to residuals of a point."""
    step_s = np.diff(knots.time_s)
    before_s = step_s[:-1]
    after_s = step_s[1:]
    span_s = 0.5 * (before_s + after_s)
    # a change of speed over the mean step, as a length; points count per residual scale of a
    # centimetre
    usual_m = SPEED_CHANGE_M_S2 * span_s
    usual_rad = TURN_CHANGE_RAD_S2 * span_s
    noise_m = min(scale_m, 0.02)
    turn_change = turn[1:] / after_s[:, None] - turn[:-1] / before_s[:, None]
    speed_m_s = np.diff(knots.position_m, axis=0) / step_s[:, None]
    change = np.concatenate([turn_change, np.diff(speed_m_s, axis=0)], axis=1)
    usual = np.empty_like(change)
    usual[:, :3] = usual_rad[:, None]
    usual[:, 3:] = usual_m[:, None]
    weight = (noise_m / usual) ** 2
    # the change couples three knots: before, at and after it
    factors = (1.0 / before_s, -1.0 / before_s - 1.0 / after_s, 1.0 / after_s)
    n = len(knots.time_s)
    diagonal = np.arange(6)
    for i, first in enumerate(factors):
        rows = slice(i, n - 2 + i)
        gradient[rows] += weight * change * first[:, None]
        for j, second in enumerate(factors[i:]):
            blocks[rows, j, diagonal, diagonal] += weight * (first * second)[:, None]
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
                # the element in row 6 (k + j) + row and column 6 k + column of the matrix
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
    # two knots together couple only with the next two: blocks of 12 x 12, filled up with ones
    n = banded.shape[1] // 6
    n_pairs = -(-n // 2)
    size = 12 * n_pairs
    padded = np.zeros((24, size + 24))
    padded[:18, : 6 * n] = banded
    padded[0, 6 * n : size] = 1.0
    row, column = np.indices((12, 12))
    start = 12 * np.arange(n_pairs)[:, None, None]
    off_diagonal = np.abs(row - column)
    lower = np.where(row >= column, padded[off_diagonal, start + column], 0.0)
    upper = np.where(row < column, padded[off_diagonal, start + row], 0.0)
    diagonal = lower + upper
    off_next = 12 + row - column
    coupling = np.where(off_next < 18, padded[np.minimum(off_next, 23), start + column], 0.0)

    # elimination from the first pair to the last, and back
    inverse_pivots = np.empty_like(diagonal)
    steps = np.empty_like(diagonal)
    pivot = diagonal[0]
    for i in range(n_pairs):
        inverse_pivots[i] = np.linalg.inv(pivot)
        if i + 1 < n_pairs:
            steps[i] = inverse_pivots[i] @ coupling[i].T
            pivot = diagonal[i + 1] - coupling[i] @ steps[i]
    inverse = np.empty_like(diagonal)
    inverse[-1] = inverse_pivots[-1]
    for i in range(n_pairs - 2, -1, -1):
        inverse[i] = inverse_pivots[i] + steps[i] @ inverse[i + 1] @ steps[i].T
    of_first = inverse[:, :6, :6]
    of_second = inverse[:, 6:, 6:]
    blocks: F64 = np.stack([of_first, of_second], axis=1).reshape(-1, 6, 6)
    return blocks[:n]

"""Loops that aim the shots of a simulated scan and find the nearest surface of every shot.

The shots of a line lie nearly in one plane, and their angle within it rises or falls with the
column. Hence bodies are first intersected with the plane of the line; the intersection covers a
window of columns. How far the shots stray from the plane is measured, and every test is widened by
it, so that none changes a result.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from prc_cli.core.loops import helper, loop
from prc_cli.core.types import F64, F64_1, F64_2, F64_3, F64_4, I32, I32_2, I64
from prc_cli.simulation.thresholds import CastBodies

_TRIANGLE = 0
_CONE = 1
_ELLIPSOID = 2
_CELL_M = 0.25  # clumps of leaves [m]
_FLAT = 1e-5  # smallest sine between two edges of a triangle, and between a shot and a triangle
_EDGE = 1e-9  # share of an edge by which triangles overlap, so that no shot slips between them
_IS_READY = 13  # place of the mark that a body is prepared
_FARTHEST_M = 1e9  # a shot that begins farther out is not cast

# odd numbers, one for each purpose of random numbers from the same seed
_BODY = np.uint64(0x9E3779B97F4A7C15)
_SHOT = np.uint64(0xD1B54A32D192ED03)
_CAST = np.uint64(0x8CB92BA72F3D8DD7)
_PATH = np.uint64(0xABC98388FB8FAC03)
_LEAF = np.uint64(0x2545F4914F6CDD1D)
_ZERO = np.uint64(0)
_X = np.uint64(0xD6E8FEB86659FD93)
_Y = np.uint64(0xA0761D6478BD642F)
_Z = np.uint64(0xE7037ED1A0B428DB)


class _Frame(NamedTuple):
    """The plane of the shots of a line, and how far they stray from it."""

    normal: tuple[float, float, float]
    first: tuple[float, float, float]
    """Axis in the plane, along the first shot."""
    second: tuple[float, float, float]
    """Axis in the plane, square to both."""
    centre: tuple[float, float, float]
    """Middle of the places where shots begin [m]."""
    stray_m: float
    """Greatest distance of such a place from the centre [m]."""
    stray_out_m: float
    """Greatest distance of such a place from the plane through the centre [m]."""
    tilt: float
    """Greatest sine of the angle between a shot and the plane."""
    time_s: float
    """Middle of the times of the shots [s]."""
    half_time_s: float
    """From the middle to the first or last of the times [s]."""


class _Leaves(NamedTuple):
    """Leaves of a body for the shots of a line."""

    number: float
    """Identity of the body."""
    rate: float
    """Mean number of leaves per metre."""
    shot: int
    """Number of the first shot, or of the shot."""


class _Bins(NamedTuple):
    """Steps of angle (diamond) of a table of columns."""

    first: float
    """Start of the first step."""
    last: float
    """End of the last step."""
    scale: float
    """Steps per unit of angle."""


@helper
def _wrap(
    shape: int,
    numbers: F64,
    yaw: F64,
    hull: F64,
    j: int,
) -> None:
    """Write the hull of a body: three points, a distance around their triangle, its reach."""
    if shape == _TRIANGLE:
        for k in range(9):
            hull[j, k] = numbers[k]
        hull[j, 9] = 0.0
    elif shape == _CONE:
        for k in range(6):
            hull[j, k] = numbers[k]
        hull[j, 9] = max(numbers[6], numbers[7])
    else:  # the longest axis, and the extent at its sides
        longest = 3
        for k in range(4, 6):
            if numbers[k] > numbers[longest]:
                longest = k
        p = numbers[4] if longest == 3 else numbers[3]
        q = numbers[4] if longest == 5 else numbers[5]
        hull[j, 9] = max(p, q) if shape == _ELLIPSOID else np.sqrt(p * p + q * q)
        # an ellipsoid ends where its capsule ends; the corners of a box need a longer one
        half = numbers[longest] - hull[j, 9] if shape == _ELLIPSOID else numbers[longest]
        x = half * yaw[0] if longest == 3 else -half * yaw[1] if longest == 4 else 0.0
        y = half * yaw[1] if longest == 3 else half * yaw[0] if longest == 4 else 0.0
        z = half if longest == 5 else 0.0
        hull[j, 0] = numbers[0] - x
        hull[j, 1] = numbers[1] - y
        hull[j, 2] = numbers[2] - z
        hull[j, 3] = numbers[0] + x
        hull[j, 4] = numbers[1] + y
        hull[j, 5] = numbers[2] + z
    if shape != _TRIANGLE:
        for k in range(3):
            hull[j, 6 + k] = hull[j, 3 + k]
    farthest = 0.0
    for corner in range(3, 9, 3):
        x = hull[j, corner] - hull[j, 0]
        y = hull[j, corner + 1] - hull[j, 1]
        z = hull[j, corner + 2] - hull[j, 2]
        farthest = max(farthest, x * x + y * y + z * z)
    hull[j, 10] = np.sqrt(farthest) + hull[j, 9]


@helper
def _prepare(
    shape: int,
    numbers: F64,
    turn: F64,
    ready: F64,
) -> None:
    """Write the numbers of a body that can be computed once for all shots."""
    for k in range(6):
        ready[k] = numbers[k]
    if shape == _TRIANGLE:
        ax = numbers[3] - numbers[0]
        ay = numbers[4] - numbers[1]
        az = numbers[5] - numbers[2]
        bx = numbers[6] - numbers[0]
        by = numbers[7] - numbers[1]
        bz = numbers[8] - numbers[2]
        nx = ay * bz - az * by
        ny = az * bx - ax * bz
        nz = ax * by - ay * bx
        ready[3] = ax
        ready[4] = ay
        ready[5] = az
        ready[6] = bx
        ready[7] = by
        ready[8] = bz
        ready[9] = nx
        ready[10] = ny
        ready[11] = nz
        square = nx * nx + ny * ny + nz * nz
        edges = (ax * ax + ay * ay + az * az) * (bx * bx + by * by + bz * bz)
        ready[12] = np.sqrt(square) if square > _FLAT * _FLAT * edges else np.inf
    elif shape == _CONE:
        x = numbers[3] - numbers[0]
        y = numbers[4] - numbers[1]
        z = numbers[5] - numbers[2]
        length = np.sqrt(x * x + y * y + z * z)
        ready[3] = x / length
        ready[4] = y / length
        ready[5] = z / length
        ready[6] = length
        ready[7] = numbers[6]
        ready[8] = (numbers[7] - numbers[6]) / length
    else:
        ready[6] = turn[0]
        ready[7] = turn[1]
        for k in range(3):
            ready[8 + k] = 1.0 / numbers[3 + k]
    ready[_IS_READY] = 1.0


@helper
def _middle(numbers: F64) -> tuple[float, float]:
    """Return the middle between the smallest and the largest number, and half their difference."""
    low = high = numbers[0]
    for i in range(1, len(numbers)):
        low = numbers[i] if numbers[i] < low else low
        high = numbers[i] if numbers[i] > high else high
    return 0.5 * (low + high), 0.5 * (high - low)


@helper
def _read_line(
    origin: F64,
    direction: F64,
    time_s: F64,
    t_min: F64,
    line: int,
    rays: F64,
) -> None:
    """Write the shots of a line in rows: origin, direction, time, least range."""
    for i in range(rays.shape[1]):
        for k in range(3):
            rays[k, i] = origin[line, i, k]
            rays[3 + k, i] = direction[line, i, k]
        rays[6, i] = time_s[line, i]
        rays[7, i] = max(t_min[line, i], 0.0) if t_min[line, i] < _FARTHEST_M else np.inf


@helper
def _measure_line(rays: F64, angle: F64) -> _Frame:
    """Fit a plane to the shots of a line, measure their deviation, write their angles."""
    normal, first, second = _lay_plane(rays)
    centre = _middle(rays[0])[0], _middle(rays[1])[0], _middle(rays[2])[0]
    stray = out = tilt = 0.0
    turns = 0.0
    before = 0.0
    for i in range(rays.shape[1]):
        x = rays[0, i] - centre[0]
        y = rays[1, i] - centre[1]
        z = rays[2, i] - centre[2]
        square = x * x + y * y + z * z
        h = x * normal[0] + y * normal[1] + z * normal[2]
        stray = max(stray, square)
        out = max(out, abs(h))
        dx = rays[3, i]
        dy = rays[4, i]
        dz = rays[5, i]
        up = dx * normal[0] + dy * normal[1] + dz * normal[2]
        tilt = max(tilt, abs(up) / np.sqrt(dx * dx + dy * dy + dz * dz))
        here = _diamond(
            dx * first[0] + dy * first[1] + dz * first[2],
            dx * second[0] + dy * second[1] + dz * second[2],
        )
        if i > 0:
            turns -= np.floor((here - before + 2.0) / 4.0)
        angle[i] = here + 4.0 * turns
        before = here
    tilt = min(tilt * (1.0 + 1e-9) + 1e-12, 1.0)
    time_s, half_time_s = _middle(rays[6])
    return _Frame(normal, first, second, centre, np.sqrt(stray), out, tilt, time_s, half_time_s)


@helper
def _lay_plane(
    rays: F64,
) -> tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]:
    """Return the normal of a line's plane, the direction of its first shot, and the third axis."""
    m = rays.shape[1]
    quarter = max(m // 4, 1)
    nx = ny = nz = 0.0
    for i in range(m - quarter):
        k = i + quarter
        nx += rays[4, i] * rays[5, k] - rays[5, i] * rays[4, k]
        ny += rays[5, i] * rays[3, k] - rays[3, i] * rays[5, k]
        nz += rays[3, i] * rays[4, k] - rays[4, i] * rays[3, k]
    length = np.sqrt(nx * nx + ny * ny + nz * nz)
    if not length > 1e-9:  # one direction, or all directions: any plane will do
        nx = 0.0
        ny = 0.0
        nz = 1.0
        length = 1.0
    nx = nx / length
    ny = ny / length
    nz = nz / length
    ux = rays[3, 0]
    uy = rays[4, 0]
    uz = rays[5, 0]
    for _ in range(2):  # the second try, should the first shot go along the normal
        up = ux * nx + uy * ny + uz * nz
        ux = ux - up * nx
        uy = uy - up * ny
        uz = uz - up * nz
        length = np.sqrt(ux * ux + uy * uy + uz * uz)
        if length > 1e-3:
            break
        ux, uy, uz = (1.0, 0.0, 0.0) if abs(nx) < 0.7 else (0.0, 1.0, 0.0)
    ux = ux / length
    uy = uy / length
    uz = uz / length
    return (nx, ny, nz), (ux, uy, uz), (ny * uz - nz * uy, nz * ux - nx * uz, nx * uy - ny * ux)


@helper
def _diamond(x: float, y: float) -> float:
    """Return a number from 0 to 4 that rises with the angle of a vector, 1 per right angle."""
    total = abs(x) + abs(y)
    if total == 0.0:
        return 0.0
    if x < 0.0:
        return 2.0 - y / total
    return y / total if y >= 0.0 else 4.0 + y / total


@helper
def _tabulate(angle: F64, first: I64, last: I64) -> _Bins:
    """Write the first column at or after every step of angle, and the last at or before it."""
    m = len(angle)
    n_bins = len(first)
    middle, half = _middle(angle)
    begin = middle - half - 1e-9
    end = middle + half + 1e-9
    bins = _Bins(begin, end, (n_bins - 1) / (end - begin))
    for k in range(n_bins):
        first[k] = m
        last[k] = -1
    for i in range(m):
        k = _bin(angle[i], bins, n_bins)
        first[k] = min(first[k], i)
        last[k] = max(last[k], i)
    for k in range(1, n_bins):
        last[k] = max(last[k], last[k - 1])
        first[n_bins - 1 - k] = min(first[n_bins - 1 - k], first[n_bins - k])
    return bins


@helper
def _bin(angle: float, bins: _Bins, n_bins: int) -> int:
    return int(min(max((angle - bins.first) * bins.scale, 0.0), n_bins - 1.0))


@helper
def _look_around(
    hull: F64,
    velocity: F64,
    frame: _Frame,
    corners: F64,
    in_view: I64,
    spans: F64,
) -> int:
    """List the bodies that shots of a line can meet: row, first and last angle, least distance."""
    normal = frame.normal
    first = frame.first
    second = frame.second
    centre = frame.centre
    n_in_view = 0
    for j in range(len(hull)):
        vx = velocity[j, 0]
        vy = velocity[j, 1]
        moved = frame.half_time_s * np.sqrt(vx * vx + vy * vy)
        around = hull[j, 9] + moved
        reach = hull[j, 10] + moved
        x = vx * frame.time_s - centre[0]
        y = vy * frame.time_s - centre[1]
        z = -centre[2]
        p = hull[j, 0] + x
        q = hull[j, 1] + y
        r = hull[j, 2] + z
        far = np.sqrt(p * p + q * q + r * r) + reach
        # how far off the plane of the line a shot can be there
        off = frame.stray_out_m + frame.tilt * (far + frame.stray_m) + 1e-5 + 1e-6 * far
        if abs(p * normal[0] + q * normal[1] + r * normal[2]) > reach + off:
            continue
        above = below = True
        for k in range(3):
            p = hull[j, 3 * k] + x
            q = hull[j, 3 * k + 1] + y
            r = hull[j, 3 * k + 2] + z
            h = p * normal[0] + q * normal[1] + r * normal[2]
            above = above and h > around + off
            below = below and h < -around - off
            corners[k, 0] = h
            corners[k, 1] = p * first[0] + q * first[1] + r * first[2]
            corners[k, 2] = p * second[0] + q * second[1] + r * second[2]
        if above or below:
            continue
        low, high, near = _span(corners, around + off, around + frame.stray_m + 1e-5 + 1e-6 * far)
        if low <= high:
            in_view[n_in_view] = j
            spans[n_in_view, 0] = low
            spans[n_in_view, 1] = high
            spans[n_in_view, 2] = near
            n_in_view += 1
    return n_in_view


@helper
def _span(corners: F64, top: float, margin: float) -> tuple[float, float, float]:
    """Return the angles (diamond) of a triangle, (3, 3), cut at two heights, and its distance."""
    low = np.inf
    high = -np.inf
    near = np.inf
    middle = np.nan
    # the part between the two heights is convex: its corners lie on the edges, its outermost angles
    # at corners
    for corner in range(3):
        next_corner = corner + 1 if corner < 2 else 0
        h = corners[corner, 0]
        rise = corners[next_corner, 0] - corners[corner, 0]
        start = 0.0
        stop = 1.0
        if rise != 0.0:
            below = (-top - h) / rise
            above = (top - h) / rise
            if below > above:
                below, above = above, below
            start = below if below > start else start
            stop = above if above < stop else stop
        elif abs(h) > top:
            continue
        if start > stop:
            continue
        for end in range(2):
            way = stop if end else start
            u = corners[corner, 1] + way * (corners[next_corner, 1] - corners[corner, 1])
            v = corners[corner, 2] + way * (corners[next_corner, 2] - corners[corner, 2])
            square = u * u + v * v
            if square <= margin * margin * 1.0001:
                return 0.0, 4.0, 0.0
            # half the angle of a disc, or more; a step of the diamond is never longer than that of
            # the angle
            width = margin / np.sqrt(square - margin * margin) + 1e-9
            here = _diamond(u, v)
            if np.isnan(middle):
                middle = here
            here = (
                here - 4.0 if here - middle >= 2.0 else here + 4.0 if here - middle < -2.0 else here
            )
            low = here - width if here - width < low else low
            high = here + width if here + width > high else high
            near = square if square < near else near
    if high - low > 1.999:  # all around the scanner
        return 0.0, 4.0, 0.0
    return low, high, np.sqrt(near) - margin


@helper
def _list_windows(
    low: float,
    high: float,
    bins: _Bins,
    first: I64,
    last: I64,
    windows: I64,
) -> int:
    """List the windows of columns [start, stop) whose shots go between two angles, at any turn."""
    n = 0
    turns = np.ceil((bins.first - high) / 4.0)
    while low + 4.0 * turns <= bins.last:
        start = first[_bin(low + 4.0 * turns, bins, len(first))]
        stop = last[_bin(high + 4.0 * turns, bins, len(first))] + 1
        turns += 1.0
        if start >= stop:
            continue
        if n > 0 and (n == len(windows) or start <= windows[n - 1, 1]):  # one window for both
            windows[n - 1, 0] = min(windows[n - 1, 0], start)
            windows[n - 1, 1] = max(windows[n - 1, 1], stop)
            continue
        windows[n, 0] = start
        windows[n, 1] = stop
        n += 1
    return n


@helper
def _sort(keys: F64, rows: I64, n: int) -> None:
    """Sort the first n rows by their keys, in place (Shell 1959)."""
    step = n // 2
    while step > 0:
        for i in range(step, n):
            row = rows[i]
            k = i
            while k >= step and keys[rows[k - step], 2] > keys[row, 2]:
                rows[k] = rows[k - step]
                k -= step
            rows[k] = row
        step //= 2


@helper
def _cast_triangle(
    rays: F64,
    start: int,
    stop: int,
    velocity: F64,
    ready: F64,
    b: int,
    t: F64,
    body: I32,
) -> None:
    """Intersect a window of shots with a triangle (Möller and Trumbore 1997)."""
    vx = velocity[0]
    vy = velocity[1]
    px = ready[3]
    py = ready[4]
    pz = ready[5]
    qx = ready[6]
    qy = ready[7]
    qz = ready[8]
    nx = ready[9]
    ny = ready[10]
    nz = ready[11]
    flat = _FLAT * ready[12]
    for i in range(start, stop):
        dx = rays[3, i]
        dy = rays[4, i]
        dz = rays[5, i]
        slope = dx * nx + dy * ny + dz * nz
        if not abs(slope) > flat:
            continue
        x = ready[0] - (rays[0, i] - vx * rays[6, i])
        y = ready[1] - (rays[1, i] - vy * rays[6, i])
        z = ready[2] - rays[2, i]
        here = (x * nx + y * ny + z * nz) / slope
        if not (here > rays[7, i] and (here < t[i] or (here == t[i] and b < body[i]))):
            continue
        ax = y * dz - z * dy
        ay = z * dx - x * dz
        az = x * dy - y * dx
        u = (px * ax + py * ay + pz * az) / slope
        v = (qx * ax + qy * ay + qz * az) / slope
        # v is the share of the first edge, minus u that of the second
        if u <= _EDGE and v >= -_EDGE and v - u <= 1.0 + _EDGE:
            t[i] = here
            body[i] = b


@helper
def _turned(
    rays: F64,
    i: int,
    vx: float,
    vy: float,
    ready: F64,
) -> tuple[float, float, float, float, float, float]:
    """Return origin and direction of a shot in the coordinates of an ellipsoid or box."""
    x = rays[0, i] - vx * rays[6, i] - ready[0]
    y = rays[1, i] - vy * rays[6, i] - ready[1]
    cos = ready[6]
    sin = ready[7]
    dx = rays[3, i]
    dy = rays[4, i]
    return (
        cos * x + sin * y,
        cos * y - sin * x,
        rays[2, i] - ready[2],
        cos * dx + sin * dy,
        cos * dy - sin * dx,
        rays[5, i],
    )


@helper
def _roots(a: float, b: float, c: float) -> tuple[float, float]:
    """Solve a t^2 + 2 b t + c = 0 without loss of digits; NaN or inf = no solution."""
    square = b * b - a * c
    if not square >= 0.0:
        return np.nan, np.nan
    q = -(b + np.sqrt(square)) if b > 0.0 else np.sqrt(square) - b
    first = q / a
    second = c / q
    if first < second:
        return first, second
    return second, first


@helper
def _along_cone(
    rays: F64,
    i: int,
    vx: float,
    vy: float,
    ready: F64,
) -> tuple[float, float, float, float, float, float, float]:
    """Return a, b, c of a shot and a cone; place, speed, radius, growth along the axis."""
    x = rays[0, i] - vx * rays[6, i] - ready[0]
    y = rays[1, i] - vy * rays[6, i] - ready[1]
    z = rays[2, i] - ready[2]
    dx = rays[3, i]
    dy = rays[4, i]
    dz = rays[5, i]
    along = x * ready[3] + y * ready[4] + z * ready[5]
    rise = dx * ready[3] + dy * ready[4] + dz * ready[5]
    radius = ready[7] + ready[8] * along
    growth = ready[8] * rise
    a = dx * dx + dy * dy + dz * dz - rise * rise - growth * growth
    b = x * dx + y * dy + z * dz - along * rise - growth * radius
    c = x * x + y * y + z * z - along * along - radius * radius
    return a, b, c, along, rise, radius, growth


@helper
def _cut_ellipsoid(
    x: float,
    y: float,
    z: float,
    dx: float,
    dy: float,
    dz: float,
    ready: F64,
) -> tuple[float, float]:
    p = ready[8]
    q = ready[9]
    r = ready[10]
    x = x * p
    y = y * q
    z = z * r
    dx = dx * p
    dy = dy * q
    dz = dz * r
    a = dx * dx + dy * dy + dz * dz
    b = x * dx + y * dy + z * dz
    return _roots(a, b, x * x + y * y + z * z - 1.0)


@helper
def _through_slab(place: float, step: float, half: float) -> tuple[float, float]:
    if step == 0.0:
        return (np.inf, -np.inf) if abs(place) > half else (-np.inf, np.inf)
    enter = (-half - place) / step
    leave = (half - place) / step
    return (enter, leave) if enter < leave else (leave, enter)


@helper
def _cut_box(
    x: float,
    y: float,
    z: float,
    dx: float,
    dy: float,
    dz: float,
    ready: F64,
) -> tuple[float, float]:
    low, high = _through_slab(x, dx, ready[3])
    enter, leave = _through_slab(y, dy, ready[4])
    low = enter if enter > low else low
    high = leave if leave < high else high
    enter, leave = _through_slab(z, dz, ready[5])
    low = enter if enter > low else low
    high = leave if leave < high else high
    return (np.inf, np.inf) if low > high else (low, high)


@helper
def _cast_round(
    rays: F64,
    start: int,
    stop: int,
    velocity: F64,
    ready: F64,
    shape: int,
    b: int,
    t: F64,
    body: I32,
) -> None:
    """Intersect a window of shots with the surface of a cone, an ellipsoid or a box."""
    vx = velocity[0]
    vy = velocity[1]
    for i in range(start, stop):
        if shape == _CONE:
            a, h, c, along, rise, _, _ = _along_cone(rays, i, vx, vy, ready)
            low, high = _roots(a, h, c)
            if not 0.0 <= along + low * rise <= ready[6]:
                low = np.inf
            if not 0.0 <= along + high * rise <= ready[6]:
                high = np.inf
        else:
            x, y, z, dx, dy, dz = _turned(rays, i, vx, vy, ready)
            if shape == _ELLIPSOID:
                low, high = _cut_ellipsoid(x, y, z, dx, dy, dz, ready)
            else:
                low, high = _cut_box(x, y, z, dx, dy, dz, ready)
        here = low if low > rays[7, i] and low < np.inf else high
        if here > rays[7, i] and (here < t[i] or (here == t[i] and b < body[i])) and here < np.inf:
            t[i] = here
            body[i] = b


@helper
def mix(x: np.uint64) -> np.uint64:
    """Mix the bits of a number (the finaliser of SplitMix64, Steele et al. 2014)."""
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return x ^ (x >> np.uint64(31))


@helper
def _chance(x: np.uint64) -> float:
    """Turn a number into one from 0 to below 1."""
    return np.float64(np.int64(mix(x) >> np.uint64(11))) * 2.0**-53


@helper
def _shot_key(body_key: np.uint64, shot: int, t_min: float) -> np.uint64:
    cast = np.uint64(np.int64(np.floor(t_min * 1024.0)))
    return mix(body_key ^ mix(np.uint64(shot) + _SHOT)) ^ (cast * _CAST)


@helper
def _facing(
    rays: F64,
    i: int,
    velocity: F64,
    ready: F64,
    shape: int,
    leaves: _Leaves,
    t: float,
) -> float:
    if shape == _TRIANGLE:
        slope = rays[3, i] * ready[9] + rays[4, i] * ready[10] + rays[5, i] * ready[11]
        return float(abs(slope) / ready[12])
    vx = velocity[0]
    vy = velocity[1]
    if shape == _CONE:
        a, b, _, _, _, radius, growth = _along_cone(rays, i, vx, vy, ready)
        cosine = abs(b + t * a) / ((radius + growth * t) * np.sqrt(1.0 + ready[8] * ready[8]))
        return cosine if cosine < 1.0 else 1.0
    if leaves.rate > 0.0:  # leaves face everywhere; those that face the shot are met more often
        body_key = mix(np.uint64(np.int64(leaves.number)) + _BODY)
        key = _shot_key(body_key, leaves.shot, rays[7, i])
        return float(np.sqrt(_chance(key + _LEAF)))
    x, y, z, dx, dy, dz = _turned(rays, i, vx, vy, ready)
    if shape == _ELLIPSOID:
        p = ready[8]
        q = ready[9]
        r = ready[10]
        x = x * p
        y = y * q
        z = z * r
        dx = dx * p
        dy = dy * q
        dz = dz * r
        a = dx * dx + dy * dy + dz * dz
        b = x * dx + y * dy + z * dz
        nx = (x + t * dx) * p
        ny = (y + t * dy) * q
        nz = (z + t * dz) * r
        cosine = abs(b + t * a) / np.sqrt(nx * nx + ny * ny + nz * nz)
        return cosine if cosine < 1.0 else 1.0
    # the face that lies at that range: of entry, or else of exit
    x_low, x_high = _through_slab(x, dx, ready[3])
    y_low, y_high = _through_slab(y, dy, ready[4])
    z_low, _ = _through_slab(z, dz, ready[5])
    if max(x_low, y_low, z_low) != t:
        x_low = x_high
        y_low = y_high
    cosine = abs(dx) if x_low == t else abs(dy) if y_low == t else abs(dz)
    return cosine if cosine < 1.0 else 1.0


@helper
def _cast_leaves(
    rays: F64,
    start: int,
    stop: int,
    velocity: F64,
    ready: F64,
    shape: int,
    b: int,
    leaves: _Leaves,
    quantiles: F64,
    t: F64,
    body: I32,
) -> None:
    """Send a window of shots through a body that is filled with leaves."""
    vx = velocity[0]
    vy = velocity[1]
    key = mix(np.uint64(np.int64(leaves.number)) + _BODY)
    for i in range(start, stop):
        begin = rays[7, i]
        if not begin < _FARTHEST_M:
            continue
        x, y, z, dx, dy, dz = _turned(rays, i, vx, vy, ready)
        if shape == _ELLIPSOID:
            enter, leave = _cut_ellipsoid(x, y, z, dx, dy, dz, ready)
        else:
            enter, leave = _cut_box(x, y, z, dx, dy, dz, ready)
        now = enter if enter > begin else begin
        if not (enter < leave and now < leave and now <= t[i]):
            continue
        chance = mix(_shot_key(key, leaves.shot + i, begin) + _PATH)
        left = quantiles[np.int64(chance >> np.uint64(11)) % len(quantiles)]
        here = _walk(x, y, z, dx, dy, dz, now, leave, t[i], leaves.rate, left, key)
        if here < t[i] or (here == t[i] and b < body[i] and here < np.inf):
            t[i] = here
            body[i] = b


@helper
def _walk(
    x: float,
    y: float,
    z: float,
    dx: float,
    dy: float,
    dz: float,
    now: float,
    leave: float,
    limit: float,
    rate: float,
    left: float,
    key: np.uint64,
) -> float:
    """Go from cell to cell of a body's lattice until the leaves on the way suffice; inf = never."""
    # next side of the cell; its step from cell to cell, and the step of the cell's mark
    p = np.floor((x + now * dx) / _CELL_M)
    q = np.floor((y + now * dy) / _CELL_M)
    r = np.floor((z + now * dz) / _CELL_M)
    mark = np.uint64(np.int64(p)) * _X + np.uint64(np.int64(q)) * _Y + np.uint64(np.int64(r)) * _Z
    step_x, mark_x = (1.0, _X) if dx > 0.0 else (-1.0, _ZERO - _X)
    step_y, mark_y = (1.0, _Y) if dy > 0.0 else (-1.0, _ZERO - _Y)
    step_z, mark_z = (1.0, _Z) if dz > 0.0 else (-1.0, _ZERO - _Z)
    p = p + 1.0 if dx > 0.0 else p
    q = q + 1.0 if dy > 0.0 else q
    r = r + 1.0 if dz > 0.0 else r
    fast_x = 1.0 / dx
    fast_y = 1.0 / dy
    fast_z = 1.0 / dz
    u = (p * _CELL_M - x) * fast_x if dx != 0.0 else np.inf
    v = (q * _CELL_M - y) * fast_y if dy != 0.0 else np.inf
    w = (r * _CELL_M - z) * fast_z if dz != 0.0 else np.inf
    while now <= limit:
        then = v if v < u else u
        then = w if w < then else then
        then = leave if leave < then else then
        clump = _chance(key ^ mark)
        thickness = rate * (4.0 * clump * clump * clump)
        gain = thickness * (then - now) if then > now else 0.0
        if gain >= left:
            here = now + left / thickness
            return here if here < then else then
        if then >= leave:
            return np.inf
        left -= gain
        now = then if then > now else now
        if then == u:
            p += step_x
            mark += mark_x
            u = (p * _CELL_M - x) * fast_x
        elif then == v:
            q += step_y
            mark += mark_y
            v = (q * _CELL_M - y) * fast_y
        else:
            r += step_z
            mark += mark_z
            w = (r * _CELL_M - z) * fast_z
    return np.inf


@loop()
def cast_shots(
    origin: F64_3,
    direction: F64_3,
    time_s: F64_2,
    t_min: F64_2,
    first_shot: int,
    bodies: CastBodies,
    quantiles: F64_1,
) -> tuple[F64_2, I32_2, F64_2]:
    """Find the nearest surface of every shot; of surfaces at one place, that of the first body.

    ``origin, direction`` (lines, M, 3) float64; ``time_s`` (lines, M) float64; ``t_min`` (lines, M)
    float64; ``quantiles`` (2^k,) float64; returns ``t`` (lines, M) float64, ``body`` (lines, M)
    int32, ``facing`` (lines, M) float64.

    Notes
    -----
    A shot in leaves meets a clump in every cell of a lattice, of a density between none and four
    times that of the body (mean one, 4 u^3 with u uniform); it ends where the density on its way,
    halved since leaves face everywhere, adds up to an exponential number.
    """
    n_lines, n_columns = time_s.shape
    shape, numbers, turn, density, velocity, number = bodies
    n = len(shape)
    t = np.empty((n_lines, n_columns))
    body = np.empty((n_lines, n_columns), np.int32)
    facing = np.empty((n_lines, n_columns))
    if time_s.size == 0:
        return t, body, facing
    hull = np.empty((n, 11))
    ready = np.empty((n, _IS_READY + 1))
    for b in range(n):
        ready[b, _IS_READY] = 0.0
        _wrap(shape[b], numbers[b], turn[b], hull, b)
    rays = np.empty((8, n_columns))  # a row a number: a window of columns is read in one go
    angle = np.empty(n_columns)
    corners = np.empty((3, 3))
    first = np.empty(2 * n_columns, np.int64)
    last = np.empty(2 * n_columns, np.int64)
    in_view = np.empty(n, np.int64)
    rows = np.empty(n, np.int64)
    spans = np.empty((n, 3))
    windows = np.empty((4, 2), np.int64)
    for line in range(n_lines):
        shot = first_shot + line * n_columns
        _read_line(origin, direction, time_s, t_min, line, rays)
        frame = _measure_line(rays, angle)
        bins = _tabulate(angle, first, last)
        n_in_view = _look_around(hull, velocity, frame, corners, in_view, spans)
        # surfaces first, then the nearest leaves: the way through leaves ends at a hit
        for k in range(n_in_view):
            b = in_view[k]
            rows[k] = k
            if not (shape[b] >= _ELLIPSOID and density[b] > 0.0):
                spans[k, 2] = -np.inf
            if ready[b, _IS_READY] == 0.0:
                _prepare(shape[b], numbers[b], turn[b], ready[b])
        _sort(spans, rows, n_in_view)
        near = t[line]
        near_body = body[line]
        for i in range(n_columns):
            near[i] = np.inf
            near_body[i] = -1
        for row in range(n_in_view):
            k = rows[row]
            b = in_view[k]
            for w in range(_list_windows(spans[k, 0], spans[k, 1], bins, first, last, windows)):
                start = windows[w, 0]
                stop = windows[w, 1]
                if shape[b] == _TRIANGLE:
                    _cast_triangle(rays, start, stop, velocity[b], ready[b], b, near, near_body)
                elif shape[b] == _CONE or not density[b] > 0.0:
                    _cast_round(
                        rays, start, stop, velocity[b], ready[b], shape[b], b, near, near_body
                    )
                else:
                    leaves = _Leaves(number[b], 0.5 * density[b], shot)
                    _cast_leaves(
                        rays,
                        start,
                        stop,
                        velocity[b],
                        ready[b],
                        shape[b],
                        b,
                        leaves,
                        quantiles,
                        near,
                        near_body,
                    )
        for i in range(n_columns):
            b = int(near_body[i])
            facing[line, i] = 0.0
            if b >= 0:
                leaves = _Leaves(number[b], 0.5 * density[b], shot + i)
                facing[line, i] = _facing(rays, i, velocity[b], ready[b], shape[b], leaves, near[i])
    return t, body, facing


@loop()
def aim_shots(position: F64_3, turn: F64_4, columns: F64_2) -> tuple[F64_3, F64_3]:
    """Place and turn every shot of every line, straight between the poses around it.

    ``position`` (lines, k + 1, 3) float64, metres; ``turn`` (lines, k + 1, 3, 3) float64;
    ``columns`` (M, 3) float64; returns ``origin`` (lines, M, 3) float64, ``direction`` (lines, M,
    3) float64.
    """
    n_lines = position.shape[0]
    n_knots = position.shape[1] - 1
    m = columns.shape[0]
    origin = np.empty((n_lines, m, 3))
    direction = np.empty((n_lines, m, 3))
    for line in range(n_lines):
        for column in range(m):
            place = column * n_knots / m
            k = int(place)
            late = place - k
            x = columns[column, 0]
            y = columns[column, 1]
            z = columns[column, 2]
            square = 0.0
            for i in range(3):
                before = position[line, k, i]
                origin[line, column, i] = before + late * (position[line, k + 1, i] - before)
                here = turn[line, k, i, 0] * x + turn[line, k, i, 1] * y + turn[line, k, i, 2] * z
                after = (
                    turn[line, k + 1, i, 0] * x
                    + turn[line, k + 1, i, 1] * y
                    + turn[line, k + 1, i, 2] * z
                )
                along = here + late * (after - here)
                direction[line, column, i] = along
                square += along * along
            length = np.sqrt(square)
            for i in range(3):
                direction[line, column, i] /= length
    return origin, direction

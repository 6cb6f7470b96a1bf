"""The loop that finds the nearest surface of every shot of a simulated scan.

The shots of a line lie nearly in one plane, and their angle within it rises or falls with the column. Hence bodies
are first cut with the plane of the line, in groups and then one by one, and what is left covers a window of columns.
How far the shots of a line stray from its plane is measured, not assumed, and every cut is widened by it: no cut
changes a result.
"""

from __future__ import annotations

import numpy as np

from prc_cli.core.types import F64, I32, I64, U8
from prc_cli.kernels.cache import helper, kernel

_TRIANGLE, _CONE, _ELLIPSOID = 0, 1, 2
_GROUP = 32  # bodies that are cut together
_CELL_M = 0.25  # clumps of leaves [m]
_FLAT = 1e-5  # smallest sine between two edges of a triangle, and between a shot and a triangle
_EDGE = 1e-9  # share of an edge by which triangles overlap, so that no shot slips between them
_FARTHEST_M = 1e9  # a shot that begins behind this is not cast

# what is known of a line
_CENTRE = 9  # after the normal of its plane and two axes within it, three numbers each
_STRAY, _STRAY_OUT, _TILT, _FIRST, _LAST, _SCALE, _TIME, _HALF_TIME, _N_FRAME = 12, 13, 14, 15, 16, 17, 18, 19, 20

# odd numbers that keep apart what is drawn from the same seed
_BODY, _SHOT, _CAST = np.uint64(0x9E3779B97F4A7C15), np.uint64(0xD1B54A32D192ED03), np.uint64(0x8CB92BA72F3D8DD7)
_PATH, _LEAF = np.uint64(0xABC98388FB8FAC03), np.uint64(0x2545F4914F6CDD1D)
_X, _Y, _Z = np.uint64(0xD6E8FEB86659FD93), np.uint64(0xA0761D6478BD642F), np.uint64(0xE7037ED1A0B428DB)


@helper
def _prepare(shape: int, numbers: F64, turn: F64, hull: F64, ready: F64) -> None:
    """Say what a body is to a shot, and what it lies in: three points and a distance around their triangle."""
    if shape == _TRIANGLE:
        hull[:9] = numbers
        hull[9] = 0.0
        ready[:9] = numbers
        for k in range(3):
            ready[3 + k] -= ready[k]
            ready[6 + k] -= ready[k]
        ax, ay, az, bx, by, bz = ready[3], ready[4], ready[5], ready[6], ready[7], ready[8]
        nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        ready[9], ready[10], ready[11] = nx, ny, nz
        square = nx * nx + ny * ny + nz * nz
        edges = (ax * ax + ay * ay + az * az) * (bx * bx + by * by + bz * bz)
        ready[12] = np.sqrt(square) if square > _FLAT * _FLAT * edges else np.inf
    elif shape == _CONE:
        hull[:6] = numbers[:6]
        hull[6:9] = numbers[3:6]
        hull[9] = max(numbers[6], numbers[7])
        ready[:3] = numbers[:3]
        x, y, z = numbers[3] - numbers[0], numbers[4] - numbers[1], numbers[5] - numbers[2]
        length = np.sqrt(x * x + y * y + z * z)
        ready[3], ready[4], ready[5] = x / length, y / length, z / length
        ready[6] = length
        ready[7] = numbers[6]
        ready[8] = (numbers[7] - numbers[6]) / length
    else:
        ready[:6] = numbers[:6]
        ready[6:8] = turn
        longest = np.argmax(numbers[3:6])
        others = np.inf
        for k in range(3):
            hull[k] = hull[3 + k] = numbers[k]
        x = turn[0] if longest == 0 else -turn[1] if longest == 1 else 0.0
        y = turn[1] if longest == 0 else turn[0] if longest == 1 else 0.0
        z = 1.0 if longest == 2 else 0.0
        half = numbers[3 + longest]
        p, q = numbers[3 + (longest + 1) % 3], numbers[3 + (longest + 2) % 3]
        others = max(p, q) if shape == _ELLIPSOID else np.sqrt(p * p + q * q)
        hull[0] -= half * x
        hull[1] -= half * y
        hull[2] -= half * z
        hull[3] += half * x
        hull[4] += half * y
        hull[5] += half * z
        hull[6:9] = hull[3:6]
        hull[9] = others


@helper
def _prepare_all(shape: U8, numbers: F64, turn: F64, order: I64) -> tuple[F64, F64, I64]:
    """Prepare all bodies in their order; the last result is the place of every body in it."""
    hull = np.empty((len(order), 10))
    ready = np.empty((len(order), 13))
    place = np.empty(len(order), np.int64)
    for j in range(len(order)):
        place[order[j]] = j
        _prepare(shape[order[j]], numbers[order[j]], turn[order[j]], hull[j], ready[j])
    return hull, ready, place


@helper
def _bound_groups(hull: F64, velocity: F64, order: I64, time_s: F64) -> F64:
    """Put a sphere around successive bodies, wherever they are during the block."""
    n = len(order)
    groups = np.empty(((n + _GROUP - 1) // _GROUP, 4))
    middle = 0.5 * (time_s.min() + time_s.max())
    half = 0.5 * (time_s.max() - time_s.min())
    for g in range(len(groups)):
        start, stop = g * _GROUP, min((g + 1) * _GROUP, n)
        for k in range(3):
            low, high = np.inf, -np.inf
            for j in range(start, stop):
                shift = velocity[order[j], k] * middle if k < 2 else 0.0
                for corner in range(3):
                    low = min(low, hull[j, 3 * corner + k] + shift)
                    high = max(high, hull[j, 3 * corner + k] + shift)
            groups[g, k] = 0.5 * (low + high)
        radius = 0.0
        for j in range(start, stop):
            vx, vy = velocity[order[j], 0], velocity[order[j], 1]
            beyond = hull[j, 9] + half * np.sqrt(vx * vx + vy * vy)
            for corner in range(3):
                x = hull[j, 3 * corner] + vx * middle - groups[g, 0]
                y = hull[j, 3 * corner + 1] + vy * middle - groups[g, 1]
                z = hull[j, 3 * corner + 2] - groups[g, 2]
                radius = max(radius, np.sqrt(x * x + y * y + z * z) + beyond)
        groups[g, 3] = radius
    return groups


@helper
def _read_line(origin: F64, direction: F64, time_s: F64, t_min: F64, rays: F64) -> None:
    """Take the shots of a line apart into rows."""
    for i in range(rays.shape[1]):
        for k in range(3):
            rays[k, i] = origin[i, k]
            rays[3 + k, i] = direction[i, k]
        rays[6, i] = time_s[i]
        rays[7, i] = max(t_min[i], 0.0) if t_min[i] < _FARTHEST_M else np.inf


@helper
def _measure_line(rays: F64, frame: F64, angle: F64) -> None:
    """Lay a plane through the shots of a line, and measure how far they stray from it."""
    m = rays.shape[1]
    _lay_plane(rays, frame)
    for k in range(3):
        frame[_CENTRE + k] = 0.5 * (rays[k].min() + rays[k].max())
    stray = out = tilt = 0.0
    turns = 0.0
    before = 0.0
    for i in range(m):
        x, y, z = rays[0, i] - frame[9], rays[1, i] - frame[10], rays[2, i] - frame[11]
        square = x * x + y * y + z * z
        h = x * frame[0] + y * frame[1] + z * frame[2]
        stray = max(stray, square)
        out = max(out, abs(h))
        dx, dy, dz = rays[3, i], rays[4, i], rays[5, i]
        up = dx * frame[0] + dy * frame[1] + dz * frame[2]
        tilt = max(tilt, abs(up) / np.sqrt(dx * dx + dy * dy + dz * dz))
        here = _diamond(dx * frame[3] + dy * frame[4] + dz * frame[5], dx * frame[6] + dy * frame[7] + dz * frame[8])
        if i > 0:
            turns -= np.floor((here - before + 2.0) / 4.0)
        angle[i] = here + 4.0 * turns
        before = here
    frame[_STRAY] = np.sqrt(stray)
    frame[_STRAY_OUT] = out
    frame[_TILT] = min(tilt * (1.0 + 1e-9) + 1e-12, 1.0)
    frame[_TIME] = 0.5 * (rays[6].min() + rays[6].max())
    frame[_HALF_TIME] = 0.5 * (rays[6].max() - rays[6].min())


@helper
def _lay_plane(rays: F64, frame: F64) -> None:
    """Find the axes of a line: the normal of its plane, where its first shot goes, and what is square to both."""
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
        nx, ny, nz, length = 0.0, 0.0, 1.0, 1.0
    nx, ny, nz = nx / length, ny / length, nz / length
    ux, uy, uz = rays[3, 0], rays[4, 0], rays[5, 0]
    for _ in range(2):  # the second try, should the first shot go along the normal
        up = ux * nx + uy * ny + uz * nz
        ux, uy, uz = ux - up * nx, uy - up * ny, uz - up * nz
        length = np.sqrt(ux * ux + uy * uy + uz * uz)
        if length > 1e-3:
            break
        ux, uy, uz = (1.0, 0.0, 0.0) if abs(nx) < 0.7 else (0.0, 1.0, 0.0)
    ux, uy, uz = ux / length, uy / length, uz / length
    frame[0], frame[1], frame[2] = nx, ny, nz
    frame[3], frame[4], frame[5] = ux, uy, uz
    frame[6], frame[7], frame[8] = ny * uz - nz * uy, nz * ux - nx * uz, nx * uy - ny * ux


@helper
def _diamond(x: float, y: float) -> float:
    """Return a number that rises with the angle of a vector, 1 for a right angle, 0 to 4; quicker than the angle."""
    total = abs(x) + abs(y)
    if total == 0.0:
        return 0.0
    if x < 0.0:
        return 2.0 - y / total
    return y / total if y >= 0.0 else 4.0 + y / total


@helper
def _tabulate(angle: F64, frame: F64, first: I64, last: I64) -> None:
    """Note for every small step of angle the first column at or after it, and the last at or before it."""
    m, n_bins = len(angle), len(first)
    frame[_FIRST], frame[_LAST] = angle.min(), angle.max()
    frame[_SCALE] = (n_bins - 1) / max(frame[_LAST] - frame[_FIRST], 1e-9)
    first[:] = m
    last[:] = -1
    for i in range(m):
        k = _bin(angle[i], frame, n_bins)
        first[k] = min(first[k], i)
        last[k] = max(last[k], i)
    for k in range(1, n_bins):
        last[k] = max(last[k], last[k - 1])
        first[n_bins - 1 - k] = min(first[n_bins - 1 - k], first[n_bins - k])


@helper
def _bin(angle: float, frame: F64, n_bins: int) -> int:
    return int(min(max((angle - frame[_FIRST]) * frame[_SCALE], 0.0), n_bins - 1.0))


@helper
def _first_turn(high: float, frame: F64) -> int:
    return int(np.ceil((frame[_FIRST] - high) / 4.0))


@helper
def _last_turn(low: float, frame: F64) -> int:
    return int(np.floor((frame[_LAST] - low) / 4.0))


@helper
def _columns(low: float, high: float, frame: F64, first: I64, last: I64) -> tuple[int, int]:
    return first[_bin(low, frame, len(first))], last[_bin(high, frame, len(first))] + 1


@helper
def _look_around(
    groups: F64, hull: F64, velocity: F64, order: I64, frame: F64, corners: F64, seen: I64, spans: F64
) -> int:
    """List the bodies that shots of a line can meet: place in the order, first and last angle, nearest distance."""
    n_seen = 0
    for g in range(len(groups)):
        x, y, z = groups[g, 0] - frame[9], groups[g, 1] - frame[10], groups[g, 2] - frame[11]
        height = x * frame[0] + y * frame[1] + z * frame[2]
        if abs(height) > _slab(np.sqrt(x * x + y * y + z * z) + groups[g, 3], groups[g, 3], frame):
            continue
        for j in range(g * _GROUP, min((g + 1) * _GROUP, len(order))):
            is_seen, low, high, near = _span(hull[j], velocity[order[j]], frame, corners)
            if is_seen:
                seen[n_seen] = j
                spans[n_seen, 0], spans[n_seen, 1], spans[n_seen, 2] = low, high, near
                n_seen += 1
    return n_seen


@helper
def _slab(far: float, around: float, frame: F64) -> float:
    """Height above the plane of a line from which on no shot gets, within a distance."""
    reach = far + frame[_STRAY]
    return around + frame[_STRAY_OUT] + frame[_TILT] * reach + 1e-5 + 1e-6 * far


@helper
def _span(hull: F64, velocity: F64, frame: F64, corners: F64) -> tuple[bool, float, float, float]:
    """Tell whether shots of a line can meet a body, and within which angles (diamond), and from which distance on."""
    around = hull[9] + frame[_HALF_TIME] * np.sqrt(velocity[0] * velocity[0] + velocity[1] * velocity[1])
    far = 0.0
    for corner in range(3):
        x = hull[3 * corner] + velocity[0] * frame[_TIME] - frame[9]
        y = hull[3 * corner + 1] + velocity[1] * frame[_TIME] - frame[10]
        z = hull[3 * corner + 2] - frame[11]
        far = max(far, x * x + y * y + z * z)
        corners[corner, 0] = x * frame[0] + y * frame[1] + z * frame[2]
        corners[corner, 1] = x * frame[3] + y * frame[4] + z * frame[5]
        corners[corner, 2] = x * frame[6] + y * frame[7] + z * frame[8]
    far = np.sqrt(far) + around
    top = _slab(far, around, frame)
    if min(corners[0, 0], corners[1, 0], corners[2, 0]) > top:
        return False, 0.0, 0.0, 0.0
    if max(corners[0, 0], corners[1, 0], corners[2, 0]) < -top:
        return False, 0.0, 0.0, 0.0
    margin = around + frame[_STRAY] + 1e-5 + 1e-6 * far
    low, high, near, middle = np.inf, -np.inf, np.inf, np.nan
    # what is left between the two heights is convex, its corners lie on the edges, the outermost angles at corners
    for corner in range(3):
        other = (corner + 1) % 3
        h, rise = corners[corner, 0], corners[other, 0] - corners[corner, 0]
        start, stop = 0.0, 1.0
        if rise != 0.0:
            one, two = (-top - h) / rise, (top - h) / rise
            start, stop = max(start, min(one, two)), min(stop, max(one, two))
        elif abs(h) > top:
            continue
        if start > stop:
            continue
        for way in (start, stop):
            u = corners[corner, 1] + way * (corners[other, 1] - corners[corner, 1])
            v = corners[corner, 2] + way * (corners[other, 2] - corners[corner, 2])
            distance = np.sqrt(u * u + v * v)
            near = min(near, distance - margin)
            if distance <= margin * 1.0001:
                return True, 0.0, 4.0, 0.0
            # the angle of a disc; a step of the diamond is never longer than that of the angle
            width = margin / np.sqrt(distance * distance - margin * margin) + 1e-9
            here = _diamond(u, v)
            if np.isnan(middle):
                middle = here
            here -= 4.0 * np.floor((here - middle + 2.0) / 4.0)
            low = min(low, here - width)
            high = max(high, here + width)
    if high - low > 1.999:  # all around the scanner
        return True, 0.0, 4.0, 0.0
    return low <= high, low, high, near


@helper
def _cast_triangle(rays: F64, start: int, stop: int, velocity: F64, ready: F64, b: int, t: F64, body: I32) -> None:
    """Intersect a window of shots with a triangle (Möller and Trumbore 1997, with the normal prepared)."""
    ax, ay, az, ux, uy, uz = ready[0], ready[1], ready[2], ready[3], ready[4], ready[5]
    vx, vy, vz, nx, ny, nz = ready[6], ready[7], ready[8], ready[9], ready[10], ready[11]
    flat = _FLAT * ready[12]
    for i in range(start, stop):
        x = ax - (rays[0, i] - velocity[0] * rays[6, i])
        y = ay - (rays[1, i] - velocity[1] * rays[6, i])
        z = az - rays[2, i]
        dx, dy, dz = rays[3, i], rays[4, i], rays[5, i]
        slope = dx * nx + dy * ny + dz * nz
        if not abs(slope) > flat:
            continue
        here = (x * nx + y * ny + z * nz) / slope
        if not (here > rays[7, i] and (here < t[i] or (here == t[i] and b < body[i]))):
            continue
        qx, qy, qz = y * dz - z * dy, z * dx - x * dz, x * dy - y * dx
        u = (ux * qx + uy * qy + uz * qz) / slope
        v = (vx * qx + vy * qy + vz * qz) / slope
        # v is the share of the first edge, minus u that of the second
        if u <= _EDGE and v >= -_EDGE and v - u <= 1.0 + _EDGE:
            t[i] = here
            body[i] = b


@helper
def _cast_round(
    rays: F64, start: int, stop: int, velocity: F64, ready: F64, shape: int, b: int, t: F64, body: I32
) -> None:
    """Intersect a window of shots with the surface of a cone, an ellipsoid or a box."""
    for i in range(start, stop):
        low, high, _, _ = _cut(rays[:, i], velocity, ready, shape)
        here = low if low > rays[7, i] else high
        if here > rays[7, i] and (here < t[i] or (here == t[i] and b < body[i])) and here < np.inf:
            t[i] = here
            body[i] = b


@helper
def _cut(ray: F64, velocity: F64, ready: F64, shape: int) -> tuple[float, float, float, float]:
    """Return where a shot meets a body, nearest first (inf = not), and the cosines of incidence there."""
    x = ray[0] - velocity[0] * ray[6] - ready[0]
    y = ray[1] - velocity[1] * ray[6] - ready[1]
    z = ray[2] - ready[2]
    if shape == _CONE:
        return _cut_cone(x, y, z, ray[3], ray[4], ray[5], ready)
    cos, sin = ready[6], ready[7]
    x, y = cos * x + sin * y, cos * y - sin * x
    dx, dy = cos * ray[3] + sin * ray[4], cos * ray[4] - sin * ray[3]
    if shape == _ELLIPSOID:
        return _cut_ellipsoid(x, y, z, dx, dy, ray[5], ready)
    return _cut_box(x, y, z, dx, dy, ray[5], ready)


@helper
def _roots(a: float, b: float, c: float) -> tuple[float, float]:
    """Solve a t^2 + 2 b t + c = 0 without loss of digits, the smaller first; NaN or infinite where there is none."""
    square = b * b - a * c
    if not square >= 0.0:
        return np.nan, np.nan
    q = -(b + np.sqrt(square)) if b > 0.0 else np.sqrt(square) - b
    one, two = q / a, c / q
    if one < two:
        return one, two
    return two, one


@helper
def _cut_cone(
    x: float, y: float, z: float, dx: float, dy: float, dz: float, ready: F64
) -> tuple[float, float, float, float]:
    along = x * ready[3] + y * ready[4] + z * ready[5]
    rise = dx * ready[3] + dy * ready[4] + dz * ready[5]
    radius, widening = ready[7] + ready[8] * along, ready[8] * rise
    a = dx * dx + dy * dy + dz * dz - rise * rise - widening * widening
    b = x * dx + y * dy + z * dz - along * rise - widening * radius
    c = x * x + y * y + z * z - along * along - radius * radius
    low, high = _roots(a, b, c)
    low_on = 0.0 <= along + low * rise <= ready[6]
    high_on = 0.0 <= along + high * rise <= ready[6]
    slant = np.sqrt(1.0 + ready[8] * ready[8])
    low_cos = abs(b + low * a) / ((radius + widening * low) * slant)
    high_cos = abs(b + high * a) / ((radius + widening * high) * slant)
    return low if low_on else np.inf, high if high_on else np.inf, low_cos, high_cos


@helper
def _cut_ellipsoid(
    x: float, y: float, z: float, dx: float, dy: float, dz: float, ready: F64
) -> tuple[float, float, float, float]:
    p, q, r = ready[3], ready[4], ready[5]
    x, y, z, dx, dy, dz = x / p, y / q, z / r, dx / p, dy / q, dz / r
    a = dx * dx + dy * dy + dz * dz
    b = x * dx + y * dy + z * dz
    low, high = _roots(a, b, x * x + y * y + z * z - 1.0)
    nx, ny, nz = (x + low * dx) / p, (y + low * dy) / q, (z + low * dz) / r
    low_cos = abs(b + low * a) / np.sqrt(nx * nx + ny * ny + nz * nz)
    nx, ny, nz = (x + high * dx) / p, (y + high * dy) / q, (z + high * dz) / r
    high_cos = abs(b + high * a) / np.sqrt(nx * nx + ny * ny + nz * nz)
    return low, high, low_cos, high_cos


@helper
def _cut_box(
    x: float, y: float, z: float, dx: float, dy: float, dz: float, ready: F64
) -> tuple[float, float, float, float]:
    low, high, low_cos, high_cos = -np.inf, np.inf, 0.0, 0.0
    for place, step, half in ((x, dx, ready[3]), (y, dy, ready[4]), (z, dz, ready[5])):
        if step == 0.0:
            if abs(place) > half:
                return np.inf, np.inf, 0.0, 0.0
            continue
        one, two = (-half - place) / step, (half - place) / step
        if min(one, two) > low:
            low, low_cos = min(one, two), abs(step)
        if max(one, two) < high:
            high, high_cos = max(one, two), abs(step)
    if low > high:
        return np.inf, np.inf, 0.0, 0.0
    return low, high, low_cos, high_cos


@helper
def _facing(ray: F64, velocity: F64, ready: F64, shape: int, t: float) -> float:
    """Return the cosine of incidence of a shot on the surface that it has met."""
    if shape == _TRIANGLE:
        return abs(ray[3] * ready[9] + ray[4] * ready[10] + ray[5] * ready[11]) / ready[12]
    low, _, low_cos, high_cos = _cut(ray, velocity, ready, shape)
    cosine = low_cos if low == t else high_cos
    return cosine if cosine < 1.0 else 1.0


@helper
def _mix(x: np.uint64) -> np.uint64:
    """Mix the bits of a number (the finaliser of SplitMix64, Steele et al. 2014)."""
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return x ^ (x >> np.uint64(31))


@helper
def _chance(x: np.uint64) -> float:
    """Turn a number into one from 0 to below 1."""
    return np.float64(np.int64(_mix(x) >> np.uint64(11))) * 2.0**-53


@helper
def _leaf_key(number: float, shot: int, t_min: float) -> np.uint64:
    """Return what seeds the way of a shot through the leaves of a body."""
    body = _mix(np.uint64(np.int64(number)) + _BODY)
    cast = np.uint64(np.int64(np.floor(t_min * 1024.0)))
    return _mix(body ^ _mix(np.uint64(shot) + _SHOT)) ^ (cast * _CAST)


@helper
def _cast_leaves(
    ray: F64,
    shot: int,
    velocity: F64,
    ready: F64,
    shape: int,
    b: int,
    leaves: tuple[float, float],
    quantiles: F64,
    t: F64,
    body: I32,
    i: int,
) -> None:
    """Send a shot through a body that is filled with leaves, from cell to cell of its lattice."""
    if not ray[7] < _FARTHEST_M:
        return
    enter, leave, _, _ = _cut(ray, velocity, ready, shape)
    now = max(enter, ray[7])
    if not (enter < leave and now < leave and now <= t[i]):
        return
    x = ray[0] - velocity[0] * ray[6] - ready[0]
    y = ray[1] - velocity[1] * ray[6] - ready[1]
    z = ray[2] - ready[2]
    cos, sin = ready[6], ready[7]
    x, y = cos * x + sin * y, cos * y - sin * x
    dx, dy, dz = cos * ray[3] + sin * ray[4], cos * ray[4] - sin * ray[3], ray[5]
    number, rate = leaves
    key = _mix(np.uint64(np.int64(number)) + _BODY)
    chance = _mix(_leaf_key(number, shot, ray[7]) + _PATH)
    left = quantiles[np.int64(chance >> np.uint64(11)) % len(quantiles)]
    p, q, r = np.floor((x + now * dx) / _CELL_M), np.floor((y + now * dy) / _CELL_M), np.floor((z + now * dz) / _CELL_M)
    while now <= t[i]:
        # where the shot leaves the cell on each side
        u = ((p + 1.0 if dx > 0.0 else p) * _CELL_M - x) / dx if dx != 0.0 else np.inf
        v = ((q + 1.0 if dy > 0.0 else q) * _CELL_M - y) / dy if dy != 0.0 else np.inf
        w = ((r + 1.0 if dz > 0.0 else r) * _CELL_M - z) / dz if dz != 0.0 else np.inf
        then = min(min(u, v), min(w, leave))
        cell = np.uint64(np.int64(p)) * _X + np.uint64(np.int64(q)) * _Y + np.uint64(np.int64(r)) * _Z
        clump = _chance(key ^ cell)
        thickness = rate * (4.0 * clump * clump * clump)
        gain = thickness * max(then - now, 0.0)
        if gain >= left:
            here = min(now + left / thickness, then)
            if here < t[i] or (here == t[i] and b < body[i]):
                t[i] = here
                body[i] = b
            return
        if then >= leave:
            return
        left -= gain
        now = max(now, then)
        if then == u:
            p += 1.0 if dx > 0.0 else -1.0
        elif then == v:
            q += 1.0 if dy > 0.0 else -1.0
        else:
            r += 1.0 if dz > 0.0 else -1.0


@kernel(
    "Tuple((float64[:, ::1], int32[:, ::1], float64[:, ::1]))"
    "(float64[:, :, ::1], float64[:, :, ::1], float64[:, ::1], float64[:, ::1], int64,"
    " uint8[::1], float64[:, ::1], float64[:, ::1], float64[::1], float64[:, ::1], float64[::1],"
    " int64[::1], float64[::1])"
)
def cast_shots(
    origin: F64,
    direction: F64,
    time_s: F64,
    t_min: F64,
    first_shot: int,
    shape: U8,
    numbers: F64,
    turn: F64,
    density: F64,
    velocity: F64,
    number: F64,
    order: I64,
    quantiles: F64,
) -> tuple[F64, I32, F64]:
    """Find the nearest surface of every shot; of surfaces at one place, that of the first body.

    Parameters
    ----------
    origin, direction : (lines, M, 3) float64
        Where the shots begin [m], and where they go (unit vectors); any, but quick only where those of a line lie
        nearly in a plane.
    time_s : (lines, M) float64
        When they are shot [s].
    t_min : (lines, M) float64
        Only what lies behind this is met [m], zero or above; from 1e9 on the shot is not cast.
    first_shot : int
        Number of the first shot, counted from the beginning of the scan; it seeds the leaves.
    shape, numbers, density, velocity, number : (n, ...)
        As in :class:`prc_cli.simulation.world.Bodies`.
    turn : (n, 2) float64
        Cosine and sine of the yaw of ellipsoids and boxes.
    order : (n,) int64
        Every body once, neighbours beside each other. It decides how quick the search is, and nothing else.
    quantiles : (2^k,) float64
        Exponential numbers of mean 1, equally likely.

    Returns
    -------
    t : (lines, M) float64
        Range [m]; inf = nothing.
    body : (lines, M) int32
        Which body, -1 = none.
    facing : (lines, M) float64
        Cosine of the angle of incidence; 0 = nothing.

    Notes
    -----
    A shot in leaves meets a clump in every cell of a lattice, of a density between none and four times that of the
    body (mean one, 4 u^3 with u uniform); it ends where the density on its way, halved since leaves face everywhere,
    adds up to an exponential number.
    """
    n_lines, n_columns = time_s.shape
    t = np.full((n_lines, n_columns), np.inf)
    body = np.full((n_lines, n_columns), -1, np.int32)
    facing = np.zeros((n_lines, n_columns))
    n = len(order)
    if n == 0 or n_lines == 0 or n_columns == 0:
        return t, body, facing
    hull, ready, place = _prepare_all(shape, numbers, turn, order)
    groups = _bound_groups(hull, velocity, order, time_s)
    rays = np.empty((8, n_columns))  # one row per number, so that a window of columns is read in one go
    angle = np.empty(n_columns)
    frame = np.empty(_N_FRAME)
    first = np.empty(2 * n_columns, np.int64)
    last = np.empty(2 * n_columns, np.int64)
    seen = np.empty(n, np.int64)
    spans = np.empty((n, 3))
    corners = np.empty((3, 3))
    for line in range(n_lines):
        shot = first_shot + line * n_columns
        _read_line(origin[line], direction[line], time_s[line], t_min[line], rays)
        _measure_line(rays, frame, angle)
        _tabulate(angle, frame, first, last)
        n_seen = _look_around(groups, hull, velocity, order, frame, corners, seen, spans)
        crowns = np.empty(n_seen, np.int64)
        n_crowns = 0
        for k in range(n_seen):
            j = seen[k]
            b = order[j]
            if shape[b] >= _ELLIPSOID and density[b] > 0.0:
                crowns[n_crowns] = k
                n_crowns += 1
                continue
            low, high = spans[k, 0], spans[k, 1]
            for turns in range(_first_turn(high, frame), _last_turn(low, frame) + 1):
                start, stop = _columns(low + 4.0 * turns, high + 4.0 * turns, frame, first, last)
                if shape[b] == _TRIANGLE:
                    _cast_triangle(rays, start, stop, velocity[b], ready[j], b, t[line], body[line])
                else:
                    _cast_round(rays, start, stop, velocity[b], ready[j], shape[b], b, t[line], body[line])
        # the nearest crowns first: no way through leaves is walked that lies behind a hit
        for k in crowns[:n_crowns][np.argsort(spans[crowns[:n_crowns], 2])]:
            j = seen[k]
            b = order[j]
            low, high = spans[k, 0], spans[k, 1]
            leaves = (number[b], 0.5 * density[b])
            for turns in range(_first_turn(high, frame), _last_turn(low, frame) + 1):
                start, stop = _columns(low + 4.0 * turns, high + 4.0 * turns, frame, first, last)
                for i in range(start, stop):
                    _cast_leaves(
                        rays[:, i],
                        shot + i,
                        velocity[b],
                        ready[j],
                        shape[b],
                        b,
                        leaves,
                        quantiles,
                        t[line],
                        body[line],
                        i,
                    )
        for i in range(n_columns):
            b = np.int64(body[line, i])
            if b >= 0:
                if shape[b] >= _ELLIPSOID and density[b] > 0.0:
                    facing[line, i] = np.sqrt(_chance(_leaf_key(number[b], shot + i, rays[7, i]) + _LEAF))
                else:
                    facing[line, i] = _facing(rays[:, i], velocity[b], ready[place[b]], shape[b], t[line, i])
    return t, body, facing

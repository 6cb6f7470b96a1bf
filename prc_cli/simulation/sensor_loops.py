"""Loops of the simulated sensor: echoes, their mixture, loss, noise and stray light.

Random numbers are hashes of seed, line, column and purpose, so that they depend on nothing else.
Powers are in 1/m²: share of the light that comes back from a surface, times the cosine of
incidence, over the square of the range.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from prc_cli.core.loops import helper, loop
from prc_cli.core.types import (
    F32,
    F32_1,
    F32_2,
    F64,
    F64_1,
    F64_2,
    I32,
    I32_2,
    U8,
    U8_1,
    U8_2,
    Mask_2,
)
from prc_cli.simulation.casting_loops import mix
from prc_cli.simulation.thresholds import Hits, SensorModel

GLASS = 1
LEAVED = 2
CURVED = 4
"""Bits of a body."""
LABEL_MISSING = 0
LABEL_NOISE = 2
"""As in :class:`prc_cli.core.classes.Label`; the compiler takes no enumerations."""

(
    _FOR_NOISE,
    _FOR_LOSS,
    _FOR_STRAY,
    _FOR_PLACE,
    _FOR_GLASS,
    _FOR_LEAVES,
    _FOR_EDGE,
    _FOR_ECHO,
    _FOR_SKY,
) = range(9)
_WHITE = 0.9
"""Reflectance of what data sheets call white."""
_FLASH = 0.9986
"""Cosine of three degrees: glass at nearly normal incidence mirrors the beam back."""
_SKY_COLUMNS = 24
_SKY_LINES = 100
"""Bright patches of the sky: number in a line, and lines of each."""

_GHOST_REFLECTANCE = 0.1
"""Of what a pane mirrors, with the loss at the pane, twice."""
_NOTHING = 128
"""Bit of a shot that meets nothing."""
_T, _POWER, _SLOPE, _LABEL, _N_ECHO = range(5)
"""Range, power, tangent of incidence, label: columns of echoes, first rows of a line's shots."""
_STEEP, _BEFORE, _AFTER, _N_WORK = range(4, 8)
"""Further rows: slope of flat surfaces, shares of the beam on the surfaces of the shots beside
it."""


class _Hit(NamedTuple):
    """A surface that one shot meets."""

    t: float
    """Range [m]."""
    body: int
    """Row in the bodies, -1 = none."""
    facing: float
    """Cosine of the angle of incidence."""


@helper
def _key(seed: int, line: int) -> np.uint64:
    return mix(mix(np.uint64(seed)) + np.uint64(line) * np.uint64(0x9E3779B97F4A7C15))


@helper
def _draw(key: np.uint64, column: int, purpose: int) -> float:
    """Return a number in 0..1 for a shot and a purpose."""
    bits = (
        key
        + np.uint64(column) * np.uint64(0xD1B54A32D192ED03)
        + np.uint64(purpose) * np.uint64(0x8CB92BA72F3D8DD7)
    )
    return float(mix(bits) >> np.uint64(11)) * 2.0**-53


@helper
def _normal(uniform: float, quantiles: F64) -> float:
    """Return the quantile of the standard normal law, from a table."""
    place = uniform * (quantiles.shape[0] - 1)
    i = int(place)
    return float(quantiles[i] + (place - i) * (quantiles[i + 1] - quantiles[i]))


@helper
def _cosine(facing: float) -> float:
    return min(max(abs(facing), 0.02), 1.0)


@helper
def _slope(facing: float) -> float:
    cosine = _cosine(facing)
    return float(np.sqrt(1.0 - cosine * cosine) / cosine)


@helper
def _goes_on(
    key: np.uint64,
    column: int,
    bits: int,
    facing: float,
    model: SensorModel,
) -> bool:
    if bits & GLASS:
        return (
            abs(facing) < _FLASH
            and _draw(key, column, _FOR_GLASS) >= model.pane_share + model.ghost_share
        )
    return (
        bits & LEAVED != 0
        and model.max_returns > 1
        and _draw(key, column, _FOR_LEAVES) < model.leaves_share
    )


@helper
def _prepare(
    t: F64,
    body: I32,
    facing: F64,
    surface: F64,
    kind: U8,
    model: SensorModel,
    work: F64,
    bits: U8,
) -> None:
    """Write power, slope and label of the surface of every shot of a line, and its bits."""
    for column in range(t.shape[0]):
        b = body[column]
        if b < 0:
            bits[column] = _NOTHING
            work[_T, column] = np.inf
            continue
        bits[column] = kind[b, 1]
        work[_T, column] = t[column]
        work[_LABEL, column] = kind[b, 0]
        work[_POWER, column] = surface[b, 0] * _cosine(facing[column]) / (t[column] * t[column])
        slope = _slope(facing[column])
        work[_SLOPE, column] = 0.0 if kind[b, 1] & LEAVED else slope
        # slanted planes have steps too; the slope of round bodies and leaves is not that of their
        # edge
        work[_STEEP, column] = 0.0 if kind[b, 1] & (LEAVED | CURVED) else slope


@helper
def _split(
    key: np.uint64,
    body: I32,
    work: F64,
    bits: U8,
    model: SensorModel,
) -> None:
    """Write the shares of every beam, up to half, that fall on the surfaces of the adjacent shots.

    An edge lies anywhere between two shots, each of which it splits if it is within its width.
    """
    m = body.shape[0]
    for column in range(m):
        work[_BEFORE, column] = 0.0
        work[_AFTER, column] = 0.0
    for column in range(m - 1):
        both = bits[column] | bits[column + 1]
        if both & GLASS or bits[column] & bits[column + 1] & _NOTHING:
            continue
        near = min(work[_T, column], work[_T, column + 1])
        if not both & _NOTHING:
            gap = abs(work[_T, column + 1] - work[_T, column])
            if gap <= model.edge_m or (body[column] == body[column + 1] and not both & LEAVED):
                continue
            steepest = max(work[_STEEP, column], work[_STEEP, column + 1])
            if gap <= model.edge_m + 2.0 * model.step_rad * near * steepest:
                continue
        beside = _draw(key, column, _FOR_EDGE)
        shots_apart = model.step_rad * near / (model.exit_m + model.divergence * near)
        work[_AFTER, column] = max(0.5 - beside * shots_apart, 0.0)
        work[_BEFORE, column + 1] = max(0.5 - (1.0 - beside) * shots_apart, 0.0)


@helper
def _pane_echo(
    key: np.uint64,
    column: int,
    facing: float,
    mirrored: float,
    work: F64,
    model: SensorModel,
    echo: F64,
) -> int:
    """Write the echo of glass or of its mirror image; return the number of echoes, 0 or 1."""
    t = work[_T, column]
    echo[0, _T] = t
    echo[0, _POWER] = work[_POWER, column]
    echo[0, _SLOPE] = work[_SLOPE, column]
    echo[0, _LABEL] = work[_LABEL, column]
    if abs(facing) >= _FLASH:
        echo[0, _POWER] = _cosine(facing) / (t * t)
        return 1
    chance = _draw(key, column, _FOR_GLASS)
    if chance >= model.pane_share + model.ghost_share:
        return 0
    if chance >= model.pane_share:
        # mirrored objects seem to lie behind the pane, as far as they are in front; the same for
        # the whole pane
        echo[0, _T] = t * (1.3 + 1.7 * mirrored)
        echo[0, _POWER] = _GHOST_REFLECTANCE / (echo[0, _T] * echo[0, _T])
        echo[0, _SLOPE] = 0.0
        echo[0, _LABEL] = LABEL_NOISE
    return 1


@helper
def _add_echo(
    echo: F64,
    n: int,
    t: float,
    power: float,
    slope: float,
    label: int,
) -> int:
    """Insert an echo by range; return their number."""
    i = n
    while i > 0 and echo[i - 1, _T] > t:
        for j in range(_N_ECHO):
            echo[i, j] = echo[i - 1, j]
        i -= 1
    echo[i, _T] = t
    echo[i, _POWER] = power
    echo[i, _SLOPE] = slope
    echo[i, _LABEL] = label
    return n + 1


@helper
def _merge(echo: F64, n: int, model: SensorModel) -> int:
    """Merge echoes that the scanner cannot separate; return their number."""
    kept = 0
    for i in range(1, n):
        gap = echo[i, _T] - echo[kept, _T]
        if not model.is_cw and gap > model.pulse_m:
            kept += 1
            for j in range(_N_ECHO):
                echo[kept, j] = echo[i, j]
            continue
        share = echo[i, _POWER] / (echo[kept, _POWER] + echo[i, _POWER])
        if gap * (1.0 - share) <= model.edge_m:
            echo[kept, _SLOPE] = echo[i, _SLOPE]
            echo[kept, _LABEL] = echo[i, _LABEL]
        elif gap * share > model.edge_m:
            echo[kept, _SLOPE] = 0.0
            # between two leaves it is still the tree
            if echo[kept, _LABEL] != echo[i, _LABEL]:
                echo[kept, _LABEL] = LABEL_NOISE
        echo[kept, _T] += share * gap
        echo[kept, _POWER] += echo[i, _POWER]
    return min(kept + 1, n)


@helper
def _is_answered(power: float, chance: float, model: SensorModel) -> bool:
    # half of the echoes at the power of the half range are found; odds by its fourth power
    strength = power / model.half_power
    fourth = strength * strength * strength * strength
    return bool(chance * (1.0 + fourth) < fourth * (1.0 - model.lost_share))


@helper
def _sigma(
    power: float,
    t: float,
    slope: float,
    model: SensorModel,
) -> float:
    # noise of weak echoes, and of the depth that the beam spans on a slanted surface
    width = model.exit_m + model.divergence * t
    return float(
        model.noise_m
        + model.noise_per_m * np.sqrt(_WHITE / power)
        + model.noise_spread * width * slope
    )


@helper
def _brightness(
    seed: int,
    line: int,
    column: int,
    n_columns: int,
) -> float:
    """Return 0 for sky and 1 for bright sky, smooth from patch to patch."""
    i = line // _SKY_LINES
    v = (line - i * _SKY_LINES) / _SKY_LINES
    place = column * _SKY_COLUMNS / n_columns
    j = int(place)
    u = place - j
    before = _key(seed, i)
    after = _key(seed, i + 1)
    early = _draw(before, j, _FOR_SKY) * (1.0 - u) + _draw(before, j + 1, _FOR_SKY) * u
    late = _draw(after, j, _FOR_SKY) * (1.0 - u) + _draw(after, j + 1, _FOR_SKY) * u
    return min(max(6.0 * (early * (1.0 - v) + late * v) - 3.6, 0.0), 1.0)


@helper
def _rounded(t: float, model: SensorModel) -> float:
    steps = np.floor(t / model.resolution_m + 0.5) * model.resolution_m
    return steps if model.min_range_m <= steps <= model.max_range_m else np.nan


@loop()
def goes_behind(
    hits: Hits,
    kind: U8_2,
    model: SensorModel,
    first_line: int,
    seed: int,
) -> Mask_2:
    """Mark the shots whose light goes on behind the surface that it meets first.

    ``kind`` (n, 2) uint8; returns (lines, M) bool.
    """
    body = hits.body
    facing = hits.facing
    behind = np.zeros(body.shape, np.bool_)
    for i in range(body.shape[0]):
        key = _key(seed, first_line + i)
        for column in range(body.shape[1]):
            b = body[i, column]
            if b >= 0 and kind[b, 1] & (GLASS | LEAVED):
                behind[i, column] = _goes_on(key, column, kind[b, 1], facing[i, column], model)
    return behind


@helper
def _echoes(
    key: np.uint64,
    column: int,
    facing: float,
    behind: _Hit,
    body: I32,
    surface: F64,
    kind: U8,
    work: F64,
    bits: U8,
    model: SensorModel,
    echo: F64,
) -> int:
    """Write the echoes of a shot, from near to far; return their number."""
    n = 1
    if bits[column] & GLASS:
        n = _pane_echo(key, column, facing, surface[body[column], 1], work, model, echo)
    else:
        echo[0, _T] = work[_T, column]
        echo[0, _POWER] = work[_POWER, column]
        echo[0, _SLOPE] = work[_SLOPE, column]
        echo[0, _LABEL] = work[_LABEL, column]
    b = behind.body
    if b >= 0 and _goes_on(key, column, bits[column], facing, model):
        part = 0.6
        if n == 1:
            part = 0.2 + 0.6 * _draw(key, column, _FOR_ECHO)
            echo[0, _POWER] *= 1.0 - part
        power = part * (surface[b, 0] * _cosine(behind.facing) / (behind.t * behind.t))
        slope = 0.0 if kind[b, 1] & LEAVED else _slope(behind.facing)
        n = _add_echo(echo, n, behind.t, power, slope, kind[b, 0])
    side = -1 if work[_BEFORE, column] > 0.0 else 1
    share = work[_BEFORE, column] if side < 0 else work[_AFTER, column]
    if share > 0.0:
        for j in range(n):
            echo[j, _POWER] *= 1.0 - share
        beside = column + side
        if not bits[beside] & _NOTHING:
            power = share * work[_POWER, beside]
            n = _add_echo(
                echo, n, work[_T, beside], power, work[_SLOPE, beside], work[_LABEL, beside]
            )
    return _merge(echo, n, model)


@helper
def _measure(
    key: np.uint64,
    column: int,
    number: int,
    t: float,
    power: float,
    slope: float,
    model: SensorModel,
    quantiles: F64,
) -> tuple[float, bool]:
    """Return the measured range of an echo, NaN = not found, and whether it was wrapped."""
    if not _is_answered(power, _draw(key, column, _FOR_LOSS + 16 * number), model):
        return np.nan, False
    deviate = _normal(_draw(key, column, _FOR_NOISE + 16 * number), quantiles)
    t = t + deviate * _sigma(power, t, slope, model)
    wraps = model.ambiguity_m > 0.0 and t >= model.ambiguity_m
    if wraps:
        t -= np.floor(t / model.ambiguity_m) * model.ambiguity_m
    return _rounded(t, model), wraps


@helper
def _find(
    key: np.uint64,
    column: int,
    model: SensorModel,
    quantiles: F64,
    echo: F64,
    n: int,
) -> int:
    """Measure the echoes and keep those that are found, at most ``max_returns``."""
    n_found = 0
    for i in range(n):
        power = echo[i, _POWER]
        label = echo[i, _LABEL]
        t, wraps = _measure(key, column, i, echo[i, _T], power, echo[i, _SLOPE], model, quantiles)
        if np.isnan(t):
            continue
        # a scanner of one return takes the strongest
        if model.max_returns == 1 and n_found == 1:
            if power <= echo[0, _POWER]:
                continue
            n_found = 0
        if n_found < model.max_returns:
            echo[n_found, _T] = t
            echo[n_found, _POWER] = power
            echo[n_found, _LABEL] = LABEL_NOISE if wraps else label
            n_found += 1
    return n_found


@helper
def _stray(
    key: np.uint64,
    line: int,
    column: int,
    n_columns: int,
    seed: int,
    chance: float,
    is_sky: bool,
    model: SensorModel,
    quantiles: F64,
    echo: F64,
    n: int,
) -> int:
    """Let background light replace or move the range of a continuous wave; return n returns."""
    share = model.background_share
    if n == 0:
        share = model.sky_share
        if is_sky and model.bright_sky_share > 0.0:
            share += (model.bright_sky_share - share) * _brightness(seed, line, column, n_columns)
    elif share <= chance < share + model.cluster_share:
        off = _normal(_draw(key, column, _FOR_PLACE), quantiles) * model.cluster_m
        echo[0, _T] = _rounded(echo[0, _T] + off, model)
        if abs(off) > model.edge_m:
            echo[0, _LABEL] = LABEL_NOISE
        return 0 if np.isnan(echo[0, _T]) else n
    if chance >= share:
        return n
    reach = model.ambiguity_m if model.ambiguity_m > 0.0 else model.max_range_m
    echo[0, _T] = _rounded(_draw(key, column, _FOR_PLACE) * reach, model)
    echo[0, _POWER] = model.half_power
    echo[0, _LABEL] = LABEL_NOISE
    return 0 if np.isnan(echo[0, _T]) else 1


@helper
def _keep(
    line: int,
    column: int,
    echo: F64,
    j: int,
    place: int,
    extra: I32,
    ranges: F32,
    labels: U8,
    intensities: F32,
) -> None:
    extra[place, 0] = line
    extra[place, 1] = column
    ranges[place] = np.float32(echo[j, _T])
    labels[place] = np.uint8(echo[j, _LABEL])
    intensities[place] = np.float32(echo[j, _POWER] / (_WHITE / 100.0))


@loop()
def sense(
    hits: Hits,
    behind: Hits,
    surface: F64_2,
    kind: U8_2,
    model: SensorModel,
    quantiles: F64_1,
    first_line: int,
    seed: int,
) -> tuple[F32_2, U8_2, F32_2, I32_2, F32_1, U8_1, F32_1]:
    """Measure the surfaces that the beams of consecutive lines meet.

    ``surface`` (n, 2) float64; ``kind`` (n, 2) uint8; ``quantiles`` (k,) float64; returns
    ``range_m`` (lines, M) float32, ``label`` (lines, M) uint8, ``intensity`` (lines, M) float32,
    ``extra`` (e, 2) int32, ``extra_range_m`` (e,) float32, ``extra_label`` (e,) uint8,
    ``extra_intensity`` (e,) float32.
    """
    n_lines, m = hits.t.shape
    ranges = np.full((n_lines, m), np.float32(np.nan), np.float32)
    labels = np.zeros((n_lines, m), np.uint8)
    intensities = np.zeros((n_lines, m), np.float32)
    room = n_lines * m * 2 if model.max_returns > 1 else 0
    extra = np.empty((room, 2), np.int32)
    extra_range = np.empty(room, np.float32)
    extra_label = np.empty(room, np.uint8)
    extra_intensity = np.empty(room, np.float32)
    n_extra = 0
    echo = np.empty((4, _N_ECHO))
    work = np.empty((_N_WORK, m))
    bits = np.empty(m, np.uint8)
    looks_behind = behind.t.shape[0] == n_lines
    splits = GLASS | LEAVED if model.max_returns > 1 else GLASS
    stray_with = model.background_share + model.cluster_share
    stray_without = max(model.sky_share, model.bright_sky_share)
    for i in range(n_lines):
        key = _key(seed, first_line + i)
        body = hits.body[i]
        _prepare(hits.t[i], body, hits.facing[i], surface, kind, model, work, bits)
        _split(key, body, work, bits, model)
        for column in range(m):
            n = 0
            is_there = not bits[column] & _NOTHING
            is_split = (
                bits[column] & splits != 0 or work[_BEFORE, column] + work[_AFTER, column] > 0.0
            )
            if is_there and is_split:
                t_behind = np.inf
                body_behind = -1
                facing_behind = 1.0
                if looks_behind and bits[column] & splits:
                    t_behind = behind.t[i, column]
                    body_behind = int(behind.body[i, column])
                    facing_behind = behind.facing[i, column]
                n = _echoes(
                    key,
                    column,
                    hits.facing[i, column],
                    _Hit(t_behind, body_behind, facing_behind),
                    body,
                    surface,
                    kind,
                    work,
                    bits,
                    model,
                    echo,
                )
                n = _find(key, column, model, quantiles, echo, n)
            elif is_there:
                power = work[_POWER, column]
                t, wraps = _measure(
                    key, column, 0, work[_T, column], power, work[_SLOPE, column], model, quantiles
                )
                if not np.isnan(t):
                    n = 1
                    echo[0, _T] = t
                    echo[0, _POWER] = power
                    echo[0, _LABEL] = LABEL_NOISE if wraps else work[_LABEL, column]
            if model.is_cw:
                # most shots do not stray
                chance = _draw(key, column, _FOR_STRAY)
                if chance < (stray_with if n > 0 else stray_without):
                    n = _stray(
                        key,
                        first_line + i,
                        column,
                        m,
                        seed,
                        chance,
                        bits[column] == _NOTHING,
                        model,
                        quantiles,
                        echo,
                        n,
                    )
            if n > 0:
                ranges[i, column] = np.float32(echo[0, _T])
                labels[i, column] = np.uint8(echo[0, _LABEL])
                intensities[i, column] = np.float32(echo[0, _POWER] / (_WHITE / 100.0))
            for j in range(1, n):
                _keep(i, column, echo, j, n_extra, extra, extra_range, extra_label, extra_intensity)
                n_extra += 1
    kept = slice(0, n_extra)
    further = (
        extra[kept].copy(),
        extra_range[kept].copy(),
        extra_label[kept].copy(),
        extra_intensity[kept].copy(),
    )
    return ranges, labels, intensities, *further

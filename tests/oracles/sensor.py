"""Slow and obvious twins of :mod:`prc_cli.simulation.sensor_loops`, shot by shot."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import floor, isnan, nan, sqrt

import numpy as np

from prc_cli.core.types import F32, F64, I32, U8, Mask
from prc_cli.simulation.thresholds import Hits, SensorModel

_PURPOSES = ("noise", "loss", "stray", "place", "glass", "leaves", "edge", "echo", "sky")
_WORD = 2**64 - 1
_WHITE = 0.9
_FLASH = 0.9986


@dataclass
class _Echo:
    t: float
    power: float
    slope: float
    label: int


@dataclass
class _Surface:
    """What one shot meets."""

    t: float
    body: int
    facing: float
    reflectance: float = 0.0
    mirrored: float = 0.0
    label: int = 0
    bits: int = 0
    is_glass: bool = field(init=False)
    is_leaf: bool = field(init=False)
    is_flat: bool = field(init=False)

    def __post_init__(self) -> None:
        self.is_glass, self.is_leaf = bool(self.bits & 1), bool(self.bits & 2)
        self.is_flat = not self.bits & 6

    def cosine(self) -> float:
        return float(np.clip(abs(self.facing), 0.02, 1.0))

    def tangent(self) -> float:
        return sqrt(1.0 - self.cosine() * self.cosine()) / self.cosine()

    def echo(self) -> _Echo:
        power = self.reflectance * self.cosine() / (self.t * self.t)
        return _Echo(self.t, power, 0.0 if self.is_leaf else self.tangent(), self.label)


def _scramble(x: int) -> int:
    x = ((x ^ (x >> 30)) * 0xBF58476D1CE4E5B9) & _WORD
    x = ((x ^ (x >> 27)) * 0x94D049BB133111EB) & _WORD
    return x ^ (x >> 31)


class _Dice:
    """Numbers in 0..1 of a line."""

    def __init__(self, seed: int, line: int) -> None:
        self.key = _scramble((_scramble(seed) + line * 0x9E3779B97F4A7C15) & _WORD)

    def throw(self, column: int, purpose: str, echo: int = 0) -> float:
        number = _PURPOSES.index(purpose) + 16 * echo
        bits = (self.key + column * 0xD1B54A32D192ED03 + number * 0x8CB92BA72F3D8DD7) & _WORD
        return (_scramble(bits) >> 11) / 2**53


def _surfaces(
    hits: Hits,
    i: int,
    surface: F64,
    kind: U8,
) -> list[_Surface | None]:
    surfaces: list[_Surface | None] = []
    for t, body, facing in zip(*(part[i].tolist() for part in hits), strict=True):
        if body < 0:
            surfaces.append(None)
        else:
            reflectance, mirrored = surface[body].tolist()
            surfaces.append(_Surface(t, body, facing, reflectance, mirrored, *kind[body].tolist()))
    return surfaces


def _looks_behind(
    surface: _Surface,
    dice: _Dice,
    column: int,
    model: SensorModel,
) -> bool:
    if surface.is_glass:
        return (
            abs(surface.facing) < _FLASH
            and dice.throw(column, "glass") >= model.pane_share + model.ghost_share
        )
    return (
        surface.is_leaf
        and model.max_returns > 1
        and dice.throw(column, "leaves") < model.leaves_share
    )


def goes_behind(
    hits: Hits,
    kind: U8,
    model: SensorModel,
    first_line: int,
    seed: int,
) -> Mask:
    """Mark the shots whose light goes on.

    See :func:`prc_cli.simulation.sensor_loops.goes_behind`.
    """
    behind = np.zeros(hits[0].shape, dtype=bool)
    blank = np.zeros((len(kind), 2))
    for i in range(len(behind)):
        dice = _Dice(seed, first_line + i)
        for column, surface in enumerate(_surfaces(hits, i, blank, kind)):
            behind[i, column] = surface is not None and _looks_behind(surface, dice, column, model)
    return behind


def _neighbour_share(
    line: list[_Surface | None],
    column: int,
    side: int,
    dice: _Dice,
    model: SensorModel,
) -> float:
    """Return the share of the beam on what the neighbour sees."""
    if not 0 <= column + side < len(line):
        return 0.0
    here = line[column]
    beside = line[column + side]
    seen = [hit for hit in (here, beside) if hit is not None]
    if not seen or any(hit.is_glass for hit in seen):
        return 0.0
    near = min(hit.t for hit in seen)
    if len(seen) == 2:
        gap = abs(seen[0].t - seen[1].t)
        is_one = seen[0].body == seen[1].body and not seen[0].is_leaf
        steepest = max([hit.tangent() for hit in seen if hit.is_flat], default=0.0)
        if (
            is_one
            or gap <= model.edge_m
            or gap <= model.edge_m + 2.0 * model.step_rad * near * steepest
        ):
            return 0.0
    place = dice.throw(min(column, column + side), "edge")
    away = place if side == 1 else 1.0 - place
    share = 0.5 - away * (model.step_rad * near / (model.exit_m + model.divergence * near))
    return share if share > 0.0 else 0.0


def _glass(
    surface: _Surface,
    dice: _Dice,
    column: int,
    model: SensorModel,
) -> list[_Echo]:
    pane = surface.echo()
    if abs(surface.facing) >= _FLASH:
        pane.power = surface.cosine() / (surface.t * surface.t)
        return [pane]
    chance = dice.throw(column, "glass")
    if chance < model.pane_share:
        return [pane]
    if chance < model.pane_share + model.ghost_share:
        t = surface.t * (1.3 + 1.7 * surface.mirrored)
        return [_Echo(t, 0.1 / (t * t), 0.0, 2)]
    return []


def _all_echoes(
    line: list[_Surface | None],
    column: int,
    behind: _Surface | None,
    dice: _Dice,
    model: SensorModel,
) -> list[_Echo]:
    here = line[column]
    if here is None:
        return []
    echoes = _glass(here, dice, column, model) if here.is_glass else [here.echo()]
    if behind is not None and _looks_behind(here, dice, column, model):
        share = 0.6
        if echoes:
            share = 0.2 + 0.6 * dice.throw(column, "echo")
            echoes[0].power *= 1.0 - share
        second = behind.echo()
        second.power = share * second.power
        echoes.append(second)
    for side in (-1, 1):
        share = _neighbour_share(line, column, side, dice, model)
        if share == 0.0:
            continue
        for echo in echoes:
            echo.power *= 1.0 - share
        beside_column = line[column + side]
        if beside_column is not None:
            beside = beside_column.echo()
            beside.power = share * beside.power
            echoes.append(beside)
        break
    return sorted(echoes, key=lambda echo: echo.t)


def _mixed(echoes: list[_Echo], model: SensorModel) -> list[_Echo]:
    """Merge echoes that the scanner cannot separate."""
    apart: list[_Echo] = []
    for echo in echoes:
        if not apart or (not model.is_cw and echo.t - apart[-1].t > model.pulse_m):
            apart.append(echo)
            continue
        near = apart[-1]
        share = echo.power / (near.power + echo.power)
        gap = echo.t - near.t
        to_far = gap * (1.0 - share)
        to_near = gap * share
        slope = near.slope
        label = near.label
        if to_far <= model.edge_m:
            slope = echo.slope
            label = echo.label
        elif to_near > model.edge_m:
            slope = 0.0
            label = label if label == echo.label else 2
        apart[-1] = _Echo(near.t + share * gap, near.power + echo.power, slope, label)
    return apart


def _given(t: float, model: SensorModel) -> float:
    rounded = float(floor(t / model.resolution_m + 0.5)) * model.resolution_m
    return rounded if model.min_range_m <= rounded <= model.max_range_m else nan


def _deviate(uniform: float, quantiles: F64) -> float:
    place = uniform * (len(quantiles) - 1)
    low, high = quantiles[floor(place) : floor(place) + 2].tolist()
    return float(low + (place - floor(place)) * (high - low))


def _returns(
    echoes: list[_Echo],
    dice: _Dice,
    column: int,
    model: SensorModel,
    quantiles: F64,
) -> list[_Echo]:
    returns = []
    for i, echo in enumerate(echoes):
        strength = echo.power / model.half_power
        odds = strength * strength * strength * strength
        if dice.throw(column, "loss", i) * (1.0 + odds) >= odds * (1.0 - model.lost_share):
            continue
        width = model.exit_m + model.divergence * echo.t
        sigma = (
            model.noise_m
            + model.noise_per_m * sqrt(_WHITE / echo.power)
            + model.noise_spread * width * echo.slope
        )
        t = echo.t + _deviate(dice.throw(column, "noise", i), quantiles) * sigma
        label = echo.label
        if model.ambiguity_m > 0 and t >= model.ambiguity_m:
            t = t - floor(t / model.ambiguity_m) * model.ambiguity_m
            label = 2
        t = _given(t, model)
        if not isnan(t):
            returns.append(_Echo(t, echo.power, 0.0, label))
    if model.max_returns == 1:
        return [max(returns, key=lambda echo: echo.power)] if returns else []
    return returns[: int(model.max_returns)]


def _bright(
    seed: int,
    line: int,
    column: int,
    m: int,
) -> float:
    patch = line // 100
    late = line % 100 / 100
    place = column * 24 / m
    j = floor(place)
    right = place - j
    corner = [[_Dice(seed, patch + a).throw(j + b, "sky") for b in (0, 1)] for a in (0, 1)]
    early, later = (pair[0] * (1.0 - right) + pair[1] * right for pair in corner)
    return float(np.clip(6.0 * (early * (1.0 - late) + later * late) - 3.6, 0.0, 1.0))


def _with_background(
    returns: list[_Echo],
    sky: float | None,
    dice: _Dice,
    column: int,
    model: SensorModel,
    quantiles: F64,
) -> list[_Echo]:
    """Let stray light in; ``sky`` is its brightness where the shot met nothing."""
    chance = dice.throw(column, "stray")
    place = dice.throw(column, "place")
    share = model.background_share if returns else model.sky_share
    if sky is not None and model.bright_sky_share > 0:
        share += (model.bright_sky_share - share) * sky
    if chance < share:
        t = _given(place * (model.ambiguity_m or model.max_range_m), model)
        return [] if isnan(t) else [_Echo(t, model.half_power, 0.0, 2)]
    if returns and chance < share + model.cluster_share:
        off = _deviate(place, quantiles) * model.cluster_m
        t = _given(returns[0].t + off, model)
        moved = _Echo(t, returns[0].power, 0.0, 2 if abs(off) > model.edge_m else returns[0].label)
        return [] if isnan(t) else [moved, *returns[1:]]
    return returns


def sense(
    hits: Hits,
    behind: Hits,
    surface: F64,
    kind: U8,
    model: SensorModel,
    quantiles: F64,
    first_line: int,
    seed: int,
) -> tuple[F32, U8, F32, I32, F32, U8, F32]:
    """Compute what the scanner measures; see :func:`prc_cli.simulation.sensor_loops.sense`."""
    n_lines, m = hits[0].shape
    first: list[_Echo] = []
    further: list[tuple[int, int, _Echo]] = []
    for i in range(n_lines):
        dice = _Dice(seed, first_line + i)
        line = _surfaces(hits, i, surface, kind)
        second = _surfaces(behind, i, surface, kind) if len(behind[0]) == n_lines else [None] * m
        for column, surface_here in enumerate(line):
            echoes = _mixed(_all_echoes(line, column, second[column], dice, model), model)
            returns = _returns(echoes, dice, column, model, quantiles)
            if model.is_cw:
                sky = _bright(seed, first_line + i, column, m) if surface_here is None else None
                returns = _with_background(returns, sky, dice, column, model, quantiles)
            first.append(returns[0] if returns else _Echo(nan, 0.0, 0.0, 0))
            further += [(i, column, echo) for echo in returns[1:]]

    def columns(echoes: list[_Echo]) -> tuple[F32, U8, F32]:
        intensity = [echo.power / (_WHITE / 100.0) for echo in echoes]
        return (
            np.array([echo.t for echo in echoes], dtype=np.float32),
            np.array([echo.label for echo in echoes], dtype=np.uint8),
            np.array(intensity, dtype=np.float32),
        )

    ranges, labels, intensities = (part.reshape(n_lines, m) for part in columns(first))
    place = np.array([[i, column] for i, column, _ in further], dtype=np.int32).reshape(-1, 2)
    return ranges, labels, intensities, place, *columns([echo for _, _, echo in further])  # type: ignore[return-value]

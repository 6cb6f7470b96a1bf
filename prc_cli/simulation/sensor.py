"""The nearest surface of every shot, and its measurement: ranges, labels, intensities, returns.

The model (the loops are in :mod:`sensor_loops`):

- An echo has a power, ``reflectance * cos(incidence) / range²``. Half of the echoes are found at
  the power of a white wall at the scanner's half range. The odds grow with the fourth power, so
  dark, grazing and far surfaces drop out.
- Range noise grows with the weakness of the echo, so with range, incidence and darkness alike, and
  with the depth that the beam's width spans on a slanted surface.
- Between two neighbours of a line with a step of range, there is an edge at a random place. A beam
  that is wide enough to reach it is split, so the share of split shots is the beam's width over the
  distance of the shots.
  A continuous wave gives a range in between, weighted by power; a pulse gives two returns, or a
  mixture if they are closer than the pulse is long. Only neighbours within the line count: a line
  depends on nothing but itself.
- Glass answers with the pane (always at normal incidence), with a ghost beyond it, or lets the
  light through.
- Background light gives a continuous wave a range from anywhere within the ambiguity interval, most
  often in a bright sky, and moves some ranges off their surface. Ranges beyond the interval come
  back wrapped.

A range that is not that of a surface is labelled NOISE; a mixture within ``edge_m`` of a surface is
that surface's, and one of two surfaces of the same label, such as two leaves, keeps it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from statistics import NormalDist

import numpy as np

from prc_cli.core.types import F32, F64, I32, U8, Mask
from prc_cli.simulation import sensor_loops
from prc_cli.simulation.casting_loops import cast_shots
from prc_cli.simulation.scanners import Scanner
from prc_cli.simulation.sensor_loops import sense
from prc_cli.simulation.thresholds import CastBodies, Hits, SensorModel
from prc_cli.simulation.world import PROPERTIES, Bodies, Material, Shape, hashed

_EXPONENTIAL: F64 = -np.log1p(-(np.arange(4096) + 0.5) / 4096)
_EXPONENTIAL /= _EXPONENTIAL.mean()
"""Quantiles of the exponential law of mean 1: every way through leaves is one of them."""


def cast(
    bodies: Bodies,
    origin_m: F64,
    direction: F64,
    time_s: F64,
    first_shot: int = 0,
    t_min_m: F64 | None = None,
) -> Hits:
    """Find the nearest surface of every shot; the first body wins a tie.

    Parameters
    ----------
    origin_m, direction : (lines, M, 3) float64
    time_s : (lines,) or (lines, M) float64 [s]
    first_shot : int
        Number of the first shot in the stream: it seeds the way through leaves.
    t_min_m : (lines, M) float64, optional
        Least range [m]; default 0.
    """
    shape = origin_m.shape[:2]
    times = np.asarray(time_s, dtype=np.float64)
    if times.ndim == 1:
        times = times[:, None]
    times = np.broadcast_to(times, shape)
    t_min = np.zeros(shape) if t_min_m is None else t_min_m
    yaw = np.where(bodies.shape >= Shape.ELLIPSOID, bodies.numbers[:, 6], 0.0)
    arrays = CastBodies(
        shape=np.require(bodies.shape, np.uint8, ["C", "W"]),
        numbers=_plain(bodies.numbers),
        turn=np.stack([np.cos(yaw), np.sin(yaw)], axis=1),
        density=_plain(bodies.density),
        velocity=_plain(bodies.velocity),
        number=_plain(bodies.number),
    )
    rays = _plain(origin_m), _plain(direction), _plain(times), _plain(t_min)
    return Hits(*cast_shots(*rays, first_shot, arrays, _EXPONENTIAL))


def _plain(numbers: F64) -> F64:
    return np.require(numbers, np.float64, ["C", "W"])


_GLASS = 1
_LEAVED = 2
_CURVED = 4
_QUANTILES = 4096


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """Measurements of consecutive lines."""

    range_m: F32
    """(lines, M) float32, nearest return [m]; NaN = missing."""
    label: U8
    """(lines, M) uint8, :class:`prc_cli.core.classes.Label` of the surface of the range."""
    intensity: F32
    """(lines, M) float32, power over that of a white wall at 10 m; 0 = missing."""
    extra_line: I32
    """(e,) int32, line within the block of every further return, sorted by line, column and
    range."""
    extra_column: I32
    """(e,) int32."""
    extra_range_m: F32
    """(e,) float32 [m]."""
    extra_label: U8
    """(e,) uint8."""
    extra_intensity: F32
    """(e,) float32."""


def goes_behind(
    hits: Hits,
    bodies: Bodies,
    scanner: Scanner,
    first_line: int,
    seed: int,
) -> Mask:
    """Mark shots that go through glass or past a leaf, (lines, M) bool.

    Cast them again from there and give the result to :func:`scan`.
    """
    _, kind = _about(bodies)
    mask: Mask = sensor_loops.goes_behind(hits, kind, _model(scanner), first_line, seed)
    return mask


def scan(
    hits: Hits,
    bodies: Bodies,
    scanner: Scanner,
    first_line: int,
    seed: int,
    behind: Hits | None = None,
) -> Measured:
    """Measure the surfaces that the beams meet."""
    surface, kind = _about(bodies)
    if behind is None:
        behind = Hits(np.empty((0, 0)), np.empty((0, 0), np.int32), np.empty((0, 0)))
    ranges, labels, intensities, extra, extra_range, extra_label, extra_intensity = sense(
        hits, behind, surface, kind, _model(scanner), _quantiles(), first_line, seed
    )
    return Measured(
        range_m=ranges,
        label=labels,
        intensity=intensities,
        extra_line=np.ascontiguousarray(extra[:, 0]),
        extra_column=np.ascontiguousarray(extra[:, 1]),
        extra_range_m=extra_range,
        extra_label=extra_label,
        extra_intensity=extra_intensity,
    )


def _about(bodies: Bodies) -> tuple[F64, U8]:
    """Return (reflectance, random number) and (label, bits) of bodies, (n, 2) each."""
    properties = [PROPERTIES[material] for material in Material]
    reflectance = np.array([material.reflectance for material in properties])
    label = np.array([material.label for material in properties], dtype=np.uint8)
    is_glass = np.array([material.is_glass for material in properties])
    # panes of one house have numbers close to each other, and mirror the same house across the
    # street
    mirrored = hashed(0, 32, bodies.number.astype(np.int64) // 32)
    surface = np.stack([reflectance[bodies.material], mirrored], axis=1)
    is_leaved = bodies.density > 0.0
    is_curved = (bodies.shape == Shape.CONE) | (bodies.shape == Shape.ELLIPSOID)
    bits = _GLASS * is_glass[bodies.material] + _LEAVED * is_leaved + _CURVED * is_curved
    return surface, np.stack([label[bodies.material], bits.astype(np.uint8)], axis=1)


def _model(scanner: Scanner) -> SensorModel:
    named = {name: getattr(scanner, name) for name in SensorModel._fields if hasattr(scanner, name)}
    return SensorModel(
        exit_m=scanner.exit_mm / 1000.0,
        divergence=scanner.divergence_mrad / 1000.0,
        half_power=0.9 / scanner.half_range_m**2,
        is_cw=scanner.principle == "cw",
        **named,
    )


@lru_cache(maxsize=1)
def _quantiles() -> F64:
    """Return quantiles of the standard normal law, (4097,) float64, both ends at 4.2."""
    law = NormalDist()
    inner = [law.inv_cdf(i / _QUANTILES) for i in range(1, _QUANTILES)]
    return np.array([-4.2, *inner, 4.2])

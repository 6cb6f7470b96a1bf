"""Road, pavements and the two rows of houses: everything of the street that is ruled by its plan."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from prc_cli.core.classes import Label
from prc_cli.core.types import F64, I64, U8, Mask
from prc_cli.simulation.rays import Hits, Rays, lattice

ROAD_HALF_M = 5.2
"""Crown of the road to the curb [m]; the outer two metres are for parking."""
CURB_M = 0.12
"""Height of the curb [m]."""
PAVEMENT_Z_M = 0.02 + CURB_M
FACADE_M = 8.8
"""Crown of the road to the nearest facades [m]."""
LOT_M = 16.0
"""Mean width of a lot [m]."""
_GUTTER_Z_M = -0.1
_STOREY_M, _PITCH_M = 3.2, 2.7
_RECESS_M = 0.18
_DEPTH_M = 13.0

_PROFILE = np.array(
    [
        (FACADE_M - 0.3, PAVEMENT_Z_M + 0.04),
        (ROAD_HALF_M + 0.02, _GUTTER_Z_M + CURB_M),
        (ROAD_HALF_M, _GUTTER_Z_M),
        (0.0, 0.0),
    ]
)
"""Corners of the ground from the facade to the crown of the road, (y, z) [m]."""


@dataclass(frozen=True, slots=True)
class Lots:
    """Consecutive lots on one side of a stretch of street, each in two parts: the house and the yard beside it."""

    index: I64
    """(n,) int64, number of the part along the street: even = house, odd = yard."""
    edge: F64
    """(n + 1,) float64, where parts begin and end [m]; the yards of terraced houses have no width."""
    built: Mask
    """(n,) bool, a house stands here."""
    hedged: Mask
    """(n,) bool, a hedge stands along the pavement; neither built nor hedged = a side street."""
    height: F64
    """(n,) float64, of the facade [m]."""
    setback: F64
    """(n,) float64, of the facade behind the building line [m]."""
    backdrop: F64
    """(n,) float64, distance of the next house behind an open lot, from the building line [m]; inf = none."""


def lots_between(seed: int, side: int, x_low: float, x_high: float) -> Lots:
    """Lay out the lots that a stretch of street touches.

    Quarters of four lots are either terraces at the pavement or single houses behind hedges, with side streets and
    gardens in between.

    Parameters
    ----------
    seed : int
        Of the street.
    side : int
        1 = left, -1 = right.
    x_low, x_high : float
        The stretch [m].
    """
    index = np.arange(int(x_low // LOT_M) - 1, int(x_high // LOT_M) + 3, dtype=np.int64)

    def chance(purpose: int, lots: I64 = index) -> F64:
        return lattice(seed, side, purpose, lots)

    borders = np.append(index, index[-1] + 1)
    edge = borders * LOT_M + (chance(0, borders) - 0.5) * 6.0
    house = chance(1) < 0.76
    garden = ~house & (chance(1) < 0.89)
    single = house & (chance(5, index // 4) < 0.55)
    yard = np.where(single, 3.5 + 2.5 * chance(6), 0.0)
    storeys = np.where(single, 2 + np.floor(chance(2) * 2), 3 + np.floor(chance(2) * 4))
    setback = np.where(single, 3.0, np.floor(chance(3) * 4) * 0.25)
    backdrop = np.where((single | garden) & (chance(7) < 0.6), np.inf, 20.0 + 30.0 * chance(4))
    parts = np.stack([2 * index, 2 * index + 1], axis=1)
    return Lots(
        index=parts.ravel(),
        edge=np.append(np.stack([edge[:-1], edge[1:] - yard], axis=1).ravel(), edge[-1]),
        built=np.stack([house, house & ~single], axis=1).ravel(),
        hedged=np.repeat(garden | single, 2),
        height=np.repeat(_STOREY_M * storeys + 1.0, 2),
        setback=np.repeat(setback, 2),
        backdrop=np.repeat(backdrop, 2),
    )


def cast_ground(rays: Rays, hits: Hits) -> None:
    """Let rays meet road, curbs, pavements and the open ground behind them; the same in every line."""
    left = np.vstack([(200.0, PAVEMENT_Z_M + 0.04), _PROFILE])
    right = left[::-1] * (-1.0, 1.0)
    corners = np.vstack([left, right[1:]])
    t = np.full(rays.dy.shape, np.inf)
    facing = np.ones(rays.dy.shape)
    for (y0, z0), (y1, z1) in zip(corners[:-1].tolist(), corners[1:].tolist(), strict=True):
        # normal of the piece in the plane across the street
        ny, nz = z1 - z0, y0 - y1
        length = float(np.hypot(ny, nz))
        slope = (ny * rays.dy + nz * rays.dz) / length
        reach = (ny * (y0 - rays.y) + nz * (z0 - rays.z)) / length / np.where(slope == 0, np.inf, slope)
        y = rays.y + reach * rays.dy
        on_piece = (reach > 0) & (reach < t) & (y <= y0) & (y >= y1)
        t = np.where(on_piece, reach, t)
        facing = np.where(on_piece, np.abs(slope), facing)
    shape = rays.x.shape
    hits.take_nearer(np.broadcast_to(t, shape), Label.GROUND, np.broadcast_to(facing, shape))


def cast_houses(rays: Rays, hits: Hits, seed: int, side: int, chance: F64) -> None:
    """Let rays meet the houses of one side: facades with windows, side walls along gaps, houses behind.

    Parameters
    ----------
    rays : Rays
        Shots of (lines, M).
    hits : Hits
        What they meet; filled in place.
    seed : int
        Of the street.
    side : int
        1 = left, -1 = right.
    chance : (lines, M) float64
        A uniform random number per shot, for what lies behind window panes.
    """
    columns = _run_of(rays.dy * side > 0.02)
    rays, hits, chance = rays.part(slice(None), columns), hits.part(slice(None), columns), chance[:, columns]
    outward = rays.dy * side
    lots = lots_between(seed, side, float(rays.x[0, 0]) - 40.0, float(rays.x[-1, -1]) + 60.0)

    distance = FACADE_M - side * rays.y
    lot = _lot_at(lots, rays.x + distance / outward * rays.dx)
    t = (distance + lots.setback[lot]) / outward
    z = rays.z + t * rays.dz
    facade = lots.built[lot] & (z < lots.height[lot])
    t_window, label = _windows(rays, lots, lot, t, outward, seed * 2 + (side > 0), chance)
    hits.take_nearer(np.where(facade, t_window, np.inf), label, outward)

    _cast_open_lots(rays, hits, lots, lot, distance, outward)


def _cast_open_lots(rays: Rays, hits: Hits, lots: Lots, lot: I64, distance: float, outward: F64) -> None:
    """Side walls of the neighbours along a gap, and the house at its far end."""
    # the wall ahead for rays that lean forward, the one behind for those that lean back
    ahead = (rays.dx > 0).astype(np.int64)
    edge = lots.edge[lot + ahead]
    neighbour = np.clip(lot + 2 * ahead - 1, 0, lots.index.size - 1)
    t = (edge - rays.x) / np.where(np.abs(rays.dx) < 1e-9, 1e-9, rays.dx)
    depth = t * outward - distance
    beside = ~lots.built[lot] & lots.built[neighbour] & (depth > lots.setback[neighbour]) & (depth < _DEPTH_M)
    beside &= rays.z + t * rays.dz < lots.height[neighbour]
    hits.take_nearer(np.where(beside, t, np.inf), Label.BUILDING, np.abs(rays.dx))

    t = (distance + lots.backdrop[lot]) / outward
    behind = ~lots.built[lot] & (rays.z + t * rays.dz < lots.height[lot])
    hits.take_nearer(np.where(behind, t, np.inf), Label.BUILDING, outward)


def _windows(
    rays: Rays, lots: Lots, lot: I64, t: F64, outward: F64, seed: int, chance: F64
) -> tuple[F64, U8]:  # fmt: skip
    """Range and label of shots at a facade once its windows are cut out; MISSING = swallowed by a pane.

    Returns
    -------
    (lines, M) float64, (lines, M) uint8
    """
    storey, column, inside = _opening(rays, lots, lot, t, 0.0)
    t_pane = t + _RECESS_M / outward
    _, _, clear = _opening(rays, lots, lot, t_pane, 0.06)
    pane = inside & clear
    state = lattice(seed, 7, lots.index[lot], storey, column)
    # most panes swallow the shot or mirror it away, some show a curtain, some the room behind
    depth = np.where(state < 0.5, 0.0, np.where(state < 0.75, 0.25, 0.6 + 20.0 * (state - 0.75)))
    # a shot that rises steeply meets the ceiling of the room before its back wall
    depth = np.minimum(depth, 0.8 * outward / np.maximum(np.abs(rays.dz), 1e-3))
    seen = pane & (state >= 0.5) & (chance < np.where(state < 0.75, 0.9, 0.45))
    result = np.where(inside, t_pane + np.where(pane, depth, 0.0) / outward, t)
    return result, np.where(pane & ~seen, Label.MISSING, Label.BUILDING).astype(np.uint8)


def _opening(rays: Rays, lots: Lots, lot: I64, t: F64, margin: float) -> tuple[I64, I64, Mask]:
    """Storey and window column of points on a facade, and whether they lie in the opening less a margin [m]."""
    x, z = rays.x + t * rays.dx, rays.z + t * rays.dz - PAVEMENT_Z_M
    storey = np.floor(z / _STOREY_M).astype(np.int64)
    v = z - storey * _STOREY_M
    width = lots.edge[lot + 1] - lots.edge[lot]
    along = x - lots.edge[lot] - 0.5 * np.fmod(width, _PITCH_M)
    column = np.floor(along / _PITCH_M).astype(np.int64)
    u = along - column * _PITCH_M
    shop = storey == 0
    low, high = np.where(shop, 0.5, 0.95), np.where(shop, 2.5, 2.55)
    half = np.where(shop, 1.1, 0.65) - margin
    inside = (v > low + margin) & (v < high - margin) & (np.abs(u - 0.5 * _PITCH_M) < half)
    # a window stands only where its whole column fits the facade, and below the parapet
    inside &= (column >= 0) & (along < width - np.fmod(width, _PITCH_M)) & (z < lots.height[lot] - 1.0)
    mullion = (np.abs(u - 0.5 * _PITCH_M) < 0.04) & (margin > 0)
    return storey, column, inside & ~mullion


def _lot_at(lots: Lots, x: F64) -> I64:
    found = np.searchsorted(lots.edge, x, side="right") - 1
    return np.clip(found, 0, lots.index.size - 1).astype(np.int64)


def _run_of(mask: Mask) -> slice:
    """Slice from the first to the last true entry of a mask that is true in one run."""
    found = np.flatnonzero(mask)
    return slice(int(found[0]), int(found[-1]) + 1) if found.size else slice(0, 0)

"""Pictures of point clouds: points go to a depth buffer, gaps are closed, edges shaded by depth.

The buffer holds one integer per pixel, depth in the upper and colour in the lower half, so that a
minimum selects the nearest point. The picture does not depend on the order of the points or on how
they were cut into chunks.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.types import F32, F64, U8, Mask

EMPTY = np.uint64(0xFFFF_FFFF_FFFF_FFFF)
FIELD_OF_VIEW_DEG = 38.0
"""Horizontal angle of the perspective."""
FRAMED = ((2.0, 98.0), (2.0, 98.0), (1.0, 99.0))
"""Percentiles of x, y, z in a view: the farthest 2 % of the shots need most of the room."""
WIDENED = (0.06, 0.06, 0.1)
"""Margin on every side, as a share of the extent between the percentiles, up to the last point.

Evenly spread points are all in view (0.02 / 0.96 of the extent would do)."""
MARGIN = 0.03
"""Free margin on every side, as a share of the view."""
AZIMUTHS_DEG = tuple(range(0, 360, 15))
"""Sides from which a perspective may be taken."""
USUAL_DEG = 215.0
"""Azimuth that is used unless another side fills the picture clearly better."""
_BETTER = 1.1
_TRIED = 20_000
"""Points that the sides are compared with."""
NARROWEST = 0.35
"""Least ratio of width to height, and of height to width, of a view from above.

Narrower clouds get wider margins.
"""
SHADE = 26.0
"""How strongly steps in depth darken."""
SAMPLE = 1 << 17
"""Points at least kept for framing."""


class Sample:
    """Every n-th point of a cloud of unknown size; n doubles when the sample is full."""

    def __init__(self, width: int, most: int = 2 * SAMPLE) -> None:
        self._rows: list[F64] = []
        self._width = width
        self._most = most
        self._step = 1
        self._n_seen = 0
        self._n = 0

    def add(self, rows: F64) -> None:
        """Add rows, (n, width) float64."""
        chosen = rows[(-self._n_seen) % self._step :: self._step]
        self._n_seen += len(rows)
        self._rows.append(np.array(chosen))
        self._n += len(chosen)
        while self._n > self._most:
            thinned = np.concatenate(self._rows)[::2]
            self._rows = [thinned]
            self._n = len(thinned)
            self._step *= 2

    @property
    def n_seen(self) -> int:
        """Rows added so far."""
        return self._n_seen

    def rows(self) -> F64:
        """Return the sample, (n, width) float64."""
        return np.concatenate(self._rows) if self._rows else np.empty((0, self._width))


def bounds(sample: F64) -> tuple[F64, F64]:
    """Return the corners, two (3,) float64 [m], of the box that a view of points (n, 3) frames.

    Far and stray points are outside.
    """
    ends = [np.percentile(sample[:, axis], FRAMED[axis]) for axis in range(3)]
    low, high = np.array(ends).T
    more = (high - low) * np.array(WIDENED)
    return np.maximum(low - more, sample.min(axis=0)), np.minimum(high + more, sample.max(axis=0))


def fullest_azimuth(
    sample: F64,
    elevation_deg: float,
    width: int,
    height: int,
) -> float:
    """Return the azimuth whose view a sample (n, 3) fills best, clockwise from north [deg]."""
    points = sample[:: max(1, len(sample) // _TRIED)]
    coarse = 160, max(1, 160 * height // width)

    def n_filled(azimuth_deg: float) -> int:
        view = Perspective.around(points, azimuth_deg, elevation_deg, *coarse)
        right, down, _ = view.project(points)
        seen = (right >= 0) & (right < view.size[0]) & (down >= 0) & (down < view.size[1])
        return len(
            np.unique(down[seen].astype(np.int64) * view.size[0] + right[seen].astype(np.int64))
        )

    best = max(AZIMUTHS_DEG, key=n_filled)
    return float(best) if n_filled(best) > _BETTER * n_filled(USUAL_DEG) else USUAL_DEG


class Camera(Protocol):
    """Projection of points into a picture."""

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the picture [pixels]."""

    def project(self, xyz: F64) -> tuple[F64, F64, F64]:
        """Return pixel coordinates right and down, and the depth [m], each (n,) float64."""

    def relief(self, depth: F64) -> F64:
        """Return depths on the scale on which steps are shaded."""


@dataclass(frozen=True, slots=True)
class FromAbove:
    """A view straight down, to scale, north (+y) at the top."""

    left: float
    top: float
    """Coordinates of the upper left corner [m]."""
    highest: float
    """Height from which depth counts [m]."""
    metres: float
    """Metres a pixel."""
    size: tuple[int, int]

    @classmethod
    def around(cls, sample: F64, width: int, height: int) -> FromAbove:
        """Return the view that holds nearly all points of a sample, (n, 3) float64 [m]."""
        low, high = bounds(sample)
        middle = (low + high) / 2
        half = np.maximum((high - low) / 2, 0.05) * (1 + 2 * MARGIN)
        half[:2] = np.maximum(half[:2], NARROWEST * half[1::-1])
        metres = float(max(2 * half[0] / width, 2 * half[1] / height))
        # a round pixel size is convenient, but the view should fill the picture
        size = (
            max(1, math.ceil(2 * half[0] / metres - 1e-9)),
            max(1, math.ceil(2 * half[1] / metres - 1e-9)),
        )
        left = middle[0] - size[0] * metres / 2
        top = middle[1] + size[1] * metres / 2
        return cls(float(left), float(top), float(sample[:, 2].max()) + 1.0, metres, size)

    def project(self, xyz: F64) -> tuple[F64, F64, F64]:
        """Return pixel coordinates right and down, and the depth [m], each (n,) float64."""
        depth = np.maximum(self.highest - xyz[:, 2], 1e-3)
        return (xyz[:, 0] - self.left) / self.metres, (self.top - xyz[:, 1]) / self.metres, depth

    def relief(self, depth: F64) -> F64:
        """Return depths relative to the size of the view, the scale on which steps are shaded."""
        return depth / (self.metres * max(self.size)) * 2.0


@dataclass(frozen=True, slots=True)
class Perspective:
    """A view with a vanishing point."""

    eye: F64
    """(3,) float64 [m]."""
    axes: F64
    """(3, 3) float64: right, down and forward."""
    focal: float
    """Pixels a unit of slope."""
    size: tuple[int, int]
    centre: tuple[float, float]

    @classmethod
    def around(
        cls,
        sample: F64,
        azimuth_deg: float,
        elevation_deg: float,
        width: int,
        height: int,
    ) -> Perspective:
        """Return the view from a direction with nearly all points of a sample (n, 3) float64."""
        low, high = bounds(sample)
        inside = sample[((sample >= low) & (sample <= high)).all(axis=1)]
        inside = inside if len(inside) else sample
        target = (inside.min(axis=0) + inside.max(axis=0)) / 2
        azimuth = math.radians(azimuth_deg)
        elevation = math.radians(elevation_deg)
        out = np.array(
            [
                math.sin(azimuth) * math.cos(elevation),
                math.cos(azimuth) * math.cos(elevation),
                math.sin(elevation),
            ]
        )
        right = np.array([-math.cos(azimuth), math.sin(azimuth), 0.0])
        axes = np.stack([right, np.cross(-out, right), -out])
        seen = (inside - target) @ axes.T
        slope = math.tan(math.radians(FIELD_OF_VIEW_DEG / 2)) * (1 - 2 * MARGIN)
        # the smallest distance at which all points are within the horizontal angle and the
        # picture's aspect ratio
        away = float(np.max(np.abs(seen[:, 0]) / slope - seen[:, 2], initial=1.0))
        away = max(
            away,
            float(np.max(np.abs(seen[:, 1]) / (slope * height / width) - seen[:, 2], initial=1.0)),
        )
        away = max(away, float(-seen[:, 2].min()) * 1.05 + 0.1)
        flat = seen[:, :2] / (seen[:, 2] + away)[:, None]
        ends = np.stack([flat.min(axis=0), flat.max(axis=0)])
        spans = np.maximum(ends[1] - ends[0], 1e-6) * (1 + 2 * MARGIN)
        focal = float(min(width / spans[0], height / spans[1]))
        size = (
            max(1, math.ceil(spans[0] * focal - 1e-6)),
            max(1, math.ceil(spans[1] * focal - 1e-6)),
        )
        middle = ends.mean(axis=0) * focal
        centre = size[0] / 2 - float(middle[0]), size[1] / 2 - float(middle[1])
        return cls(target + out * away, axes, focal, size, centre)

    def project(self, xyz: F64) -> tuple[F64, F64, F64]:
        """Return pixel coordinates right and down, and the depth [m], each (n,) float64."""
        seen = (xyz - self.eye) @ self.axes.T
        depth = seen[:, 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = np.where(depth > 0, self.focal / depth, np.nan)
        return seen[:, 0] * scale + self.centre[0], seen[:, 1] * scale + self.centre[1], depth

    def relief(self, depth: F64) -> F64:
        """Return depths on the scale on which steps are shaded: doublings of the distance."""
        return np.asarray(np.log2(np.maximum(depth, 1e-6)))


class DepthBuffer:
    """A picture of points with depth test."""

    def __init__(self, camera: Camera, splat: int = 1) -> None:
        self._camera = camera
        self._splat = splat
        self._size = camera.size
        self._keys = np.full(self._size[0] * self._size[1], EMPTY, np.uint64)
        self.n_inside = 0

    def add(self, xyz: F64, colours: U8) -> None:
        """Draw points: ``xyz`` (n, 3) float64, ``colours`` (n, 3) uint8."""
        width, height = self._size
        right, down, depth = self._camera.project(xyz)
        with np.errstate(invalid="ignore"):
            inside = (right >= 0) & (right < width) & (down >= 0) & (down < height) & (depth > 0)
        self.n_inside += int(np.count_nonzero(inside))
        column = right[inside].astype(np.int64)
        row = down[inside].astype(np.int64)
        # positive floats sort like their bit patterns
        bits = depth[inside].astype(np.float32).view(np.uint32).astype(np.uint64)
        chosen = colours[inside].astype(np.uint64)
        keys = (
            bits << np.uint64(32)
            | chosen[:, 0] << np.uint64(16)
            | chosen[:, 1] << np.uint64(8)
            | chosen[:, 2]
        )
        first = -((self._splat - 1) // 2)
        for across in range(first, first + self._splat):
            for along in range(first, first + self._splat):
                x = column + across
                y = row + along
                kept = (x >= 0) & (x < width) & (y >= 0) & (y < height)
                np.minimum.at(self._keys, (y * width + x)[kept], keys[kept])

    def picture(self, *, close: int = 2, shade: bool = True) -> U8:
        """Return the picture, (height, width, 3) uint8; white where there is nothing."""
        width, height = self._size
        keys = self._keys.reshape(height, width)
        for _ in range(close):
            keys = _close_gaps(keys)
        depth = (keys >> np.uint64(32)).astype(np.uint32).view(np.float32)
        empty = keys == EMPTY
        colours = np.stack(
            [(keys >> np.uint64(shift)) & np.uint64(255) for shift in (16, 8, 0)], axis=-1
        )
        picture = colours.astype(np.float32)
        if shade:
            relief = np.where(
                empty, np.inf, self._camera.relief(np.where(empty, 1.0, depth).astype(np.float64))
            )
            picture *= _shading(relief.astype(np.float32))[..., None]
        picture[empty] = 255.0
        return np.rint(picture).astype(np.uint8)


def _neighbours(image: NDArray[Any], fill: object, reach: int = 1) -> list[NDArray[Any]]:
    """Return the eight neighbours of every pixel at some distance, outside = ``fill``."""
    padded = np.pad(image, reach, constant_values=fill)  # type: ignore[call-overload]
    height, width = image.shape
    steps = [
        (dy, dx)
        for dy in (0, reach, 2 * reach)
        for dx in (0, reach, 2 * reach)
        if (dy, dx) != (reach, reach)
    ]
    return [padded[dy : dy + height, dx : dx + width] for dy, dx in steps]


def _close_gaps(keys: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Fill pixels that are empty, or seen through a gap, among at least five nearer neighbours."""
    near = np.zeros(keys.shape, np.uint8)
    # nearer means by 2 % or more: that is at least 2^17 in the bits of a float32
    limit = keys - np.minimum(keys, np.uint64((1 << 17) << 32))
    best = np.full(keys.shape, EMPTY, np.uint64)
    for neighbour in _neighbours(keys, EMPTY):
        nearer: Mask = neighbour < limit
        near += nearer
        np.minimum(best, np.where(nearer, neighbour, EMPTY), out=best)
    return np.where(near >= 5, best, keys)


def _shading(relief: F32) -> F32:
    """Return brightness from 0 to 1: lower where neighbours are in front."""
    total = np.zeros(relief.shape, np.float32)
    for reach, weight in ((1, 1.0), (2, 0.5), (4, 0.25)):
        for neighbour in _neighbours(relief, np.inf, reach):
            with np.errstate(invalid="ignore"):
                step = relief - neighbour
            # limit the effect of one deep step, which is an edge and must not turn its surroundings
            # black
            total += np.float32(weight) * np.clip(
                np.nan_to_num(step, nan=0.0, posinf=0.0, neginf=0.0), 0.0, 0.06
            )
    return np.asarray(np.maximum(np.exp(-SHADE * total / 14.0), 0.25), np.float32)


def splat_for(n_points: int, size: tuple[int, int]) -> int:
    """Return the width of a point that closes surfaces in a picture of so many points [pixels].

    >>> splat_for(10_000_000, (2000, 1000)), splat_for(20_000, (2000, 1000))
    (1, 4)
    """
    pixels = size[0] * size[1]
    share = n_points / max(pixels, 1)
    for splat, least_share in ((1, 0.6), (2, 0.12), (3, 0.03)):
        if share > least_share:
            return splat
    return 4

"""Pictures of point clouds: points go to a depth buffer, gaps are closed, edges shaded by depth.

The buffer holds one integer per pixel, depth in the upper and colour in the lower half, so that a
minimum selects the nearest point. The picture does not depend on the order of the points or on how
they were cut into chunks.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

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
        first = (-self._n_seen) % self._step
        chosen = rows[first :: self._step]
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
        if not self._rows:
            return np.empty((0, self._width))
        return np.concatenate(self._rows)


class Box(NamedTuple):
    """A box along the axes."""

    low: F64
    high: F64
    """Corners, (3,) float64 [m]."""

    def contains(self, xyz: F64) -> Mask:
        """Return which points (..., 3) are inside or on the border, (...) bool."""
        inside = (xyz >= self.low) & (xyz <= self.high)
        return np.asarray(inside.all(axis=-1), np.bool_)


class Projection(NamedTuple):
    """Points as a camera sees them, each (n,) float64."""

    right: F64
    down: F64
    """Pixel coordinates from the upper left corner."""
    depth: F64
    """Distance along the view [m]."""

    def is_inside(self, width: int, height: int) -> Mask:
        """Return which points are within a picture of this size [pixels], (n,) bool."""
        across = (self.right >= 0) & (self.right < width)
        along = (self.down >= 0) & (self.down < height)
        return across & along


def bounds(sample: F64) -> Box:
    """Return the box that a view of points (n, 3) [m] frames; far and stray points are outside."""
    ends = [np.percentile(sample[:, axis], FRAMED[axis]) for axis in range(3)]
    low, high = np.array(ends).T
    margins = (high - low) * np.array(WIDENED)
    return Box(
        low=np.maximum(low - margins, sample.min(axis=0)),
        high=np.minimum(high + margins, sample.max(axis=0)),
    )


def fullest_azimuth(
    sample: F64,
    elevation_deg: float,
    width: int,
    height: int,
) -> float:
    """Return the azimuth whose view a sample (n, 3) fills best, clockwise from north [deg]."""
    points = sample[:: max(1, len(sample) // _TRIED)]
    coarse_width = 160
    coarse_height = max(1, 160 * height // width)

    def n_filled(azimuth_deg: float) -> int:
        view = Perspective.around(points, azimuth_deg, elevation_deg, coarse_width, coarse_height)
        projection = view.project(points)
        inside = projection.is_inside(*view.size)
        columns = projection.right[inside].astype(np.int64)
        rows = projection.down[inside].astype(np.int64)
        return len(np.unique(rows * view.size[0] + columns))

    best_deg = max(AZIMUTHS_DEG, key=n_filled)
    if n_filled(best_deg) > _BETTER * n_filled(USUAL_DEG):
        return float(best_deg)
    return USUAL_DEG


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
        view_width = max(1, math.ceil(2 * half[0] / metres - 1e-9))
        view_height = max(1, math.ceil(2 * half[1] / metres - 1e-9))
        return cls(
            left=float(middle[0] - view_width * metres / 2),
            top=float(middle[1] + view_height * metres / 2),
            highest=float(sample[:, 2].max()) + 1.0,
            metres=metres,
            size=(view_width, view_height),
        )

    def project(self, xyz: F64) -> Projection:
        """Return where points (n, 3) float64 [m] are in the picture."""
        return Projection(
            right=(xyz[:, 0] - self.left) / self.metres,
            down=(self.top - xyz[:, 1]) / self.metres,
            depth=np.maximum(self.highest - xyz[:, 2], 1e-3),
        )

    def relief(self, depth: F64) -> F64:
        """Return depths relative to the size of the view, the scale on which steps are shaded."""
        return depth / (self.metres * max(self.size)) * 2.0


@dataclass(frozen=True, slots=True)
class Perspective:
    """A view with a vanishing point, as in a page to look around in."""

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
        inside = sample[bounds(sample).contains(sample)]
        if not len(inside):
            inside = sample
        target = (inside.min(axis=0) + inside.max(axis=0)) / 2
        azimuth = math.radians(azimuth_deg)
        elevation = math.radians(elevation_deg)
        backward = np.array(
            [
                math.sin(azimuth) * math.cos(elevation),
                math.cos(azimuth) * math.cos(elevation),
                math.sin(elevation),
            ]
        )
        right = np.array([-math.cos(azimuth), math.sin(azimuth), 0.0])
        axes = np.stack([right, np.cross(-backward, right), -backward])
        from_target = (inside - target) @ axes.T
        across = from_target[:, 0]
        down = from_target[:, 1]
        forward = from_target[:, 2]

        # the smallest distance at which all points are within the horizontal angle, within the
        # aspect ratio of the picture, and in front of the eye
        slope_across = math.tan(math.radians(FIELD_OF_VIEW_DEG / 2)) * (1 - 2 * MARGIN)
        slope_down = slope_across * height / width
        away = float(np.max(np.abs(across) / slope_across - forward, initial=1.0))
        away = max(away, float(np.max(np.abs(down) / slope_down - forward, initial=1.0)))
        away = max(away, float(-forward.min()) * 1.05 + 0.1)

        # the largest scale at which the picture holds them, and the picture cut to them
        slopes = from_target[:, :2] / (forward + away)[:, None]
        ends = np.stack([slopes.min(axis=0), slopes.max(axis=0)])
        spans = np.maximum(ends[1] - ends[0], 1e-6) * (1 + 2 * MARGIN)
        focal = float(min(width / spans[0], height / spans[1]))
        view_width = max(1, math.ceil(spans[0] * focal - 1e-6))
        view_height = max(1, math.ceil(spans[1] * focal - 1e-6))
        middle = ends.mean(axis=0) * focal
        return cls(
            eye=target + backward * away,
            axes=axes,
            focal=focal,
            size=(view_width, view_height),
            centre=(view_width / 2 - float(middle[0]), view_height / 2 - float(middle[1])),
        )

    def project(self, xyz: F64) -> Projection:
        """Return where points (n, 3) float64 [m] are in the picture, NaN for those behind."""
        from_eye = (xyz - self.eye) @ self.axes.T
        depth = from_eye[:, 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = np.where(depth > 0, self.focal / depth, np.nan)
        return Projection(
            right=from_eye[:, 0] * scale + self.centre[0],
            down=from_eye[:, 1] * scale + self.centre[1],
            depth=depth,
        )


class DepthBuffer:
    """A picture of points with depth test."""

    def __init__(self, camera: FromAbove, splat: int = 1) -> None:
        self._camera = camera
        self._splat = splat
        self._size = camera.size
        self._keys = np.full(self._size[0] * self._size[1], EMPTY, np.uint64)
        self.n_inside = 0

    def add(self, xyz: F64, colours: U8) -> None:
        """Draw points: ``xyz`` (n, 3) float64, ``colours`` (n, 3) uint8."""
        width, height = self._size
        projection = self._camera.project(xyz)
        with np.errstate(invalid="ignore"):
            inside = projection.is_inside(width, height) & (projection.depth > 0)
        self.n_inside += int(np.count_nonzero(inside))
        columns = projection.right[inside].astype(np.int64)
        rows = projection.down[inside].astype(np.int64)
        # positive floats sort like their bit patterns
        depth_bits = projection.depth[inside].astype(np.float32).view(np.uint32)
        rgb = colours[inside].astype(np.uint64)
        keys = depth_bits.astype(np.uint64) << np.uint64(32)
        keys |= rgb[:, 0] << np.uint64(16)
        keys |= rgb[:, 1] << np.uint64(8)
        keys |= rgb[:, 2]
        first = -((self._splat - 1) // 2)
        steps = range(first, first + self._splat)
        for across in steps:
            for down in steps:
                column = columns + across
                row = rows + down
                drawn = (column >= 0) & (column < width) & (row >= 0) & (row < height)
                pixels = (row * width + column)[drawn]
                np.minimum.at(self._keys, pixels, keys[drawn])

    def picture(self, *, close: int = 2, shade: bool = True) -> U8:
        """Return the picture, (height, width, 3) uint8; white where there is nothing."""
        width, height = self._size
        keys = self._keys.reshape(height, width)
        for _ in range(close):
            keys = _close_gaps(keys)
        empty = keys == EMPTY
        brightness = self._brightness_of(keys, empty) if shade else np.float32(1.0)
        picture = np.empty((height, width, 3), np.uint8)
        # one channel after the other: a large picture takes much memory
        for k, shift in enumerate((16, 8, 0)):
            channel = (keys >> np.uint64(shift)).astype(np.uint8) * brightness
            channel[empty] = 255.0
            picture[..., k] = np.rint(channel)
        return picture

    def _brightness_of(self, keys: NDArray[np.uint64], empty: Mask) -> F32:
        depth = (keys >> np.uint64(32)).astype(np.uint32).view(np.float32)
        depth[empty] = np.float32(1.0)
        relief = self._camera.relief(depth.astype(np.float64)).astype(np.float32)
        relief[empty] = np.inf
        return _brightness(relief)


def _neighbours(image: NDArray[Any], fill: object, reach: int = 1) -> Iterator[NDArray[Any]]:
    """Iterate over the eight neighbours of all pixels at ``reach``, ``fill`` outside the image."""
    padded = np.pad(image, reach, constant_values=fill)  # type: ignore[call-overload]
    height, width = image.shape
    for top in (0, reach, 2 * reach):
        for left in (0, reach, 2 * reach):
            if (top, left) != (reach, reach):
                yield padded[top : top + height, left : left + width]


def _close_gaps(keys: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Fill pixels that are empty, or seen through a gap, among at least five nearer neighbours."""
    # nearer means by 2 % or more: that is at least 2^17 in the bits of a float32
    limits = keys - np.minimum(keys, np.uint64((1 << 17) << 32))
    n_nearer = np.zeros(keys.shape, np.uint8)
    nearest = np.full(keys.shape, EMPTY, np.uint64)
    for neighbour in _neighbours(keys, EMPTY):
        is_nearer: Mask = neighbour < limits
        n_nearer += is_nearer
        np.minimum(nearest, np.where(is_nearer, neighbour, EMPTY), out=nearest)
    return np.where(n_nearer >= 5, nearest, keys)


def _brightness(relief: F32) -> F32:
    """Return brightness from 0 to 1, lower where neighbours are in front."""
    total = np.zeros(relief.shape, np.float32)
    for reach, weight in ((1, 1.0), (2, 0.5), (4, 0.25)):
        for neighbour in _neighbours(relief, np.inf, reach):
            with np.errstate(invalid="ignore"):
                step = relief - neighbour
            step = np.nan_to_num(step, nan=0.0, posinf=0.0, neginf=0.0)
            # a deep step is an edge and must not turn its surroundings black
            total += np.float32(weight) * np.clip(step, 0.0, 0.06)
    brightness = np.exp(-SHADE * total / 14.0)
    return np.asarray(np.maximum(brightness, 0.25), np.float32)


def splat_for(n_points: int, n_pixels: int) -> int:
    """Return the width of a point that closes surfaces in a picture of so many points [pixels].

    >>> splat_for(10_000_000, 2_000_000), splat_for(20_000, 2_000_000)
    (1, 4)
    """
    share = n_points / max(n_pixels, 1)
    for splat, least_share in ((1, 0.6), (2, 0.12), (3, 0.03)):
        if share > least_share:
            return splat
    return 4

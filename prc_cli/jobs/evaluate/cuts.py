"""Cuts of an evaluation: lines or times, an area, heights above ground, stems of listed trees."""

from __future__ import annotations

import csv
import io
import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from prc_cli.core.errors import ConfigError, InputError
from prc_cli.core.files import read_small
from prc_cli.core.types import F64, I64, Mask
from prc_cli.core.window import Window
from prc_cli.matching.join import Columns
from prc_cli.matching.nearest import SQUARE_M, cell_keys, cell_places, keys_of
from prc_cli.matching.sides import LINE, SECONDS

_MOST_BYTES = 64 << 20
GROUND_CELL_M = 1.0
STEM_FROM_M = 0.3
STEM_TO_M = 4.3
STEM_DIAMETERS = 2.0
"""Cylinders of Lehtola et al. (2019), section III.

4 m high from 1 m below breast height, with a radius of twice the diameter there.
"""


class ScoredWindow:
    """Leaves out pairs of records outside a window, and counts the others."""

    def __init__(self, window: Window) -> None:
        self._window = window
        self._origin_s: float | None = None
        self._n = self._n_inside = 0
        self._low = math.inf
        self._high = -math.inf

    def keep(self, columns: Columns) -> Mask:
        """Mark the records within the window."""
        position = np.asarray(columns[LINE if self._window.in_lines else SECONDS], np.float64)
        known = np.isfinite(position) & ~(self._window.in_lines & (position < 0))
        if known.any():
            if self._origin_s is None:
                self._origin_s = float(position[known][0])
            self._low = min(self._low, float(position[known].min()))
            self._high = max(self._high, float(position[known].max()))
        low, high = self._window.bounds(self._origin_s or 0.0)
        keep: Mask = known & (position >= low) & (position < high)
        self._n += len(keep)
        self._n_inside += int(np.count_nonzero(keep))
        return keep

    def outside(self, path: str) -> tuple[str, int]:
        """Return a sentence with the number of pairs that are not scored, and this number."""
        if not self._n_inside:
            unit = "lines" if self._window.in_lines else "times"
            problem = (
                f"found {unit} from {self._low:.9g} to {self._high:.9g}, "
                f"expected some in {self._window.option}"
            )
            raise InputError(path, problem, f"choose {unit} that it has")
        return (
            f"{self._window.option}: {{n}} records outside are not scored",
            self._n - self._n_inside,
        )


class Area:
    """A rectangle ``X1,Y1,X2,Y2`` or the polygons of a GeoJSON file, as the points [m]."""

    def __init__(self, text: str) -> None:
        self._polygons: Any = None
        numbers = _numbers(text)
        if len(numbers) == 4:
            xs = sorted(numbers[::2])
            ys = sorted(numbers[1::2])
            self.bounds = xs[0], ys[0], xs[1], ys[1]
        elif Path(text).suffix.lower() in (".geojson", ".json"):
            self._polygons = _polygons(Path(text))
            self.bounds = self._polygons.bounds
        else:
            problem = f"found {text!r}, expected X1,Y1,X2,Y2 or a .geojson file of polygons"
            raise ConfigError("--inside", problem, "both in the coordinates of the points")

    def holds(self, x: F64, y: F64) -> Mask:
        """Mark the points inside."""
        x0, y0, x1, y1 = self.bounds
        inside: Mask = (x >= x0) & (x <= x1) & (y >= y0) & (y <= y1)
        if self._polygons is not None and inside.any():
            import shapely

            inside[inside] = shapely.contains_xy(self._polygons, x[inside], y[inside])
        return inside


def _numbers(text: str) -> list[float]:
    try:
        return [number for word in text.split(",") if math.isfinite(number := float(word))]
    except ValueError:
        return []


_NO_GEOJSON = (
    OSError,
    ValueError,
    LookupError,
    TypeError,
    AttributeError,
    RecursionError,
    OverflowError,
)


def _polygons(path: Path) -> Any:
    try:
        import shapely
        from shapely.geometry import shape
    except ImportError:
        raise ConfigError(
            str(path), "polygons need shapely", 'pip install ".[geo]", or give X1,Y1,X2,Y2'
        ) from None
    try:
        geojson = json.loads(read_small(path, _MOST_BYTES))
        features = geojson["features"] if geojson["type"] == "FeatureCollection" else [geojson]
        shapes = []
        for feature in features:
            geometry = feature["geometry"] if feature["type"] == "Feature" else feature
            shapes.append(shape(geometry))
        polygons = [item for item in shapes if item.geom_type in ("Polygon", "MultiPolygon")]
        area = shapely.union_all(polygons)
        if not np.isfinite(area.bounds).all() and not area.is_empty:
            message = "coordinates that are no numbers"
            raise ValueError(message)
    except (*_NO_GEOJSON, shapely.errors.ShapelyError) as error:
        text = " ".join(str(error).split())[:160]
        raise InputError(
            str(path), f"no GeoJSON ({text})", "export the test area as GeoJSON polygons"
        ) from error
    if area.is_empty:
        raise InputError(
            str(path), f"found {len(shapes)} geometries, none of them a polygon", "export polygons"
        )
    shapely.prepare(area)
    return area


class Ground:
    """Heights of the lowest reference ground point of every square metre."""

    def __init__(self) -> None:
        self._keys = np.empty(0, np.int64)
        self._z = np.empty(0)
        self._tree: Any = None

    def add(self, x: F64, y: F64, z: F64) -> None:
        """Add points of the ground [m]."""
        keys = np.concatenate([self._keys, cell_keys(x, y, GROUND_CELL_M)])
        heights = np.concatenate([self._z, z])
        order = np.lexsort((heights, keys))
        keys = keys[order]
        heights = heights[order]
        first = np.append(True, keys[1:] != keys[:-1])[: len(keys)]
        self._keys = keys[first]
        self._z = heights[first]

    def heights(self, columns: Columns) -> F64:
        """Return the height of points above the nearest ground [m]."""
        from scipy.spatial import cKDTree

        if self._tree is None:
            self._tree = cKDTree((np.stack(cell_places(self._keys), axis=1) + 0.5) * GROUND_CELL_M)
        nearest = self._tree.query(np.stack([columns["x"], columns["y"]], axis=1), workers=-1)[1]
        return np.asarray(columns["z"] - self._z[nearest], np.float64)

    @property
    def is_empty(self) -> bool:
        """Whether there is no ground."""
        return not len(self._keys)


@dataclass(frozen=True, slots=True)
class Trees:
    """Upright cylinders around stems."""

    xy: F64
    """(n, 2) [m]."""
    radius: F64
    top: F64
    """Height of the upper end above ground [m]."""

    @classmethod
    def read(cls, path: Path) -> Trees:
        """Read a table ``x,y,radius[,height]``, or one of ``prc simulate forest --stems``."""
        try:
            rows = list(csv.DictReader(io.StringIO(read_small(path, _MOST_BYTES).decode())))
            names = {name.strip().lower().removesuffix("_m"): name for name in rows[0] if name}
            by_diameter = "radius" not in names
            x, y, width = (
                np.array([float(row[names[name]]) for row in rows])
                for name in ("x", "y", "dbh" if by_diameter else "radius")
            )
            asked = "height" in names and not by_diameter
            top = np.array([float(row[names["height"]]) if asked else STEM_TO_M for row in rows])
            wrong = ~np.isfinite([x, y, width, top]).all(axis=0) | (width < 0)
            if wrong.any():
                row_number = int(np.argmax(wrong)) + 1
                message = f"row {row_number}: a number that is not finite, or a width below 0"
                raise ValueError(message)
        except OSError as error:
            raise InputError(
                str(path), f"cannot be read ({error.strerror or error})", "check the name"
            ) from error
        except (ValueError, LookupError, TypeError, csv.Error) as error:
            problem = (
                f"found no trees ({error}), "
                "expected a CSV file with the columns x,y,radius[,height] in metres"
            )
            raise InputError(str(path), problem, "write these columns, a tree a row") from error
        return cls(np.stack([x, y], axis=1), width * (STEM_DIAMETERS if by_diameter else 1.0), top)

    def holds(self, columns: Columns, height: F64) -> Mask:
        """Mark the points inside a cylinder."""
        from scipy.spatial import cKDTree

        is_stem = np.zeros(len(height), np.bool_)
        low = np.flatnonzero((height >= STEM_FROM_M) & (height <= self.top.max(initial=0.0)))
        if not len(low) or not len(self.xy):
            return is_stem
        points = cKDTree(np.stack([columns["x"][low], columns["y"][low]], axis=1))
        for members, top in zip(
            points.query_ball_point(self.xy, self.radius), self.top.tolist(), strict=True
        ):
            inside = low[np.asarray(members, np.int64)]
            is_stem[inside[height[inside] <= top]] = True
        return is_stem


class Cover:
    """The squares of the plan that the reference covers, and the predicted shots outside."""

    EDGE_M = SQUARE_M
    COARSE = 8
    FEW = 0.25
    """Empty squares with fewer predicted shots than this share of the mean contain noise.

    They are in the air, or seen through a window or a gap.
    """

    def __init__(self, predicted: I64, n_shots: I64, reference: I64) -> None:
        """Start with sorted keys of the squares of both sides, and numbers of predicted shots."""
        self._predicted = predicted
        self._n = n_shots
        self._covered = reference
        column, row = cell_places(self._covered)
        self._coarse = np.unique(keys_of(column // self.COARSE, row // self.COARSE))
        self._empty: dict[int, int] = {}
        self.n_outside = 0

    def holds(self, x: F64, y: F64) -> Mask:
        """Mark the predicted shots where the reference has points; count the others."""
        if not len(x):
            return np.zeros(0, np.bool_)
        keys = cell_keys(x, y, self.EDGE_M)
        coarse = cell_keys(x, y, self.EDGE_M * self.COARSE)
        covered = np.isin(keys, self._covered)
        n_of_covered = self._n[np.isin(self._predicted, self._covered)]
        most = self.FEW * float(n_of_covered.mean()) if len(n_of_covered) else 0.0
        n_of_square = self._n[np.searchsorted(self._predicted, keys)]
        covered |= np.isin(coarse, self._coarse) & (n_of_square < most)
        cells, n = np.unique(coarse[~covered], return_counts=True)
        self.n_outside += int(n.sum())
        for cell, count in zip(cells.tolist(), n.tolist(), strict=True):
            self._empty[cell] = self._empty.get(cell, 0) + count
        return covered

    def largest_gap(self) -> tuple[int, tuple[float, float, float, float]] | None:
        """Return the number of shots and the bounds [m] of the largest gap in the reference."""
        from scipy.ndimage import label

        edge = self.EDGE_M * self.COARSE
        mean = float(self._n.sum()) / max(len(self._coarse), 1)
        cells = np.array(
            sorted(cell for cell, n in self._empty.items() if n > self.FEW * mean), np.int64
        )
        if not len(cells):
            return None
        column, row = cell_places(cells)
        shape = int(np.ptp(column)) + 1, int(np.ptp(row)) + 1
        if shape[0] * shape[1] > _MOST_BYTES:
            return None
        grid = np.zeros(shape, np.int64)
        cells_of_grid = column - column.min(), row - row.min()
        grid[cells_of_grid] = [self._empty[cell] for cell in cells.tolist()]
        names = label(grid > 0)[0][cells_of_grid]
        n = np.bincount(names, grid[cells_of_grid])
        in_gap = names == int(np.argmax(n))
        x = column[in_gap] * edge
        y = row[in_gap] * edge
        return int(n.max()), (
            float(x.min()),
            float(y.min()),
            float(x.max() + edge),
            float(y.max() + edge),
        )

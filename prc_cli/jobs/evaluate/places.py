"""Places where two labellings differ: collected while pairs are counted, with a picture of each."""

from __future__ import annotations

import io
import shlex
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from prc_cli.core.types import F64, I64, Mask
from prc_cli.evaluation.html import class_colour
from prc_cli.evaluation.mapping import ClassMapping
from prc_cli.evaluation.places import (
    Differing,
    ListedPlace,
    Place,
    PlaceFinder,
    Places,
)
from prc_cli.formats.las.vlrs import epsg_of
from prc_cli.formats.writing.disk import scratch_errors
from prc_cli.formats.writing.record import PROGRAM, read_record
from prc_cli.matching.join import Columns
from prc_cli.matching.keys import AXES
from prc_cli.matching.sides import COLUMN, CONFIDENCE, FILE, LINE, REASON, ROW, SECONDS, Side
from prc_cli.methods.reasons import rule_of

N_PICTURES = 30
"""Places that have a picture."""
PLACE_COLUMNS = (LINE, COLUMN, SECONDS, *AXES)
"""Columns of either side."""
PREDICTED_COLUMNS = (CONFIDENCE, REASON)
"""Columns of the predicted side."""
_PRESETS = {
    ("prc", "urban"): "prc-2019-urban",
    ("prc", "forest"): "prc-2019-forest",
    ("fused", "urban"): "fused",
    ("fused", "forest"): "fused-forest",
    ("rings", ""): "rings",
    ("sequential_angle", ""): "street-scan",
}
"""Preset by method and environment, for the command that explains a shot."""
_PAIR = np.dtype(
    [
        ("file", "<i4"),
        ("line", "<i4"),
        ("column", "<i4"),
        ("range", "<f4"),
        ("x", "<f8"),
        ("y", "<f8"),
        ("z", "<f8"),
        ("reference", "<i2"),
        ("predicted", "<i2"),
    ]
)
_PAIRS_AT_ONCE = 1 << 17
_MAX_SHOTS = 20_000
"""Shots in a picture."""
_MARGIN_LINES = 20
_MARGIN_COLUMNS = 40
_MAX_LINES = 160
_MAX_COLUMNS = 240
_MARGIN_M = 2.0
_MAX_LENGTH_M = 20.0
_PIXEL_M = 0.08
_HEIGHT = 240
_NOTHING = (255, 255, 255)
_UNSCORED = (225, 225, 225)


class PlaceCollector:
    """Collects the differing pairs of one pool of files, and all pairs for the pictures."""

    def __init__(self, mapping: ClassMapping, pairs: PairFile | None, *, in_space: bool) -> None:
        self._mapping = mapping
        self._finder = PlaceFinder(in_space=in_space)
        self._pairs = pairs
        reference = np.array(mapping.names("reference"))
        predicted = np.array(mapping.names("predicted"))
        shared = list(mapping.scored_names)
        differs = reference[:, None] != predicted[None, :]
        # a class of one side only cannot agree
        can_agree = np.isin(reference, shared)[:, None] & np.isin(predicted, shared)[None, :]
        self._differs: Mask = differs & can_agree

    def add(self, columns: Columns, codes: I64, rows: I64) -> None:
        """Take pairs: columns of both sides, predicted codes, reference classes."""
        predicted = self._mapping.class_indices(codes, "predicted")
        if self._pairs is not None:
            self._pairs.add(columns, rows, predicted)
        is_scored = (rows >= 0) & (predicted >= 0)
        differs = np.zeros(len(rows), np.bool_)
        differs[is_scored] = self._differs[rows[is_scored], predicted[is_scored]]
        n = int(np.count_nonzero(differs))
        if not n:
            return
        chosen = {name: values[differs] for name, values in columns.items()}

        def whole(name: str, unknown: int) -> I64:
            return np.asarray(chosen.get(name, np.full(n, unknown)), np.int64)

        def number(name: str) -> F64:
            return np.asarray(chosen.get(name, np.full(n, np.nan)), np.float64)

        self._finder.add(
            Differing(
                pair=rows[differs] * self._differs.shape[1] + predicted[differs],
                confidence=whole(CONFIDENCE, -1),
                reason=np.maximum(whole(REASON, 0), 0),
                records={
                    "file": whole(FILE, 0),
                    "row": whole(ROW, -1),
                    "line": whole(LINE, -1),
                    "column": whole(COLUMN, -1),
                },
                places={**{axis: number(axis) for axis in AXES}, "time": number(SECONDS)},
            )
        )

    def places(self) -> tuple[list[Place], int]:
        """Return the places, and the number of records that differ."""
        places = self._finder.places(
            self._mapping.names("reference"), self._mapping.names("predicted")
        )
        return places, self._finder.n_differ


class PairFile:
    """All pairs in a temporary file, for the pictures of places."""

    def __init__(self, handle: BinaryIO) -> None:
        self._handle = handle
        self._n_kept = 0
        self._n = 0

    def add(self, columns: Columns, reference: I64, predicted: I64) -> None:
        """Append pairs."""
        pairs = np.zeros(len(reference), _PAIR)
        for name in (*AXES, "range"):
            pairs[name] = columns.get(name, np.nan)
        for name in ("file", "line", "column"):
            pairs[name] = columns.get(name, -1)
        pairs["reference"] = reference
        pairs["predicted"] = predicted
        with scratch_errors("places"):
            self._handle.seek(self._n * _PAIR.itemsize)
            self._handle.write(pairs.view(np.uint8).data)
        self._n += len(pairs)

    def restart(self) -> None:
        """Forget the pairs since the last :meth:`keep`: a match starts again."""
        self._n = self._n_kept

    def keep(self) -> None:
        """Keep all pairs so far: a match is finished."""
        self._n_kept = self._n

    def _chunks(self) -> Iterator[NDArray[Any]]:
        with scratch_errors("places"):
            self._handle.seek(0)
            for first in range(0, self._n, _PAIRS_AT_ONCE):
                n = min(_PAIRS_AT_ONCE, self._n - first)
                yield np.frombuffer(self._handle.read(n * _PAIR.itemsize), _PAIR)

    def around(self, places: Sequence[Place]) -> list[NDArray[Any]]:
        """Return the pairs around every place."""
        parts: list[list[NDArray[Any]]] = [[] for _ in places]
        for pairs in self._chunks():
            for place, part in zip(places, parts, strict=True):
                near = pairs[_is_near(pairs, place)]
                if len(near) and sum(map(len, part)) < _MAX_SHOTS:
                    part.append(near)
        return [np.concatenate([np.empty(0, _PAIR), *part])[:_MAX_SHOTS] for part in parts]


def _is_near(pairs: NDArray[Any], place: Place) -> Mask:
    near: Mask
    if place.line >= 0 and place.column >= 0:
        near = pairs["file"] == place.file
        spans = (
            ("line", place.first_line, place.last_line, _MARGIN_LINES, _MAX_LINES),
            ("column", place.first_column, place.last_column, _MARGIN_COLUMNS, _MAX_COLUMNS),
        )
        for name, first, last, margin, most in spans:
            middle = place.line if name == "line" else place.column
            near &= pairs[name] >= max(first - margin, middle - most // 2)
            near &= pairs[name] <= min(last + margin, middle + most // 2)
        return near
    near = np.ones(len(pairs), np.bool_)
    for k, axis in enumerate(AXES):
        middle_m = (place.x, place.y, place.z)[k]
        near &= pairs[axis] >= max(place.low[k] - _MARGIN_M, middle_m - _MAX_LENGTH_M / 2)
        near &= pairs[axis] <= min(place.high[k] + _MARGIN_M, middle_m + _MAX_LENGTH_M / 2)
    return near


def picture_of(pairs: NDArray[Any], mapping: ClassMapping) -> bytes:
    """Draw the shots around a place: range, predicted, reference; the sky is up."""
    down, across = _pixels(pairs)
    shape = int(down.max(initial=0)) + 1, int(across.max(initial=0)) + 1
    colours = {
        side: np.array(
            [*(tuple(bytes.fromhex(class_colour(name)[1:])) for name in mapping.names(side)),
             _UNSCORED],
            np.uint8,
        )
        for side in ("predicted", "reference")
    }  # fmt: skip
    panels = []
    for values in (_greys(pairs), *(colours[side][pairs[side]] for side in colours)):
        panel = np.full((*shape, 3), _NOTHING, np.uint8)
        panel[down, across] = values
        zoom = max(1, _HEIGHT // shape[0])
        panels.append(np.repeat(np.repeat(panel, zoom, axis=0), zoom, axis=1))
    gap = np.full((panels[0].shape[0], 8, 3), _NOTHING, np.uint8)
    strip = np.concatenate([panels[0], gap, panels[1], gap, panels[2]], axis=1)
    target = io.BytesIO()
    Image.fromarray(strip).save(target, "PNG", optimize=True)
    return target.getvalue()


def _pixels(pairs: NDArray[Any]) -> tuple[I64, I64]:
    """Return row and column of the pixel of every shot."""
    if len(pairs) and (pairs["line"] >= 0).all() and (pairs["column"] >= 0).all():
        across = pairs["line"].astype(np.int64)
        down = pairs["column"].astype(np.int64)
        height = pairs["z"]
    else:
        along = max("xy", key=lambda axis: float(np.ptp(pairs[axis])) if len(pairs) else 0.0)
        across = np.floor(pairs[along] / _PIXEL_M).astype(np.int64)
        down = np.floor(pairs["z"] / _PIXEL_M).astype(np.int64)
        height = pairs["z"]
    if np.isfinite(height).all() and np.sum((down - down.mean()) * (height - height.mean())) > 0:
        down = -down
    return down - down.min(initial=0 if not len(down) else down[0]), across - across.min(
        initial=0 if not len(across) else across[0]
    )


def _greys(pairs: NDArray[Any]) -> NDArray[np.uint8]:
    """Return greys of ranges, near = dark; (n, 3)."""
    values = pairs["range"]
    known = np.isfinite(values)
    grey = np.full(len(values), _UNSCORED[0], np.float64)
    if known.any():
        low, high = np.percentile(values[known], (2, 98))
        grey[known] = 30 + 200 * np.clip((values[known] - low) / max(high - low, 0.1), 0, 1)
    return np.repeat(grey.astype(np.uint8)[:, None], 3, axis=1)


def listed_places(
    places: Sequence[Place],
    n_differ: int,
    files: Sequence[str],
    sides: Sequence[tuple[Side, Side]],
    pairs: PairFile | None,
    mapping: ClassMapping,
) -> Places:
    """Return the places with their files, rules, commands, coordinate system and pictures.

    The best come first.
    """
    listed = [
        ListedPlace(
            place,
            files[place.file],
            rule_of(place.reason)[1].sentence if place.reason else "",
            _command(Path(files[place.file]), place),
        )
        for place in places
    ]
    systems = {crs for pair in sides for side in pair for file in side.files if (crs := file.crs)}
    crs = epsg_of(systems.pop()) if len(systems) == 1 else None
    pictures: tuple[bytes, ...] = ()
    if pairs is not None:
        around = pairs.around(places[:N_PICTURES])
        pictures = tuple(picture_of(near, mapping) for near in around)
    return Places(tuple(listed), n_differ, crs, pictures)


def _command(predicted: Path, place: Place) -> str:
    """Return the command that explains a shot; empty if its line and column are not known."""
    if place.line < 0 or place.column < 0:
        return ""
    source = "INPUT"
    preset = ""
    with suppress(OSError, ValueError, LookupError, TypeError, RecursionError):
        record = read_record(predicted)
        if record["program"] == PROGRAM:
            name = Path(str(record["input"]["name"])).name
            beside = predicted.with_name(name)
            source = shlex.quote(str(beside) if beside.exists() else name)
            preset = _preset(record["config"])
    command = f"prc explain {source} --at {place.line},{place.column}"
    return f"{command} --preset {preset}" if preset else command


def _preset(config: dict[str, Any]) -> str:
    method = config["method"]
    environment = config.get(method, {}).get("environment", "")
    return _PRESETS.get((method, environment), "")

"""The configuration of inputs (``[input]``) and the layout of raw dumps and text (``[layout]``)."""

from __future__ import annotations

import math
import re
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Field, model_validator

from prc_cli.core.config import Params
from prc_cli.core.errors import ConfigError
from prc_cli.core.findings import CHECK_NAMES
from prc_cli.core.window import Window, parse_window

MAX_RECORD_BYTES = 1 << 20
"""Longest record of a raw dump, as in LAS: chunks of records are held in memory."""


LEAST_RATE_HZ = 1e-6
MOST_RATE_HZ = 1e12
"""Allowed line frequencies and shot rates, well beyond those of real scanners [Hz]."""


def _rule(*patterns: str) -> AfterValidator:
    """Accept words that match a pattern (``*`` = a name, ``#`` = a number)."""

    def check(value: str) -> str:
        for pattern in patterns:
            regex = re.escape(pattern).replace(r"\*", ".+").replace(r"\#", r"[0-9.eE+-]+")
            # names of files and dimensions never hold a zero byte
            if re.fullmatch(regex, value) and "\0" not in value:
                return value
        shown = ", ".join(
            pattern.replace("*", "NAME").replace("#", "NUMBER") for pattern in patterns
        )
        message = f"one of: {shown}"
        raise ValueError(message)

    return AfterValidator(check)


LineRule = Annotated[
    str, _rule("auto", "dimension:*", "fixed", "angle-wrap", "time:#", "rings", "elevation:#")
]
ColumnRule = Annotated[str, _rule("auto", "dimension:*", "angle", "time:#", "order")]
RangeRule = Annotated[
    str, _rule("auto", "dimension:*", "trajectory:*", "origin:*", "sensor-xyz", "points")
]


def _known_check(name: str) -> str:
    if name not in CHECK_NAMES:
        message = f"names of checks: {', '.join(CHECK_NAMES)}"
        raise ValueError(message)
    return name


CheckName = Annotated[str, AfterValidator(_known_check)]


def _window_text(name: str) -> AfterValidator:
    def check(value: str) -> str:
        parse_window(**{**dict.fromkeys(("only_lines", "only_time", "first")), name: value})
        return value

    return AfterValidator(check)


class InputConfig(Params):
    """How the stream is found in an input (``[input]``).

    ``auto`` is resolved by the reader and reported.
    """

    lines: LineRule = Field(
        "auto",
        description=(
            "where scan lines begin: dimension:NAME, fixed (every points_per_line records), "
            "angle-wrap, time:HZ (line frequency), rings (x, y, z of a frame, ring after ring: "
            "lines are azimuths), or elevation:DEG (x, y, z alone: lines end where the elevation "
            "drops by more)"
        ),
    )
    columns: ColumnRule = Field(
        "auto",
        description=(
            "which column a shot is: dimension:NAME, angle, time:HZ (shots a second), or order"
        ),
    )
    range: RangeRule = Field(
        "auto",
        description=(
            "slant range: dimension:NAME, trajectory:FILE (CSV, TUM, SBET, a bag), origin:X,Y,Z "
            "(static scan), sensor-xyz, or points (registered cloud with times: rotation and path "
            "from the points)"
        ),
    )
    scanner: Literal["none", "scanner_channel", "point_source_id", "user_data"] = Field(
        "none", description="split the input by this field, classify each part, write one file"
    )
    return_: Literal["strongest", "first", "last"] = Field(
        "strongest",
        alias="return",
        description="the return that stands for a shot of several returns",
    )
    points_per_line: int | None = Field(
        None, ge=1, le=10_000_000, description="M, shots in a scan line"
    )
    order: Literal["require", "trust", "sort-time"] = Field(
        "require",
        description=(
            "require = refuse an input that is not chronological; trust = take it as it is; "
            "sort-time = sort the records by time first"
        ),
    )
    partial_line: Literal["error", "pad"] = Field(
        "error",
        description=(
            "when M does not divide the records of a fixed layout: refuse, or pad with missing"
        ),
    )
    range_scale: float = Field(
        1.0,
        gt=0.0,
        le=1e6,
        description="metres in one of the stored ranges: 0.001 for millimetres, 0.3048 for feet",
    )
    min_range: float = Field(0.0, ge=0.0, description="ranges at or below are missing [m]")
    max_range: float | None = Field(None, gt=0.0, description="ranges beyond are missing [m]")
    time_unit: Literal["auto", "s", "ms", "us", "ns", "turn"] = Field(
        "auto",
        description=(
            "unit of the times of points in clouds of bags and in lists of points; auto = in "
            "clouds the unit in which the scanner turns as scanners do, else as the format says; "
            "turn = parts of a turn (clouds)"
        ),
    )
    time_origin: float | None = Field(
        None,
        description=(
            "time at which line 0, column 0 was fired [s]; default: the first record's time"
        ),
    )
    angle_start: float | None = Field(
        None, description="scan angle of column 0 [deg]; default: found in the input"
    )
    angle_step: float | None = Field(
        None, description="scan angle between columns [deg], signed; default: found"
    )
    angles: Literal["auto", "measured"] = Field(
        "auto",
        description=(
            "auto = scan angles as given, as recorded with the shots, or from coordinates, and "
            "where there are none, measured from the ranges; measured = from the ranges, column 0 "
            "at 0 deg"
        ),
    )
    nadir: float | None = Field(
        None,
        description=(
            "scan angle of the beam that points straight down [deg]; default: found in the input"
        ),
    )
    azimuth_step: float | None = Field(
        None,
        ge=0.001,
        le=90.0,
        description="lines = rings: azimuth between lines [deg]; default: found",
    )
    trajectory_time_offset: float = Field(
        0.0, description="added to the trajectory's times to match gps_time [s]"
    )
    trajectory_max_gap: float | None = Field(
        None,
        gt=0,
        description=(
            "points in a longer gap of the trajectory are an error [s]; default: ten times the "
            "median step, at least 1 s"
        ),
    )
    trajectory_topic: str | None = Field(
        None,
        min_length=1,
        description="topic of a trajectory in a bag; default: the only one with poses",
    )
    trajectory_lever_arm: tuple[float, float, float] | None = Field(
        None,
        description=(
            "from the trajectory's point to the scanner, on the axes of the vehicle [m]; for poses "
            "with an orientation (TUM, bags)"
        ),
    )
    trajectory_crs: str | None = Field(
        None,
        description=(
            "coordinate system of the points for an SBET trajectory, e.g. EPSG:32635; default: the "
            "file's"
        ),
    )
    topic: str | None = Field(
        None,
        min_length=1,
        description="bags: the topics to read, in a row with commas; captures: ADDRESS:PORT of the "
        "scanners; default: all scans of the best kind",
    )
    metadata: str | None = Field(
        None,
        min_length=1,
        description=(
            "captures: the JSON metadata of an Ouster sensor; default: the name of the capture "
            "with .json"
        ),
    )
    max_gap_lines: int = Field(
        100_000,
        ge=0,
        le=1_000_000_000,
        description="more missing lines in a row than this are an error, not a gap",
    )

    only_lines: Annotated[str, _window_text("only_lines")] | None = Field(
        None, description="read only these scan lines, A:B from 0, B not included; to try settings"
    )
    only_time: Annotated[str, _window_text("only_time")] | None = Field(
        None,
        description=(
            "read only the lines of these times, A:B in the stream's own seconds, or +A:+B since "
            "its first one"
        ),
    )
    first: Annotated[str, _window_text("first")] | None = Field(
        None, description="read only the first part: 30s, 2min or 500lines"
    )
    accept_doubts: tuple[CheckName, ...] | None = Field(
        None,
        description=(
            "names of checks whose doubts the office knows better; they are recorded, and do no "
            "more"
        ),
    )

    @model_validator(mode="after")
    def _check(self) -> InputConfig:
        if self.max_range is not None and self.max_range <= self.min_range:
            message = f"max_range ({self.max_range} m) above min_range ({self.min_range} m)"
            raise ValueError(message)
        if self.range.startswith("origin:"):
            parse_origin(self.range)
        if self.angle_step == 0:
            message = "angle_step other than 0"
            raise ValueError(message)
        for name in ("lines", "columns"):
            rule = getattr(self, name)
            if rule.startswith("time:") and not LEAST_RATE_HZ <= parse_rate(rule) <= MOST_RATE_HZ:
                rates = f"{LEAST_RATE_HZ:g} to {MOST_RATE_HZ:g} Hz"
                message = f"{name} = time:HZ with {rates}, found {rule!r}"
                raise ValueError(message)
        parse_window(self.only_lines, self.only_time, self.first)
        return self

    @property
    def window(self) -> Window | None:
        """The part of the stream that is read; None = all of it."""
        return parse_window(self.only_lines, self.only_time, self.first)


def parse_rate(rule: str) -> float:
    """Return the number in ``time:48``, NaN if it is not a number.

    >>> parse_rate("time:48")
    48.0
    """
    try:
        return float(rule.partition(":")[2])
    except ValueError:
        return float("nan")


def origin_of(config: InputConfig) -> tuple[float, float, float] | None:
    """Return the place of the scanner that ``range = origin:X,Y,Z`` gives [m]; None if it does not.

    >>> origin_of(InputConfig(range="origin:1,2,3.5")), origin_of(InputConfig())
    ((1.0, 2.0, 3.5), None)
    """
    return parse_origin(config.range) if config.range.startswith("origin:") else None


def parse_origin(rule: str) -> tuple[float, float, float]:
    """Return the coordinates in ``origin:X,Y,Z`` [m].

    >>> parse_origin("origin:1,2,3.5")
    (1.0, 2.0, 3.5)
    """
    try:
        x, y, z = (float(part) for part in rule.partition(":")[2].split(","))
    except ValueError:
        x = y = z = float("nan")
    if not all(math.isfinite(value) for value in (x, y, z)):
        message = f"range = origin:X,Y,Z with three numbers, all finite, found {rule!r}"
        raise ValueError(message)
    return x, y, z


def _numpy_type(value: str) -> str:
    try:
        dtype = np.dtype(value)
    except (TypeError, ValueError, SyntaxError):
        # numpy parses a comma as a list of types
        dtype = None
    if dtype is None or dtype.kind not in "iuf":
        message = "a numpy number type such as f4, u2, i4, float64"
        raise ValueError(message)
    return value


class LayoutField(Params):
    """One field of a record (``[[layout.fields]]``)."""

    name: str = Field(
        min_length=1,
        description=(
            "range, scan_line, column, angle, time, x, y, z, intensity; any other name is carried "
            "or skipped"
        ),
    )
    type: Annotated[str, AfterValidator(_numpy_type)] = Field(
        "f4", description="raw binary: numpy number type"
    )
    source: str | int | None = Field(
        None,
        description="text: column name, or column number from 0; default: the field's own name",
    )
    scale: float = Field(1.0, description="value = stored * scale + offset, in m, s, rad or deg")
    offset: float = Field(0.0, description="value = stored * scale + offset")
    missing: float | None = Field(None, description="stored value that means no return")
    unit: Literal["m", "cm", "mm", "ft", "s", "ms", "us", "ns", "rad", "deg", "gon", ""] = Field(
        "",
        description=(
            "range, x, y, z: m, cm, mm or ft (default m); time: s, ms, us or ns (default s); "
            "angle: deg, rad or gon (default deg)"
        ),
    )


class Layout(Params):
    """The records of a raw dump or a text file (``[layout]``)."""

    header_bytes: int = Field(
        0, ge=0, le=1 << 40, description="raw binary: bytes before the first record"
    )
    endian: Literal["little", "big"] = Field(
        "little", description="raw binary: byte order of the fields"
    )
    record_bytes: int | None = Field(
        None,
        ge=1,
        le=MAX_RECORD_BYTES,
        description=(
            "raw binary: size of a record if it is larger than its fields (padding at the end)"
        ),
    )
    decimal: Literal[".", ","] | None = Field(
        None, description="text: character before the decimals; default: found by looking"
    )
    delimiter: str = Field(
        ",", min_length=1, max_length=1, description="text: between cells; a space = any blanks"
    )
    header: bool | None = Field(
        None, description="text: the first row holds names; default: found by looking"
    )
    comment: str = Field(
        "#", max_length=1, description="text: rows that begin with this are skipped"
    )
    points_per_line: int | None = Field(
        None, ge=1, le=10_000_000, description="M, shots in a scan line"
    )
    line_frequency: float | None = Field(None, gt=0, description="scan lines a second [Hz]")
    fields: tuple[LayoutField, ...] = Field((), description="the record, in order")

    @model_validator(mode="after")
    def _check(self) -> Layout:
        names = [item.name for item in self.fields]
        twice = {name for name in names if names.count(name) > 1}
        if twice:
            message = f"every field name once, found {sorted(twice)} more than once"
            raise ValueError(message)
        return self


RANGES_ONLY = Layout(fields=(LayoutField(name="range", type="f4"),))
"""The simplest raw dump: little-endian float32 ranges alone."""


FACTORS = {
    "m": 1.0,
    "cm": 0.01,
    "mm": 0.001,
    "ft": 0.3048,
    "s": 1.0,
    "ms": 1e-3,
    "us": 1e-6,
    "ns": 1e-9,
    "rad": 1.0,
    "deg": math.pi / 180,
    "gon": math.pi / 200,
}
"""Metres, seconds or radians in one of a unit; ft is the international foot."""
_LENGTHS = ("", "m", "cm", "mm", "ft")
UNITS = {
    "range": _LENGTHS,
    "x": _LENGTHS,
    "y": _LENGTHS,
    "z": _LENGTHS,
    "time": ("", "s", "ms", "us", "ns"),
    "angle": ("", "deg", "rad", "gon"),
}
"""Units allowed for fields of a standard name; use ``scale`` to convert others."""


def record_dtype(layout: Layout) -> np.dtype[np.void]:
    """Return a layout as a numpy record type."""
    if not layout.fields:
        raise ConfigError(
            "layout.fields",
            "none given, expected at least one field",
            "add a [[layout.fields]] table",
        )
    check_fields(layout)
    types = [np.dtype(item.type).newbyteorder(layout.endian) for item in layout.fields]
    for item, stored in zip(layout.fields, types, strict=True):
        _check_missing(item, stored)
    least = sum(stored.itemsize for stored in types)
    size = layout.record_bytes or least
    if size < least:
        problem = f"found {size}, but the fields take {least} bytes"
        raise ConfigError("layout.record_bytes", problem, f"leave it out or give {least} or more")
    return np.dtype(
        {"names": [item.name for item in layout.fields], "formats": types, "itemsize": size}
    )


def check_fields(layout: Layout) -> None:
    """Refuse units that do not belong to their field."""
    for item in layout.fields:
        known = UNITS.get(item.name)
        if known is not None and item.unit not in known:
            expected = " or ".join(unit for unit in known if unit)
            problem = f"field {item.name!r}: found unit {item.unit!r}, expected {expected}"
            raise ConfigError("layout.fields", problem, "convert with scale and offset")


def _check_missing(item: LayoutField, stored: np.dtype[Any]) -> None:
    """Refuse a missing value that the type cannot hold, because it would never match."""
    if item.missing is None:
        return
    if stored.kind == "f":
        fits = abs(item.missing) <= float(np.finfo(stored).max)
    else:
        bounds = np.iinfo(stored)
        fits = item.missing == int(item.missing) and bounds.min <= int(item.missing) <= bounds.max
    if not fits:
        problem = (
            f"field {item.name!r}: found missing = {item.missing:g}, which {item.type} cannot hold"
        )
        raise ConfigError(
            "layout.fields", problem, "give the value as it is stored, before scale and offset"
        )


def decode(stored: NDArray[Any], item: LayoutField) -> NDArray[Any]:
    """Turn stored numbers into values in metres, seconds and radians; NaN where missing.

    A value is ``stored * scale + offset`` in the unit of the field.

    >>> import numpy as np
    >>> item = LayoutField(name="range", type="i4", scale=0.001, missing=0)
    >>> decode(np.array([12_345, 0], "<i4"), item)
    array([12.345,    nan])
    """
    factor = 1.0 if item.unit in ("", "deg") else FACTORS[item.unit]
    is_plain = item.scale == 1.0 and item.offset == 0.0 and factor == 1.0
    missing = (
        None if item.missing is None else stored == np.array(item.missing).astype(stored.dtype)
    )
    if is_plain and missing is None and stored.dtype.kind in "iu" and item.name not in UNITS:
        return np.ascontiguousarray(stored, dtype=stored.dtype.newbyteorder("="))
    narrow = (
        is_plain
        and item.name == "range"
        and stored.dtype.kind == "f"
        and stored.dtype.itemsize <= 4
    )
    with np.errstate(over="ignore", invalid="ignore"):
        # a buffer that is not changed need not be copied
        kept = item.name == "range" and is_plain and missing is None
        is_ours = stored.flags.c_contiguous and (stored.flags.writeable or kept)
        values: NDArray[np.floating[Any]] = stored.astype(
            np.float32 if narrow else np.float64, copy=not is_ours
        )
        if not is_plain:
            values *= item.scale
            values += item.offset
            if factor != 1.0:
                values *= factor
    if item.name == "angle" and item.unit in ("", "deg"):
        values = np.deg2rad(values)
    if missing is not None:
        values[missing] = np.nan
    return values

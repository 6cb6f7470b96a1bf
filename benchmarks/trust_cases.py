"""Cases of the benchmark of trust.

What is wrong with a file or a command, as files and command lines of a user.

Nothing here knows how the program checks its input. A row writes the files of a case into a folder
and returns the arguments of ``prc classify`` and the reference class of every label that comes out.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeAlias

import laspy
import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from pyarrow import csv

from benchmarks.contest_files import dump
from benchmarks.pages import ROOT
from benchmarks.trust_scans import Window
from prc_cli.core.types import F64, I64
from prc_cli.jobs.convert import convert

Shots: TypeAlias = dict[str, NDArray[Any]]
"""Columns of records in the order of a file, with ``truth``.

The reference class, 0 = not judged.
"""
Random: TypeAlias = np.random.Generator

METHODS: dict[str, tuple[str, ...]] = {
    "prc": ("--preset", "prc-2019-urban"),
    "prc push-broom": ("--config", str(ROOT / "sample_configs" / "sick_push_broom.toml")),
    "prc forest": (
        "--preset",
        "prc-2019-forest",
        "--set",
        "prc.support.zeta_s=1",
        "--set",
        "prc.support.zeta_p=0.1",
    ),
    "fused": ("--preset", "fused"),
    "fused-forest": ("--preset", "fused-forest"),
    "sequential-angle": ("--preset", "street-scan"),
}
AIMED = frozenset({"fused", "fused-forest", "sequential-angle"})
"""Methods that need to know where down is."""
FEET = 1.0 / 0.3048
NOISE = 7
WEEK_S = 604_800.0
PLACE_M = (650_000.0, 6_860_000.0, 40.0)
"""Where the scans lie in registered coordinates [m]."""
TRAJECTORY_ENDS_S = 3.0
"""Time by which a trajectory reaches beyond the scan [s]."""


@dataclass(frozen=True, slots=True)
class Told:
    """An input, what the user tells of it, and the truth about its records."""

    path: Path
    options: tuple[str, ...]
    """Of ``prc classify``, the method left out."""
    truth: I64
    """(n,) int64, reference class of every label that comes out; 0 = not judged."""


@dataclass(frozen=True, slots=True)
class Pair:
    """A case whose counterpart is not the window itself."""

    wrong: Told
    right: Told


Made: TypeAlias = Told | Pair | None
"""None: there is no such case of this scan."""


@dataclass(frozen=True, slots=True)
class Context:
    """Where and for which method a case is made."""

    folder: Path
    method: str
    random: Random

    @property
    def is_aimed(self) -> bool:
        return self.method in AIMED


@dataclass(frozen=True, slots=True)
class Row:
    """One kind of corruption."""

    name: str
    make: Callable[[Window, Context], Made]
    aimed_only: bool = False
    """Whether only methods that need straight down are concerned."""
    is_right: bool = False
    """Nothing is wrong: the same scan in another form."""
    everywhere: bool = False
    """Run at every window."""


def methods_of(window: Window) -> tuple[str, ...]:
    """Return the methods that are meant for a scan."""
    if window.is_forest:
        return ("fused-forest", "prc forest")
    if window.is_push_broom:
        return ("fused", "prc push-broom", "sequential-angle")
    return ("fused", "prc")


# Files, as they are written by scanners and by other programs


def shots_of(window: Window, *, returns_only: bool = False) -> Shots:
    """Return the shots of a window in firing order."""
    line, column = np.indices(window.range_m.shape).reshape(2, -1)
    shots: Shots = {
        "range": window.range_m.ravel(),
        "time": window.time_s.ravel(),
        "angle": window.angle_deg()[column],
        "scan_line": line,
        "column": column,
        "truth": window.codes.ravel(),
    }
    if window.world_m is not None:
        shots |= {axis: window.world_m[..., i].ravel() + PLACE_M[i] for i, axis in enumerate("xyz")}
    return taken(shots, np.flatnonzero(~np.isnan(shots["range"]))) if returns_only else shots


def taken(shots: Shots, order: NDArray[np.integer[Any]]) -> Shots:
    """Return records in another order, or some of them."""
    return {name: values[order] for name, values in shots.items()}


def recorded(
    window: Window, context: Context, shots: Shots, names: str, *more: str, **aiming: Any
) -> Told:
    """Write records with the named fields; tell their layout, M, and straight down."""
    path = context.folder / "scan.dat"
    layout = dump(path, shots, names.split())
    aimed = aim(window, context, **{"angles": False, **aiming})
    options = (*layout, *more, "-M", str(window.points_per_line), *aimed)
    return Told(path, options, shots["truth"])


def aim(
    window: Window,
    context: Context,
    *,
    step: float = 1.0,
    nadir: float | None = 0.0,
    angles: bool = True,
) -> tuple[str, ...]:
    """Return the options that tell angles and straight down, where the method needs them.

    Parameters
    ----------
    step : float
        Factor of the angle step.
    nadir : float or None
        Error of the direction of down [deg]; None = it is not told.
    angles : bool
        Whether the file has no angles, so that they are told.
    """
    if not context.is_aimed:
        return ()
    options = _steps(window, step) if angles else ()
    return options if nadir is None else options + _set("nadir", window.nadir_deg + nadir)


def _steps(window: Window, factor: float = 1.0) -> tuple[str, ...]:
    return _set("angle_start", window.start_deg) + _set("angle_step", window.step_deg * factor)


def _set(key: str, value: float) -> tuple[str, str]:
    return ("--set", f"input.{key}={value:.8g}")


def flat(
    window: Window,
    context: Context,
    values: NDArray[Any],
    truth: I64 | None = None,
    *,
    m: int = 0,
) -> Told:
    """Write values one after the other, as a plain dump of ranges with M told."""
    path = context.folder / "scan.bin"
    values.tofile(path)
    m = m or window.points_per_line
    kept = window.codes.ravel() if truth is None else truth
    return Told(path, ("-M", str(m), *aim(window, context)), kept)


def plain(window: Window, context: Context, **aiming: Any) -> Told:
    """Write a window as a plain dump."""
    stated = flat(window, context, window.range_m)
    return replace(
        stated, options=("-M", str(window.points_per_line), *aim(window, context, **aiming))
    )


def array(window: Window, context: Context, step: float = 1.0, **aiming: Any) -> Told:
    """Write a window as .npz with scan angles and times."""
    path = context.folder / "scan.npz"
    np.savez(
        path, range_m=window.range_m, angle_deg=window.angle_deg() * step, time_s=window.time_s
    )
    return Told(path, aim(window, context, angles=False, **aiming), window.codes.ravel())


def listed(window: Window, context: Context) -> Told:
    """Write the returns as records with line, column, angle and time."""
    shots = shots_of(window, returns_only=True)
    return recorded(window, context, shots, "range angle time scan_line column")


def text(window: Window, context: Context) -> Told:
    """Write one row a shot, missing ones with an empty cell."""
    shots = shots_of(window)
    path = context.folder / "scan.csv"
    columns = {
        "scan_line": shots["scan_line"],
        "column": shots["column"],
        "angle_deg": shots["angle"].round(6),
        "time_s": shots["time"],
        "range_m": shots["range"],
    }
    table = pa.table({name: pa.array(values, from_pandas=True) for name, values in columns.items()})
    csv.write_csv(table, path)
    return Told(path, aim(window, context, angles=False), shots["truth"])


def las(window: Window, context: Context) -> Told:
    """Write registered returns with scan angle, line, column and range.

    Heights say where down is.
    """
    shots = shots_of(window, returns_only=True)
    path = context.folder / "scan.las"
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales = np.full(3, 0.001)
    header.offsets = np.array(PLACE_M)
    for name, kind in (("range", "f4"), ("scan_line", "u4"), ("column", "u4")):
        header.add_extra_dim(laspy.ExtraBytesParams(name, kind))
    points = laspy.ScaleAwarePointRecord.zeros(len(shots["range"]), header=header)
    points.x = shots["x"]
    points.y = shots["y"]
    points.z = shots["z"]
    points.gps_time = 3e8 + shots["time"]
    turned = (shots["angle"] + 180.0) % 360.0 - 180.0
    points["scan_angle"] = np.clip(np.rint(turned / 0.006), -30_000, 30_000).astype("i2")
    points.return_number = points.number_of_returns = np.ones(len(turned), "u1")
    for name in ("range", "scan_line", "column"):
        points[name] = shots[name]
    with laspy.open(path, "w", header=header) as writer:
        writer.write_points(points)
    return Told(path, ("-M", str(window.points_per_line)), shots["truth"])


def right_forms(window: Window) -> tuple[Callable[[Window, Context], Told], ...]:
    """Return the ways in which a window can be told rightly."""
    return (
        (plain, array, listed, text)
        if window.world_m is None
        else (plain, array, listed, text, las)
    )


# Direction and angles


def not_told(window: Window, context: Context) -> Made:
    return array(window, context, nadir=None)


def seam_elsewhere(window: Window, context: Context) -> Made:
    """Begin the file amid a line: columns in another rotation."""
    lost = int(context.random.integers(1, window.points_per_line))
    cells = slice(lost, lost - window.points_per_line)
    m = window.points_per_line
    shape = (window.n_lines - 1, window.points_per_line)
    whole = abs(window.step_deg) * m > 359.0
    angle = np.roll(window.angle_deg(), -lost)
    if whole:
        angle[m - lost :] += 360.0 * np.sign(window.step_deg)
    path = context.folder / "scan.npz"
    ranges = window.range_m.ravel()[cells]
    codes = window.codes.ravel()[cells]
    np.savez(path, range_m=ranges.reshape(shape), angle_deg=angle)
    return Told(path, aim(window, context, angles=False), codes)


def down_off(degrees: float) -> Callable[[Window, Context], Made]:
    def make(window: Window, context: Context) -> Made:
        sign = float(context.random.choice([-1.0, 1.0]))
        form = plain if context.random.random() < 0.5 else array
        return form(window, context, nadir=sign * degrees)

    return make


def registered(window: Window, context: Context) -> Made:
    """Registered heights in the file, angles from the command, down not told."""
    if window.world_m is None:
        return None
    shots = shots_of(window, returns_only=True)
    names = "range x y z scan_line column"
    return recorded(window, context, shots, names, angles=True, nadir=None)


def trajectory_late(window: Window, context: Context) -> Made:
    """Registered points and a trajectory whose clock is a second off; right is the same without."""
    if window.world_m is None or window.scanner_m is None:
        return None
    shots = shots_of(window, returns_only=True)
    drive = context.folder / "drive.csv"
    time_s = window.time_s.mean(axis=1)
    places = window.scanner_m + PLACE_M
    ends = np.array([-TRAJECTORY_ENDS_S, TRAJECTORY_ENDS_S])
    speed = (places[-1] - places[0]) / (time_s[-1] - time_s[0])
    time_s = np.concatenate([time_s[:1] + ends[:1], time_s, time_s[-1:] + ends[1:]])
    places = np.concatenate([places[:1] + ends[0] * speed, places, places[-1:] + ends[1] * speed])
    rows = np.column_stack([time_s, places])
    np.savetxt(drive, rows, delimiter=",", header="time,x,y,z", comments="", fmt="%.6f")
    options = ("--range", f"trajectory:{drive}", *_set("trajectory_max_gap", 2 * TRAJECTORY_ENDS_S))
    right = recorded(window, context, shots, "x y z time angle scan_line column", *options)
    late = (*right.options, *_set("trajectory_time_offset", 1))
    return Pair(replace(right, options=late), right)


def step_times(factor: float) -> Callable[[Window, Context], Made]:
    def make(window: Window, context: Context) -> Made:
        is_told = context.random.random() < 0.5
        if is_told:
            return plain(window, context, step=factor)
        return array(window, context, step=factor, nadir=None)

    return make


def radians(window: Window, context: Context) -> Made:
    """Write radians under the name of degrees, in an array or in text."""
    if context.random.random() < 0.5:
        return array(window, context, step=math.pi / 180.0, nadir=None)
    turned = replace(
        window, start_deg=math.radians(window.start_deg), step_deg=math.radians(window.step_deg)
    )
    return replace(text(turned, context), options=())


def angles_mirrored(window: Window, context: Context) -> Made:
    stated = plain(window, context)
    aimed = (*_steps(window, -1.0), *_set("nadir", window.nadir_deg))
    return replace(stated, options=("-M", str(window.points_per_line), *aimed))


# M


def wrong_m(window: Window, context: Context, m: int) -> Made:
    """Tell another M; the file ends with a whole line of it."""
    n = window.range_m.size // m * m
    return flat(window, context, window.range_m.ravel()[:n], window.codes.ravel()[:n], m=m)


def m_beside(window: Window, context: Context) -> Made:
    return wrong_m(window, context, window.points_per_line + int(context.random.choice([-1, 1])))


def m_times(factor: float) -> Callable[[Window, Context], Made]:
    def make(window: Window, context: Context) -> Made:
        m = round(window.points_per_line * factor)
        return wrong_m(window, context, m) if window.range_m.size >= 24 * m else None

    return make


# Units and bytes


def ranges_times(factor: float) -> Callable[[Window, Context], Made]:
    def make(window: Window, context: Context) -> Made:
        scaled = replace(window, range_m=(window.range_m * np.float32(factor)).astype(np.float32))
        return plain(scaled, context) if context.random.random() < 0.5 else array(scaled, context)

    return make


def wrong_order_of_bytes(window: Window, context: Context) -> Made:
    return flat(window, context, window.range_m.astype(">f4"))


def two_bytes_off(window: Window, context: Context) -> Made:
    content = window.range_m.astype("<f4").tobytes()
    return flat(window, context, np.frombuffer(b"\0\0" + content[:-2], np.uint8))


def millimetres_as_floats(window: Window, context: Context) -> Made:
    return flat(window, context, np.rint(np.nan_to_num(window.range_m) * 1000.0).astype("<u4"))


def header_as_shots(window: Window, context: Context) -> Made:
    """A header that is not told, of as many bytes as some shots.

    The file ends with a whole line.
    """
    n = int(context.random.integers(window.points_per_line // 8, window.points_per_line // 2))
    values = np.concatenate([np.zeros(n, np.float32), window.range_m.ravel()[:-n]])
    truth = np.concatenate([np.zeros(n, np.int64), window.codes.ravel()[:-n]])
    return flat(window, context, values, truth)


def buffer_lost(window: Window, context: Context) -> Made:
    """A buffer of shots lost amid the file, and as many at its end."""
    m = window.points_per_line
    n = int(context.random.integers(m // 8, m // 2))
    first = window.range_m.size // 3
    keep = np.r_[0:first, first + n : window.range_m.size - (m - n)]
    return flat(window, context, window.range_m.ravel()[keep], window.codes.ravel()[keep])


def converted(window: Window, context: Context) -> Told:
    """A dump of ``prc convert`` with its layout beside it, which is not named."""
    source = context.folder / "before.npz"
    intensity = np.where(np.isnan(window.range_m), np.nan, 100.0).astype(np.float32)
    np.savez(
        source,
        range_m=window.range_m,
        angle_deg=window.angle_deg(),
        time_s=window.time_s,
        intensity=intensity,
    )
    # in a folder of its own: the layout would be taken for that of other dumps of this name
    path = context.folder / "converted" / "scan.bin"
    path.parent.mkdir(exist_ok=True)
    convert(source, path, overwrite=True)
    return replace(plain(window, context), path=path)


def converted_without_layout(window: Window, context: Context) -> Made:
    """The same where the layout is gone: eight fields a shot read as plain ranges."""
    stated = converted(window, context)
    stated.path.with_name("scan.bin.toml").unlink()
    words = stated.path.stat().st_size // 4 // window.range_m.size
    truth = np.zeros((window.range_m.size, words), np.int64)
    truth[:, 0] = window.codes.ravel()  # the range comes first
    return replace(stated, truth=truth.ravel())


def transposed(window: Window, context: Context) -> Made:
    truth = np.ascontiguousarray(window.codes.T).ravel()
    return flat(window, context, np.ascontiguousarray(window.range_m.T), truth)


# Order


def _reordered(window: Window, context: Context, order: NDArray[np.integer[Any]]) -> Told:
    return flat(window, context, window.range_m.ravel()[order], window.codes.ravel()[order])


def shuffled_shots(window: Window, context: Context) -> Made:
    return _reordered(window, context, context.random.permutation(window.range_m.size))


def shuffled_lines(window: Window, context: Context) -> Made:
    lines = context.random.permutation(window.n_lines)
    return _reordered(window, context, window.cells()[lines].ravel())


def zigzag(window: Window, context: Context) -> Made:
    """Every other line runs back."""
    cells = window.cells()
    cells[1::2] = cells[1::2, ::-1]
    return _reordered(window, context, cells.ravel())


def timed(window: Window, context: Context, shots: Shots) -> Told:
    """Write shots with times: lines of fixed M, or returns alone with lines from the wrap of the
    angle."""
    if context.random.random() < 0.5:
        return recorded(window, context, shots, "range time", angles=True)
    shots = taken(shots, np.flatnonzero(~np.isnan(shots["range"])))
    path = context.folder / "scan.dat"
    layout = dump(path, shots, ("range", "angle", "time"))
    wrap = ("--lines", "angle-wrap", "--columns", "angle", *_steps(window))
    options = (*layout, *wrap, *aim(window, context, angles=False))
    return Told(path, options, shots["truth"])


def with_times(window: Window, context: Context) -> Made:
    """Nothing wrong: times, and lines of fixed M or from the wrap of the angle."""
    return timed(window, context, shots_of(window))


def _in_blocks(
    window: Window, n: int, order: Callable[[int], Sequence[int]]
) -> NDArray[np.integer[Any]]:
    """Return the cells with blocks of whole lines in another order."""
    parts = np.array_split(window.cells(), n)
    return np.concatenate([parts[i].ravel() for i in order(n)])


def permuted_blocks(n: int) -> Callable[[Window, Context], Made]:
    def make(window: Window, context: Context) -> Made:
        order = _in_blocks(window, n, lambda k: context.random.permutation(k).tolist())
        return timed(window, context, taken(shots_of(window), order))

    return make


def lines_twice(window: Window, context: Context) -> Made:
    """Fifty lines are in the file twice, as after a copy that was resumed."""
    cells = window.cells()
    first = window.n_lines // 3
    order = np.concatenate([cells[: first + 50], cells[first:]])
    return timed(window, context, taken(shots_of(window), order.ravel()))


def line_numbers_begin_anew(window: Window, context: Context) -> Made:
    shots = shots_of(window, returns_only=True)
    half = window.n_lines // 2
    shots["scan_line"] = np.where(
        shots["scan_line"] < half, shots["scan_line"], shots["scan_line"] - half
    )
    return recorded(window, context, shots, "range angle time scan_line column")


def _from_half_on(window: Window, change: Callable[[F64], F64]) -> Shots:
    shots = shots_of(window)
    late = shots["scan_line"] >= window.n_lines // 2
    shots["time"] = np.where(late, change(shots["time"]), shots["time"])
    return shots


def week_ends(window: Window, context: Context) -> Made:
    middle = float(window.time_s[window.n_lines // 2, 0])
    shots = _from_half_on(window, lambda time_s: time_s)
    shots["time"] = np.mod(shots["time"] - middle, WEEK_S)
    return timed(window, context, shots)


def times_begin_anew(window: Window, context: Context) -> Made:
    back = float(window.time_s[window.n_lines // 2, 0] - window.time_s[0, 0])
    return timed(window, context, _from_half_on(window, lambda time_s: time_s - back))


def restart_sorted(window: Window, context: Context) -> Made:
    """A file with a restart, sorted by time as the refusal advises."""
    back = float(window.time_s[window.n_lines // 2, 0] - window.time_s[0, 0])
    shots = _from_half_on(window, lambda time_s: time_s - back)
    shots = taken(shots, np.flatnonzero(~np.isnan(shots["range"])))
    lines = ("--sort-by-time", "--lines", f"time:{window.line_hz:.10g}")
    columns = ("--columns", "dimension:column")
    origin = _set("time_origin", float(window.time_s[0, 0]) - 1e-7)
    return recorded(window, context, shots, "range angle time column", *lines, *columns, *origin)


def two_scanners(window: Window, context: Context) -> Made:
    """Two scanners in one file that are not split.

    Lines and columns of both have the same numbers.
    """
    shots = shots_of(window, returns_only=True)
    half = window.n_lines // 2
    shots = taken(shots, np.flatnonzero(shots["scan_line"] < 2 * half))
    shots["user_data"], shots["scan_line"] = np.divmod(shots["scan_line"], half)
    shots = taken(shots, np.lexsort((shots["user_data"], shots["column"], shots["scan_line"])))
    wrong = recorded(window, context, shots, "range angle scan_line column user_data")
    return Pair(wrong, replace(wrong, options=(*wrong.options, "--scanner", "user_data")))


# Platform and sensor


def dropouts(share: float) -> Callable[[Window, Context], Made]:
    def make(window: Window, context: Context) -> Made:
        lost = context.random.random(window.range_m.shape) < share
        truth = np.where(lost, 0, window.codes).ravel()
        return flat(window, context, np.where(lost, np.float32(np.nan), window.range_m), truth)

    return make


ROWS: tuple[Row, ...] = (
    Row("down not told", not_told, aimed_only=True, everywhere=True),
    Row("down wrong by 45°", down_off(45.0), aimed_only=True),
    Row("down wrong by 180°", down_off(180.0), aimed_only=True),
    Row("heights in the file, angles told", registered, aimed_only=True),
    Row("trajectory a second late", trajectory_late),
    Row("angle step × 0.9", step_times(0.9), aimed_only=True),
    Row("angle step × 0.5", step_times(0.5), aimed_only=True),
    Row("radians named degrees", radians, aimed_only=True),
    Row("angles the other way", angles_mirrored, aimed_only=True),
    Row("M wrong by one", m_beside),
    Row("M halved", m_times(1 / 2)),
    Row("M doubled", m_times(2)),
    Row("ranges × 100", ranges_times(100.0)),
    Row("ranges × 0.001", ranges_times(0.001)),
    Row("ranges in feet", ranges_times(FEET)),
    Row("wrong byte order", wrong_order_of_bytes),
    Row("two bytes off", two_bytes_off),
    Row("u4 mm read as f4", millimetres_as_floats),
    Row("header read as shots", header_as_shots),
    Row("a buffer lost", buffer_lost),
    Row("dump of prc convert, its layout not named", converted),
    Row("dump of prc convert, its layout gone", converted_without_layout),
    Row("transposed", transposed),
    Row("shots shuffled", shuffled_shots),
    Row("lines shuffled", shuffled_lines),
    Row("zigzag lines", zigzag),
    Row("100 blocks shuffled, with times", permuted_blocks(100)),
    Row("50 lines twice, with times", lines_twice),
    Row("scan_line goes back", line_numbers_begin_anew),
    Row("GPS week ends", week_ends),
    Row("times begin anew", times_begin_anew),
    Row("restart sorted by time", restart_sorted),
    Row("two scanners, not split", two_scanners),
    Row("30 % of the shots lost", dropouts(0.3)),
    Row("right: seam elsewhere", seam_elsewhere, aimed_only=True, is_right=True),
    Row("right: with times", with_times, is_right=True),
)


@dataclass(frozen=True, slots=True)
class QuickCase:
    """A case of the tests, on a small scan."""

    row: str
    toy: str
    method: str


_QUICK_CASES = """\
down not told | street | fused
scan_line goes back | street | fused
100 blocks shuffled, with times | street | prc
M doubled | street | fused
GPS week ends | push-broom | fused
times begin anew | street | fused
heights in the file, angles told | street | fused
right: with times | street | fused
right: with times | push-broom | prc push-broom
right: seam elsewhere | street | fused
right: seam elsewhere | push-broom | fused
down wrong by 45° | street | fused
down wrong by 180° | push-broom | fused
angle step × 0.5 | push-broom | fused
M wrong by one | push-broom | fused
M halved | street | prc
ranges × 100 | street | fused
ranges × 0.001 | push-broom | prc push-broom
wrong byte order | street | prc
two bytes off | push-broom | fused
u4 mm read as f4 | street | fused
dump of prc convert, its layout not named | street | fused
dump of prc convert, its layout gone | street | fused
transposed | street | fused
header read as shots | street | fused
a buffer lost | push-broom | fused
shots shuffled | push-broom | prc push-broom
lines shuffled | forest | fused-forest
zigzag lines | forest | fused-forest
restart sorted by time | street | fused
two scanners, not split | push-broom | fused
30 % of the shots lost | push-broom | fused"""
QUICK_CASES = tuple(QuickCase(*line.split(" | ")) for line in _QUICK_CASES.splitlines())

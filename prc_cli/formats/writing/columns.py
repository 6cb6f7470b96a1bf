"""The ``[output]`` table, optional columns of all writers, and coordinates of returns."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from prc_cli.core.classes import FURTHER_RETURN, ClassCodes, Label
from prc_cli.core.config import Params
from prc_cli.core.errors import ConfigError
from prc_cli.core.facts import ClassContexts
from prc_cli.core.stream import LabelledBlock, ScanBlock
from prc_cli.core.types import F64
from prc_cli.formats.options import InputConfig

if TYPE_CHECKING:
    from prc_cli.formats.input import Input

SPACING_M = 0.1
"""Assumed distance of lines [m]."""


class Coordinates(NamedTuple):
    """Coordinates of the returns of a block [m]."""

    cells: F64
    """(lines, M, 3) float64."""
    extra: F64
    """(n, 3) float64, of further returns."""


Placement: TypeAlias = Callable[[ScanBlock], Coordinates]
"""Returns the coordinates of a block."""


@dataclass(frozen=True, slots=True)
class LinesApart:
    """Scan planes one behind the other, for inputs without coordinates.

    A line of two shots, straight down and to the side:

    >>> place = LinesApart({0: np.array([0.0, np.pi / 2])})
    >>> place(ScanBlock(3, np.array([[2.0, 5.0]], np.float32)))[0].round(3).tolist()
    [[[0.3, 0.0, -2.0], [0.3, 5.0, -0.0]]]
    """

    beams: Mapping[int, F64] = field(default_factory=dict)
    """Angle of every column's beam from straight down, by scanner [rad]; empty = unknown."""
    apart_m: float = SPACING_M
    how: str = "assumed"
    """Origin of the distance, for notices."""

    def __call__(self, block: ScanBlock) -> Coordinates:
        """Return the coordinates of a block."""
        extra = block.extra
        line = np.arange(block.n_lines)[:, None]
        angle, is_upright = self._angles(block)
        xyz = behind(self._along(block, line), angle[None, :], block.range_m, is_upright=is_upright)
        extra_xyz = behind(
            self._along(block, extra.line),
            angle[extra.column],
            extra.range_m,
            is_upright=is_upright,
        )
        return Coordinates(xyz, extra_xyz)

    def notice(self, block: ScanBlock) -> str:
        """Return a notice on the origin of the coordinates."""
        if self._angles(block)[1]:
            plane = "scan planes stand upright"
        elif block.angle_rad is not None:
            plane = (
                "straight down is not known: scan planes lie flat, "
                "x = r cos(angle), y = r sin(angle)"
            )
        else:
            m = block.points_per_line
            plane = (
                f"nor angles: scan planes lie flat, with {m} columns spread evenly over a full turn"
            )
        spacing = f"{self.apart_m:.2g} m apart ({self.how})"
        return f"the input has no coordinates; {plane}, one line behind the other, {spacing}"

    def _along(self, block: ScanBlock, line: NDArray[Any]) -> F64:
        return (block.first_line + line.astype(np.float64)) * self.apart_m

    def _angles(self, block: ScanBlock) -> tuple[F64, bool]:
        """Return the angle of every column, and whether it is counted from straight down."""
        beam = block.beam_rad if block.beam_rad is not None else self.beams.get(block.scanner)
        if beam is not None:
            return beam, True
        if block.angle_rad is not None:
            return block.angle_rad, False
        return 2.0 * np.pi * np.arange(block.points_per_line) / block.points_per_line, False


@dataclass(frozen=True, slots=True)
class AtStations:
    """Coordinates of static scans: relative to the scanner, plus the position of the scanner.

    >>> place = AtStations({1: (100.0, 0.0, 5.0)})
    >>> xyz = np.array([[[1.0, 2.0, 3.0]]], np.float32)
    >>> place(ScanBlock(0, np.array([[3.74]], np.float32), scanner=1, xyz_m=xyz))[0].tolist()
    [[[101.0, 2.0, 8.0]]]
    """

    stations: Mapping[int, tuple[float, float, float]]
    """Position of every scanner [m]."""

    def __call__(self, block: ScanBlock) -> Coordinates:
        """Return the coordinates of a block."""
        (xyz, extra_xyz), _ = coordinates(block, None)
        station_m = np.array(self.stations.get(block.scanner, (0.0, 0.0, 0.0)))
        return Coordinates(xyz + station_m, extra_xyz + station_m)


def behind(
    along_m: NDArray[Any],
    angle: NDArray[Any],
    range_m: NDArray[Any],
    *,
    is_upright: bool = True,
) -> F64:
    """Return the coordinates of shots in parallel scan planes, (..., 3) float64 [m].

    Upright planes are one behind the other along x, flat planes one above the other.
    """
    r = np.asarray(range_m, np.float64)
    along = np.broadcast_to(along_m, r.shape)
    down = r * np.cos(angle)
    side = r * np.sin(angle)
    xyz: F64 = np.stack([along, side, -down] if is_upright else [down, side, along], axis=-1)
    xyz[np.isnan(r)] = np.nan
    return xyz


def coordinates(block: ScanBlock, place: Placement | None) -> tuple[Coordinates, str]:
    """Return the coordinates of a block by a placement, else relative to the scanner.

    The second value is a notice on coordinates that were made up, or empty.
    """
    if place is None and block.xyz_m is None:
        place = LinesApart()
    if place is not None:
        return place(block), place.notice(block) if isinstance(place, LinesApart) else ""
    assert block.xyz_m is not None
    extra = block.extra
    xyz = block.xyz_m.astype(np.float64)
    # all returns of a shot lie on the same beam
    ranges = block.range_m[extra.line, extra.column].astype(np.float64)
    ratio = extra.range_m / np.where(np.isnan(ranges), 1.0, ranges)
    return Coordinates(xyz, xyz[extra.line, extra.column] * ratio[:, None]), ""


HIGH_NOISE_CODE = 18
"""LAS 1.4 table 17: high noise."""

FIVE_BIT_LIMIT = 32
"""Point formats 0-5 keep the class in five bits: codes 0 to 31."""


class OutputConfig(Params):
    """Contents of outputs (``[output]``)."""

    segment_ids: bool = Field(
        False,
        description=(
            "add the segment id R_b of every shot: extra bytes uint32 `segment_id`, or a column "
            "`segment`"
        ),
    )
    range: bool = Field(
        False, description="add the range of every shot [m]: extra bytes float32 `range` (LAS, LAZ)"
    )
    stages: bool = Field(
        False,
        description=(
            "add what the classifier found on the way, as extra bytes or columns: float32 "
            "`height_above_ground` [m; NaN unknown] (fused, sequential-angle); of sequential-angle "
            "also uint8 `surface` (coarse class: 1 vegetation, 2 horizontal, 3 vertical, 4 "
            "undecided), uint8 `dense_vegetation` (T'), float32 `ground_height` [m, relative to "
            "the scanner; NaN unknown], uint8 `trigger` (of a suspicious half-line: 1 before the "
            "trigger, 2 the trigger, 3 after it), uint16 `car_interval` (number of the interval "
            "between dividers; 0 none) and uint8 `car_test` (what became of a return in an "
            "interval: 1 cut out as a tall vertical run, 2 vegetation by the Fourier test, 3 "
            "behind a high vertical, 4 next to the ground, 5 on or behind a curb, 6 car); of prc "
            "float32 `critical_zeta_p` and `critical_zeta_s` (a shot is supported if they are "
            "below zeta_p and zeta_s [m]; infinite = never)"
        ),
    )
    confidence: bool = Field(
        False,
        description=(
            "add how sure every label is: extra bytes uint8 `confidence`, or a column, 0 to 100 = "
            "per cent of such shots whose label is right on simulated scans; 0 = not known (fused)"
        ),
    )
    reason: bool = Field(
        False,
        description=(
            "add the number of the rule that gave every label: extra bytes uint8 `reason`, or a "
            "column; the page on reasons has a sentence for each, 0 = no return"
        ),
    )
    codes: Literal["upgrade", "below-32"] = Field(
        "upgrade",
        description=(
            "codes above 31 in LAS point formats 0-5: upgrade = write the matching format 6-10 "
            "when such a code occurs; below-32 = refuse to start unless every code in [classes] is "
            "below 32"
        ),
    )
    high_noise_beyond: float | None = Field(
        None,
        gt=0.0,
        description="noise farther than this gets code 18 (high noise) [m]; default: never",
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class LabelOutput:
    """A classified file that is to be written."""

    path: Path
    """The suffix selects the format."""
    source: Input
    """Input; LAS, PLY, PCD and bags of an input of the same kind read it again."""
    n_records: int | None
    """Records of the input; None if unknown before reading."""
    points_per_line: int
    """M, shots in a scan line."""
    codes: ClassCodes
    options: OutputConfig = field(default_factory=OutputConfig)
    laz_contexts: ClassContexts | None = None
    """Contexts of a LAZ input, which make rewriting faster and change no byte."""
    user_names: Mapping[int, str] = field(default_factory=dict)
    """Name of every user code that may be written, for LAS and LAZ."""
    is_part: bool = False
    """Whether only a window of the input is classified and written."""
    is_thinned: bool = False
    """Whether records without a code are left out; only the class is added."""
    rules: InputConfig = field(default_factory=InputConfig)
    """Configuration of the input, for example the topics of a bag."""
    place: Placement | None = None
    """Coordinates of returns in a new point cloud; None = relative to the scanner."""


def check_codes(codes: ClassCodes, options: OutputConfig) -> None:
    """Raise an error if a class has a code that the output may not contain.

    >>> check_codes(ClassCodes(), OutputConfig())
    >>> check_codes(ClassCodes(), OutputConfig(codes="below-32"))
    Traceback (most recent call last):
    ...
    prc_cli.core.errors.ConfigError: classes.stem: found code 64, expected a code below 32 because
    [output] codes = "below-32"; set stem to a code from 19 to 31 in [classes], or
    codes = "upgrade"
    """
    if options.codes != "below-32":
        return
    for label in Label:
        code = codes.code(label)
        if code >= FIVE_BIT_LIMIT:
            name = label.name.lower()
            because = 'because [output] codes = "below-32"'
            problem = f"found code {code}, expected a code below {FIVE_BIT_LIMIT} {because}"
            hint = f'set {name} to a code from 19 to 31 in [classes], or codes = "upgrade"'
            raise ConfigError(f"classes.{name}", problem, hint)


def class_names(codes: ClassCodes, options: OutputConfig) -> dict[int, str]:
    """Return the class name of every code of an output, high noise included.

    >>> class_names(ClassCodes(), OutputConfig(high_noise_beyond=80))[18]
    'high_noise'
    """
    names = codes.names()
    if options.high_noise_beyond is not None:
        shared = names.get(HIGH_NOISE_CODE)
        names[HIGH_NOISE_CODE] = f"{shared}/high_noise" if shared else "high_noise"
    return names


Values: TypeAlias = NDArray[Any]


@dataclass(frozen=True, slots=True)
class ExtraDimension:
    """A dimension in the extra bytes of LAS and LAZ files."""

    name: str
    dtype: np.dtype[Any]
    """Type of a value, little-endian."""
    description: str
    """At most 32 characters."""


RANGE = ExtraDimension("range", np.dtype("<f4"), "slant range [m]")


@dataclass(frozen=True, slots=True)
class OptionalColumn:
    """A value per record that is written only if requested."""

    dimension: ExtraDimension
    """Dimension in LAS and LAZ."""
    heading: str | None
    """Column in label tables; None = not written there."""
    option: str
    """Key of ``[output]`` that requests it."""
    what: str
    """Name in messages."""
    fill: float
    """Value of records outside all blocks, and of further returns where ``of_extra`` is None."""
    of_shots: Callable[[LabelledBlock], Values | None]
    """Values of the cells of a block, (lines, M); None if the method of the run has none."""
    of_extra: Callable[[LabelledBlock], Values] | None = None
    """Values of the further returns of a block, (n,)."""
    keep: bool = False
    """Whether values of this name in a LAS input stay; else they are replaced."""
    needs: str = ""
    """Method that gives the values; empty if all do."""

    @property
    def name(self) -> str:
        """Name of the dimension."""
        return self.dimension.name

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of a value, little-endian."""
        return self.dimension.dtype


def _attribute(path: str) -> Callable[[LabelledBlock], Values | None]:
    """Return a function that gives an attribute of a block, None if a part is None."""

    def look_up(block: Any) -> Any:
        for name in path.split("."):
            block = None if block is None else getattr(block, name)
        return block

    return look_up


def _of_stages(
    name: str,
    dtype: str,
    text: str,
    path: str,
) -> OptionalColumn:
    dimension = ExtraDimension(name, np.dtype(dtype), text)
    fill = np.nan if dimension.dtype.kind == "f" else 0
    needs = "fused, prc or sequential-angle method"
    return OptionalColumn(dimension, name, "stages", "stage", fill, _attribute(path), needs=needs)


OPTIONAL_COLUMNS = (
    OptionalColumn(
        ExtraDimension("segment_id", np.dtype("<u4"), "segment R_b, 0 = none"),
        "segment",
        "segment_ids",
        "segment id",
        0,
        lambda block: (
            np.zeros(block.labels.shape, np.uint32) if block.segments is None else block.segments
        ),
    ),
    OptionalColumn(
        RANGE,
        None,
        "range",
        "range",
        np.nan,
        _attribute("block.range_m"),
        lambda block: block.block.extra.range_m,
        keep=True,
    ),
    _of_stages("surface", "u1", "T 1, H 2, V 3, undecided 4", "stages.surface"),
    _of_stages(
        "dense_vegetation", "u1", "less sensitive test T', 1 = yes", "stages.dense_vegetation"
    ),
    _of_stages("ground_height", "<f4", "z_g, 0 = height of scanner [m]", "stages.ground_height_m"),
    _of_stages("height_above_ground", "<f4", "above ground [m], NaN unknown", "above_m"),
    _of_stages("trigger", "u1", "0 none, 1 before, 2 it, 3 after", "stages.trigger"),
    _of_stages("car_interval", "<u2", "divided interval, 0 = none", "stages.car_interval"),
    _of_stages("car_test", "u1", "1 V 2 T 3 wall 4 low 5 curb 6 C", "stages.car_test"),
    _of_stages("critical_zeta_p", "<f4", "supported if below zeta_p [m]", "critical.in_line_m"),
    _of_stages("critical_zeta_s", "<f4", "supported if below zeta_s [m]", "critical.adjacent_m"),
    OptionalColumn(
        ExtraDimension("confidence", np.dtype("u1"), "label is right [%], 0 unknown"),
        "confidence",
        "confidence",
        "confidence",
        0,
        _attribute("confidence"),
        lambda block: (
            np.zeros(len(block.extra_labels), np.uint8)
            if block.extra_confidence is None
            else block.extra_confidence
        ),
        needs="fused method",
    ),
    OptionalColumn(
        ExtraDimension("reason", np.dtype("u1"), "rule that decided, 0 no return"),
        "reason",
        "reason",
        "reason",
        0,
        _attribute("reasons"),
        lambda block: block.extra_labels + np.uint8(FURTHER_RETURN),
    ),
)
"""All optional columns, in the order of outputs."""


def asked_columns(options: OutputConfig) -> tuple[OptionalColumn, ...]:
    """Return the columns that ``[output]`` requests, in order.

    >>> [column.name for column in asked_columns(OutputConfig(segment_ids=True, range=True))]
    ['segment_id', 'range']
    """
    return tuple(column for column in OPTIONAL_COLUMNS if getattr(options, column.option))

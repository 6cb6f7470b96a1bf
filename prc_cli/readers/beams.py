"""The direction of every column's beam, for classifiers that must know where down is.

Three ways, in this order: the scan angle that points straight down is given (``input.nadir``), the input tells it
(zenith angles, registered heights beside range and scan angle), or coordinates relative to the scanner are
directions themselves. What none of them tells is refused.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.errors import ConfigError, InputError
from prc_cli.core.stream import Assumption, ScanBlock, ScanStream, StreamInfo
from prc_cli.core.types import F32, F64
from prc_cli.readers.nadir import Beams, NoDirectionError, fit_beams, fit_heights, turn_evenly, wrap
from prc_cli.readers.options import InputConfig

SAMPLE_LINES = 64
"""Lines with returns, from the start, that directions are found in."""
MAX_SAMPLE_CELLS = 1 << 23
"""Cells of a scanner among which these lines must lie: blocks of a scanner met late wait for them in memory."""
MAX_LENGTH_OFF = 0.01
"""Share of the range by which coordinates relative to the scanner may be longer or shorter, in the middle."""
MAX_LENGTH_OFF_M = 0.05
"""The same in metres: the larger of the two holds."""
KEY = "input.nadir"
WAYS = (
    "give input.nadir with scan angles (input.angle_start and input.angle_step where the input has none), "
    "--range trajectory:FILE, --range origin:X,Y,Z, or zenith_deg in an .npz"
)


def with_beams(stream: ScanStream, config: InputConfig) -> ScanStream:
    """Add the direction of every column's beam to a stream.

    Reads the first lines of the stream where only coordinates tell.

    Parameters
    ----------
    stream : ScanStream
        Any stream.
    config : InputConfig
        ``nadir``, and how the stream was opened.

    Returns
    -------
    ScanStream
        The same blocks with ``beam_rad``; its info has an assumption for what was found. Coordinates that turn out not
        to be relative to the scanner are left out of the blocks.

    Raises
    ------
    InputError
        When nothing tells where down is, the lines do not rise, or the directions do not turn with the column.
    ConfigError
        When ``nadir`` is given and the stream has no scan angles.
    """
    finder = _Finder(stream.info, config)
    known: dict[int, _Found] = {}
    waiting: dict[int, _Sample] = {}
    for block in stream.blocks():
        if block.scanner not in known:
            sample = waiting.setdefault(block.scanner, _Sample())
            sample.add(block)
            if sample.is_complete:
                known[block.scanner] = finder.find(waiting.pop(block.scanner))
        if not waiting:
            break
    else:
        known |= {scanner: finder.find(sample) for scanner, sample in waiting.items()}
    found = tuple(dict.fromkeys(one.assumption for one in known.values() if one.assumption is not None))
    info = replace(stream.info, assumptions=(*stream.info.assumptions, *found))
    return BeamStream(info, stream, finder, known)


@dataclass(frozen=True, slots=True)
class BeamStream:
    """A stream whose blocks say where their beams point; see :func:`with_beams`."""

    info: StreamInfo
    source: ScanStream
    finder: _Finder
    known: dict[int, _Found]
    """By scanner, of those that were met in the first lines."""

    def blocks(self) -> Iterator[ScanBlock]:
        """Read from the start; see :meth:`prc_cli.core.stream.ScanStream.blocks`."""
        known = dict(self.known)
        waiting: dict[int, _Sample] = {}
        for block in self.source.blocks():
            scanner = block.scanner
            if scanner in known:
                yield known[scanner].put(block)
                continue
            sample = waiting.setdefault(scanner, _Sample())
            sample.add(block)
            sample.held.append(block)
            if sample.is_complete:
                known[scanner] = self.finder.find(waiting.pop(scanner))
                yield from map(known[scanner].put, sample.held)
        for sample in waiting.values():
            yield from map(self.finder.find(sample).put, sample.held)


@dataclass(slots=True)
class _Sample:
    """The first lines with returns of a scanner, the same however the stream is cut."""

    scanner: int = 0
    angle_rad: F64 | None = None
    range_m: list[F32] = field(default_factory=list)
    xyz_m: list[F32] = field(default_factory=list)
    n_seen: int = 0
    """Lines looked at, with or without returns."""
    max_seen: int = SAMPLE_LINES
    held: list[ScanBlock] = field(default_factory=list)
    """Blocks that wait for the directions."""

    @property
    def is_complete(self) -> bool:
        return len(self.range_m) >= SAMPLE_LINES or self.n_seen >= self.max_seen

    def add(self, block: ScanBlock) -> None:
        self.scanner, self.angle_rad = block.scanner, block.angle_rad
        self.max_seen = max(SAMPLE_LINES, MAX_SAMPLE_CELLS // block.points_per_line)
        for line in range(min(block.n_lines, self.max_seen - self.n_seen)):
            if self.is_complete:
                break
            self.n_seen += 1
            if not np.isnan(block.range_m[line]).all():
                self.range_m.append(block.range_m[line].copy())
                if block.xyz_m is not None:
                    self.xyz_m.append(block.xyz_m[line].copy())


@dataclass(frozen=True, slots=True)
class _Found:
    """What was found for a scanner."""

    beam_rad: F64
    keep_xyz: bool
    assumption: Assumption | None

    def put(self, block: ScanBlock) -> ScanBlock:
        xyz_m = block.xyz_m if self.keep_xyz else None
        return replace(block, beam_rad=self.beam_rad, xyz_m=xyz_m)


@dataclass(frozen=True, slots=True)
class _Finder:
    """Finds the directions of a scanner out of its first lines."""

    info: StreamInfo
    config: InputConfig

    def find(self, sample: _Sample) -> _Found:
        """Apply the first way that can be gone.

        Raises
        ------
        InputError, ConfigError
            See :func:`with_beams`.
        """
        angle = sample.angle_rad if sample.angle_rad is not None else self.info.angle_rad
        n = len(sample.range_m)
        range_m = np.stack(sample.range_m) if n else np.empty((0, 0), np.float32)
        xyz = np.stack(sample.xyz_m) if n and len(sample.xyz_m) == n else None
        off_m = None if xyz is None else _off(xyz, range_m)
        if self.config.nadir is not None:
            if angle is None:
                problem = f"is given, but {self.info.path} has no scan angles"
                raise ConfigError(KEY, problem, "give input.angle_start and input.angle_step, or --columns angle")
            shown = f"{self.config.nadir:g} deg"
            return self._turned(angle, math.radians(self.config.nadir), off_m, shown, "input.nadir is given")
        if self.info.nadir_rad is not None and angle is not None:
            told = any(one.key == KEY for one in self.info.assumptions)
            shown = "" if told else f"{math.degrees(self.info.nadir_rad):.2f} deg"
            return self._turned(angle, self.info.nadir_rad, off_m, shown, "the input says where down is")
        if xyz is None:
            raise InputError(self.info.path, f"no vertical direction known: {self._lacks(angle, n)}", WAYS)
        if off_m is not None:
            return self._registered(angle, range_m, xyz, off_m)
        try:
            beams = fit_beams(xyz)
        except NoDirectionError as error:
            raise InputError(self.info.path, f"no vertical direction known: {error}", WAYS) from error
        return _Found(beams.beam_rad, True, Assumption(KEY, _shown(beams.beam_rad), _why(beams)))

    def _turned(self, angle: F64, nadir_rad: float, off_m: float | None, shown: str, why: str) -> _Found:
        """Turn scan angles so that straight down is 0."""
        try:
            beam_rad = from_angles(angle, nadir_rad)
        except NoDirectionError as error:
            raise InputError(self.info.path, f"scan angles: {error}", "check the scan angles and columns") from error
        if off_m is not None:
            shown = shown or f"{math.degrees(nadir_rad):.2f} deg"
            why = f"{why}; xyz is not relative to the scanner ({off_m:.2f} m off the range) and not used"
        return _Found(beam_rad, off_m is None, Assumption(KEY, shown, why) if shown else None)

    def _registered(self, angle: F64 | None, range_m: F32, xyz: F32, off_m: float) -> _Found:
        """Use coordinates of a map: their heights, if scan angles stand beside them."""
        problem = f"xyz is not relative to the scanner: its length is {off_m:.2f} m off the range, in the middle"
        if angle is None:
            hint = "subtract the scanner's position from xyz, or add angle_deg"
            raise InputError(self.info.path, f"no vertical direction known: {problem}", hint)
        line = np.repeat(np.arange(len(range_m)), range_m.shape[1])
        every = np.tile(angle, len(range_m))
        try:
            fit = fit_heights(every, range_m.ravel(), xyz[..., 2].ravel(), line)
        except NoDirectionError as error:
            raise InputError(self.info.path, f"no vertical direction known: {problem}, and {error}", WAYS) from error
        why = f"found from the heights of xyz over {len(range_m)} lines, within {fit.off_m:.3f} m in the middle"
        return self._turned(angle, fit.nadir_rad, off_m, f"{math.degrees(fit.nadir_rad):.2f} deg", why)

    def _lacks(self, angle: F64 | None, n_lines: int) -> str:
        """Say what the stream has and lacks."""
        if not n_lines:
            return "no shot has a return"
        for one in self.info.assumptions:
            if one.key.startswith(KEY) and one.value == "not found":
                return one.why
        if angle is not None:
            return "the stream has scan angles, but nothing says which of them points straight down"
        return "the stream has neither scan angles nor coordinates relative to the scanner"


def from_angles(angle_rad: F64, nadir_rad: float) -> F64:
    """Turn scan angles so that straight down is 0.

    Parameters
    ----------
    angle_rad : (M,) float64
        Scan angle of every column [rad].
    nadir_rad : float
        The one that points straight down [rad].

    Returns
    -------
    (M,) float64
        In (-pi, pi]; strictly monotone when unwrapped, also where angles are rounded so that columns share them.

    Raises
    ------
    NoDirectionError
        When the angles do not turn one way, once around at most.

    Examples
    --------
    >>> np.rad2deg(from_angles(np.deg2rad([100.0, 90.0, 80.0]), np.deg2rad(90.0))).round(6)
    array([ 10.,   0., -10.])
    """
    if len(angle_rad) < 2:
        return wrap(np.asarray(angle_rad, np.float64) - nadir_rad)
    way = math.copysign(1.0, float(np.sign(wrap(np.diff(angle_rad))).sum()))
    beam = way * (angle_rad - nadir_rad)
    along = np.diff(np.unwrap(beam))
    if (along > 0).all() and along.sum() <= 2 * math.pi:
        return wrap(angle_rad - nadir_rad)
    m = len(beam)
    return wrap(way * turn_evenly(np.arange(m), beam, np.ones(m), m)[0])


def _off(xyz: NDArray[np.float32], range_m: F32) -> float | None:
    """Return by how much the length of coordinates differs from the range [m], None where they agree."""
    length = np.sqrt((xyz.astype(np.float64) ** 2).sum(axis=-1))
    off = np.abs(length - range_m)
    both = np.isfinite(off)
    if not both.any():
        return None
    limit = np.maximum(MAX_LENGTH_OFF * range_m[both], MAX_LENGTH_OFF_M)
    return float(np.median(off[both])) if np.median(off[both] - limit) > 0 else None


def _shown(beam_rad: F64) -> str:
    along = np.rad2deg(np.unwrap(beam_rad))
    return f"beams from {along[0]:.2f} to {along[-1]:.2f} deg from straight down"


def _why(beams: Beams) -> str:
    way = "a straight line in the column through the" if beams.is_straight else "the"
    return f"{way} median directions of xyz over {beams.n_lines} of the first lines with returns"

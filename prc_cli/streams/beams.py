"""Adds the beam direction of every column, for classifiers that need to know where down is.

Sources, in this order: ``input.nadir`` gives the scan angle of straight down; the input gives it
(zenith angles, or registered heights with range and scan angle); coordinates relative to the
scanner are directions. Without any of them straight down is where level ground is, within a degree
or two in streets and up to 10 degrees in forests; where there are no scan angles either, they are
measured from the ranges (:mod:`.angle_step`). If that fails the stream is refused, unless no line
has two returns: then placeholder directions do, because nothing can be classified.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.errors import ConfigError, InputError
from prc_cli.core.frame import SensorFrame
from prc_cli.core.hints import fitting_error
from prc_cli.core.stream import MAX_RINGS, Assumption, ScanBlock, ScanStream, StreamInfo
from prc_cli.core.threads import closing_items
from prc_cli.core.types import F32, F64
from prc_cli.formats.options import InputConfig
from prc_cli.formats.sensor_frame import are_rings, find_frame, is_spinning
from prc_cli.streams.angle_step import MOST_OFF, AngleStep, measure_step
from prc_cli.streams.angles import are_radians
from prc_cli.streams.directions import fit_beams, forward_steps, turn_evenly
from prc_cli.streams.down import (
    MIN_TILT_RAD,
    LevelLinesError,
    NoddingError,
    NoDirectionError,
    TooFewReturnsError,
    WrongOriginError,
    fit_heights,
    guess_down,
    shown_tilt,
    spread_rows,
    wrap,
)
from prc_cli.streams.ranges import MAX_LENGTH_OFF, MAX_LENGTH_OFF_M, XYZ
from prc_cli.streams.rules import POINTS
from prc_cli.streams.stream import Stream

SAMPLE_LINES = 64
"""Number of lines with returns used to find directions."""
SPREAD = 10
"""Level ground is looked for in lines spread over this many times as many: facades come and go."""
TURN_LINES = 4096
"""Lines of a spinning scanner that its frame is found in: a turn or more."""
MAX_SAMPLE_CELLS = 1 << 23
"""Most cells read per scanner to find these lines: its blocks wait in memory."""
MADE_UP_RAD = (0.1, math.pi - 0.1)
"""Placeholder directions of the outermost columns if no shot can be classified [rad]."""
KEY = "input.nadir"
ANGLES = "input.angles"
MEASURED = f"--set {ANGLES}=measured"
_ANGLES_ALONE = "the angles input.angle_start, input.angle_step and input.nadir"
_ARRAY = "array"


@dataclass(slots=True)
class Sample:
    """The first lines with returns of a scanner, independent of block boundaries."""

    scanner: int = 0
    angle_rad: F64 | None = None
    points_per_line: int = 0
    range_m: list[F32] = field(default_factory=list)
    xyz_m: list[F32] = field(default_factory=list)
    n_seen: int = 0
    """Lines read, with or without returns."""
    max_seen: int = SAMPLE_LINES
    held: list[ScanBlock] = field(default_factory=list)
    """Blocks that wait for the directions."""
    n_lines: int = SAMPLE_LINES
    """Lines with returns to take."""
    is_spinning: bool = False
    frame: SensorFrame | None = None
    """Frame of the scanner, where the reader found it."""
    tells: bool = False
    """Whether a line has two returns."""

    @property
    def is_complete(self) -> bool:
        """Whether no more lines are needed."""
        return len(self.range_m) >= self.n_lines or self.n_seen >= self.max_seen

    def add(self, block: ScanBlock) -> None:
        """Add lines of the next block of the scanner, as far as needed."""
        self.scanner = block.scanner
        self.angle_rad = block.angle_rad
        self.points_per_line = block.points_per_line
        self.max_seen = max(SAMPLE_LINES, MAX_SAMPLE_CELLS // block.points_per_line)
        for line in range(min(block.n_lines, self.max_seen - self.n_seen)):
            if self.is_complete:
                break
            self.n_seen += 1
            n_returns = int(np.count_nonzero(~np.isnan(block.range_m[line])))
            if n_returns == 0:
                continue
            self.range_m.append(block.range_m[line].copy())
            if block.xyz_m is not None:
                self.xyz_m.append(block.xyz_m[line].copy())
            self.tells |= n_returns > 1
            if len(self.range_m) >= SAMPLE_LINES and not self.tells:
                # a recording may begin with stray shots: directions are looked for behind them
                del self.range_m[:-1], self.xyz_m[:-1]


@dataclass(frozen=True, slots=True)
class Directions:
    """Directions found for a scanner."""

    beam_rad: F64
    keep_xyz: bool
    assumption: Assumption | None
    cos_tilt: float = 1.0
    """Cosine of the tilt of the scan plane from the vertical."""
    is_made_up: bool = False
    """Whether the directions are placeholders, allowed only while no line has two returns."""
    note: str = ""
    angle_rad: F64 | None = None
    """(M,) float64, scan angle of every column, where it was measured from the ranges [rad]."""
    angles_off: float = 0.0
    """Their uncertainty, as a share."""
    frame: SensorFrame | None = None
    """Frame of the scanner in that of its coordinates."""
    has_rings: bool = False
    """Whether coordinates show that columns are the rings of a spinning scanner."""


@dataclass(frozen=True, slots=True)
class BeamFinder:
    """Finds the beam directions of a scanner from its first lines."""

    info: StreamInfo
    down_deg: float | None
    """Given scan angle of straight down [deg]."""
    split_by: str | None
    """Dimension with the scanner id."""
    measures: bool = False
    """Whether scan angles are measured from the ranges though there are others."""

    def sample(self, first: ScanBlock) -> Sample:
        """Return an empty sample for a scanner, from its first block."""
        has_angles = not self.measures and (
            first.angle_rad is not None or self.info.angle_rad is not None
        )
        has_down = self.down_deg is not None or self.info.down(first.scanner)[0] is not None
        knows = not self.measures and (first.xyz_m is not None or (has_angles and has_down))
        spins = (
            first.xyz_m is not None
            and first.points_per_line <= MAX_RINGS
            and is_spinning(first.xyz_m)
        )
        n_lines = SAMPLE_LINES if knows else SPREAD * SAMPLE_LINES
        return Sample(
            n_lines=TURN_LINES if spins else n_lines, is_spinning=spins, frame=first.frame
        )

    def put(self, directions: Directions, block: ScanBlock) -> ScanBlock:
        """Return a block with its directions."""
        if directions.is_made_up and (np.isfinite(block.range_m).sum(axis=1) > 1).any():
            error = self._refusal(
                block.scanner, f"the first {MAX_SAMPLE_CELLS} shots tell nothing", None
            )
            raise fitting_error(error, self.info.facts.refuses, self.info.facts.remedy)
        xyz_m = block.xyz_m if directions.keep_xyz else None
        if xyz_m is None and directions.cos_tilt < math.cos(MIN_TILT_RAD):
            xyz_m = _tilted(block.range_m, directions.beam_rad, directions.cos_tilt)
        angle_rad = block.angle_rad if directions.angle_rad is None else directions.angle_rad
        frame = directions.frame if block.frame is None and directions.keep_xyz else block.frame
        has_rings = block.has_rings or directions.has_rings
        return replace(
            block,
            beam_rad=directions.beam_rad,
            xyz_m=xyz_m,
            angle_rad=angle_rad,
            frame=frame,
            has_rings=has_rings,
        )

    def find(self, sample: Sample) -> Directions:
        """Apply the first applicable method, and find whether columns are rings.

        Hints name only options that the input accepts.
        """
        facts = self.info.facts
        try:
            directions = self._find(sample)
        except (InputError, ConfigError) as error:
            raise fitting_error(error, facts.refuses, facts.remedy) from error
        # in a file of scans the scanner does not move, and turns slowly
        if (
            not sample.is_spinning
            or not directions.keep_xyz
            or directions.is_made_up
            or facts.has_scans
        ):
            return directions
        xyz = np.stack(sample.xyz_m[:SAMPLE_LINES])
        return replace(
            directions,
            has_rings=are_rings(xyz if directions.frame is None else directions.frame.own(xyz)),
        )

    def _find(self, sample: Sample) -> Directions:
        scanner = sample.scanner
        angle = sample.angle_rad if sample.angle_rad is not None else self.info.angle_rad
        n = len(sample.range_m)
        range_m = np.stack(sample.range_m) if n else np.empty((0, 0), np.float32)
        xyz = np.stack(sample.xyz_m) if n and len(sample.xyz_m) == n else None
        if self.measures or (angle is None and xyz is None):
            return self._measured(sample, range_m)
        off_m = None if xyz is None else _off(xyz, range_m)
        if self.down_deg is not None:
            if angle is None:
                problem = f"is given, but {self.info.path} has no scan angles"
                raise ConfigError(
                    KEY, problem, "give input.angle_start and input.angle_step, or --columns angle"
                )
            shown = f"{self.down_deg:g} deg"
            return self._turned(
                angle, math.radians(self.down_deg), off_m, shown, "input.nadir is given"
            )
        down_rad, cos_tilt = self.info.down(scanner)
        if down_rad is not None and angle is not None:
            is_assumed = any(assumption.key.startswith(KEY) for assumption in self.info.assumptions)
            shown = "" if is_assumed else f"{math.degrees(down_rad):.2f} deg"
            return self._turned(
                angle, down_rad, off_m, shown, "the input says where down is", cos_tilt
            )
        if not (np.isfinite(range_m).sum(axis=1) > 1).any():
            return self._made_up(scanner, sample.points_per_line, has_returns=n > 0)
        if xyz is None and angle is not None:
            return self._guessed(scanner, angle, range_m)
        assert xyz is not None
        if off_m is not None:
            return self._registered(scanner, angle, range_m, xyz, off_m)
        frame, xyz = _in_frame(sample, xyz)
        try:
            beams = fit_beams(xyz)
        except TooFewReturnsError:
            # coordinates are zero, but ranges are not
            return self._made_up(scanner, sample.points_per_line, has_returns=True)
        except NoDirectionError as error:
            raise self._refusal(scanner, str(error), error) from error
        way = "a straight line in the column through the" if beams.is_straight else "the"
        why = f"{way} median directions of xyz over {beams.n_lines} of the first lines with returns"
        directions = Directions(
            beams.beam_rad, True, Assumption(KEY, _shown(beams.beam_rad), why), frame=frame
        )
        return (
            directions if frame is None else replace(directions, note=self._noted(frame, scanner))
        )

    def _noted(self, frame: SensorFrame, scanner: int) -> str:
        which = self._which(scanner)
        before, after = frame.spread_deg
        why = (
            f"rings spread by {before:.2g} deg of elevation as the coordinates are, "
            f"by {after:.2g} from there"
        )
        prefix = f"{which}: " if which else ""
        return f"{prefix}{frame.shown()} in the frame of x, y, z ({why}); undone"

    def _measured(self, sample: Sample, range_m: F32) -> Directions:
        """Use angles measured from the ranges; straight down is given, or level ground."""
        scanner = sample.scanner
        m = sample.points_per_line
        if not (np.isfinite(range_m).sum(axis=1) > 1).any():
            return self._made_up(scanner, m, has_returns=len(range_m) > 0)
        step = measure_step(range_m)
        if step is None or step.off > MOST_OFF:
            raise self._refusal(
                scanner, f"{self._lacks(scanner, None)}, and {_no_step(step, m)}", None
            )
        angle = step.angles(m)
        if self.down_deg is not None:
            directions = self._turned(angle, math.radians(self.down_deg), None, "", "")
        else:
            directions = self._guessed(scanner, angle, range_m)
        column = int(np.argmin(np.abs(directions.beam_rad)))
        where = f"down at column {column}"
        origin = "given" if self.down_deg is not None else "from level ground"
        why = f"{origin}: {where}; the input gives no angles"
        shown = step.shown(m)
        which = self._which(scanner)
        note = f"{which + ': ' if which else ''}angles measured from the ranges: {shown}; {where}"
        taken = Assumption(ANGLES, f"measured: {shown}", why)
        return replace(
            directions, assumption=taken, note=note, angle_rad=angle, angles_off=step.off
        )

    def _made_up(self, scanner: int, points_per_line: int, *, has_returns: bool) -> Directions:
        """Return placeholder directions.

        Lines of one return have no angles, and stay unclassified.
        """
        beam_rad = np.linspace(*MADE_UP_RAD, points_per_line)
        which = self._which(scanner)
        shown = (
            "no line has two returns: nothing can be classified"
            if has_returns
            else "no shot has a return"
        )
        return Directions(
            beam_rad, True, None, is_made_up=True, note=f"{which}: {shown}" if which else shown
        )

    def _turned(
        self,
        angle: F64,
        down_rad: float,
        off_m: float | None,
        shown: str,
        why: str,
        cos_tilt: float = 1.0,
    ) -> Directions:
        try:
            beam_rad = from_angles(angle, down_rad)
        except NoDirectionError as error:
            raise InputError(
                self.info.path, f"scan angles: {error}", "check the scan angles and columns"
            ) from error
        if off_m is not None:
            shown = shown or f"{math.degrees(down_rad):.2f} deg"
            why = (
                f"{why}; "
                f"xyz is not relative to the scanner ({off_m:.2f} m off the range) and not used"
            )
        return Directions(
            beam_rad, off_m is None, Assumption(KEY, shown, why) if shown else None, cos_tilt
        )

    def _guessed(self, scanner: int, angle: F64, range_m: F32) -> Directions:
        """Use the direction of level ground, where no other comes near."""
        if are_radians(angle):
            span = math.degrees(float(np.ptp(angle)))
            problem = (
                f"the angles of a line span {span:.3g} deg, as radians of a turn do: "
                "name them angle_rad"
            )
            hint = f"if they are degrees, give {KEY}; if they have another scale: {MEASURED}"
            raise InputError(self._where(scanner), problem, hint)
        range_m = range_m[spread_rows(len(range_m), SAMPLE_LINES)]
        guess = guess_down(angle, range_m)
        if guess is None:
            if "angle_start" in self.info.facts.refuses:
                hint = f"give the scan angle that points straight down: --set {KEY}=DEG"
                problem = f"no vertical direction known: {self._lacks(scanner, angle)}"
                raise InputError(self._where(scanner), problem, hint)
            raise self._refusal(scanner, self._lacks(scanner, angle), None)
        if not guess.is_sure and guess.rival_rad is not None:
            ways = [f"{math.degrees(way_rad):.0f}" for way_rad in (guess.down_rad, guess.rival_rad)]
            problem = f"level ground may be at {ways[0]} deg of the scan angle or at {ways[1]}"
            weaker = (
                "one the floor, the other a ceiling"
                if guess.is_room
                else f"only {guess.ratio:.1f} times weaker"
            )
            problem = f"no vertical direction known: {problem} ({weaker})"
            hint = (
                "give the one that points straight down, "
                f"--set {KEY}={ways[0]} or --set {KEY}={ways[1]}"
            )
            raise InputError(self._where(scanner), problem, hint)
        why = f"{len(range_m)} lines see level ground around it; give {KEY} to be exact"
        directions = self._turned(angle, guess.down_rad, None, guess.shown(), why)
        which = self._which(scanner)
        note = f"{which}: " if which else ""
        return replace(
            directions, note=f"{note}straight down is taken to be at scan angle {guess.shown()}"
        )

    def _registered(
        self,
        scanner: int,
        angle: F64 | None,
        range_m: F32,
        xyz: F32,
        off_m: float,
    ) -> Directions:
        """Use heights of registered coordinates, if there are scan angles."""
        problem = (
            "xyz is not relative to the scanner: "
            f"its length is {off_m:.2f} m off the range, in the middle"
        )
        if angle is None:
            hint = "subtract the scanner's position from xyz, or add angle_deg"
            raise InputError(self._where(scanner), f"no vertical direction known: {problem}", hint)
        line = np.repeat(np.arange(len(range_m)), range_m.shape[1])
        every = np.tile(angle, len(range_m))
        try:
            fit = fit_heights(every, range_m.ravel(), xyz[..., 2].ravel(), line)
        except NoDirectionError as error:
            raise self._refusal(scanner, f"{problem}, and {error}", error) from error
        why = (
            f"found from the heights of xyz over {len(range_m)} lines, "
            f"within {fit.off_m:.3f} m in the middle"
        )
        shown = f"{math.degrees(fit.down_rad):.2f} deg{shown_tilt(fit.cos_tilt)}"
        return self._turned(angle, fit.down_rad, off_m, shown, why, fit.cos_tilt)

    def _lacks(self, scanner: int, angle: F64 | None) -> str:
        keys = (KEY, f"{KEY} of {self._which(scanner)}")
        for assumption in self.info.assumptions:
            if assumption.key in keys and assumption.value == "not found":
                return assumption.why
        if angle is not None:
            return "the input has scan angles, but not the angle of straight down"
        return "the input has no scan angles"

    def _which(self, scanner: int) -> str:
        """Return the place for messages, with the scanner where the input may have several."""
        if scanner < len(self.info.facts.scanners):
            return self.info.facts.scanners[scanner]
        if self.info.facts.has_scans:
            return f"scan {scanner}"
        return "" if self.split_by is None else f"{self.split_by} {scanner}"

    def _where(self, scanner: int) -> str:
        which = self._which(scanner)
        return f"{self.info.path}: {which}" if which else self.info.path

    def _refusal(self, scanner: int, problem: str, error: NoDirectionError | None) -> InputError:
        return InputError(
            self._where(scanner), f"no vertical direction known: {problem}", self._hint(error)
        )

    def _hint(self, error: NoDirectionError | None) -> str:
        if isinstance(error, NoddingError):
            return (
                "check that the origin is the scanner and z is up; "
                "for a scanner that nods: --method prc"
            )
        if self.info.facts.has_scans:
            if isinstance(error, LevelLinesError):
                return (
                    "check whether rows and columns are exchanged in the header, "
                    "and whether its pose turns z up"
                )
            if isinstance(error, WrongOriginError):
                return (
                    "export the scan with its origin at the scanner "
                    "and the registration in the pose"
                )
            return "check rows, columns and pose in the header, or export the scan again"
        if self.info.format == _ARRAY:
            if isinstance(error, LevelLinesError):
                return "check whether lines and columns are exchanged, and that z is up"
            if isinstance(error, WrongOriginError):
                return "subtract the scanner's position from xyz"
            return f"give {_ANGLES_ALONE}, or an .npz with zenith_deg or xyz of the scanner"
        if isinstance(error, LevelLinesError):
            return "check the lines (--lines, -M), and that z is up"
        ways = self._ways_of_coordinates(origin_only=isinstance(error, WrongOriginError))
        if isinstance(error, WrongOriginError):
            return f"give {' or '.join(ways)}"
        if self.info.angle_rad is not None and not self.measures:
            ways = [f"{MEASURED} if the recorded angles have another scale", *ways]
        return f"give {', '.join([*ways, ''])}{'or ' if ways else ''}{_ANGLES_ALONE}"

    def _ways_of_coordinates(self, *, origin_only: bool) -> list[str]:
        has = self.info.dimensions
        if has and not set(has) >= set(XYZ):
            return []
        ways = ["--range origin:X,Y,Z"]
        if not has or "time" in has:
            ways.insert(0, "--range trajectory:FILE")
        if "time" in has:
            ways.insert(0, POINTS)
        return ways if origin_only else ["--range sensor-xyz", *ways]


def with_beams(stream: ScanStream, config: InputConfig) -> Stream:
    """Add the direction of the beam of every column, given or found in the first lines."""
    plain = Stream.of(stream)
    split_by = None if config.scanner == "none" else config.scanner
    finder = BeamFinder(plain.info, config.nadir, split_by, config.angles == "measured")
    known = _first_directions(plain, finder)
    observed = replace(plain.observed, beams={})
    directed = partial(_directed, finder=finder, known=known, late=observed.beams)
    return replace(plain.through(directed), plain=plain, beams=known, observed=observed)


def _first_directions(stream: Stream, finder: BeamFinder) -> dict[int, Directions]:
    """Return the directions of every scanner in the first lines, until all of these are known."""
    known: dict[int, Directions] = {}
    waiting: dict[int, Sample] = {}
    with closing_items(stream.first_blocks()) as blocks:
        for block in blocks:
            if block.scanner not in known:
                sample = waiting.setdefault(block.scanner, finder.sample(block))
                sample.add(block)
                if sample.is_complete or block.is_last:
                    known[block.scanner] = finder.find(waiting.pop(block.scanner))
            if not waiting:
                return known
    return known | {scanner: finder.find(sample) for scanner, sample in waiting.items()}


def _directed(
    blocks: Iterator[ScanBlock],
    finder: BeamFinder,
    known: Mapping[int, Directions],
    late: dict[int, Directions],
) -> Iterator[ScanBlock]:
    """Put directions into blocks; those of a scanner that is not ``known`` are found ``late``."""
    by_scanner = dict(known)
    waiting: dict[int, Sample] = {}
    for block in blocks:
        scanner = block.scanner
        if scanner in by_scanner:
            yield finder.put(by_scanner[scanner], block)
            continue
        sample = waiting.setdefault(scanner, finder.sample(block))
        sample.add(block)
        sample.held.append(block)
        if sample.is_complete or block.is_last:
            by_scanner[scanner] = late[scanner] = finder.find(waiting.pop(scanner))
            for held in sample.held:
                yield finder.put(by_scanner[scanner], held)
    for scanner, sample in waiting.items():
        late[scanner] = finder.find(sample)
        for held in sample.held:
            yield finder.put(late[scanner], held)


def _in_frame(sample: Sample, xyz: F32) -> tuple[SensorFrame | None, F32]:
    """Return the frame of a scanner, and coordinates of its first lines in it."""
    frame = sample.frame
    if sample.is_spinning:
        if frame is None:
            there = np.isfinite(xyz[..., 0])
            frame = find_frame(xyz[there], np.nonzero(there)[1])
        # as many lines as of other scanners tell the beams
        xyz = xyz[:SAMPLE_LINES]
    return frame, xyz if frame is None else frame.own(xyz)


def _no_step(step: AngleStep | None, points_per_line: int) -> str:
    if step is None:
        return "too few planes to measure angles"
    return f"planes do not agree on the angles: {step.shown(points_per_line)}"


def _tilted(range_m: F32, beam_rad: F64, cos_tilt: float) -> F32:
    """Return coordinates (lines, M, 3) in a tilted scan plane.

    Heights are true, x is the horizontal distance.
    """
    up = -cos_tilt * np.cos(beam_rad)
    across = np.copysign(np.sqrt(1 - up * up), np.sin(beam_rad))
    xyz: F32 = np.zeros((*range_m.shape, 3), np.float32)
    xyz[..., 0] = range_m * across
    xyz[..., 2] = range_m * up
    xyz[np.isnan(range_m)] = np.nan
    return xyz


def from_angles(angle_rad: F64, down_rad: float) -> F64:
    """Turn scan angles so that straight down is 0; those that go back a little grow all the same.

    >>> bool((np.diff(from_angles(np.radians([10, 20, 19, 40]), 0.0)) > 0).all())
    True
    """
    if len(angle_rad) < 2:
        return wrap(np.asarray(angle_rad, np.float64) - down_rad)
    way = math.copysign(1.0, float(np.sign(wrap(np.diff(angle_rad))).sum()))
    beam = way * (angle_rad - down_rad)
    along = forward_steps(beam)
    if (along > 0).all() and along.sum() <= 2 * math.pi:
        return wrap(angle_rad - down_rad)
    m = len(beam)
    return wrap(way * turn_evenly(np.arange(m), beam, np.ones(m), m)[0])


def _off(xyz: NDArray[np.float32], range_m: F32) -> float | None:
    """Return the median of ``|xyz| - range`` [m]; None if they agree."""
    length = np.sqrt((xyz.astype(np.float64) ** 2).sum(axis=-1))
    off = np.abs(length - range_m)
    both = np.isfinite(off)
    if not both.any():
        return None
    limit = np.maximum(MAX_LENGTH_OFF * range_m[both], MAX_LENGTH_OFF_M)
    return float(np.median(off[both])) if np.median(off[both] - limit) > 0 else None


def _shown(beam_rad: F64) -> str:
    """Return a text with the angles from straight down, 0 to 180 deg on either side."""
    degrees = np.rad2deg(beam_rad)
    sides = [np.abs(side) for side in (degrees[degrees >= 0], degrees[degrees < 0]) if len(side)]
    first, *others = (f"{side.min():.2f} to {side.max():.2f}" for side in sides)
    shown = f"beams from {first} deg from straight down"
    return f"{shown} on one side, {others[0]} on the other" if others else shown

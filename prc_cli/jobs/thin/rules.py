"""Rules of ``prc thin``: which share of which class is kept, by line and column, or by spacing along the line."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.classes import ClassCodes, Label
from prc_cli.core.errors import ConfigError
from prc_cli.core.stream import ExtraReturns
from prc_cli.core.types import F64, I64, Mask
from prc_cli.formats.records import NO_CODE
from prc_cli.formats.writing.base import StreamItem
from prc_cli.formats.writing.columns import HIGH_NOISE_CODE

MAX_DENOMINATOR = 1_000_000
"""Largest denominator of a fraction."""
MAX_SPACING_M = 10_000.0


@dataclass(frozen=True, slots=True)
class ThinRule:
    """How much of a class is kept."""

    name: str
    codes: tuple[int, ...]
    """Class codes of the rule."""
    is_rest: bool = False
    """Whether it is for all returns but those of these classes, as for those without a class."""
    share: Fraction | None = None
    """Share of shots to keep, in a pattern of line and column; 0 = none, 1 = all."""
    spacing_m: float | None = None
    """Least distance between shots of the class in a line [m]."""

    def holds(self, codes: NDArray[np.integer]) -> Mask:
        """Mark the returns that the rule is for."""
        found: Mask = np.isin(codes, self.codes) ^ self.is_rest
        return found

    def __str__(self) -> str:
        return f"{self.name}={self.share if self.spacing_m is None else f'{self.spacing_m:g} m'}"


def parse_rules(
    keep: Iterable[str] = (),
    spacing: Iterable[str] = (),
    drop: Iterable[str] = (),
    codes: ClassCodes | None = None,
    *,
    keep_only: Iterable[str] = (),
) -> tuple[ThinRule, ...]:
    """Parse options into rules; noise is dropped unless a rule names it.

    >>> [str(rule) for rule in parse_rules(["ground=1/4"], ["building=0.1"], ["car,noise"])]
    ['ground=1/4', 'building=0.1 m', 'car=0', 'noise=0']
    >>> [str(rule) for rule in parse_rules(["ground=1/4"], keep_only=["ground,pole"])]
    ['ground=1/4', 'all but ground, pole=0']
    """
    table = codes or ClassCodes()
    keep, spacing, drop, only = (
        [part.strip() for text in texts for part in text.split(",") if part.strip()]
        for texts in (keep, spacing, drop, keep_only)
    )
    rules: list[ThinRule] = []
    for text in keep:
        name, value = _split(text, "--keep", "FRACTION", "ground=1/4")
        rules.append(ThinRule(name, _codes(name, "--keep", table), share=_share(text, value)))
    for text in spacing:
        name, value = _split(text, "--spacing", "METRES", "ground=0.1")
        rules.append(
            ThinRule(name, _codes(name, "--spacing", table), spacing_m=_metres(text, value))
        )
    rules.extend(ThinRule(name, _codes(name, "--drop", table), share=Fraction(0)) for name in drop)
    if only:
        rules.append(_rest(only, rules, table))
    named = {code for rule in rules for code in rule.codes}
    left = (
        () if only else tuple(code for code in _codes("noise", "noise", table) if code not in named)
    )
    if left and table.noise not in named:
        rules.append(ThinRule("noise", left, share=Fraction(0)))
    seen: dict[int, str] = {}
    for rule in rules:
        for code in () if rule.is_rest else rule.codes:
            if code in seen:
                problem = f"class code {code} is named twice, as {seen[code]} and {rule}"
                raise ConfigError("classes to thin", problem, "give one rule a class")
            seen[code] = str(rule)
    return tuple(rules)


def _rest(only: list[str], rules: list[ThinRule], table: ClassCodes) -> ThinRule:
    """Return the rule that drops what is not of some classes."""
    kept = tuple(code for name in only for code in _codes(name, "--keep-only", table))
    for rule in rules:
        if (rule.share == 0) == any(code in kept for code in rule.codes):
            problem = f"found {rule} beside --keep-only {','.join(only)}, which says otherwise"
            raise ConfigError("classes to thin", problem, "name a class in one of them")
    return ThinRule(f"all but {', '.join(only)}", kept, is_rest=True, share=Fraction(0))


def _split(
    text: str,
    option: str,
    what: str,
    example: str,
) -> tuple[str, str]:
    name, sign, value = (part.strip() for part in text.partition("="))
    if not (name and sign and value):
        raise ConfigError(
            option, f"found {text!r}, expected CLASS={what}", f"for example {option} {example}"
        )
    return name, value


def _share(text: str, value: str) -> Fraction:
    try:
        share = Fraction(value)
    except (ValueError, ZeroDivisionError):
        share = Fraction(-1)
    if not 0 <= share <= 1 or share.denominator > MAX_DENOMINATOR:
        problem = f"found {text!r}, expected a fraction from 0 to 1 with a denominator up to {MAX_DENOMINATOR}"
        raise ConfigError("--keep", problem, "for example --keep ground=1/4")
    return share


def _metres(text: str, value: str) -> float:
    try:
        metres = float(value)
    except ValueError:
        metres = math.nan
    if not 0 < metres <= MAX_SPACING_M:
        problem = f"found {text!r}, expected a distance above 0, up to {MAX_SPACING_M:g} m"
        raise ConfigError("--spacing", problem, "for example --spacing ground=0.1")
    return metres


def _codes(name: str, option: str, table: ClassCodes) -> tuple[int, ...]:
    """Return the codes of a class name or number."""
    names = {label.name.lower(): table.code(label) for label in Label if label is not Label.MISSING}
    if name.lower() == "noise":
        return tuple(dict.fromkeys((table.noise, HIGH_NOISE_CODE)))
    if name.lower() in names:
        return (names[name.lower()],)
    if name.isdecimal() and int(name) < 2**31:
        return (int(name),)
    near = difflib.get_close_matches(name.lower(), names, n=1, cutoff=0.4)
    hint = (
        f"did you mean {near[0]!r}?"
        if near
        else f"known classes: {', '.join(names)}, or a class code"
    )
    raise ConfigError(option, f"unknown class {name!r}", hint)


_GOLDEN = 0.618
"""Shift of the pattern from line to line, as a share of its period, to avoid stripes."""


def keep_by_pattern(
    line: NDArray[np.integer], column: NDArray[np.integer], share: Fraction
) -> Mask:
    """Mark a share of the shots, evenly along a line, shifted from line to line.

    >>> grid = np.indices((4, 8))
    >>> keep_by_pattern(grid[0], grid[1], Fraction(1, 4)).astype(int)
    array([[1, 0, 0, 0, 1, 0, 0, 0],
           [0, 0, 1, 0, 0, 0, 1, 0],
           [1, 0, 0, 0, 1, 0, 0, 0],
           [0, 0, 1, 0, 0, 0, 1, 0]])
    """
    part = share.numerator
    whole = share.denominator
    shift = max(round(_GOLDEN * whole / max(part, 1)), 1)
    place = (column.astype(np.int64) + shift * (line.astype(np.int64) % whole)) % whole
    kept: Mask = place * part % whole < part
    return kept


def keep_by_spacing(position_m: F64, chosen: Mask, spacing_m: float) -> Mask:
    """Mark in every line the first chosen shot, and each next one at least ``spacing_m`` from the last one marked.

    >>> position = np.arange(6.0)[None, :, None]
    >>> keep_by_spacing(position, np.ones((1, 6), np.bool_), 2.5).astype(int)
    array([[1, 0, 0, 1, 0, 0]])
    """
    kept = np.zeros(chosen.shape, np.bool_)
    last = np.full((len(chosen), position_m.shape[2]), np.inf)
    # all lines together, column by column
    by_column = np.ascontiguousarray(position_m.transpose(1, 0, 2))
    for column in np.flatnonzero(chosen.any(axis=0)):
        away = ((by_column[column] - last) ** 2).sum(axis=1)
        taken = chosen[:, column] & ~(away < spacing_m**2)
        kept[taken, column] = True
        last[taken] = by_column[column][taken]
    return kept


def choose(item: StreamItem, rules: tuple[ThinRule, ...]) -> tuple[Mask, Mask]:
    """Mark the returns to keep; further ones by their own class, with a spacing as the main return."""
    block = item.block
    extra = item.block.extra
    codes = item.codes
    extra_codes = item.extra_codes
    assert codes is not None
    assert extra_codes is not None
    kept = ~np.isnan(block.range_m)
    kept_extra = ~np.isnan(extra.range_m)
    line = (block.first_line + np.arange(block.n_lines, dtype=np.int64))[:, None]
    column = np.arange(block.points_per_line, dtype=np.int64)[None, :]
    spaced = np.zeros(len(extra), np.bool_)
    for rule in rules:
        chosen = kept & rule.holds(codes)
        chosen_extra = rule.holds(extra_codes)
        if rule.share is not None:
            kept &= ~chosen | keep_by_pattern(line, column, rule.share)
            if chosen_extra.any():
                cells = (extra.line.astype(np.int64) + block.first_line, extra.column)
                kept_extra &= ~chosen_extra | keep_by_pattern(*cells, rule.share)
        elif rule.spacing_m is not None:
            if chosen.any():
                kept &= ~chosen | keep_by_spacing(_positions(item), chosen, rule.spacing_m)
            spaced |= chosen_extra
    kept_extra &= ~spaced | kept[extra.line, extra.column]
    return kept, kept_extra


def _positions(item: StreamItem) -> F64:
    """Coordinates of every cell: relative to the scanner, else in the scan plane, else as registered."""
    block = item.block
    if block.xyz_m is not None:
        return block.xyz_m.astype(np.float64)
    if block.angle_rad is not None:
        ranges = block.range_m.astype(np.float64)
        return np.stack(
            [ranges * np.cos(block.angle_rad), ranges * np.sin(block.angle_rad)], axis=-1
        )
    if item.registered_m is not None:
        return item.registered_m
    problem = (
        "found neither scan angles nor coordinates, expected one of them to measure distances by"
    )
    raise ConfigError(
        "--spacing", problem, "give input.angle_start and input.angle_step, or thin with --keep"
    )


def without(item: StreamItem, kept: Mask, kept_extra: Mask) -> StreamItem:
    """Return a block without the dropped returns.

    If a main return is dropped, the nearest kept one takes its cell.
    """
    block = item.block
    extra = item.block.extra
    range_m = np.where(kept, block.range_m, np.float32(np.nan))
    xyz = (
        None if block.xyz_m is None else np.where(kept[..., None], block.xyz_m, np.float32(np.nan))
    )
    intensity = (
        None if block.intensity is None else np.where(kept, block.intensity, np.float32(np.nan))
    )
    codes = None if item.codes is None else np.where(kept, item.codes, np.int32(NO_CODE))
    further = item.extra_registered_m
    registered = (
        None if item.registered_m is None else np.where(kept[..., None], item.registered_m, np.nan)
    )
    stays = np.flatnonzero(kept_extra)
    orphans = stays[np.isnan(range_m[extra.line[stays], extra.column[stays]])]
    if len(orphans):
        heirs = _first_of_cell(extra, orphans, block.points_per_line)
        at = (extra.line[heirs], extra.column[heirs])
        range_m[at] = extra.range_m[heirs]
        if intensity is not None and extra.intensity is not None:
            intensity[at] = extra.intensity[heirs]
        if xyz is not None and block.xyz_m is not None:
            beam = block.xyz_m[at] * (extra.range_m[heirs] / block.range_m[at])[:, None]
            xyz[at] = beam if registered is not None or further is None else further[heirs]
        if codes is not None and item.extra_codes is not None:
            codes[at] = item.extra_codes[heirs]
        if registered is not None and further is not None:
            registered[at] = further[heirs]
        stays = np.setdiff1d(stays, heirs)
    lights = None if extra.intensity is None else extra.intensity[stays]
    left = ExtraReturns(
        extra.line[stays], extra.column[stays], extra.range_m[stays], extra.record[stays], lights
    )
    return StreamItem(
        replace(block, range_m=range_m, xyz_m=xyz, intensity=intensity, extra=left),
        codes,
        None if item.extra_codes is None else item.extra_codes[stays],
        registered,
        None if further is None else further[stays],
    )


def _first_of_cell(extra: ExtraReturns, which: I64, points_per_line: int) -> I64:
    """Return the nearest of some further returns for every cell."""
    cell = extra.line[which].astype(np.int64) * points_per_line + extra.column[which]
    order = np.lexsort((extra.range_m[which], cell))
    first = np.unique(cell[order], return_index=True)[1]
    return which[order[first]]

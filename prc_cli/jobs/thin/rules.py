"""Rules of ``prc thin``: keep a share of a class, by line and column or by spacing in a line."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.classes import NO_CODE, ClassCodes, Label
from prc_cli.core.errors import ConfigError
from prc_cli.core.near import did_you_mean
from prc_cli.core.stream import ExtraReturns
from prc_cli.core.types import F64, I64, Mask
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
    """Whether the rule is for all returns except these classes, also for returns without one."""
    share: Fraction | None = None
    """Share of shots to keep, in a pattern of line and column; 0 = none, 1 = all."""
    spacing_m: float | None = None
    """Least distance between shots of the class in a line [m]."""

    def holds(self, codes: NDArray[np.integer]) -> Mask:
        """Mark the returns that the rule is for."""
        held: Mask = np.isin(codes, self.codes) ^ self.is_rest
        return held

    def __str__(self) -> str:
        if self.spacing_m is not None:
            return f"{self.name}={self.spacing_m:g} m"
        return f"{self.name}={self.share}"


def parse_rules(
    keep: Iterable[str] = (),
    spacing: Iterable[str] = (),
    codes: ClassCodes | None = None,
    *,
    keep_only: Iterable[str] = (),
) -> tuple[ThinRule, ...]:
    """Parse options into rules; noise is dropped unless a rule names it.

    >>> [str(rule) for rule in parse_rules(["ground=1/4,car=0"], ["building=0.1"])]
    ['ground=1/4', 'car=0', 'building=0.1 m', 'noise=0']
    >>> [str(rule) for rule in parse_rules(["ground=1/4"], keep_only=["ground,pole"])]
    ['ground=1/4', 'all but ground, pole=0']
    """
    table = codes or ClassCodes()
    only = _parts(keep_only)
    rules: list[ThinRule] = []
    for text in _parts(keep):
        name, value = _split(text, "--keep", "FRACTION", "ground=1/4")
        rules.append(ThinRule(name, _codes(name, "--keep", table), share=_share(text, value)))
    for text in _parts(spacing):
        name, value = _split(text, "--spacing", "METRES", "ground=0.1")
        rules.append(
            ThinRule(name, _codes(name, "--spacing", table), spacing_m=_metres(text, value))
        )
    if only:
        rules.append(_all_but(only, rules, table))
    named = {code for rule in rules for code in rule.codes}
    if not only and table.noise not in named:
        noise = tuple(code for code in _codes("noise", "noise", table) if code not in named)
        rules.append(ThinRule("noise", noise, share=Fraction(0)))
    seen: dict[int, str] = {}
    for rule in rules:
        for code in () if rule.is_rest else rule.codes:
            if code in seen:
                problem = f"class code {code} is named twice, as {seen[code]} and {rule}"
                raise ConfigError("classes to thin", problem, "give one rule a class")
            seen[code] = str(rule)
    return tuple(rules)


def _parts(texts: Iterable[str]) -> list[str]:
    return [part.strip() for text in texts for part in text.split(",") if part.strip()]


def _all_but(only: list[str], rules: list[ThinRule], table: ClassCodes) -> ThinRule:
    kept = tuple(code for name in only for code in _codes(name, "--keep-only", table))
    for rule in rules:
        if (rule.share == 0) == any(code in kept for code in rule.codes):
            problem = f"found {rule} beside --keep-only {','.join(only)}, which says otherwise"
            raise ConfigError("classes to thin", problem, "name a class in one of them")
    return ThinRule(f"all but {', '.join(only)}", kept, is_rest=True, share=Fraction(0))


def _split(
    text: str,
    option: str,
    value_name: str,
    example: str,
) -> tuple[str, str]:
    name, sign, value = (part.strip() for part in text.partition("="))
    if not (name and sign and value):
        raise ConfigError(
            option,
            f"found {text!r}, expected CLASS={value_name}",
            f"for example {option} {example}",
        )
    return name, value


def _share(text: str, value: str) -> Fraction:
    try:
        share = Fraction(value)
    except (ValueError, ZeroDivisionError):
        share = Fraction(-1)
    if not 0 <= share <= 1 or share.denominator > MAX_DENOMINATOR:
        problem = (
            f"found {text!r}, expected a fraction from 0 to 1 "
            f"with a denominator up to {MAX_DENOMINATOR}"
        )
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
    # of a class name or number
    names = {label.name.lower(): table.code(label) for label in Label if label is not Label.MISSING}
    if name.lower() == "noise":
        return tuple(dict.fromkeys((table.noise, HIGH_NOISE_CODE)))
    if name.lower() in names:
        return (names[name.lower()],)
    if name.isdecimal() and int(name) < 2**31:
        return (int(name),)
    known = f"known classes: {', '.join(names)}, or a class code"
    raise ConfigError(option, f"unknown class {name!r}", did_you_mean(name, names) or known)


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
    n_kept = share.numerator
    period = share.denominator
    shift = max(round(_GOLDEN * period / max(n_kept, 1)), 1)
    phase = (column.astype(np.int64) + shift * (line.astype(np.int64) % period)) % period
    kept: Mask = phase * n_kept % period < n_kept
    return kept


def keep_by_spacing(position_m: F64, chosen: Mask, spacing_m: float) -> Mask:
    """Mark the first chosen shot of every line, then each one ``spacing_m`` from the last marked.

    ``position_m`` is (L, M, 2 or 3) float64, ``chosen`` (L, M).

    >>> position = np.arange(6.0)[None, :, None]
    >>> keep_by_spacing(position, np.ones((1, 6), np.bool_), 2.5).astype(int)
    array([[1, 0, 0, 1, 0, 0]])
    """
    kept = np.zeros(chosen.shape, np.bool_)
    last = np.full((len(chosen), position_m.shape[2]), np.inf)
    # column by column, for all lines at once
    by_column = np.ascontiguousarray(position_m.transpose(1, 0, 2))
    for column in np.flatnonzero(chosen.any(axis=0)):
        squared_m2 = ((by_column[column] - last) ** 2).sum(axis=1)
        taken = chosen[:, column] & ~(squared_m2 < spacing_m**2)
        kept[taken, column] = True
        last[taken] = by_column[column][taken]
    return kept


def choose(item: StreamItem, rules: tuple[ThinRule, ...]) -> tuple[Mask, Mask]:
    """Mark the main and the further returns to keep.

    A share is applied to further returns by their class; with a spacing they follow their main
    return.
    """
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
    # (L, M, 2 or 3) [m]: relative to the scanner, else in the scan plane, else as registered
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
    problem = "found neither scan angles nor coordinates, expected one of them to measure distances"
    raise ConfigError(
        "--spacing", problem, "give input.angle_start and input.angle_step, or thin with --keep"
    )


def without(item: StreamItem, kept: Mask, kept_extra: Mask) -> StreamItem:
    """Return a block without the dropped returns.

    If a main return is dropped, the nearest kept further return takes its cell.
    """
    block = item.block
    extra = item.block.extra
    range_m = np.where(kept, block.range_m, np.float32(np.nan))
    xyz = _blank(block.xyz_m, kept, np.float32(np.nan))
    intensity = _blank(block.intensity, kept, np.float32(np.nan))
    codes = _blank(item.codes, kept, np.int32(NO_CODE))
    registered = _blank(item.registered_m, kept, np.nan)
    extra_registered = item.extra_registered_m
    stays = np.flatnonzero(kept_extra)
    orphans = stays[np.isnan(range_m[extra.line[stays], extra.column[stays]])]
    if len(orphans):
        heirs = _first_of_cell(extra, orphans, block.points_per_line)
        cells = (extra.line[heirs], extra.column[heirs])
        range_m[cells] = extra.range_m[heirs]
        if intensity is not None and extra.intensity is not None:
            intensity[cells] = extra.intensity[heirs]
        if xyz is not None and block.xyz_m is not None:
            if registered is None and extra_registered is not None:
                xyz[cells] = extra_registered[heirs]
            else:
                # further along the beam
                stretch = extra.range_m[heirs] / block.range_m[cells]
                xyz[cells] = block.xyz_m[cells] * stretch[:, None]
        if codes is not None and item.extra_codes is not None:
            codes[cells] = item.extra_codes[heirs]
        if registered is not None and extra_registered is not None:
            registered[cells] = extra_registered[heirs]
        stays = np.setdiff1d(stays, heirs)
    intensity_left = None if extra.intensity is None else extra.intensity[stays]
    extra_left = ExtraReturns(
        extra.line[stays],
        extra.column[stays],
        extra.range_m[stays],
        extra.record[stays],
        intensity_left,
    )
    return StreamItem(
        replace(block, range_m=range_m, xyz_m=xyz, intensity=intensity, extra=extra_left),
        codes,
        None if item.extra_codes is None else item.extra_codes[stays],
        registered,
        None if extra_registered is None else extra_registered[stays],
    )


def _blank(values: Any, kept: Mask, blank: Any) -> Any:
    # values is None, (L, M) or (L, M, 3)
    if values is None:
        return None
    return np.where(kept if values.ndim == kept.ndim else kept[..., None], values, blank)


def _first_of_cell(extra: ExtraReturns, which: I64, points_per_line: int) -> I64:
    # the nearest further return of every cell
    cell = extra.line[which].astype(np.int64) * points_per_line + extra.column[which]
    order = np.lexsort((extra.range_m[which], cell))
    first = np.unique(cell[order], return_index=True)[1]
    return which[order[first]]

"""Selects the returns of a block to keep: by line and column, or by spacing along the line."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.errors import ConfigError
from prc_cli.core.stream import ExtraReturns
from prc_cli.core.types import F64, I32, I64, Mask
from prc_cli.formats.writing.base import NO_CODE, StreamItem
from prc_cli.jobs.thin.rules import ThinRule

_GOLDEN = 0.618
"""Shift of the pattern from line to line, as a share of its period, to avoid stripes."""


def keep_by_pattern(line: NDArray[np.integer], column: NDArray[np.integer], share: Fraction) -> Mask:
    """Mark a share of the shots, evenly along a line, shifted from line to line.

    >>> grid = np.indices((4, 8))
    >>> keep_by_pattern(grid[0], grid[1], Fraction(1, 4)).astype(int)
    array([[1, 0, 0, 0, 1, 0, 0, 0],
           [0, 0, 1, 0, 0, 0, 1, 0],
           [1, 0, 0, 0, 1, 0, 0, 0],
           [0, 0, 1, 0, 0, 0, 1, 0]])
    """
    part, whole = share.numerator, share.denominator
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


def choose(item: StreamItem, codes: I32, extra_codes: I32, rules: tuple[ThinRule, ...]) -> tuple[Mask, Mask]:
    """Mark the returns of a block to keep.

    A further return follows the share of its own class at its own cell; with a spacing, it follows the main return of
    its shot.
    """
    block, extra = item.block, item.block.extra
    kept = ~np.isnan(block.range_m)
    kept_extra = ~np.isnan(extra.range_m)
    line = (block.first_line + np.arange(block.n_lines, dtype=np.int64))[:, None]
    column = np.arange(block.points_per_line, dtype=np.int64)[None, :]
    spaced = np.zeros(len(extra), np.bool_)
    for rule in rules:
        chosen, chosen_extra = kept & np.isin(codes, rule.codes), np.isin(extra_codes, rule.codes)
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
        return np.stack([ranges * np.cos(block.angle_rad), ranges * np.sin(block.angle_rad)], axis=-1)
    if item.registered_m is not None:
        return item.registered_m
    problem = "found neither scan angles nor coordinates, expected one of them to measure distances by"
    raise ConfigError("--spacing", problem, "give input.angle_start and input.angle_step, or thin with --keep")


def without(item: StreamItem, kept: Mask, kept_extra: Mask) -> StreamItem:
    """Return a block without the dropped returns; if a main return is dropped, the nearest kept one takes its cell."""
    block, extra = item.block, item.block.extra
    range_m = np.where(kept, block.range_m, np.float32(np.nan))
    xyz = None if block.xyz_m is None else np.where(kept[..., None], block.xyz_m, np.float32(np.nan))
    intensity = None if block.intensity is None else np.where(kept, block.intensity, np.float32(np.nan))
    codes = None if item.codes is None else np.where(kept, item.codes, np.int32(NO_CODE))
    further = item.extra_registered_m
    registered = None if item.registered_m is None else np.where(kept[..., None], item.registered_m, np.nan)
    stays = np.flatnonzero(kept_extra)
    orphans = stays[np.isnan(range_m[extra.line[stays], extra.column[stays]])]
    if len(orphans):
        heirs = _first_of_cell(extra, orphans, block.points_per_line)
        at = (extra.line[heirs], extra.column[heirs])
        range_m[at] = extra.range_m[heirs]
        if xyz is not None and block.xyz_m is not None:
            beam = block.xyz_m[at] * (extra.range_m[heirs] / block.range_m[at])[:, None]
            xyz[at] = beam if registered is not None or further is None else further[heirs]
        if codes is not None and item.extra_codes is not None:
            codes[at] = item.extra_codes[heirs]
        if registered is not None and further is not None:
            registered[at] = further[heirs]
        stays = np.setdiff1d(stays, heirs)
    left = ExtraReturns(extra.line[stays], extra.column[stays], extra.range_m[stays], extra.record[stays])
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

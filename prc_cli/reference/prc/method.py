"""The whole PRC method written from the paper (Lehtola et al. 2019), slow and obvious.

It sees the whole stream at once: support and background are computed on all of it and cut into blocks afterwards,
running totals are kept for ever. The shipped classifier sees one block and a bounded state and must give the same
labels and segments, bit for bit. Only NumPy, SciPy and scikit-image; it shares no code with classifier and kernels.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.classes import Label
from prc_cli.core.types import F32, I64, U8, Mask
from prc_cli.reference.prc.stages import (
    dilate,
    fill_holes,
    is_intersection,
    label_components,
)


@dataclass(frozen=True)
class Settings:
    """Parameters under the paper's symbols; ``area`` belongs to a full block of ``k`` lines."""

    k: int = 99
    environment: str = "urban"
    zeta_s: float = 1.0
    zeta_p: float = 1.0
    rho_c: float = 1 / 3
    rounding: str = "ceil"
    form: str = "centred"
    alpha: float = 0.3
    d_c: float = 0.05
    min_votes: int = 3
    area: float = 30.0
    gamma: int = 2
    ground: str = "running-total"
    column_step: int = 10
    density: float = 1 / 3
    noise_in_ground_columns: bool = True


@dataclass
class Memory:
    """What a block leaves to the next one."""

    last_line: list[int]
    totals: Counter[int] = field(default_factory=Counter)
    next_id: int = 1


def classify_stream(range_m: F32, settings: Settings) -> tuple[U8, I64]:
    """Label a whole stream.

    Parameters
    ----------
    range_m : (n_lines, M) float32, metres
        NaN = missing.
    settings : Settings

    Returns
    -------
    labels : (n_lines, M) uint8
    segments : (n_lines, M) int64
    """
    supported = support(range_m, settings)
    background = extended_background(range_m, supported, settings)
    labels = np.zeros(range_m.shape, dtype=np.uint8)
    segments = np.zeros(range_m.shape, dtype=np.int64)
    memory = Memory(last_line=[0] * range_m.shape[1])
    for first in range(0, len(range_m), settings.k):
        lines = slice(first, first + settings.k)
        labels[lines], segments[lines] = _classify_block(
            ~np.isnan(range_m[lines]), supported[lines], background[lines], memory, settings
        )
    return labels, segments


def support(range_m: F32, settings: Settings) -> Mask:
    """Supported measurements of a whole stream (II-B): neighbours by flat index, absent ones do not count."""
    flat = range_m.ravel()
    m = range_m.shape[1]
    in_slice = [-4, -3, -2, -1, 1, 2, 3, 4]
    adjacent = [shift for shift in (-m - 1, -m, -m + 1, m - 1, m, m + 1) if shift != 0]
    need_in_slice, need_adjacent = settings.rho_c * 8, settings.rho_c * 6
    if settings.rounding == "floor":
        need_in_slice, need_adjacent = math.floor(need_in_slice), math.floor(need_adjacent)
    mask = (
        ~np.isnan(flat)
        & (_count_agreeing(flat, in_slice, settings.zeta_p) >= need_in_slice)
        & (_count_agreeing(flat, adjacent, settings.zeta_s) >= need_adjacent)
    )
    return mask.reshape(range_m.shape)


def _count_agreeing(flat: F32, shifts: list[int], zeta: float) -> NDArray[np.int64]:
    """Count neighbours whose range differs by less than zeta (eqs. 5 and 6)."""
    count = np.zeros(len(flat), dtype=np.int64)
    for shift in shifts:
        here = np.arange(len(flat))
        here = here[(here + shift >= 0) & (here + shift < len(flat))]
        difference = np.abs(flat[here] - flat[here + shift])
        count[here] += difference.astype(np.float64) < np.float64(zeta)
    return count


def extended_background(range_m: F32, supported: Mask, settings: Settings) -> Mask:
    """Supported shots at intersections of surfaces (II-C), over a whole stream."""
    flat = range_m.ravel().astype(np.float64).tolist()
    mask = np.zeros(range_m.size, dtype=bool)
    for i in np.flatnonzero(supported).tolist():
        if i == 0 or i == len(flat) - 1 or math.isnan(flat[i - 1]) or math.isnan(flat[i + 1]):
            continue
        mask[i] = is_intersection(flat[i - 1], flat[i], flat[i + 1], settings.form, settings.alpha, settings.d_c)
    return mask.reshape(range_m.shape)


def _classify_block(
    valid: Mask, supported: Mask, background: Mask, memory: Memory, settings: Settings
) -> tuple[U8, I64]:
    """Do steps 3 to 6 of Algorithm 1 for one block and bring the memory up to date."""
    components, n_components = label_components(supported & ~background)
    components = fill_holes(components, background)
    ids = _carry_labels(components, n_components, memory, settings.min_votes)
    h_image = np.array([ids[c] for c in components.ravel().tolist()], dtype=np.int64).reshape(valid.shape)

    areas = Counter(h_image[h_image > 0].tolist())
    wanted = settings.area * len(valid) / settings.k
    small = {label for label, area in areas.items() if area < wanted}
    seeds = np.isin(h_image, list(small)) | (background & (h_image == 0))
    patches, n_patches = label_components(dilate(seeds, settings.gamma))
    in_patch = supported & (patches > 0)
    segments = np.where(in_patch, patches + (memory.next_id - 1), np.where(supported, h_image, 0))
    memory.next_id += n_patches
    smooth = supported & ~in_patch

    memory.last_line = [
        int(label) if is_smooth else 0 for label, is_smooth in zip(segments[-1], smooth[-1], strict=True)
    ]
    paint = _forest if settings.environment == "forest" else _urban
    labels = paint(valid, supported, smooth, segments, memory, settings)
    labels[~valid] = Label.MISSING
    return labels, segments


def _carry_labels(components: NDArray[np.int32], n_components: int, memory: Memory, min_votes: int) -> list[int]:
    """Segment id of every component: carried over the block boundary by votes, or new (II-D.2)."""
    votes: dict[int, Counter[int]] = {c: Counter() for c in range(1, n_components + 1)}
    for component, old in zip(components[0].tolist(), memory.last_line, strict=True):
        if component != 0 and old != 0:
            votes[component][old] += 1
    ids = [0]
    for component in range(1, n_components + 1):
        won = [(-count, old) for old, count in votes[component].items() if count >= min_votes]
        if won:
            ids.append(min(won)[1])
        else:
            ids.append(memory.next_id)
            memory.next_id += 1
    return ids


def _urban(valid: Mask, supported: Mask, smooth: Mask, segments: I64, memory: Memory, settings: Settings) -> U8:
    """Ground is the largest smooth segment so far, other smooth ones are buildings (II-F)."""
    here = Counter(segments[smooth].tolist())
    memory.totals.update(here)
    size = memory.totals if settings.ground == "running-total" else here
    ground = min(here, key=lambda label: (-size[label], label), default=0)
    labels = np.full(valid.shape, Label.NOISE, dtype=np.uint8)
    labels[supported] = Label.VEGETATION
    labels[smooth] = Label.BUILDING
    labels[smooth & (segments == ground)] = Label.GROUND
    return labels


def _forest(valid: Mask, supported: Mask, smooth: Mask, segments: I64, memory: Memory, settings: Settings) -> U8:
    """Smooth is stem, columns that are smooth often enough are ground (II-F, eq. 12)."""
    labels = np.full(valid.shape, Label.NOISE, dtype=np.uint8)
    labels[supported] = Label.VEGETATION
    labels[smooth] = Label.STEM
    for column in range(0, valid.shape[1], settings.column_step):
        if np.mean(smooth[:, column]) > settings.density:
            group = np.zeros(valid.shape, dtype=bool)
            group[:, column : column + settings.column_step] = True
            overwritten = valid if settings.noise_in_ground_columns else supported
            labels[group & overwritten] = Label.GROUND
    return labels

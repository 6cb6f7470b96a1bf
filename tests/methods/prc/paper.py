"""The whole PRC method, written from the paper, in its order and symbols.

V. V. Lehtola et al. (2019), "Preregistration classification of mobile LIDAR data using spatial
correlations", IEEE TGRS 57(9), sections II-A to II-F and Algorithm 1, whose steps are numbered
here.

Slow: support and background are computed for the whole stream before it is cut into blocks, and the
areas of all segments are kept. The compiled classifier sees one block and a bounded state, and must
give the same labels and segments, bit for bit. This module shares no code with it."""

import math
from collections import Counter
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.classes import Label
from prc_cli.core.types import F32, I32, I64, U8, Mask
from prc_cli.reference.prc.stages import dilate, fill_holes, is_intersection, label_components


@dataclass(frozen=True)
class Settings:
    """Parameters, with the symbols of the paper; choices that it leaves open have names."""

    k: int = 99
    """Scan lines of a block."""
    environment: str = "urban"
    zeta_s: float = 1.0
    """Greatest range difference to shots of adjacent lines [m]."""
    zeta_p: float = 1.0
    """Greatest range difference within the line [m]."""
    rho_c: float = 1 / 3
    """Least share of the neighbourhood that supports a shot."""
    rounding: str = "ceil"
    """How ``rho_c |N|`` becomes a count.

    "ceil" as (3) has it, 3 of 8 and 2 of 6; "floor" 2 and 2.
    """
    form: str = "centred"
    """Reading of (9), see :func:`prc_cli.reference.prc.stages.is_intersection`."""
    alpha: float = 0.3
    d_c: float = 0.05
    """Least length of physical objects [m]."""
    min_votes: int = 3
    forks: str = "all"
    """Pieces of a split segment that keep its label: "all", or the "largest"."""
    area: float = 30.0
    """A, pixels of a smooth segment in a block of k lines."""
    gamma: int = 2
    """Iterations of the dilation."""
    ground: str = "running-total"
    """Which smooth segment is largest: by its pixels of all blocks, or of this one."""
    column_step: int = 10
    density: float = 1 / 3
    noise_in_ground_columns: bool = True
    """Whether ground overwrites noise as well, in the forest."""


@dataclass
class Memory:
    """What a block leaves to the next one."""

    last_line: list[int]
    """Labels of the smooth shots of its last line, 0 = none."""
    totals: Counter[int] = field(default_factory=Counter)
    """Pixels of every smooth segment so far."""
    next_id: int = 1


def classify_stream(range_m: F32, settings: Settings) -> tuple[U8, I64]:
    """Label a whole stream (Algorithm 1).

    ``range_m`` (n_lines, M) float32, metres; returns ``labels`` (n_lines, M) uint8, ``segments``
    (n_lines, M) int64."""
    supported = support(range_m, settings)
    background = extended_background(range_m, supported, settings)
    labels = np.zeros(range_m.shape, dtype=np.uint8)
    segments = np.zeros(range_m.shape, dtype=np.int64)
    memory = Memory(last_line=[0] * range_m.shape[1])
    for first in range(0, len(range_m), settings.k):
        block = slice(first, first + settings.k)
        labels[block], segments[block] = _classify_block(
            ~np.isnan(range_m[block]), supported[block], background[block], memory, settings
        )
    return labels, segments


# II-B. Supported measurements


def support(range_m: F32, settings: Settings) -> Mask:
    """Return S, the shots that enough of their neighbours support (4).

    Neighbours are counted along the stream, so the shots at the end of a line are next to those at
    the beginning of the next one. Missing ones support nothing."""
    r = range_m.ravel()
    m = range_m.shape[1]
    n_adjacent = (-m - 1, -m, -m + 1, m - 1, m, m + 1)  # (7)
    n_in_slice = (-4, -3, -2, -1, 1, 2, 3, 4)  # (8)
    need_in_slice = settings.rho_c * len(n_in_slice)
    need_adjacent = settings.rho_c * len(n_adjacent)
    if settings.rounding == "floor":
        need_in_slice = math.floor(need_in_slice)
        need_adjacent = math.floor(need_adjacent)
    supported = (
        ~np.isnan(r)
        & (_cover(r, n_in_slice, settings.zeta_p) >= need_in_slice)
        & (_cover(r, n_adjacent, settings.zeta_s) >= need_adjacent)
    )
    return supported.reshape(range_m.shape)


def _cover(r: F32, neighbourhood: tuple[int, ...], zeta: float) -> NDArray[np.int64]:
    """Return C, how many neighbours differ by less than zeta in range (5, 6)."""
    cover = np.zeros(len(r), dtype=np.int64)
    i = np.arange(len(r))
    for shift in neighbourhood:
        if shift != 0:  # in lines of one shot, a neighbour of (7) is the shot itself
            inside = i[(i + shift >= 0) & (i + shift < len(r))]
            difference = np.abs(r[inside] - r[inside + shift])
            cover[inside] += difference.astype(np.float64) < np.float64(zeta)
    return cover


# II-C. Extension of background


def extended_background(range_m: F32, supported: Mask, settings: Settings) -> Mask:
    """Return G, the supported shots where two surfaces meet (9).

    Both neighbours along the stream must be there.
    """
    r = range_m.ravel().astype(np.float64).tolist()
    background = np.zeros(range_m.size, dtype=bool)
    for i in np.flatnonzero(supported).tolist():
        if 0 < i < len(r) - 1 and not math.isnan(r[i - 1] + r[i + 1]):
            background[i] = is_intersection(
                r[i - 1], r[i], r[i + 1], settings.form, settings.alpha, settings.d_c
            )
    return background.reshape(range_m.shape)


def _classify_block(
    valid: Mask,
    supported: Mask,
    background: Mask,
    memory: Memory,
    settings: Settings,
) -> tuple[U8, I64]:
    """Take a block through steps 3 to 6 and bring the memory up to date.

    Return labels and segments R.
    """
    h = _smooth_image(supported, background, memory, settings)
    v, n_patches = _nonsmooth_image(h, background, settings)
    # step 5: R has the labels of V where there are any, else those of H
    in_v = supported & (v > 0)
    segments = np.where(in_v, v.astype(np.int64) + (memory.next_id - 1), np.where(supported, h, 0))
    memory.next_id += n_patches
    smooth = supported & ~in_v
    memory.last_line = np.where(smooth[-1], segments[-1], 0).tolist()
    # step 6
    classify = _forest if settings.environment == "forest" else _urban
    labels = classify(valid, supported, smooth, segments, memory, settings)
    labels[~valid] = Label.MISSING
    return labels, segments


# II-D. Connected components in 2-D


def _smooth_image(
    supported: Mask,
    background: Mask,
    memory: Memory,
    settings: Settings,
) -> I64:
    """Return H (step 3)."""
    components, n_components = label_components(supported & ~background)  # a to c
    components = fill_holes(components, background)  # d, II-D.1
    ids = _carry_labels(components, n_components, memory, settings)  # e, II-D.2
    return np.array(ids, dtype=np.int64)[components]


def _carry_labels(
    components: I32,
    n_components: int,
    memory: Memory,
    settings: Settings,
) -> list[int]:
    """Return the label of every component.

    That of the block before with most votes, of equals the smallest, or new.

    Every shot of the first line votes for the label of the last line of the block before, in its
    column."""
    votes = Counter(
        (component, old)
        for component, old in zip(components[0].tolist(), memory.last_line, strict=True)
        if component != 0 and old != 0
    )
    ids = [0]
    for component in range(1, n_components + 1):
        won = [
            (-n, old)
            for (voter, old), n in votes.items()
            if voter == component and n >= settings.min_votes
        ]
        ids.append(min(won, default=(0, 0))[1])
    if settings.forks == "largest":
        for old in set(ids) - {0}:
            pieces = [component for component, label in enumerate(ids) if label == old]
            pieces.sort(key=lambda component: -np.count_nonzero(components == component))
            for smaller in pieces[1:]:
                ids[smaller] = 0
    for component in range(1, n_components + 1):
        if ids[component] == 0:
            ids[component] = memory.next_id
            memory.next_id += 1
    return ids


# II-E. Smooth and nonsmooth surfaces


def _nonsmooth_image(h: I64, background: Mask, settings: Settings) -> tuple[I32, int]:
    """Return V and the number of its segments (step 4).

    Small segments of H (11), dilated and connected anew.

    A / (k M) is constant, so the last block of a stream, of fewer lines, has a smaller A. Shots of
    G that no component took are small as well."""
    area = settings.area * len(h) / settings.k
    label, pixels = np.unique(h[h > 0], return_counts=True)
    small = np.isin(h, label[pixels < area]) | (background & (h == 0))
    return label_components(dilate(small, settings.gamma))


# II-F. Classification


def _urban(
    valid: Mask,
    supported: Mask,
    smooth: Mask,
    segments: I64,
    memory: Memory,
    settings: Settings,
) -> U8:
    """Label noise, ground, buildings and vegetation.

    Ground is the largest smooth segment, connected over blocks.
    """
    here = Counter(segments[smooth].tolist())
    memory.totals.update(here)
    size = memory.totals if settings.ground == "running-total" else here
    largest = min(here, key=lambda label: (-size[label], label), default=0)
    labels = np.full(valid.shape, Label.NOISE, dtype=np.uint8)
    labels[supported] = Label.VEGETATION
    labels[smooth] = Label.BUILDING
    labels[smooth & (segments == largest)] = Label.GROUND
    return labels


def _forest(
    valid: Mask,
    supported: Mask,
    smooth: Mask,
    segments: I64,
    memory: Memory,
    settings: Settings,
) -> U8:
    """Label noise, stems, other vegetation, and ground.

    Columns with a large share of smooth shots (12).
    """
    labels = np.full(valid.shape, Label.NOISE, dtype=np.uint8)
    labels[supported] = Label.VEGETATION
    labels[smooth] = Label.STEM
    for column in range(0, valid.shape[1], settings.column_step):
        if np.mean(smooth[:, column]) > settings.density:
            columns = slice(column, column + settings.column_step)
            overwritten = valid if settings.noise_in_ground_columns else supported
            labels[:, columns][overwritten[:, columns]] = Label.GROUND
    return labels

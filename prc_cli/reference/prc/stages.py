"""The steps of PRC with NumPy, SciPy and scikit-image (Lehtola et al. 2019, section II).

Names, arguments and results are those of the compiled loops in :mod:`prc_cli.methods.prc`; no code
is shared.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from skimage import measure

from prc_cli.core.types import F32, I32, I64, U8, Mask

CROSS = np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]], dtype=bool)
"""A pixel and its four neighbours."""


# II-A. From range image to binary image


def _inside(window: F32, image: Mask) -> F32:
    """Cut the block out of its window."""
    reach = max(image.shape[1] + 1, 4)
    return window[reach : reach + image.size].reshape(image.shape)


# II-B. Supported measurements


def support_mask(
    window: F32,
    n_lines: int,
    n_columns: int,
    zeta_p: float,
    zeta_s: float,
    min_in_slice: int,
    min_adjacent: int,
) -> Mask:
    """Mark shots that enough neighbours support (4 to 8).

    See :func:`support_loops.support_mask`.
    """
    m = n_columns
    shot = np.arange(n_lines * m) + max(m + 1, 4)
    ranges = window[shot]

    def count_agreeing(shifts: tuple[int, ...], zeta: float) -> NDArray[np.int64]:
        count = np.zeros(len(shot), np.int64)
        for shift in shifts:
            if shift != 0:
                difference = np.abs(ranges - window[shot + shift])
                count += difference.astype(np.float64) < np.float64(zeta)
        return count

    in_slice = count_agreeing((-4, -3, -2, -1, 1, 2, 3, 4), zeta_p)
    adjacent = count_agreeing((-m - 1, -m, -m + 1, m - 1, m, m + 1), zeta_s)
    is_supported = (in_slice >= min_in_slice) & (adjacent >= min_adjacent)
    mask: Mask = is_supported & ~np.isnan(ranges)
    return mask.reshape(n_lines, m)


# II-C. Extension of background


def background_mask(
    window: F32,
    supported: Mask,
    form: int,
    alpha: float,
    d_c: float,
) -> Mask:
    """Mark shots where surfaces meet (9); see :func:`support_loops.background_mask`."""
    n_lines, n_columns = supported.shape
    reach = max(n_columns + 1, 4)
    reading = ("centred", "literal", "abs", "guard")[form]
    mask = np.zeros((n_lines, n_columns), dtype=bool)
    for line, column in np.argwhere(supported).tolist():
        i = reach + line * n_columns + column
        before = float(window[i - 1])
        here = float(window[i])
        after = float(window[i + 1])
        if not np.isnan(before) and not np.isnan(after):
            mask[line, column] = is_intersection(before, here, after, reading, alpha, d_c)
    return mask


def is_intersection(
    before: float,
    here: float,
    after: float,
    form: str,
    alpha: float,
    d_c: float,
) -> bool:
    """Whether three successive ranges are of two surfaces that meet: (9) does not hold.

    ``form`` is how (9) is read: "literal"; "abs", with absolute differences, since ranges may fall
    as well as rise; "centred", the distance from the middle of the neighbours, which is (9) where
    they rise by ``d_c`` or more, and symmetric; "guard", the same, but never where the neighbours
    differ by less than ``d_c``.
    """
    if form == "literal":
        return not alpha < (here - before) / max(after - before, d_c) < 1.0 - alpha
    if form == "abs":
        return not alpha < abs(here - before) / max(abs(after - before), d_c) < 1.0 - alpha
    if form == "guard" and abs(after - before) < d_c:
        return False
    middle = (before + after) / 2.0
    return abs(here - middle) >= (0.5 - alpha) * max(abs(after - before), d_c)


# II-D. Connected components in 2-D


def label_components(image: Mask) -> tuple[I32, int]:
    """Find 4-connected components; see :func:`components_loops.label_components`."""
    label: Callable[..., I32] = measure.label
    labels = label(image, connectivity=1)
    numbers, first_pixel = np.unique(labels, return_index=True)
    in_raster_order = numbers[np.argsort(first_pixel)]
    in_raster_order = in_raster_order[in_raster_order != 0]
    renumbered = np.zeros(image.shape, dtype=np.int32)
    for new_number, number in enumerate(in_raster_order, start=1):
        renumbered[labels == number] = new_number
    return renumbered, len(in_raster_order)


def fill_holes(components: I32, holes: Mask) -> I32:
    """Give holes the most frequent component of 8 neighbours (II-D.1), of equals the smallest.

    Holes without such a neighbour stay 0.
    """
    framed = np.pad(components, 1)
    filled = components.copy()
    for line, column in np.argwhere(holes).tolist():
        neighbours = framed[line : line + 3, column : column + 3].ravel().tolist()
        del neighbours[4]  # the hole itself
        votes = Counter(label for label in neighbours if label != 0)
        if votes:
            filled[line, column] = min(votes, key=lambda label: (-votes[label], label))
    return filled


def join_and_fill(supported: Mask, background: Mask) -> tuple[I32, I64]:
    """Connect and fill; see :func:`components_loops.join_and_fill`."""
    joined, n_components = label_components(np.logical_and(supported, ~background))
    filled = fill_holes(joined, background)
    sizes = np.bincount(filled.ravel(), minlength=n_components + 1).astype(np.int64)
    sizes[0] = 0
    return filled, sizes


def carry_labels(
    first_line: I32,
    last_line: I64,
    n_components: int,
    min_votes: int,
) -> I64:
    """Carry labels over to the next block (II-D.2); see :func:`components_loops.carry_labels`."""
    votes = Counter(zip(first_line.tolist(), last_line.tolist(), strict=True))
    labels = np.zeros(n_components + 1, np.int64)
    for component in range(1, n_components + 1):
        candidates = [
            (-count, old_label)
            for (voter, old_label), count in votes.items()
            if voter == component and old_label != 0 and count >= min_votes
        ]
        if candidates:
            _, labels[component] = min(candidates)
    return labels


# II-E. Smooth and nonsmooth surfaces


def dilate(image: Mask, iterations: int) -> Mask:
    """Dilate with the cross; see :func:`surfaces_loops.dilate`."""
    if iterations == 0:  # SciPy takes 0 as "until nothing changes"
        return image.copy()
    grown: Mask = ndimage.binary_dilation(image, structure=CROSS, iterations=iterations)
    return grown


# II-F. Classification


def select_components(supported: Mask, components: I32, wanted: Mask) -> Mask:
    """Mark shots of some components; see :func:`surfaces_loops.select_components`."""
    selected: Mask = np.logical_and(np.take(wanted, components), supported)
    return selected


def count_covered(
    supported: Mask,
    covered: Mask,
    components: I32,
    n_components: int,
) -> I64:
    """Count shots under an image; see :func:`surfaces_loops.count_covered`."""
    under = components[np.logical_and(supported, covered)]
    return np.bincount(under, minlength=n_components + 1).astype(np.int64)


def draw_components(
    window: F32,
    supported: Mask,
    covered: Mask,
    components: I32,
    label_of: U8,
    others: U8,
) -> U8:
    """Draw labels by component; see :func:`surfaces_loops.draw_components`."""
    labels = np.where(covered, others[2], np.take(label_of, components))
    labels[~supported] = others[1]
    labels[~supported & np.isnan(_inside(window, supported))] = others[0]
    return labels


def draw_columns(
    window: F32,
    supported: Mask,
    covered: Mask,
    columns: Mask,
    noise_too: bool,
    labels_of: U8,
) -> U8:
    """Draw labels by cover and column; see :func:`surfaces_loops.draw_columns`."""
    missing, noise, marked, cover, free = labels_of
    labels = np.full(supported.shape, noise)
    if noise_too:
        labels[:, columns] = marked
    labels[np.isnan(_inside(window, supported))] = missing
    labels[supported] = free
    labels[np.logical_and(supported, covered)] = cover
    labels[np.logical_and(supported, columns[None, :])] = marked
    return labels

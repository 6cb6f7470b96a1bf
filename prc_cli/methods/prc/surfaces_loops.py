"""Loops that grow non-smooth surfaces and draw the classes (Lehtola et al. 2019, II-E, II-F)."""

from __future__ import annotations

import numpy as np

from prc_cli.core.loops import loop
from prc_cli.core.types import F32_1, I32_2, I64_1, U8_1, U8_2, Mask_1, Mask_2


@loop("prc_cli.reference.prc.stages")
def select_components(supported: Mask_2, components: I32_2, wanted: Mask_1) -> Mask_2:
    """Mark the supported shots of some components.

    ``supported`` (n_lines, n_columns) bool; ``components`` (n_lines, n_columns) int32; ``wanted``
    (n + 1,) bool; returns (n_lines, n_columns) bool.
    """
    n_lines, n_columns = supported.shape
    selected = np.empty((n_lines, n_columns), np.bool_)
    for line in range(n_lines):
        row = selected[line]
        inside = supported[line]
        component = components[line]
        for h in range(n_columns):
            row[h] = inside[h] & wanted[component[h]]
    return selected


@loop("prc_cli.reference.prc.stages")
def dilate(image: Mask_2, iterations: int) -> Mask_2:
    """Dilate a binary image with the 4-neighbour cross; outside the image is background.

    ``image`` (n_lines, n_columns) bool; returns (n_lines, n_columns) bool.
    """
    n_lines, n_columns = image.shape
    last = n_columns - 1
    grown = image.copy()
    before = np.empty_like(image)
    for _ in range(iterations):
        grown, before = before, grown
        for line in range(n_lines):
            row = grown[line]
            line_before = before[line]
            up = before[max(line - 1, 0)]
            down = before[min(line + 1, n_lines - 1)]
            for h in range(n_columns):
                row[h] = line_before[h] | up[h] | down[h]
            for h in range(last):
                row[h] |= line_before[h + 1]
            for h in range(last):
                row[h + 1] |= line_before[h]
    return grown


@loop("prc_cli.reference.prc.stages")
def count_covered(
    supported: Mask_2,
    covered: Mask_2,
    components: I32_2,
    n_components: int,
) -> I64_1:
    """Count the supported shots of every component that lie under another image.

    ``supported, covered`` (n_lines, n_columns) bool; ``components`` (n_lines, n_columns) int32;
    returns (n_components + 1,) int64.
    """
    n_lines, n_columns = supported.shape
    counts = np.zeros(n_components + 1, np.int64)
    n_words = n_columns // 8
    for line in range(n_lines):
        inside = supported[line]
        over = covered[line]
        component = components[line]
        words = over[: 8 * n_words].view(np.int64)
        for word in range(n_words):
            if words[word] == 0:  # as nearly everywhere: eight shots at once
                continue
            for h in range(8 * word, 8 * word + 8):
                counts[component[h]] += inside[h] & over[h]
        for h in range(8 * n_words, n_columns):
            counts[component[h]] += inside[h] & over[h]
    return counts


@loop("prc_cli.reference.prc.stages")
def draw_components(
    window: F32_1,
    supported: Mask_2,
    covered: Mask_2,
    components: I32_2,
    label_of: U8_1,
    others: U8_1,
) -> U8_2:
    """Draw labels by component where nothing covers them.

    ``window`` (reach + n_lines * n_columns + reach,) float32, metres; ``supported, covered``
    (n_lines, n_columns) bool; ``components`` (n_lines, n_columns) int32; ``label_of`` (n + 1,)
    uint8; ``others`` (3,) uint8; returns (n_lines, n_columns) uint8.
    """
    missing = others[0]
    noise = others[1]
    cover = others[2]
    n_lines, n_columns = supported.shape
    reach = max(n_columns + 1, 4)
    labels = np.empty((n_lines, n_columns), np.uint8)
    for line in range(n_lines):
        row = labels[line]
        inside = supported[line]
        over = covered[line]
        component = components[line]
        ranges = window[reach + line * n_columns : reach + (line + 1) * n_columns]
        for h in range(n_columns):
            row[h] = label_of[component[h]]
        for h in range(n_columns):
            label = cover if over[h] else row[h]
            unsupported = noise if ranges[h] == ranges[h] else missing
            row[h] = label if inside[h] else unsupported
    return labels


@loop("prc_cli.reference.prc.stages")
def draw_columns(
    window: F32_1,
    supported: Mask_2,
    covered: Mask_2,
    columns: Mask_1,
    noise_too: bool,
    labels_of: U8_1,
) -> U8_2:
    """Draw a label for covered shots, one for free shots, and another one in some columns.

    ``window`` (reach + n_lines * n_columns + reach,) float32, metres; ``supported, covered``
    (n_lines, n_columns) bool; ``columns`` (n_columns,) bool; ``labels_of`` (5,) uint8; returns
    (n_lines, n_columns) uint8.
    """
    n_lines, n_columns = supported.shape
    reach = max(n_columns + 1, 4)
    missing = labels_of[0]
    noise = labels_of[1]
    marked = labels_of[2]
    cover = labels_of[3]
    free = labels_of[4]
    labels = np.empty((n_lines, n_columns), np.uint8)
    for line in range(n_lines):
        row = labels[line]
        inside = supported[line]
        over = covered[line]
        ranges = window[reach + line * n_columns : reach + (line + 1) * n_columns]
        for h in range(n_columns):
            label = cover if over[h] else free
            label = marked if columns[h] else label
            unsupported = marked if columns[h] & noise_too else noise
            unsupported = unsupported if ranges[h] == ranges[h] else missing
            row[h] = label if inside[h] else unsupported
    return labels

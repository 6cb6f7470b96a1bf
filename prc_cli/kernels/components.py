"""Loops over the binary image: connected components and hole filling (Lehtola et al. 2019, II-D)."""

from __future__ import annotations

import numpy as np

from prc_cli.core.types import I32, Mask
from prc_cli.kernels.cache import kernel


@kernel("int32(int32[::1], int32)")
def _root(parent: I32, run: int) -> int:
    """Follow a run to the first run of its component, shortening the way for the next one."""
    while parent[run] != run:
        parent[run] = parent[parent[run]]
        run = parent[run]
    return run


@kernel("Tuple((int32[:, ::1], int64))(boolean[:, ::1])")
def label_components(image: Mask) -> tuple[I32, int]:
    """Find the 4-connected components of a binary image, numbered in the raster order of their first pixels.

    Works on runs, stretches of ones within a line: runs of successive lines that share a column are joined, the
    earlier run always becoming the root, so that roots come in raster order.

    Parameters
    ----------
    image : (n_lines, n_columns) bool

    Returns
    -------
    labels : (n_lines, n_columns) int32
        0 = background, components from 1.
    n_components : int
    """
    n_lines, n_columns = image.shape
    most_runs = n_lines * ((n_columns + 1) // 2)
    start = np.empty(most_runs, np.int32)
    stop = np.empty(most_runs, np.int32)
    parent = np.empty(most_runs, np.int32)
    first_run = np.empty(n_lines + 1, np.int32)
    n_runs = 0
    above = 0
    for line in range(n_lines):
        first_run[line] = n_runs
        first = n_runs
        row = image[line]
        h = 0
        while h < n_columns:
            if not row[h]:
                h += 1
                continue
            begin = h
            while h < n_columns and row[h]:
                h += 1
            start[n_runs] = begin
            stop[n_runs] = h
            parent[n_runs] = n_runs
            while above < first and stop[above] <= begin:
                above += 1
            while above < first and start[above] < h:
                one, other = _root(parent, n_runs), _root(parent, above)
                parent[max(one, other)] = min(one, other)
                if stop[above] > h:  # it may reach the next run of this line too
                    break
                above += 1
            n_runs += 1
        above = first
    first_run[n_lines] = n_runs

    labels = np.zeros((n_lines, n_columns), np.int32)
    number = np.empty(n_runs, np.int32)
    n_components = 0
    for line in range(n_lines):
        row_out = labels[line]
        for run in range(first_run[line], first_run[line + 1]):
            if parent[run] == run:
                n_components += 1
                number[run] = n_components
            else:  # parents come earlier
                number[run] = number[parent[run]]
            row_out[start[run] : stop[run]] = number[run]
    return labels, n_components


@kernel("int32[:, ::1](int32[:, ::1], boolean[:, ::1])")
def fill_holes(components: I32, holes: Mask) -> I32:
    """Give pixels the most frequent component among their 8 neighbours, all at once.

    Parameters
    ----------
    components : (n_lines, n_columns) int32
        Component image, 0 = background; only this is looked at, so the order of filling does not matter.
    holes : (n_lines, n_columns) bool
        Pixels to fill, all of them background.

    Returns
    -------
    (n_lines, n_columns) int32
        Ties go to the smallest number; pixels without labelled neighbours stay 0.
    """
    n_lines, n_columns = components.shape
    filled = components.copy()
    near = np.empty(9, np.int32)
    for line in range(n_lines):
        row = holes[line]
        for h in range(n_columns):
            if not row[h]:
                continue
            n_near = 0
            for y in range(max(line - 1, 0), min(line + 2, n_lines)):
                for x in range(max(h - 1, 0), min(h + 2, n_columns)):
                    if components[y, x] != 0:
                        near[n_near] = components[y, x]
                        n_near += 1
            best = 0
            most = 0
            for one in range(n_near):
                count = 0
                for other in range(n_near):
                    count += near[one] == near[other]
                if count > most or (count == most and near[one] < best):
                    best = near[one]
                    most = count
            filled[line, h] = best
    return filled

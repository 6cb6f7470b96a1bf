"""Loops over the binary image: connected components, hole filling, votes.

Lehtola et al. (2019), II-D.
"""

from __future__ import annotations

import numpy as np

from prc_cli.core.loops import helper, loop
from prc_cli.core.types import I32, I32_1, I32_2, I64, I64_1, Mask, Mask_2
from prc_cli.core.union_find_loops import find_root

ONES = 0x0101010101010101
"""Eight booleans that are all true, as a number."""
NONE = np.int32(2**31 - 1)
"""Larger than the number of any component."""


@helper
def _find_edges(row: Mask, edges: I32, n_edges: int) -> int:
    """Append the columns where runs of ones begin and end to ``edges``; return their number.

    Eight shots at a time are skipped if they are all like the one before. In the others every
    column is written, and kept if it is an edge: no branch that the processor could mispredict.
    """
    n_columns = len(row)
    n_words = n_columns // 8
    words = row[: 8 * n_words].view(np.int64)
    inside = False
    for word in range(n_words):
        if words[word] == (ONES if inside else 0):
            continue
        for h in range(8 * word, 8 * word + 8):
            edges[n_edges] = h
            n_edges += row[h] != inside
            inside = row[h]
    for h in range(8 * n_words, n_columns):
        edges[n_edges] = h
        n_edges += row[h] != inside
        inside = row[h]
    edges[n_edges] = n_columns
    return n_edges + inside


@helper
def _find_runs(image: Mask) -> tuple[I32, I32, I32]:
    """Find the runs of an image, stretches of ones within a line, and join those that touch.

    Runs of successive lines that share a column are joined, the earlier run always becoming the
    root, so that roots come in raster order.

    Returns ``edges`` (at least 2 n,) int32, ``first_run`` (n_lines + 1,) int32, ``parent`` (n,)
    int32.
    """
    n_lines, n_columns = image.shape
    most_runs = n_lines * ((n_columns + 1) // 2)
    edges = np.empty(2 * most_runs + 1, np.int32)
    parent = np.empty(most_runs, np.int32)
    first_run = np.empty(n_lines + 1, np.int32)
    n_runs = 0
    first_above = 0
    for line in range(n_lines):
        first_run[line] = first = n_runs
        n_runs = _find_edges(image[line], edges, 2 * n_runs) // 2
        above = first_above
        for run in range(first, n_runs):
            begin = edges[2 * run]
            end = edges[2 * run + 1]
            while above < first and edges[2 * above + 1] <= begin:
                above += 1
            root = run
            while above < first and edges[2 * above] < end:
                root_above = find_root(parent, above)
                low = min(root, root_above)
                if root != run:
                    parent[max(root, root_above)] = low
                root = low
                if edges[2 * above + 1] > end:  # it may reach the next run of this line too
                    break
                above += 1
            parent[run] = root
        first_above = first
    first_run[n_lines] = n_runs
    return edges, first_run, parent[:n_runs]


@helper
def _draw_runs(
    edges: I32,
    first_run: I32,
    parent: I32,
    n_columns: int,
) -> tuple[I32, I64]:
    """Draw the components, numbered in raster order; also return their pixels, (n + 1,) int64."""
    number = np.empty(len(parent), np.int32)
    n_components = 0
    for run in range(len(parent)):
        if parent[run] == run:
            n_components += 1
            number[run] = n_components
        else:  # parents come earlier
            number[run] = number[parent[run]]
    pixels = np.zeros(n_components + 1, np.int64)
    # eight at a time, beyond the end of a run: what lies there is drawn later
    size = (len(first_run) - 1) * n_columns
    drawn = np.empty(size + 8, np.int32)
    i = 0
    for line in range(len(first_run) - 1):
        first = line * n_columns
        for run in range(first_run[line], first_run[line + 1]):
            begin = first + edges[2 * run]
            end = first + edges[2 * run + 1]
            label = number[run]
            pixels[label] += end - begin
            while i < begin:
                for j in range(8):
                    drawn[i + j] = 0
                i += 8
            i = begin
            while i < end:
                for j in range(8):
                    drawn[i + j] = label
                i += 8
            i = end
    drawn[i:size] = 0
    return drawn[:size].reshape((len(first_run) - 1, n_columns)), pixels


@loop("prc_cli.reference.prc.stages")
def label_components(image: Mask_2) -> tuple[I32_2, int]:
    """Find the 4-connected components of a binary image, in the raster order of their first pixels.

    ``image`` (n_lines, n_columns) bool; returns ``labels`` (n_lines, n_columns) int32.
    """
    edges, first_run, parent = _find_runs(image)
    labels, pixels = _draw_runs(edges, first_run, parent, image.shape[1])
    return labels, len(pixels) - 1


@helper
def _find_ones(row: Mask, columns: I32, n_ones: int) -> int:
    """Append the columns of the ones to ``columns``; return their number."""
    n_columns = len(row)
    n_words = n_columns // 8
    words = row[: 8 * n_words].view(np.int64)
    for word in range(n_words):
        if words[word] == 0:
            continue
        for h in range(8 * word, 8 * word + 8):
            columns[n_ones] = h
            n_ones += row[h]
    for h in range(8 * n_words, n_columns):
        columns[n_ones] = h
        n_ones += row[h]
    return n_ones


@helper
def _winner(
    components: I32,
    line: int,
    column: int,
    low: int,
    high: int,
) -> int:
    """Return the most frequent component around a pixel; only ``low`` and ``high`` are likely."""
    n_lines, n_columns = components.shape
    if 0 < line < n_lines - 1 and 0 < column < n_columns - 1:
        n_low = 0
        n_high = 0
        n_near = 0
        for y in range(3):
            row = components[line - 1 + y]
            for x in range(3):
                near = row[column - 1 + x]
                n_low += near == low
                n_high += near == high
                n_near += near != 0
        if n_low + n_high == n_near:  # as nearly always
            return high if n_high > n_low else low
    return _most_frequent(components, line, column)


@helper
def _most_frequent(components: I32, line: int, column: int) -> int:
    """Return the most frequent component around a pixel, of equals the smallest."""
    n_lines, n_columns = components.shape
    near = np.empty(9, np.int32)
    n_near = 0
    for y in range(max(line - 1, 0), min(line + 2, n_lines)):
        for x in range(max(column - 1, 0), min(column + 2, n_columns)):
            near[n_near] = components[y, x]
            n_near += components[y, x] != 0
    best = 0
    most = 0
    for i in range(n_near):
        count = 0
        for j in range(n_near):
            count += near[i] == near[j]
        if count > most or (count == most and near[i] < best):
            best = near[i]
            most = count
    return best


@loop("prc_cli.reference.prc.stages")
def join_and_fill(supported: Mask_2, background: Mask_2) -> tuple[I32_2, I64_1]:
    """Connect supported shots and give those of the background to the component around them.

    ``supported, background`` (n_lines, n_columns) bool; returns ``components`` (n_lines, n_columns)
    int32, ``pixels`` (n + 1,) int64.
    """
    n_lines, n_columns = supported.shape
    foreground = np.empty((n_lines, n_columns), np.bool_)
    first_hole = np.empty(n_lines + 1, np.int32)
    holes = np.empty(n_lines * n_columns + 1, np.int32)
    n_holes = int(np.int64(0))  # not the literal, for which a helper would be compiled once more
    for line in range(n_lines):
        inside = supported[line]
        apart = background[line]
        row = foreground[line]
        for h in range(n_columns):
            row[h] = inside[h] & (not apart[h])
        first_hole[line] = n_holes
        n_holes = _find_ones(apart, holes, n_holes)
    first_hole[n_lines] = n_holes
    edges, first_run, parent = _find_runs(foreground)
    components, pixels = _draw_runs(edges, first_run, parent, n_columns)

    chosen = np.empty(n_holes, np.int32)
    # least and most component in three lines at a column, with a frame around
    least = np.full(n_columns + 2, NONE, np.int32)
    most = np.zeros(n_columns + 2, np.int32)
    for line in range(n_lines):
        if first_hole[line] == first_hole[line + 1]:
            continue
        line_above = components[max(line - 1, 0)]
        row_components = components[line]
        line_below = components[min(line + 1, n_lines - 1)]
        least_inside = least[1 : n_columns + 1]
        most_inside = most[1 : n_columns + 1]
        for h in range(n_columns):
            above = line_above[h]
            here = row_components[h]
            below = line_below[h]
            most_inside[h] = max(above, here, below)
            least_inside[h] = min(
                above if above else NONE, here if here else NONE, below if below else NONE
            )
        for hole in range(first_hole[line], first_hole[line + 1]):
            h = int(holes[hole])
            high = max(most[h], most[h + 1], most[h + 2])
            low = min(least[h], least[h + 1], least[h + 2])
            if high == 0 or high == low:  # none, or one that is alone
                chosen[hole] = high
            else:
                chosen[hole] = _winner(components, line, h, int(low), int(high))
    for line in range(n_lines):  # after all neighbours were read
        filled = components[line]
        for hole in range(first_hole[line], first_hole[line + 1]):
            filled[holes[hole]] = chosen[hole]
            pixels[chosen[hole]] += 1
    pixels[0] = 0
    return components, pixels


@helper
def _sort_votes(component: I32, label: I64, n: int) -> I32:
    """Order votes by component, then by label.

    Merged by hand, as the library's sort takes seconds to compile.
    """
    order = np.empty(n, np.int32)
    merged = np.empty(n, np.int32)
    for i in range(n):
        order[i] = i
    width = 1
    while width < n:
        for begin in range(0, n, 2 * width):
            middle = min(begin + width, n)
            end = min(begin + 2 * width, n)
            i = begin
            j = middle
            for k in range(begin, end):
                left = order[min(i, n - 1)]
                right = order[min(j, n - 1)]
                if component[left] == component[right]:
                    later = label[left] > label[right]
                else:
                    later = component[left] > component[right]
                if i == middle or (j < end and later):
                    merged[k] = right
                    j += 1
                else:
                    merged[k] = left
                    i += 1
        order, merged = merged, order
        width *= 2
    return order


@loop("prc_cli.reference.prc.stages")
def carry_labels(
    first_line: I32_1,
    last_line: I64_1,
    n_components: int,
    min_votes: int,
) -> I64_1:
    """Let the last line before a block vote for the labels of the block's components.

    Every column where both lines have a label is a vote. A component gets the label that most of
    its shots vote for, if they are enough; of equals the oldest. Several components may get the
    same label.

    ``first_line`` (M,) int32; ``last_line`` (M,) int64; returns (n_components + 1,) int64.
    """
    width = len(first_line)
    # stretches of equal votes
    component = np.empty(width, np.int32)
    label = np.empty(width, np.int64)
    votes = np.empty(width, np.int64)
    n_stretches = int(np.int64(0))  # as above
    for h in range(width):
        if first_line[h] == 0 or last_line[h] == 0:
            continue
        last = n_stretches - 1
        if n_stretches and component[last] == first_line[h] and label[last] == last_line[h]:
            votes[last] += 1
        else:
            component[n_stretches] = first_line[h]
            label[n_stretches] = last_line[h]
            votes[n_stretches] = 1
            n_stretches += 1
    labels = np.zeros(n_components + 1, np.int64)
    if not n_stretches:
        return labels
    order = _sort_votes(component, label, n_stretches)
    most = 0
    count = 0
    for i in range(n_stretches):
        vote = order[i]
        vote_before = order[max(i - 1, 0)]
        if i == 0 or component[vote] != component[vote_before]:
            most = count = 0
        elif label[vote] != label[vote_before]:
            count = 0
        count += votes[vote]
        if count > most and count >= min_votes:
            most = count
            labels[component[vote]] = label[vote]
    return labels

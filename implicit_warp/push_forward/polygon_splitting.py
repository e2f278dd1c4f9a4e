"""Splitting polygons along the levels of one family, between vertices that lie on them."""

from __future__ import annotations

import numpy as np
from numba import prange

from fields.jit import kernel, parallel_kernel
from implicit_warp.push_forward.edge_splitting import CHUNK
from implicit_warp.push_forward.families import OUTSIDE, levels_between


@parallel_kernel
def count_pieces(
    corner_vertices, corner_edges, starts, lengths, count, codes, slots, first_vertices, pieces
):
    """pieces[p] = into how many pieces polygon p falls, 0 if it stays exactly as it is.

    Returns:
        (chunks, 4): additional polygons, corners of all pieces, the longest loop once its edges
        are split, polygons left uncut.
    """
    chunks = (count + CHUNK - 1) // CHUNK
    totals = np.zeros((chunks, 4), np.int64)
    for c in prange(chunks):
        for p in range(c * CHUNK, min(count, (c + 1) * CHUNK)):
            begin, end = starts[p], starts[p] + lengths[p]
            low = high = codes[corner_vertices[begin]]
            lowest = begin
            for k in range(begin + 1, end):
                code = codes[corner_vertices[k]]
                if code < low:
                    low = code
                    lowest = k
                high = max(high, code)
            levels = 0 if low == OUTSIDE else max(0, levels_between(low, high))
            pieces[p] = 0
            if levels == 0 and low != OUTSIDE:
                continue
            length = end - begin
            for k in range(begin, end):
                slot = slots[corner_edges[k]]
                if slot >= 0:
                    length += first_vertices[slot + 1] - first_vertices[slot]
            if levels == 0 and length == end - begin:
                continue
            if levels > 0 and not _is_unimodal(corner_vertices, codes, begin, end, lowest, high):
                totals[c, 3] += 1
                levels = 0
            pieces[p] = levels + 1
            totals[c, 0] += levels
            totals[c, 1] += length + 2 * levels
            totals[c, 2] = max(totals[c, 2], length)
    return totals


@kernel
def _is_unimodal(corner_vertices, codes, begin, end, lowest, high):
    """Does every level meet the loop only twice: once going up from its lowest corner, once down?

    A convex loop does, but for rounding.  Touching a level again from the side that one has come to
    does no harm.
    """
    highest_so_far = lowest_so_far = codes[corner_vertices[lowest]]
    rising = True
    for step in range(end - begin):
        k = lowest + step
        code = codes[corner_vertices[k if k < end else k - (end - begin)]]
        if rising:
            if levels_between(code, highest_so_far) > 0:
                return False
            highest_so_far = max(highest_so_far, code)
            if code == high:
                rising = False
                lowest_so_far = code
        else:
            if levels_between(lowest_so_far, code) > 0:
                return False
            lowest_so_far = min(lowest_so_far, code)
    return True


@parallel_kernel
def split_polygons(
    corner_vertices, corner_edges, starts, lengths, sources, count, n_corners, edges, n_edges,
    codes, slots, first_vertices, shift, pieces, polygon_offsets, corner_offsets,
    longest,
):  # fmt: skip
    """Write the pieces: the lowest takes its polygon's place, the others come at the end.

    Going around from the lowest corner, `up` and `down` are the corners at which the loop leaves
    each level: the last on it before it rises above, and the last before it sinks below.  Pieces
    lie between neighbouring levels; a new edge joins up[j] and down[j].
    """
    for c in prange(len(polygon_offsets) - 1):
        polygon = count + polygon_offsets[c]
        edge = n_edges + polygon_offsets[c]
        at = n_corners + corner_offsets[c]
        vertices, along = np.empty(longest[c], np.int32), np.empty(longest[c], np.int32)
        up, down = np.empty(longest[c], np.int32), np.empty(longest[c], np.int32)
        for p in range(c * CHUNK, min(count, (c + 1) * CHUNK)):
            if pieces[p] == 0:
                continue
            length = _unroll(
                corner_vertices, corner_edges, starts[p], lengths[p], edges, codes, slots,
                first_vertices, shift, vertices, along,
            )  # fmt: skip
            levels = pieces[p] - 1
            starts[p] = at
            if levels == 0:
                at = _write(corner_vertices, corner_edges, at, vertices, along, 0, length)
                lengths[p] = length
                continue
            _find_exits(vertices, codes, length, levels, up, down)
            for j in range(levels + 1):
                begin = at
                if j == 0:
                    at = _write(corner_vertices, corner_edges, at, vertices, along, 0, up[0] + 1)
                    corner_edges[at - 1] = edge
                    at = _write(corner_vertices, corner_edges, at, vertices, along, down[0], length)
                    lengths[p] = at - begin
                    continue
                last = down[levels - 1] if j == levels else up[j]
                at = _write(
                    corner_vertices, corner_edges, at, vertices, along, up[j - 1], last + 1
                )  # fmt: skip
                if j < levels:
                    corner_edges[at - 1] = edge + j
                    at = _write(
                        corner_vertices, corner_edges, at, vertices, along, down[j], down[j - 1] + 1
                    )
                corner_edges[at - 1] = edge + j - 1
                starts[polygon] = begin
                lengths[polygon] = at - begin
                sources[polygon] = sources[p]
                polygon += 1
            for j in range(levels):
                edges[edge + j, 0] = vertices[up[j]]
                edges[edge + j, 1] = vertices[down[j]]
            edge += levels


@kernel
def _unroll(
    corner_vertices, corner_edges, start, length, edges, codes, slots, first_vertices, shift,
    vertices, along,
):  # fmt: skip
    """Write a loop with its edges split, beginning at a lowest corner; its length."""
    lowest = 0
    for k in range(1, length):
        if codes[corner_vertices[start + k]] < codes[corner_vertices[start + lowest]]:
            lowest = k
    at = 0
    for step in range(length):
        k = lowest + step
        k = start + (k if k < length else k - length)
        vertex, e = corner_vertices[k], corner_edges[k]
        vertices[at] = vertex
        along[at] = e
        at += 1
        slot = slots[e]
        if slot < 0:
            continue
        first, end = first_vertices[slot], first_vertices[slot + 1]
        if edges[e, 0] == vertex:
            for new in range(first, end):
                vertices[at] = new
                along[at] = new + shift
                at += 1
        else:
            along[at - 1] = end - 1 + shift
            for new in range(end - 1, first - 1, -1):
                vertices[at] = new
                along[at] = new - 1 + shift if new > first else e
                at += 1
    return at


@kernel
def _find_exits(vertices, codes, length, levels, up, down):
    """Positions at which an unrolled loop leaves each level, upwards and then downwards."""
    low = codes[vertices[0]]
    high = low
    for k in range(1, length):
        high = max(high, codes[vertices[k]])
    first = low // 2 + 1
    j = 0
    k = 0
    while j < levels:
        while codes[vertices[k]] <= 2 * (first + j):
            k += 1
        up[j] = k - 1
        j += 1
    while codes[vertices[k]] != high:
        k += 1
    j = levels - 1
    while j >= 0:
        while k < length and codes[vertices[k]] >= 2 * (first + j):
            k += 1
        # Going down ends at the lowest corner, where the loop began.
        down[j] = k - 1
        j -= 1


@kernel
def _write(corner_vertices, corner_edges, at, vertices, along, begin, end):
    """Append part of an unrolled loop; where the next corner goes."""
    for k in range(begin, end):
        corner_vertices[at] = vertices[k]
        corner_edges[at] = along[k]
        at += 1
    return at

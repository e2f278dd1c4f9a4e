"""Where the edges of a shape pierce the faces of cells."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fields.jit import kernel
from implicit_warp.extraction.cells import Surface, longer, taller
from implicit_warp.extraction.cube import FACE_AXIS, FACE_SIDE, Tables, tables
from implicit_warp.extraction.samples import Sampler
from implicit_warp.extraction.sides import (
    FARTHEST,
    REACH,
    ROUNDS,
    Occupied,
    nearer_values,
    on_surface,
    within,
)

ANGLE = 20.0
"""Degrees between the normals of two crossings from which there is an edge between them."""


class Segments(NamedTuple):
    """Steps of loops from one crossing to the next, across an edge of the shape.

    Attributes:
        cell: (s,) the cell.
        step: (s,) the place of the step in the cell's loop.
        start, end: (s,) vertices.
        face: (s, 4) axis across the face, and its lattice place.
        number: (s,) the face's number; both cells of a face have a segment with it.
    """

    cell: NDArray[np.int64]
    step: NDArray[np.int64]
    start: NDArray[np.int64]
    end: NDArray[np.int64]
    face: NDArray[np.int64]
    number: NDArray[np.int64]

    def where(self, chosen: NDArray[np.bool_]) -> Segments:
        """Some of the segments."""
        return Segments(*(column[chosen] for column in self))


def sharp_segments(
    surface: Surface, corners: NDArray[np.int64], normals: NDArray[np.float64]
) -> Segments:
    """The steps of the loops of cells with a single one, between normals that differ, where both
    cells of the face are such cells.

    Faces that a loop passes twice are left out: a point put into one of the two steps there could
    come to lie beyond the other.
    """
    found = _find_segments(
        surface.patterns,
        surface.cell_edges,
        corners,
        normals,
        math.cos(math.radians(ANGLE)),
        *_table_parts(tables()),
    )
    return _shared(*found)


def _table_parts(t: Tables) -> tuple[NDArray[np.int64], ...]:
    return t.n_loops, t.loop_length, t.loop_edges, t.loop_faces


@kernel
def _find_segments(
    patterns, cell_edges, corners, normals, cosine, n_loops, loop_length, loop_edges, loop_faces
):
    capacity = 1024
    cell, step = np.empty(capacity, np.int64), np.empty(capacity, np.int64)
    start, end = np.empty(capacity, np.int64), np.empty(capacity, np.int64)
    face = np.empty((capacity, 4), np.int64)
    count = 0
    for i in range(len(patterns)):
        pattern = patterns[i]
        if n_loops[pattern] != 1:
            continue
        length = loop_length[pattern, 0]
        for j in range(length):
            a = cell_edges[i, loop_edges[pattern, 0, j]]
            b = cell_edges[i, loop_edges[pattern, 0, (j + 1) % length]]
            across = loop_faces[pattern, 0, j]
            dot = 0.0
            for k in range(3):
                dot += normals[a, k] * normals[b, k]
            passes = 0
            for k in range(length):
                passes += np.int64(loop_faces[pattern, 0, k] == across)
            if dot >= cosine or passes != 1:
                continue
            if count == capacity:
                capacity *= 2
                cell, step = longer(cell, capacity), longer(step, capacity)
                start, end = longer(start, capacity), longer(end, capacity)
                face = taller(face, capacity)
            cell[count], step[count] = i, j
            start[count], end[count] = a, b
            face[count, 0] = FACE_AXIS[across]
            for k in range(3):
                face[count, 1 + k] = corners[i, k]
            face[count, 1 + FACE_AXIS[across]] += FACE_SIDE[across]
            count += 1
    return cell[:count], step[:count], start[:count], end[:count], face[:count]


def _shared(cell, step, start, end, face) -> Segments:
    """The segments that both cells of their face have."""
    _, number, count = np.unique(face, axis=0, return_inverse=True, return_counts=True)
    number = number.reshape(-1)
    twice = count[number] == 2
    renumbered = np.cumsum(count == 2) - 1
    return Segments(
        cell[twice], step[twice], start[twice], end[twice], face[twice], renumbered[number[twice]]
    )


def piercing_points(
    segments: Segments,
    vertices: NDArray[np.float64],
    normals: NDArray[np.float64],
    occupied: Occupied,
    sampler: Sampler,
) -> tuple[NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_]]:
    """The point of each face's plane where the edge passes.

    Returns:
        (f, 3) points by the number of their face; (f,) whether there is one; (f,) whether it lies
        outside of the face, in cells that are not crossed.
    """
    _, first = np.unique(segments.number, return_index=True)
    axis, low = segments.face[first, 0], segments.face[first, 1:]
    plane = np.stack([(axis + 1) % 3, (axis + 2) % 3], axis=1)
    row = np.arange(len(first))
    ends = np.stack([segments.start[first], segments.end[first]], axis=1)
    sides = vertices[ends]  # (f, 2, 3)
    borders = low[row[:, None], plane]
    # Each side's line in the face: slope . (q - anchor) + value = 0.
    slopes, anchors, values = normals[ends], sides, np.zeros(ends.shape)
    points, solvable = sides.mean(axis=1), np.ones(len(first), np.bool_)
    for round_ in range(1 + ROUNDS):
        if round_:
            slopes, anchors, values = nearer_values(
                points[:, None], sides, slopes, anchors, values, sampler
            )
        flat = np.take_along_axis(slopes, plane[:, None], axis=2)
        at = np.take_along_axis(anchors, plane[:, None], axis=2)
        solved, solvable = _common_point(flat, (flat * at).sum(axis=2) - values)
        solved = np.where(solvable[:, None], solved, points[row[:, None], plane])
        points[row[:, None], plane] = within(solved, borders, -FARTHEST)
    solved = points[row[:, None], plane]
    outside = np.abs(solved - borders - 0.5).max(axis=1, initial=0.0) - 0.5
    near = outside < REACH
    points[row[:, None], plane] = np.where(near[:, None], within(solved, borders), solved)
    cells = np.floor(points).astype(np.int64)
    cells[row, axis] = low[row, axis]
    beside = cells.copy()
    beside[row, axis] -= 1
    free = ~near & ~occupied.among(cells) & ~occupied.among(beside)
    found = solvable & (near | free) & on_surface(points, sampler)
    return points, found, found & free


def _common_point(
    slopes: NDArray[np.float64], right: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """(f, 2) where two lines slopes . q = right meet, and (f,) whether they clearly do."""
    determinant = slopes[:, 0, 0] * slopes[:, 1, 1] - slopes[:, 0, 1] * slopes[:, 1, 0]
    clear = np.abs(determinant) > 0.1 * np.linalg.norm(slopes, axis=2).prod(axis=1)
    safe = np.where(clear, determinant, 1.0)
    x = right[:, 0] * slopes[:, 1, 1] - right[:, 1] * slopes[:, 0, 1]
    y = right[:, 1] * slopes[:, 0, 0] - right[:, 0] * slopes[:, 1, 0]
    return np.stack([x / safe, y / safe], axis=1), clear

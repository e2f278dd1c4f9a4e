"""Where the edges of a shape pierce the planes of cells' faces."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fields.jit import kernel
from implicit_warp.extraction.cells import Surface
from implicit_warp.extraction.cube import FACE_AXIS, FACE_SIDE, tables
from implicit_warp.extraction.rings import Rings
from implicit_warp.extraction.samples import Sampler
from implicit_warp.extraction.sides import (
    FARTHEST,
    REACH,
    ROUNDS,
    nearer_values,
    on_surface,
    within,
)

ANGLE = 20.0
"""Degrees between the normals of two crossings from which there is an edge between them."""


class Segments(NamedTuple):
    """Steps of rings from one crossing to the next, across an edge of the shape.

    Attributes:
        row: (s,) the ring.
        step: (s,) the place of the step in it.
        ends: (s, 2) vertices.
        face: (s, 4) axis across the face, and its lattice place.
        number: (s,) the face's number; the rings of both of its cells have a segment with it.
    """

    row: NDArray[np.int64]
    step: NDArray[np.int64]
    ends: NDArray[np.int64]
    face: NDArray[np.int64]
    number: NDArray[np.int64]

    def where(self, chosen: NDArray[np.bool_]) -> Segments:
        """Some of the segments."""
        return Segments(*(column[chosen] for column in self))


class Piercing(NamedTuple):
    """Points where edges of the shape pass through the planes of faces, by the face's number.

    Attributes:
        points: (f, 3)
        found: (f,) whether there is one in the face.
        beyond: (f,) whether there is one outside of the face.
        face: (f, 4) axis across the face, and its lattice place.
        crossings: (f, 2, 2) for each side of the edge, where its line in the plane meets the border
            of the face beyond which the point lies: place along that border.
        border: (f, 2) that border: the axis across it, and 0 or 1 for the low or the high one.
    """

    points: NDArray[np.float64]
    found: NDArray[np.bool_]
    beyond: NDArray[np.bool_]
    face: NDArray[np.int64]
    crossings: NDArray[np.float64]
    border: NDArray[np.int64]


def sharp_cells(
    surface: Surface, normals: NDArray[np.float64]
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Cells with one loop in which (n,) some step leads across an edge; (n,) a tip may lie."""
    single = tables().n_loops[surface.patterns] == 1
    sharp, tip = np.zeros(len(single), np.bool_), np.zeros(len(single), np.bool_)
    limits = [math.cos(math.radians(factor * ANGLE)) for factor in (1.0, 2.5)]
    t = tables()
    _find_sharp(
        surface.patterns, surface.cell_edges, single, normals, *limits, t.loop_length, t.loop_edges,
        sharp, tip,
    )  # fmt: skip
    return sharp, tip


@kernel
def _find_sharp(
    patterns, cell_edges, single, normals, edge, wide, loop_length, loop_edges, sharp, tip
):
    for i in range(len(patterns)):
        if not single[i]:
            continue
        length = loop_length[patterns[i], 0]
        for j in range(length):
            a = cell_edges[i, loop_edges[patterns[i], 0, j]]
            for k in range(j):
                b = cell_edges[i, loop_edges[patterns[i], 0, k]]
                dot = 0.0
                for c in range(3):
                    dot += normals[a, c] * normals[b, c]
                adjacent = k == j - 1 or (k == 0 and j == length - 1)
                sharp[i] |= adjacent and dot < edge
                tip[i] |= dot < wide


def sharp_segments(
    rings: Rings, corners: NDArray[np.int64], normals: NDArray[np.float64]
) -> Segments:
    """The steps of rings between normals that differ, where both cells of the face have a ring.

    Faces that a cell's rings pass twice are left out: a point put into one of the two steps there
    could come to lie beyond the other.
    """
    place = np.arange(rings.points.shape[1])
    row, step = np.nonzero(place < rings.length[:, None])
    onward = (step + 1) % rings.length[row]
    ends = np.stack([rings.points[row, step], rings.points[row, onward]], axis=1)
    across = rings.faces[row, step]
    cells, of_ring = np.unique(rings.cells, return_inverse=True)
    face_of_cell = 6 * of_ring[row] + across
    passes = np.bincount(face_of_cell, minlength=6 * len(cells))[face_of_cell]
    alike = np.einsum("si,si->s", *normals[ends.T])
    chosen = (alike < math.cos(math.radians(ANGLE))) & (passes == 1)
    row, step, ends, across = row[chosen], step[chosen], ends[chosen], across[chosen]
    face = np.concatenate([FACE_AXIS[across][:, None], corners[rings.cells[row]]], axis=1)
    face[np.arange(len(face)), 1 + FACE_AXIS[across]] += FACE_SIDE[across]
    # A cell has one segment in a face at most, so that a face has two: those of its two cells.
    low = face[:, 1:].min(axis=0, initial=0)
    extent = face[:, 1:].max(axis=0, initial=0) - low + 1
    key = 3 * np.ravel_multi_index((face[:, 1:] - low).T, extent) + face[:, 0]
    order = np.argsort(key, kind="stable")
    sorted_ends = np.sort(ends[order], axis=1)
    alike = key[order][1:] == key[order][:-1]
    first = np.flatnonzero(alike & (sorted_ends[1:] == sorted_ends[:-1]).all(axis=1))
    pair = np.stack([order[first], order[first + 1]], axis=1).reshape(-1)
    number = np.repeat(np.arange(len(first)), 2)
    return Segments(row[pair], step[pair], ends[pair], face[pair], number)


def piercing_points(
    segments: Segments,
    vertices: NDArray[np.float64],
    normals: NDArray[np.float64],
    sampler: Sampler,
) -> Piercing:
    """The point of each face's plane where the edge passes.

    Args:
        segments: both of each face.
        vertices: (v, 3) crossings.
        normals: (v, 3) unit, there.
        sampler: of the field.
    """
    _, first = np.unique(segments.number, return_index=True)
    face, ends = segments.face[first], segments.ends[first]
    axis, low = face[:, 0], face[:, 1:]
    plane = np.stack([(axis + 1) % 3, (axis + 2) % 3], axis=1)
    row = np.arange(len(first))
    sides = vertices[ends]  # (f, 2, 3)
    borders = low[row[:, None], plane].astype(np.float64)
    # Each side's line in the face: slope . (q - anchor) + value = 0.
    slopes, anchors, values = normals[ends], sides, np.zeros(ends.shape)
    points, solvable = sides.mean(axis=1), np.ones(len(first), np.bool_)
    for round_ in range(1 + ROUNDS):
        if round_:
            slopes, anchors, values = nearer_values(
                points[:, None], sides, slopes, anchors, values, sampler
            )
        flat = np.take_along_axis(slopes, plane[:, None], axis=2)
        at = np.take_along_axis(anchors, plane[:, None], axis=2) - borders[:, None]
        right = (flat * at).sum(axis=2) - values
        solved, solvable = _common_point(flat, right)
        solved = np.where(solvable[:, None], solved, 0.5)
        points[row[:, None], plane] = within(solved, 0.0, -FARTHEST) + borders
    solved = points[row[:, None], plane] - borders
    outside = np.abs(solved - 0.5).max(axis=1, initial=0.0) - 0.5
    near = outside < REACH
    points[row[:, None], plane] = np.where(near[:, None], within(solved, 0.0), solved) + borders
    sound = solvable & on_surface(points, sampler)
    # The border most exceeded, and where each side's line meets it.
    which = np.abs(solved - 0.5).argmax(axis=1)
    high = solved[row, which] > 0.5
    along = flat[row, :, 1 - which]
    safe = np.where(along != 0, along, 1.0)
    meets = (right - flat[row, :, which] * high[:, None]) / safe
    return Piercing(
        points,
        sound & near,
        sound & ~near & (along != 0).all(axis=1),
        face,
        meets,
        np.stack([plane[row, which], high], axis=1),
    )


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

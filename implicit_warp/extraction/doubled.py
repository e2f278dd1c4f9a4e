"""Lattice edges that an edge of the shape crosses twice, which signs at lattice points do not show.

A convex edge of the shape can pass between two lattice points and come out of one face of a cell
through its border, without any lattice point inside: the lattice edge there is crossed twice, once
by each side.  Left alone, the shape's edge would have a chip there.  Such lattice edges are found
from the piercing points that lie beyond their face, confirmed by the field's own values, and both
crossings become vertices.  The rings of the four cells around are then traced anew, face by face.

Guarantee: what is traced depends on each face alone, so that both cells of a face agree and rings
close.  A doubled edge is dropped again if one of its faces would have more than four crossings.
Non-guarantee: a cell can come to have several rings, whose fans could meet.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fields.jit import kernel
from implicit_warp.extraction.cells import Surface
from implicit_warp.extraction.cube import EDGE_AXIS, EDGE_ENDS, EDGE_LOW, face_cycles
from implicit_warp.extraction.names import Names
from implicit_warp.extraction.piercing import Piercing
from implicit_warp.extraction.placement import NEAREST
from implicit_warp.extraction.rings import Rings
from implicit_warp.extraction.samples import Sampler

_MOST_RINGS = 6
"""Rings of a cell: at least two crossings each, of twelve that four a face allow."""

_HALVINGS = 24
"""Bisections that place a crossing to 1e-7 of a voxel."""


class Doubled(NamedTuple):
    """Lattice edges crossed twice, each listed once.

    Attributes:
        low: (d, 3) lattice point at the low end.
        axis: (d,) along which it runs.
        at: (d, 2) where it is crossed, from 0 at the low end to 1.
        ends_inside: (d,) whether both of its ends are inside.
    """

    low: NDArray[np.int64]
    axis: NDArray[np.int64]
    at: NDArray[np.float64]
    ends_inside: NDArray[np.bool_]

    @staticmethod
    def none() -> Doubled:
        """No edges."""
        return Doubled(
            np.empty((0, 3), np.int64), np.empty(0, np.int64), np.empty((0, 2)), np.empty(0, bool)
        )

    def where(self, chosen: NDArray[np.bool_]) -> Doubled:
        """Some of the edges."""
        return Doubled(*(column[chosen] for column in self))

    def joined(self, other: Doubled) -> Doubled:
        """These and others; an edge in both is taken from these."""
        both = Doubled(*(np.concatenate(pair) for pair in zip(self, other, strict=True)))
        names = np.concatenate([both.low, both.axis[:, None]], axis=1)
        _, first = np.unique(names, axis=0, return_index=True)
        chosen = np.zeros(len(names), np.bool_)
        chosen[first] = True
        return both.where(chosen)

    def crossings(self) -> NDArray[np.float64]:
        """(2 d, 3) points: first and second crossing of each edge in turn."""
        points = np.repeat(self.low.astype(np.float64), 2, axis=0)
        points[np.arange(len(points)), np.repeat(self.axis, 2)] += self.at.reshape(-1)
        return points

    def cells(self) -> NDArray[np.int64]:
        """(d, 4, 3) the four cells around each edge."""
        result = np.repeat(self.low[:, None], 4, axis=1)
        row = np.arange(len(self.low))
        for k, (b, c) in enumerate(((0, 0), (1, 0), (0, 1), (1, 1))):
            result[row, k, (self.axis + 1) % 3] -= b
            result[row, k, (self.axis + 2) % 3] -= c
        return result


def doubled_edges(piercing: Piercing, sampler: Sampler) -> Doubled:
    """The lattice edges beyond which piercing points lie, if the field confirms two crossings."""
    chosen = piercing.beyond & ((piercing.crossings > 0) & (piercing.crossings < 1)).all(axis=1)
    axis_across, low = piercing.face[chosen, 0], piercing.face[chosen, 1:].copy()
    border_axis, high = piercing.border[chosen].T
    row = np.arange(len(low))
    low[row, border_axis] += high
    axis = 3 - axis_across - border_axis
    crossings = np.sort(piercing.crossings[chosen], axis=1)
    ends = np.stack([low, low], axis=1)
    ends[row, 1, axis] += 1
    signs = _inside(low, axis, np.array([0.0, 1.0]) + np.zeros((len(low), 2)), sampler)
    middle = crossings.mean(axis=1, keepdims=True)
    turned = _inside(low, axis, middle, sampler)[:, 0] != signs[:, 0]
    sound = turned & (signs[:, 0] == signs[:, 1])
    within = ((low >= sampler.first_cell + 1) & (low <= sampler.last_cell)).all(axis=1)
    low, axis, middle, signs = (x[sound & within] for x in (low, axis, middle, signs))
    outer = np.array([0.0, 1.0]) + np.zeros((len(low), 2))
    inner = np.repeat(middle, 2, axis=1)
    for _ in range(_HALVINGS):
        half = 0.5 * (outer + inner)
        beyond = _inside(low, axis, half, sampler) == signs[:, :1]
        outer, inner = np.where(beyond, half, outer), np.where(beyond, inner, half)
    at = np.clip(0.5 * (outer + inner), NEAREST, 1.0 - NEAREST)
    apart = at[:, 1] - at[:, 0] >= 2 * NEAREST
    return Doubled.none().joined(Doubled(low, axis, at, signs[:, 0]).where(apart))


def _inside(
    low: NDArray[np.int64], axis: NDArray[np.int64], at: NDArray[np.float64], sampler: Sampler
) -> NDArray[np.bool_]:
    """(d, m) whether places (d, m) along lattice edges are inside."""
    points = np.repeat(low[:, None].astype(np.float64), at.shape[1], axis=1)
    points[np.arange(len(low))[:, None], np.arange(at.shape[1]), axis[:, None]] += at
    return (sampler.value_at(points.reshape(-1, 3)) < 0).reshape(at.shape)


class Traced(NamedTuple):
    """Cells around doubled edges, with their rings.

    Attributes:
        corners: (n + m, 3) all crossed cells, and those that only doubled edges cross.
        rings: of the cells around doubled edges.
    """

    corners: NDArray[np.int64]
    rings: Rings


def traced(
    surface: Surface,
    corners: NDArray[np.int64],
    places: Names,
    doubled: Doubled,
    number: NDArray[np.int64],
    normals: NDArray[np.float64],
    refused: NDArray[np.int64],
) -> Traced:
    """The rings of the cells around doubled edges.

    Args:
        surface: of the crossed cells.
        corners: (n, 3) their low corners.
        places: of these.
        doubled: the edges.
        number: (d,) that of the first crossing of each; the second has the next one.
        normals: (p, 3) unit, at all crossings, by their numbers.
        refused: (r, 3) cells around which no edge may be doubled.
    """
    good = (Names(refused).of(doubled.cells().reshape(-1, 3)) < 0).reshape(-1, 4).all(axis=1)
    while True:
        doubled, number = doubled.where(good), number[good]
        around = doubled.cells()
        cells, row = np.unique(around.reshape(-1, 3), axis=0, return_inverse=True)
        row = row.reshape(-1, 4)
        place = places.of(cells)
        known = place >= 0
        patterns, crossings = np.zeros(len(cells), np.uint8), np.full((len(cells), 12, 2), -1)
        patterns[known] = surface.patterns[place[known]]
        crossings[known, :, 0] = surface.cell_edges[place[known]]
        inside = np.zeros(len(cells), np.bool_)
        inside[row] = doubled.ends_inside[:, None]
        patterns[~known & inside] = 255
        for k in range(4):
            edge = _edge_of(doubled.low - around[:, k], doubled.axis)
            crossings[row[:, k], edge, 0] = number
            crossings[row[:, k], edge, 1] = number + 1
        place[~known] = len(corners) + np.arange(int((~known).sum()))
        rings, sound = Rings.blank(np.repeat(place, _MOST_RINGS)), np.zeros(len(cells), np.bool_)
        cycles = face_cycles()
        _trace(
            patterns, crossings, normals, np.array([c for c, _ in cycles]),
            np.array([e for _, e in cycles]), rings.length, rings.points, rings.faces, sound,
        )  # fmt: skip
        good = sound[row].all(axis=1)
        if good.all():
            rings = rings.where(rings.length > 0)
            return Traced(np.concatenate([corners, cells[~known]]), rings)


def _edge_of(offset: NDArray[np.int64], axis: NDArray[np.int64]) -> NDArray[np.int64]:
    """(d,) the edge of a cube with its low end at an offset (d, 3) and along an axis."""
    table = np.full((3, 8), -1)
    table[EDGE_AXIS, EDGE_LOW @ [4, 2, 1]] = np.arange(12)
    return table[axis, offset @ [4, 2, 1]]


@kernel
def _trace(patterns, crossings, normals, face_corners, face_edges, length, points, faces, sound):
    """Follow the steps on the faces of every cell; `sound` unless a face has too many crossings.

    A crossing is named 2 * edge + (0 or 1), in the order along the edge.
    """
    onward, across = np.empty(24, np.int64), np.empty(24, np.int64)
    met, entering = np.empty(8, np.int64), np.empty(8, np.bool_)
    for i in range(len(patterns)):
        onward[:] = -1
        most = 0
        for f in range(6):
            n = 0
            doubled = False
            inside = (patterns[i] >> face_corners[f, 0]) & 1
            for j in range(4):
                e = face_edges[f, j]
                count = np.int64(crossings[i, e, 0] >= 0) + np.int64(crossings[i, e, 1] >= 0)
                doubled |= count == 2
                backwards = EDGE_ENDS[0, e] != face_corners[f, j]
                for k in range(count):
                    met[n] = 2 * e + (count - 1 - k if backwards else k)
                    entering[n] = inside == 0
                    inside = 1 - inside
                    n += 1
            most = max(most, n)
            if n == 0 or n > 4:
                continue
            entry = 0 if entering[0] else 1
            # Join the inside, as the tables do: the exit before the entry.
            step = n - 1
            if n == 4 and doubled:
                # Crossings of one side belong together: normals tell.
                alike = np.zeros(2)
                for way in range(2):
                    for k in range(entry, 4, 2):
                        a = met[k]
                        b = met[(k + (3 if way == 0 else 1)) % 4]
                        u, v = crossings[i, a >> 1, a & 1], crossings[i, b >> 1, b & 1]
                        for c in range(3):
                            alike[way] += normals[u, c] * normals[v, c]
                step = 3 if alike[0] >= alike[1] else 1
            for k in range(entry, n, 2):
                onward[met[k]] = met[(k + step) % n]
                across[met[k]] = f
        sound[i] = most <= 4
        if not sound[i]:
            continue
        ring = i * _MOST_RINGS
        for start in range(24):
            if onward[start] < 0:
                continue
            at = start
            while onward[at] >= 0:
                points[ring, length[ring]] = crossings[i, at >> 1, at & 1]
                faces[ring, length[ring]] = across[at]
                length[ring] += 1
                following = onward[at]
                onward[at] = -1
                at = following
            ring += 1

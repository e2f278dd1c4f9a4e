"""What hangs together in a mesh: its edges, the components they join, the fans at its vertices.

Half-edge h = 3 f + k runs from corner k of face f to the next corner. Half-edges are brought into
the order of their undirected edges by two counting sorts, and faces and fans are joined by
union-find: everything takes linear time, and about 30 bytes a face beyond the faces themselves.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fields.jit import kernel

Indices = NDArray[np.int64]

_GOOD, _OPEN, _NONMANIFOLD, _MISORIENTED = range(4)


class EdgeTable:
    """The undirected edges of triangles with distinct corners.

    Args:
        triangles: `(F, 3)` vertex indices, no two equal in a row.
        num_vertices: number of vertices, in use or not.

    Attributes:
        component_of_face: `(F,)` label of the component that a face belongs to by its edges;
            components are numbered by their first face.
        num_components: how many there are.
        may_repeat: `(F,)` whether another face may have the same three vertices.
    """

    def __init__(self, triangles: Indices, num_vertices: int) -> None:
        # Half the memory while 32 bits hold every index.
        small = max(3 * len(triangles), num_vertices) < 2**31
        index = np.int32 if small else np.int64
        self._triangles = triangles
        self._num_vertices = num_vertices
        self._order = _edge_order(triangles, num_vertices, np.empty(0, index))
        self._starts, self._states, self.may_repeat = _edges(triangles, self._order)
        parents = np.arange(len(triangles), dtype=index)
        _join_faces(self._order, self._starts, parents)
        self.component_of_face, self.num_components = _numbered(parents)

    @property
    def open_edges(self) -> Indices:
        """Edges `(k, 2)` of one face, smaller index first, sorted."""
        return self._edges_in(_OPEN)

    @property
    def nonmanifold_edges(self) -> Indices:
        """Edges `(k, 2)` of three or more faces."""
        return self._edges_in(_NONMANIFOLD)

    @property
    def misoriented_edges(self) -> Indices:
        """Edges `(k, 2)` of two faces that run along it the same way."""
        return self._edges_in(_MISORIENTED)

    @property
    def closed(self) -> bool:
        """Whether every directed edge occurs once, and so does its reverse."""
        return not self._states.any()

    @cached_property
    def _fan_roots(self) -> NDArray[np.integer]:
        """For each corner `(3 F,)`, the first corner of its fan."""
        parents = np.arange(self._triangles.size, dtype=self._order.dtype)
        _join_corners(self._triangles, self._order, self._starts, parents)
        return parents

    def fans_of_vertex(self) -> NDArray[np.integer]:
        """Number of fans at each vertex, `(V,)`: faces joined across edges at that vertex."""
        return _count_fans(self._triangles, self._fan_roots, self._num_vertices)

    def genus(self) -> tuple[int | None, ...]:
        """Genus of each component from V - E + F = 2 - 2 g; None where not watertight.

        A pinched vertex counts once for each fan: the genus is that of the surface with its
        pinches taken apart.
        """
        euler, bad = _euler(
            self._fan_roots,
            self._order,
            self._starts,
            self._states,
            self.component_of_face,
            self.num_components,
        )
        return tuple(
            None if b else (2 - e) // 2 for b, e in zip(bad.tolist(), euler.tolist(), strict=True)
        )

    def _edges_in(self, state: int) -> Indices:
        half = self._order[self._starts[:-1][self._states == state]]
        face, corner = np.divmod(half, 3)
        ends = [self._triangles[face, corner], self._triangles[face, (corner + 1) % 3]]
        return np.sort(np.column_stack(ends), axis=1)


@kernel
def _edge_order(triangles, num_vertices, like):
    """Half-edges sorted by the smaller, then the larger end, then by number.

    The indices have the type of the array `like`.
    """
    by_larger = np.empty(triangles.size, like.dtype)
    order = np.empty(triangles.size, like.dtype)
    for turn in range(2):
        slots = np.zeros(num_vertices + 1, np.int64)
        for h in range(triangles.size):
            a, b = triangles[h // 3, h % 3], triangles[h // 3, (h + 1) % 3]
            slots[(max(a, b) if turn == 0 else min(a, b)) + 1] += 1
        for v in range(num_vertices):
            slots[v + 1] += slots[v]
        for i in range(triangles.size):
            h = i if turn == 0 else by_larger[i]
            a, b = triangles[h // 3, h % 3], triangles[h // 3, (h + 1) % 3]
            key = max(a, b) if turn == 0 else min(a, b)
            if turn == 0:
                by_larger[slots[key]] = h
            else:
                order[slots[key]] = h
            slots[key] += 1
    return order


@kernel
def _edges(triangles, order):
    """Where each edge's half-edges start in `order`, its state, and faces that may be repeated."""
    n = len(order)
    count = 0
    for pass_ in range(2):
        if pass_ == 1:
            starts = np.empty(count + 1, order.dtype)
            states = np.empty(count, np.int8)
            may_repeat = np.zeros(len(triangles), np.bool_)
            starts[count] = n
        count = 0
        i = 0
        while i < n:
            face, k = order[i] // 3, order[i] % 3
            a, b = triangles[face, k], triangles[face, (k + 1) % 3]
            apex = triangles[face, (k + 2) % 3]
            balance = 1
            repeated = False
            j = i + 1
            while j < n:
                face, k = order[j] // 3, order[j] % 3
                c, d = triangles[face, k], triangles[face, (k + 1) % 3]
                if c == a and d == b:
                    balance += 1
                elif c == b and d == a:
                    balance -= 1
                else:
                    break
                repeated |= triangles[face, (k + 2) % 3] == apex
                j += 1
            if pass_ == 1:
                uses = j - i
                starts[count] = i
                if uses == 1:
                    states[count] = _OPEN
                elif uses > 2:
                    states[count] = _NONMANIFOLD
                else:
                    states[count] = _GOOD if balance == 0 else _MISORIENTED
                if repeated or uses > 2:
                    for m in range(i, j):
                        may_repeat[order[m] // 3] = True
            count += 1
            i = j
    return starts, states, may_repeat


@kernel
def _root(parents, i):
    while parents[i] != i:
        parents[i] = parents[parents[i]]
        i = parents[i]
    return i


@kernel
def _join(parents, i, j):
    """Join two sets; the root is always the smallest member."""
    i, j = _root(parents, i), _root(parents, j)
    if i < j:
        parents[j] = i
    else:
        parents[i] = j


@kernel
def _join_faces(order, starts, parents):
    for e in range(len(starts) - 1):
        for m in range(starts[e] + 1, starts[e + 1]):
            _join(parents, order[m - 1] // 3, order[m] // 3)


@kernel
def _numbered(parents):
    """Labels from 0 in the order of the sets' first members, and how many sets there are."""
    labels = np.empty(len(parents), np.int64)
    count = 0
    for i in range(len(parents)):
        root = _root(parents, i)
        if root == i:
            labels[i] = count
            count += 1
        else:
            labels[i] = labels[root]
    return labels, count


@kernel
def _join_corners(triangles, order, starts, parents):
    """Join the corners on both sides of every edge; corner h is the tail of half-edge h."""
    for e in range(len(starts) - 1):
        for m in range(starts[e] + 1, starts[e + 1]):
            a, b = order[m - 1], order[m]
            after_a, after_b = a - a % 3 + (a % 3 + 1) % 3, b - b % 3 + (b % 3 + 1) % 3
            if triangles[a // 3, a % 3] == triangles[b // 3, b % 3]:
                _join(parents, a, b)
                _join(parents, after_a, after_b)
            else:
                _join(parents, a, after_b)
                _join(parents, after_a, b)
    for h in range(len(parents)):
        parents[h] = _root(parents, h)


@kernel
def _count_fans(triangles, roots, num_vertices):
    fans = np.zeros(num_vertices, roots.dtype)
    for h in range(len(roots)):
        if roots[h] == h:
            fans[triangles[h // 3, h % 3]] += 1
    return fans


@kernel
def _euler(roots, order, starts, states, labels, num_components):
    """Fans - edges + faces of each component, and whether it has a bad edge."""
    euler = np.zeros(num_components, np.int64)
    bad = np.zeros(num_components, np.bool_)
    for f in range(len(labels)):
        euler[labels[f]] += 1
    for h in range(len(roots)):
        if roots[h] == h:
            euler[labels[h // 3]] += 1
    for e in range(len(starts) - 1):
        component = labels[order[starts[e]] // 3]
        euler[component] -= 1
        bad[component] |= states[e] != _GOOD
    return euler, bad

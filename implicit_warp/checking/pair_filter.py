"""The float64 filter: what can be said for certain about a pair of faces, and quickly.

`pair_verdict` answers `CLEAR`, `CROSSING` or `DUPLICATE` only when the certain signs of
`predicates` prove it, else `UNSURE_PAIR`. The order of its attempts follows what meshes are
made of: nearly all candidate pairs are neighbours, and on flat-sided parts these lie in one
plane, where every 3D orientation is unsure but some projection separates them.

A zero-area face is never the face that is certainly pierced, since no certain sign comes from a
degenerate triple, but its edge may pierce the other: a `CROSSING` needs certain areas too.
"""

from __future__ import annotations

from fields.jit import kernel
from implicit_warp.checking.predicates import has_area, orient2d, orient3d, side_of_plane

CLEAR = 0
CROSSING = 1
UNSURE_PAIR = 2
DUPLICATE = 3


@kernel
def pair_verdict(v, faces, f, g):
    """Verdict on faces f and g; `v` are unit-scaled vertices, `faces` is `(F, 3)`."""
    a0, a1, a2 = faces[f, 0], faces[f, 1], faces[f, 2]
    b0, b1, b2 = faces[g, 0], faces[g, 1], faces[g, 2]
    if a0 == a1 or a1 == a2 or a2 == a0 or b0 == b1 or b1 == b2 or b2 == b0:
        return UNSURE_PAIR
    shared_a0 = a0 in (b0, b1, b2)
    shared_a1 = a1 in (b0, b1, b2)
    shared_a2 = a2 in (b0, b1, b2)
    shared_b0 = b0 in (a0, a1, a2)
    shared_b1 = b1 in (a0, a1, a2)
    count = int(shared_a0) + int(shared_a1) + int(shared_a2)
    if count == 3:
        return DUPLICATE
    if count == 0:
        verdict = _apart(v, a0, a1, a2, b0, b1, b2)
        if verdict == CROSSING and not (has_area(v, a0, a1, a2) and has_area(v, b0, b1, b2)):
            return UNSURE_PAIR
        return verdict
    # Rotate both faces so that the odd vertex out (shared or not) comes first.
    if shared_a1 == shared_a2:
        p, q, r = a0, a1, a2
    elif shared_a2 == shared_a0:
        p, q, r = a1, a2, a0
    else:
        p, q, r = a2, a0, a1
    if count == 1:
        if shared_b0:
            s, t = b1, b2
        elif shared_b1:
            s, t = b2, b0
        else:
            s, t = b0, b1
        verdict = _common_vertex(v, p, q, r, s, t)
        if verdict == CROSSING and not (has_area(v, p, q, r) and has_area(v, p, s, t)):
            return UNSURE_PAIR
        return verdict
    if not shared_b0:
        opposite = b0
    elif not shared_b1:
        opposite = b1
    else:
        opposite = b2
    return _common_edge(v, q, r, p, opposite)


@kernel
def _common_edge(v, p, q, c, d):
    """Faces pqc and pqd: they intersect only when folded flat onto each other."""
    if orient3d(v, p, q, c, d) != 0:
        return CLEAR
    for i in range(3):
        j = (i + 1) % 3
        turn = orient2d(v, p, q, c, i, j)
        if turn != 0 and orient2d(v, p, q, d, i, j) == -turn:
            return CLEAR
    return UNSURE_PAIR


@kernel
def _common_vertex(v, p, b, c, e, f):
    """Faces pbc and pef, which share the vertex p only."""
    if _bisector_separates(v, p, b, c, e, f):
        return CLEAR
    first = _segment_triangle(v, b, c, p, e, f)
    if first == CROSSING:
        return CROSSING
    second = _segment_triangle(v, e, f, p, b, c)
    if second == CROSSING:
        return CROSSING
    if first == CLEAR and second == CLEAR:
        return CLEAR
    if _edge_separates_at(v, p, b, c, e, f) or _edge_separates_at(v, p, e, f, b, c):
        return CLEAR
    return UNSURE_PAIR


@kernel
def _bisector_separates(v, p, b, c, e, f):
    """Whether the plane through p across the two faces' mean directions separates them."""
    n0 = n1 = n2 = 0.0
    for corner, weight in ((b, 1.0), (c, 1.0), (e, -1.0), (f, -1.0)):
        d0 = v[corner, 0] - v[p, 0]
        d1 = v[corner, 1] - v[p, 1]
        d2 = v[corner, 2] - v[p, 2]
        squared = d0 * d0 + d1 * d1 + d2 * d2
        if squared == 0.0:
            return False
        scale = weight / squared**0.5
        n0 += scale * d0
        n1 += scale * d1
        n2 += scale * d2
    return (
        side_of_plane(v, p, n0, n1, n2, b) == 1
        and side_of_plane(v, p, n0, n1, n2, c) == 1
        and side_of_plane(v, p, n0, n1, n2, e) == -1
        and side_of_plane(v, p, n0, n1, n2, f) == -1
    )


@kernel
def _edge_separates_at(v, p, b, c, e, f):
    """Whether in some projection the line of edge pb or pc keeps e and f off the face pbc."""
    for i in range(3):
        j = (i + 1) % 3
        turn = orient2d(v, p, b, c, i, j)
        if turn == 0:
            continue
        if orient2d(v, p, b, e, i, j) == -turn and orient2d(v, p, b, f, i, j) == -turn:
            return True
        if orient2d(v, p, c, e, i, j) == turn and orient2d(v, p, c, f, i, j) == turn:
            return True
    return False


@kernel
def _apart(v, a0, a1, a2, b0, b1, b2):
    """Faces without a common vertex."""
    side = orient3d(v, a0, a1, a2, b0)
    if side != 0 and side == orient3d(v, a0, a1, a2, b1) and side == orient3d(v, a0, a1, a2, b2):
        return CLEAR
    side = orient3d(v, b0, b1, b2, a0)
    if side != 0 and side == orient3d(v, b0, b1, b2, a1) and side == orient3d(v, b0, b1, b2, a2):
        return CLEAR
    if _edges_separate(v, a0, a1, a2, b0, b1, b2) or _edges_separate(v, b0, b1, b2, a0, a1, a2):
        return CLEAR
    unsure = False
    for p, q in ((a0, a1), (a1, a2), (a2, a0)):
        contact = _segment_triangle(v, p, q, b0, b1, b2)
        if contact == CROSSING:
            return CROSSING
        unsure |= contact == UNSURE_PAIR
    for p, q in ((b0, b1), (b1, b2), (b2, b0)):
        contact = _segment_triangle(v, p, q, a0, a1, a2)
        if contact == CROSSING:
            return CROSSING
        unsure |= contact == UNSURE_PAIR
    return UNSURE_PAIR if unsure else CLEAR


@kernel
def _edges_separate(v, a0, a1, a2, b0, b1, b2):
    """Whether in some projection an edge line of the first face separates the second."""
    for i in range(3):
        j = (i + 1) % 3
        turn = orient2d(v, a0, a1, a2, i, j)
        if turn == 0:
            continue
        for p, q in ((a0, a1), (a1, a2), (a2, a0)):
            if (
                orient2d(v, p, q, b0, i, j) == -turn
                and orient2d(v, p, q, b1, i, j) == -turn
                and orient2d(v, p, q, b2, i, j) == -turn
            ):
                return True
    return False


@kernel
def _segment_triangle(v, p, q, a, b, c):
    """Closed segment pq against closed triangle abc: CLEAR, CROSSING (its inside) or unsure."""
    side_p = orient3d(v, a, b, c, p)
    side_q = orient3d(v, a, b, c, q)
    if side_p != 0 and side_p == side_q:
        return CLEAR
    turn_ab = orient3d(v, p, q, a, b)
    turn_bc = orient3d(v, p, q, b, c)
    turn_ca = orient3d(v, p, q, c, a)
    left = turn_ab > 0 or turn_bc > 0 or turn_ca > 0
    right = turn_ab < 0 or turn_bc < 0 or turn_ca < 0
    # A turn that is certain puts the line off the plane of abc; it then meets that plane in one
    # point at most, and turns of both signs say that this point is outside the triangle.
    if left and right:
        return CLEAR
    if side_p == 0 or side_q == 0 or turn_ab == 0 or turn_bc == 0 or turn_ca == 0:
        return UNSURE_PAIR
    return CROSSING

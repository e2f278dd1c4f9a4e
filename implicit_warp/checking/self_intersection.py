"""Pairs of faces that intersect: every one of them, and no others.

Two closed triangles *intersect* here when they meet in more than the vertex or the edge that
they share by index. Crossings, coplanar overlaps, flat folds, touching contacts and
duplicates all count, and each pair has one `IntersectionKind`. Vertices that merely have equal
coordinates are not shared: merge them first where they should be.

Method: candidate pairs from a tree of boxes, a float64 filter whose answers are proven
(`pair_filter`, `predicates`), and integer arithmetic for what the filter leaves open
(`exact`). About a second for 10^6 clean faces on two cores.

Guarantee: the result is that of exact arithmetic on the float64 coordinates as given, unless
`complete` is False.
Non-guarantee: coordinates that are rounded afterwards (float32 STL, decimal OBJ) may
intersect again: check what was written.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from implicit_warp.checking import exact
from implicit_warp.checking.box_tree import BoxTree, scan_pairs
from implicit_warp.checking.exact import IntersectionKind
from implicit_warp.checking.mesh_arrays import validated
from implicit_warp.checking.pair_filter import CROSSING as CERTAIN_CROSSING
from implicit_warp.checking.pair_filter import UNSURE_PAIR
from implicit_warp.checking.predicates import finite_or_zero, unit_scaled

DEFAULT_LIMIT = 100_000
_SLICE = 4096  # pairs decided exactly before the limit is looked at again
_UNSURE_PER_HIT = 40  # room for pairs that the filter leaves open and that turn out clear


@dataclass(frozen=True, eq=False)
class SelfIntersections:
    """The intersecting pairs of one mesh.

    Attributes:
        pairs: `(k, 2)` int64 face indices, the smaller first, sorted.
        kinds: `(k,)` int8 `IntersectionKind` of each pair.
        complete: False when the search stopped at its limit; `pairs` is then a part of them.
        judged: number of pairs whose boxes overlap.
        decided_exactly: number of pairs that took integer arithmetic.
        skipped_faces: `(m,)` faces left out for a coordinate that is not finite.
    """

    pairs: NDArray[np.int64]
    kinds: NDArray[np.int8]
    complete: bool
    judged: int
    decided_exactly: int
    skipped_faces: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.pairs)

    def count_by_kind(self) -> dict[str, int]:
        """Number of pairs of each kind, zero included, by lower-case name."""
        counts = np.bincount(self.kinds, minlength=len(IntersectionKind))
        return {
            kind.name.lower(): int(counts[kind])
            for kind in IntersectionKind
            if kind is not IntersectionKind.NONE
        }


def self_intersections(
    vertices: NDArray[np.float64], faces: NDArray[np.int64], *, limit: int = DEFAULT_LIMIT
) -> SelfIntersections:
    """Find all intersecting pairs of faces.

    Args:
        vertices: `(V, 3)` coordinates, any unit.
        faces: `(F, 3)` vertex indices.
        limit: stop after about this many intersecting pairs. It keeps a collapsed mesh, in
            which everything meets everything, from running for hours.

    Returns:
        The pairs. Faces with NaN or infinite coordinates take no part and are listed.

    Raises:
        InputError: wrong shapes or types, or an index out of range.
    """
    vertices, faces = validated(vertices, faces)
    finite = np.isfinite(vertices).all(axis=1)
    usable = finite[faces].all(axis=1)
    skipped = np.flatnonzero(~usable)
    kept = np.flatnonzero(usable)
    if len(kept) < 2:
        return _nothing(skipped)

    scaled, _ = unit_scaled(finite_or_zero(vertices, finite))
    tree = BoxTree.of(scaled, faces, kept)
    pairs, verdicts, judged, complete = _scan(scaled, faces, tree, _UNSURE_PER_HIT * limit)

    kinds = np.where(
        verdicts == CERTAIN_CROSSING, IntersectionKind.CROSSING, IntersectionKind.DUPLICATE
    ).astype(np.int8)
    unsure = np.flatnonzero(verdicts == UNSURE_PAIR)
    kinds[unsure] = IntersectionKind.NONE
    hits = int(np.count_nonzero(kinds))
    decided = 0
    while decided < len(unsure) and hits < limit:
        part = unsure[decided : decided + _SLICE]
        kinds[part] = decide_exactly(vertices, faces, pairs[part])
        hits += int(np.count_nonzero(kinds[part]))
        decided += len(part)

    hit = kinds != IntersectionKind.NONE
    pairs = np.sort(pairs[hit], axis=1)
    by_face = np.lexsort((pairs[:, 1], pairs[:, 0]))
    return SelfIntersections(
        pairs=pairs[by_face],
        kinds=kinds[hit][by_face],
        complete=complete and decided == len(unsure),
        judged=judged,
        decided_exactly=decided,
        skipped_faces=skipped,
    )


def decide_exactly(
    vertices: NDArray[np.float64], faces: NDArray[np.int64], pairs: NDArray[np.int64]
) -> NDArray[np.int8]:
    """`IntersectionKind` of each given pair `(k, 2)` of faces, by integers alone, `(k,)`."""
    used, corners = np.unique(faces[pairs], return_inverse=True)
    points = exact.integer_points(vertices[used])
    corners = corners.reshape(-1, 2, 3).tolist()
    return np.array([exact.decide(points, f, g) for f, g in corners], dtype=np.int8)


def faces_meeting(
    vertices: NDArray[np.float64], faces: NDArray[np.int64], face: int
) -> NDArray[np.int64]:
    """All faces that intersect one given face, by integers alone.

    It shares neither tree nor filter with `self_intersections`, so that it can be the judge
    where that and another tool disagree. Coordinates must be finite.
    """
    corners = vertices[faces]
    low, high = corners.min(axis=1), corners.max(axis=1)
    near = ((low <= high[face]) & (high >= low[face])).all(axis=1)
    near[face] = False
    others = np.flatnonzero(near)
    pairs = np.column_stack([np.full(len(others), face), others])
    return others[decide_exactly(vertices, faces, pairs) != IntersectionKind.NONE]


def _scan(
    scaled: NDArray[np.float64],
    faces: NDArray[np.int64],
    tree: BoxTree,
    limit: int,
) -> tuple[NDArray[np.int64], NDArray[np.int8], int, bool]:
    """Pairs that are not certainly clear, their verdicts, the number judged, completeness."""
    chunks = min(256, 1 + len(tree.faces) // 256)
    offsets = np.arange(chunks + 1) * 1024  # enough for a clean mesh; else a second pass
    while True:
        pairs = np.empty((offsets[-1], 2), dtype=np.int64)
        verdicts = np.empty(offsets[-1], dtype=np.int8)
        found, judged = scan_pairs(
            scaled,
            faces,
            tree.faces,
            tree.low,
            tree.high,
            tree.nodes,
            offsets,
            pairs,
            verdicts,
            limit,
        )
        room = np.diff(offsets)
        wanted = np.minimum(found, limit)
        if (wanted <= room).all() or offsets[-1] == limit:
            break
        ends = np.minimum(np.cumsum(wanted), limit)
        offsets = np.concatenate([[0], ends])
    written = np.minimum(found, room)
    slots = np.concatenate(
        [np.arange(o, o + w) for o, w in zip(offsets[:-1], written, strict=True)]
    )
    complete = bool((found <= np.minimum(room, limit)).all())
    return pairs[slots], verdicts[slots], int(judged.sum()), complete


def _nothing(skipped: NDArray[np.int64]) -> SelfIntersections:
    return SelfIntersections(
        pairs=np.empty((0, 2), dtype=np.int64),
        kinds=np.empty(0, dtype=np.int8),
        complete=True,
        judged=0,
        decided_exactly=0,
        skipped_faces=skipped,
    )

"""Where a mesh intersects itself, as things to draw: faces, their edges, and the lines of contact.

For display: the exact verdict is the check's; here its pairs of faces are turned into coordinates,
rounded as float64 rounds.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from implicit_warp.checking import CheckReport

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Highlights:
    """What to draw of a mesh's self-intersections.

    Attributes:
        faces: (k,) the faces that intersect another one.
        edges: (e, 2, 3) the edges of these faces, each once.
        contacts: (c, 2, 3) where pairs of faces meet, as segments; pairs that overlap in an area
            or touch in a point have none.
        kinds: number of pairs by kind, such as "crossing".
    """

    faces: NDArray[np.int64]
    edges: Array
    contacts: Array
    kinds: dict[str, int]

    def __bool__(self) -> bool:
        return len(self.faces) > 0

    def face_mask(self, count: int) -> NDArray[np.bool_]:
        """(count,) which faces of the mesh intersect another one."""
        mask = np.zeros(count, dtype=bool)
        mask[self.faces] = True
        return mask


def self_intersection_highlights(report: CheckReport) -> Highlights:
    """The self-intersections of a report as things to draw."""
    pairs = np.asarray(report.self_intersections.pairs, dtype=np.int64).reshape(-1, 2)
    faces = np.unique(pairs)
    corners = report.faces[faces]
    links = np.sort(np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]]))
    edges = report.vertices[np.unique(links, axis=0)].reshape(-1, 2, 3)
    triangles = report.vertices[report.faces[pairs]].reshape(-1, 2, 3, 3)
    kinds = {kind: n for kind, n in report.self_intersections.count_by_kind().items() if n}
    return Highlights(faces, edges, _contacts(triangles[:, 0], triangles[:, 1]), kinds)


def _contacts(first: Array, second: Array) -> Array:
    """The segments (c, 2, 3) in which pairs of triangles (n, 3, 3) meet.

    Ends of such a segment are where an edge of one pierces the other; of up to six such points the
    two farthest apart are taken.
    """
    points = np.concatenate([_piercings(first, second), _piercings(second, first)], axis=1)
    if not len(points):
        return np.empty((0, 2, 3))
    gaps = np.linalg.norm(points[:, :, None] - points[:, None], axis=-1)
    gaps = np.where(np.isfinite(gaps), gaps, -1.0).reshape(len(points), -1)
    a, b = np.divmod(gaps.argmax(axis=1), points.shape[1])
    size = np.linalg.norm(np.ptp(first, axis=1), axis=1)
    rows = np.flatnonzero(gaps.max(axis=1) > 1e-12 * size)
    return np.stack([points[rows, a[rows]], points[rows, b[rows]]], axis=1)


def _piercings(edges_of: Array, through: Array) -> Array:
    """Where the edges of triangles pierce other ones, (n, 3, 3); NaN where they do not."""
    corner = through[:, None, 0]
    u, v = through[:, None, 1] - corner, through[:, None, 2] - corner
    normal = np.cross(u, v)
    start = edges_of - corner
    along = np.roll(edges_of, -1, axis=1) - edges_of
    with np.errstate(divide="ignore", invalid="ignore"):
        t = -np.sum(normal * start, axis=-1) / np.sum(normal * along, axis=-1)
        point = start + t[..., None] * along
        area = np.sum(normal * normal, axis=-1)
        second = np.sum(np.cross(u, point) * normal, axis=-1) / area
        first = np.sum(np.cross(point, v) * normal, axis=-1) / area
        # Loose by rounding: a contact that ends in an edge of both must not be lost.
        slack = 1e-9
        hit = (t >= -slack) & (t <= 1 + slack) & (first >= -slack) & (second >= -slack)
        hit &= first + second <= 1 + slack
    return np.where(hit[..., None], point + corner, np.nan)

"""Distances put together from distances along orthogonal directions."""

from __future__ import annotations

from fields.expression import Expression, length, maximum, where_negative


def outside_or_faces(faces: Expression, outside: Expression) -> Expression:
    """`outside` where some face distance is positive, else the largest face distance."""
    return where_negative(-faces, outside, faces)


def box_distance(offsets: tuple[Expression, ...]) -> Expression:
    """The distance to {all offsets <= 0}, for offsets measured along orthogonal axes."""
    return outside_or_faces(
        maximum(*offsets), length(*(maximum(offset, 0.0) for offset in offsets))
    )

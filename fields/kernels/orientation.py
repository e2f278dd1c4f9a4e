"""Turn the faces of a surface so that neighbours agree."""

from __future__ import annotations

import numpy as np

from fields.jit import kernel


@kernel
def patches(across, disagrees):
    """Walk over each patch of faces from its first one.

    Args:
        across: `(f, 3)`, the face behind each edge; -1 where there is none or more than one.
        disagrees: `(f, 3)`, whether that face runs along the edge in the same direction.

    Returns:
        The patch of each face, and whether it has to be turned to agree with its patch's first
        face. On a surface with one side only, some edges stay in disagreement.
    """
    count = len(across)
    patch, turned = np.full(count, -1, np.int64), np.zeros(count, np.bool_)
    queue = np.empty(count, np.int64)
    number = 0
    for start in range(count):
        if patch[start] >= 0:
            continue
        patch[start], queue[0], size = number, start, 1
        while size:
            size -= 1
            face = queue[size]
            for k in range(3):
                other = across[face, k]
                if other >= 0 and patch[other] < 0:
                    patch[other] = number
                    turned[other] = turned[face] ^ disagrees[face, k]
                    queue[size] = other
                    size += 1
        number += 1
    return patch, turned

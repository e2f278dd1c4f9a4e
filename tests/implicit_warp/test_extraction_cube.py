"""The tables of cubes: every one of the 256 patterns, against rules and against scikit-image."""

from __future__ import annotations

from collections import Counter
from itertools import product

import numpy as np
import pytest
from skimage.measure import marching_cubes

from implicit_warp.checking.self_intersection import self_intersections
from implicit_warp.extraction import cube


def crossed(pattern: int) -> set[int]:
    low, high = cube.EDGE_ENDS
    return {e for e in range(12) if (pattern >> low[e] ^ pattern >> high[e]) & 1}


def test_loops_pass_every_crossed_edge_once():
    for pattern in range(256):
        passed = [e for loop in cube.loops(pattern) for e in loop.edges]
        assert sorted(passed) == sorted(crossed(pattern))


def test_steps_of_loops_lie_in_the_faces_that_they_name():
    for pattern in range(256):
        for loop in cube.loops(pattern):
            for i, face in enumerate(loop.faces):
                for edge in (loop.edges[i], loop.edges[(i + 1) % len(loop.edges)]):
                    axis, side = cube.FACE_AXIS[face], cube.FACE_SIDE[face]
                    assert cube.EDGE_AXIS[edge] != axis
                    assert cube.EDGE_LOW[edge][axis] == side


@pytest.mark.parametrize("axis", range(3))
def test_both_cubes_of_a_face_agree_on_its_segments(axis):
    """For all 16 patterns of a face, with everything else of both cubes varied."""

    def segments(pattern: int, side: int, turn: int) -> set[tuple]:
        face = 2 * axis + side
        found = set()
        for loop in cube.loops(pattern):
            for i, at in enumerate(loop.faces):
                if at == face:
                    ends = [loop.edges[i], loop.edges[(i + 1) % len(loop.edges)]][::turn]
                    places = [(*np.delete(cube.EDGE_LOW[e], axis), cube.EDGE_AXIS[e]) for e in ends]
                    found.add(tuple(places))
        return found

    on_face = [[c for c in range(8) if cube.CORNERS[c][axis] == side] for side in (0, 1)]
    for signs in product((0, 1), repeat=4):
        for rest in (0, 0b0110, 0b1111, 0b1001):
            high, low = 0, 0
            for k in range(4):
                high |= signs[k] << on_face[1][k] | (rest >> k & 1) << on_face[0][k]
                low |= signs[k] << on_face[0][k] | (rest >> k & 1) << on_face[1][k]
            # Seen from the other side, the surface runs the other way.
            assert segments(high, 1, 1) == segments(low, 0, -1)


def test_loops_are_the_borders_of_the_triangles_of_scikit_image():
    for pattern in range(1, 255):
        volume = np.ones((2, 2, 2), np.float32)
        for c, place in enumerate(cube.CORNERS):
            volume[tuple(place)] = -1.0 if pattern >> c & 1 else 1.0
        vertices, faces, _, _ = marching_cubes(volume, 0.0, method="lorensen")
        doubled = np.rint(2 * vertices).astype(int)
        names = [
            next(
                e
                for e in range(12)
                if (cube.EDGE_LOW[e] == d >> 1).all() and cube.EDGE_AXIS[e] == np.argmax(d & 1)
            )
            for d in doubled
        ]
        sides = Counter((names[f[i]], names[f[(i + 1) % 3]]) for f in faces for i in range(3))
        border = {side for side in sides if side[::-1] not in sides}
        ours = {
            (loop.edges[i], loop.edges[(i + 1) % len(loop.edges)])
            for loop in cube.loops(pattern)
            for i in range(len(loop.edges))
        }
        assert border == ours


def test_fans_fill_loops_and_have_no_diagonal_in_a_face():
    for pattern in range(256):
        for loop in cube.loops(pattern):
            n = len(loop.edges)
            fan = cube.triangles(loop)
            assert len(fan) == n - 2
            sides = Counter((t[i], t[(i + 1) % 3]) for t in fan for i in range(3))
            border = {side for side in sides if side[::-1] not in sides}
            assert border == {(loop.edges[i], loop.edges[(i + 1) % n]) for i in range(n)}
            for a, b in set(sides) - border:
                if (b, a) in sides:
                    faces_of_a = {f for f in range(6) if a in cube.face_cycles()[f][1]}
                    assert not any(b in cube.face_cycles()[f][1] for f in faces_of_a)


def test_the_triangles_of_a_cube_never_intersect(rng):
    """All patterns, crossings anywhere on their edges and often next to the ends."""
    n = 40
    table = cube.tables()
    for pattern in range(1, 255):
        fraction = rng.choice([0.01, 0.99, 0.5, -1.0], (n, 12), p=[0.35, 0.35, 0.1, 0.2])
        fraction = np.where(fraction < 0, rng.uniform(0.01, 0.99, (n, 12)), fraction)
        vertices = np.zeros((n, 12, 3)) + cube.EDGE_LOW
        vertices[:, np.arange(12), cube.EDGE_AXIS] = fraction
        vertices[..., 0] += 3.0 * np.arange(n)[:, None]
        one = table.triangles[pattern, : table.n_triangles[pattern]]
        faces = (one + 12 * np.arange(n)[:, None, None]).reshape(-1, 3)
        assert not len(self_intersections(vertices.reshape(-1, 3), faces)), pattern

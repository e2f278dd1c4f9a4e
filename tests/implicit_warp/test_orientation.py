"""The proof that layers are homeomorphisms, against rational arithmetic."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
import torch

from implicit_warp.errors import InputError, NotInjective
from implicit_warp.orientation import (
    area_bounds,
    cell_signs,
    determinant_signs,
    exact_area,
    prove_layers,
    smallest_area,
    windings,
)
from implicit_warp.square_mesh import square_mesh
from implicit_warp.warp import Warp
from tests.implicit_warp.planted_folds import (
    cell_corners,
    plant_fold,
    random_layers,
    random_warp_at_the_limits,
    rational_area,
)

SIZES = [10.0**-e for e in (3, 8, 13, 16, 20, 40, 100, 160, 200, 300)] + [0.0]


def sign(value: Fraction) -> int:
    return (value > 0) - (value < 0)


def oracle_signs(embeddings: np.ndarray, mesh) -> np.ndarray:
    return np.array(
        [
            [sign(rational_area(cell_corners(u, mesh, c))) for c in range(mesh.n_cells)]
            for u in embeddings
        ]
    )


@pytest.mark.parametrize("size", SIZES)
def test_signs_are_those_of_rational_arithmetic_beside_planted_folds(size, seed):
    rng = np.random.default_rng(seed)
    for _ in range(4):
        mesh = square_mesh(int(rng.integers(2, 7)))
        u, cell = plant_fold(rng, random_layers(rng, 1, mesh.resolution)[0], mesh, size)
        signs, decided = cell_signs(u[None], mesh)
        np.testing.assert_array_equal(signs, oracle_signs(u[None], mesh))
        assert signs[0, cell] == (-1 if size else 0)
        assert sum(decided) == mesh.n_cells


@pytest.mark.parametrize("exponent", [-1070, -1000, -600, -400, 300, 500, 1000])
def test_signs_do_not_depend_on_the_scale(exponent, seed):
    """Products of such coordinates under- or overflow; powers of two change no sign."""
    rng = np.random.default_rng(seed)
    mesh = square_mesh(5)
    u = np.ldexp(random_layers(rng, 3, 5), exponent)
    signs, _ = cell_signs(u, mesh)
    # At the bottom of the range coordinates lose their digits, and with them areas.
    np.testing.assert_array_equal(signs, oracle_signs(u, mesh))


def test_near_zero_areas_go_to_the_exact_path(rng):
    """Centres on the diagonals of their cells, up to the last digit."""
    mesh = square_mesh(6)
    u = random_layers(rng, 1, 6)
    at = mesh.triangles[:, 1:][rng.integers(mesh.n_triangles, size=9)]
    for first, second in at:
        cell = int(np.flatnonzero((mesh.triangles[:, 1:] == (first, second)).all(1))[0])
        u[0, mesh.triangles[cell, 0]] = 0.5 * (u[0, first] + u[0, second])
    signs, decided = cell_signs(u, mesh)
    assert decided.exactly > 0
    np.testing.assert_array_equal(signs, oracle_signs(u, mesh))


def test_tiny_components_are_not_lost():
    """A vertex 1e-300 below an axis: in float64 the area is right, or zero, by luck only."""
    mesh = square_mesh(3)
    for tiny in (1e-300, 5e-324, 1e-200):
        u = mesh.vertices[None].copy()
        middle = int(np.flatnonzero((mesh.vertices == 0.0).all(1))[0])
        right = int(np.flatnonzero((mesh.vertices == (1.0, 0.0)).all(1))[0])
        cell = next(
            c for c in range(mesh.n_triangles) if {middle, right} <= set(mesh.triangles[c].tolist())
        )
        centre = next(v for v in mesh.triangles[cell] if v not in (middle, right))
        side = np.sign(mesh.vertices[centre, 1])
        for y, expected in ((-side * tiny, -1), (0.0, 0), (side * tiny, 1)):
            u[0, centre] = 0.5, y
            assert cell_signs(u, mesh)[0][0, cell] == expected


@pytest.mark.parametrize("size", SIZES)
def test_planted_folds_are_refused_by_name(size, seed):
    rng = np.random.default_rng(seed)
    for _ in range(3):
        mesh = square_mesh(int(rng.integers(2, 12)))
        u = random_layers(rng, 3, mesh.resolution)
        u[1], cell = plant_fold(rng, u[1], mesh, size)
        with pytest.raises(NotInjective, match="not positive") as caught:
            Warp(torch.from_numpy(u), torch.eye(3).repeat(3, 1, 1))
        assert caught.value.layer == 1
        shift = mesh.n_triangles if caught.value.kind == "cone" else 0
        named = caught.value.cell + shift
        assert rational_area(cell_corners(u[1], mesh, named)) <= 0
        assert named <= cell  # the first bad one is named


def winding_twice() -> np.ndarray:
    """z -> z^2 / |z| on the vertices of the coarsest mesh with an inner grid vertex."""
    x, y = square_mesh(3).vertices.T
    angle, radius = 2.0 * np.arctan2(y, x), np.hypot(x, y)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], -1)[None]


def test_positive_areas_that_wind_twice_are_refused():
    u = winding_twice()
    assert (cell_signs(u, square_mesh(3))[0] > 0).all()
    assert windings(u, square_mesh(3)) == 2
    with pytest.raises(NotInjective, match=r"layer 1, boundary: .*winds 2 times") as caught:
        prove_layers(np.concatenate([square_mesh(3).vertices[None], u]), square_mesh(3))
    assert caught.value.cell is None


def test_windings_equal_the_sum_of_angles(rng):
    for resolution in (2, 3, 8):
        mesh = square_mesh(resolution)
        u = random_layers(rng, 20, resolution)
        turn = rng.uniform(0, 2 * np.pi, 20)
        cos, sin = np.cos(turn), np.sin(turn)
        turned = np.stack([[cos, -sin], [sin, cos]]).transpose(2, 0, 1)
        u = u @ turned.transpose(0, 2, 1)
        b = u[:, mesh.boundary]
        z = b[..., 0] + 1j * b[..., 1]
        steps = np.angle(np.roll(z, -1, axis=1) / z)
        np.testing.assert_allclose(windings(u, mesh), steps.sum(1) / (2 * np.pi), atol=1e-9)


def test_smallest_area_is_exact_and_bounds_enclose(seed):
    rng = np.random.default_rng(seed)
    for exponent in (0, -200, 200):
        mesh = square_mesh(5)
        u = np.ldexp(random_layers(rng, 3, 5), exponent)
        areas = np.array(
            [
                [rational_area(cell_corners(layer, mesh, c)) for c in range(mesh.n_cells)]
                for layer in u
            ]
        )
        low, high = area_bounds(u, mesh)
        assert (low <= areas).all()
        assert (areas <= high).all()
        assert (high - low <= 1e-11 * high).all()
        assert smallest_area(u, mesh) == areas.min()
        assert exact_area(cell_corners(u[0], mesh, 7)) == areas[0, 7]


def rational_determinant(matrix) -> Fraction:
    (a, b, c), (d, e, f), (g, h, i) = [[Fraction(float(x)) for x in row] for row in matrix]
    return a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)


def test_determinant_signs_are_those_of_rational_arithmetic(rng):
    matrices = rng.normal(size=(200, 3, 3))
    matrices[::2, 2] = matrices[::2, 0] * rng.normal(size=(100, 1)) + matrices[::2, 1]
    matrices[::4, 2] = matrices[::4, 0]  # exactly singular
    matrices[100:] = np.ldexp(matrices[100:], rng.integers(-340, 330, 100)[:, None, None])
    signs, decided = determinant_signs(matrices)
    assert signs.tolist() == [sign(rational_determinant(m)) for m in matrices]
    assert decided.exactly > 0
    assert {-1, 0, 1} == set(signs.tolist())


def test_affine_parts_that_are_singular_to_the_last_digit_are_refused():
    tilted = np.array([[0.1, 0.3, 0.2], [0.7, 0.11, 0.13], [0.8, 0.41, 0.33]])
    unit = torch.eye(3, dtype=torch.float64)[None]
    vertices = torch.tensor(square_mesh(3).vertices)[None]
    outcomes = set()
    for value in (0.33, np.nextafter(0.33, 1), np.nextafter(0.33, 0)):
        tilted[2, 2] = value
        positive = rational_determinant(tilted) > 0
        outcomes.add(positive)
        before = torch.from_numpy(np.concatenate([tilted, np.zeros((3, 1))], 1))
        if positive:
            Warp(vertices, unit, before=before)
        else:
            with pytest.raises(InputError, match=r"before = .*not positive"):
                Warp(vertices, unit, before=before)
    assert outcomes == {True, False}


def prove_many(count: int, seed: int) -> None:
    """Prove random warps, plant one fold in each, and find it."""
    rng = np.random.default_rng(seed)
    for i in range(count):
        warp = random_warp_at_the_limits(rng)
        size = 0.0 if rng.random() < 0.1 else 10.0 ** rng.uniform(-300.0, -3.0)
        u = warp.embeddings.numpy()
        k = int(rng.integers(warp.n_layers))
        folded, cell = plant_fold(rng, u[k], warp.mesh, size)
        signs, _ = cell_signs(folded[None], warp.mesh)
        truth = rational_area(cell_corners(folded, warp.mesh, cell))
        assert signs[0, cell] == sign(truth) <= 0, f"seed {seed}, warp {i}, size {size}"
        with pytest.raises(NotInjective):
            prove_layers(np.concatenate([u[:k], folded[None], u[k + 1 :]]), warp.mesh)


def test_random_warps_are_proved_and_every_planted_fold_is_found(seed):
    prove_many(150, seed)


@pytest.mark.statistical
def test_100_000_random_warps_are_proved_and_every_planted_fold_is_found(seed):
    for part in range(10):
        prove_many(10_000, seed + part)

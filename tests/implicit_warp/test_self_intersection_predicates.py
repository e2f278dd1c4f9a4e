"""Signs from float64 are certain or unsure, and never wrong: against rationals, at the edge."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from implicit_warp.checking import predicates
from implicit_warp.checking.predicates import certainly_not_collinear, unit_scaled


def sign(value: Fraction) -> int:
    return (value > 0) - (value < 0)


def rational(rows) -> list[list[Fraction]]:
    return [[Fraction(float(x)) for x in row] for row in rows]


def true_orient2d(points) -> int:
    (ax, ay), (bx, by), (cx, cy) = rational(points[:, :2])
    return sign((ax - cx) * (by - cy) - (ay - cy) * (bx - cx))


def true_orient3d(points) -> int:
    a, b, c, d = rational(points)
    (ax, ay, az), (bx, by, bz), (cx, cy, cz) = (
        [p - q for p, q in zip(x, d, strict=True)] for x in (a, b, c)
    )
    return sign(ax * (by * cz - bz * cy) - ay * (bx * cz - bz * cx) + az * (bx * cy - by * cx))


def true_side(points, normal) -> int:
    p, x = rational(points)
    (n,) = rational([normal])
    return sign(sum(c * (e - s) for c, e, s in zip(n, x, p, strict=True)))


def nudged(values: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Each value moved by up to two units in the last place: across the zero of a determinant."""
    return values + rng.integers(-2, 3, values.shape) * np.spacing(values)


def nearly_coplanar(rng: np.random.Generator) -> np.ndarray:
    """Four points within rounding of one plane, in a plane of random direction."""
    frame = rng.standard_normal((2, 3))
    return nudged(rng.standard_normal(3) * 0.3 + rng.standard_normal((4, 2)) @ frame, rng) / 16.0


CASES = 4000


def orientation_signs_2d(rng):
    start, along = rng.standard_normal((2, 2))
    points = np.zeros((3, 3))
    points[:, :2] = nudged(start + rng.standard_normal((3, 1)) * along, rng) / 16.0
    return predicates.orient2d(points, 0, 1, 2, 0, 1), true_orient2d(points)


def orientation_signs_3d(rng):
    points = nearly_coplanar(rng)
    return predicates.orient3d(points, 0, 1, 2, 3), true_orient3d(points)


def plane_signs(rng):
    normal = rng.standard_normal(3)
    point = rng.standard_normal(3)
    in_plane = np.cross(normal, rng.standard_normal(3))
    points = nudged(np.stack([point, point + in_plane]), rng) / 16.0
    return predicates.side_of_plane(points, 0, *normal, 1), true_side(points, normal)


@pytest.mark.parametrize("signs", [orientation_signs_2d, orientation_signs_3d, plane_signs])
def test_certain_signs_are_right_within_rounding_of_zero(signs) -> None:
    rng = np.random.default_rng(0)
    results = np.array([signs(rng) for _ in range(CASES)])
    found, truth = results.T
    wrong = (found != 0) & (found != truth)
    assert not wrong.any(), f"{wrong.sum()} wrong signs of {CASES}"
    # The cases must straddle the bound, or they would test one of its sides only.
    assert (found == 0).any()
    assert (truth > 0).any()
    assert (truth < 0).any()


@pytest.mark.parametrize("signs", [orientation_signs_2d, orientation_signs_3d, plane_signs])
def test_without_the_error_bound_signs_would_be_wrong(signs, monkeypatch) -> None:
    """Sabotage of the tests above: the cases are hard enough to need the bound."""
    for bound in ("_BOUND_2D", "_BOUND_3D", "_BOUND_SIDE", "UNDERFLOW"):
        monkeypatch.setattr(predicates, bound, 0.0)
    for name in ("orient2d", "orient3d", "side_of_plane"):
        # The plain function behind the compiled one reads its bounds when it runs.
        monkeypatch.setattr(predicates, name, getattr(predicates, name).py_func)
    rng = np.random.default_rng(0)
    found, truth = np.array([signs(rng) for _ in range(CASES)]).T
    assert ((found != 0) & (found != truth)).any()


def test_signs_of_points_in_general_position_are_certain() -> None:
    """Else everything would end in integers: correct, but a thousand times slower."""
    rng = np.random.default_rng(0)
    for _ in range(500):
        points = rng.uniform(-1, 1, (4, 3))
        assert predicates.orient3d(points, 0, 1, 2, 3) == true_orient3d(points)
        assert predicates.orient2d(points, 0, 1, 2, 0, 1) == true_orient2d(points[:3])


def test_orientation_is_positive_for_the_documented_side() -> None:
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, -1.0]])
    assert predicates.orient3d(points, 0, 1, 2, 3) == 1
    assert predicates.orient2d(points, 0, 1, 2, 0, 1) == 1


def test_exact_zeros_and_nan_are_unsure() -> None:
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0.3, 0.3, 0]])
    assert predicates.orient3d(points, 0, 1, 2, 3) == 0
    points[3] = np.nan
    assert predicates.orient3d(points, 0, 1, 2, 3) == 0
    assert predicates.side_of_plane(points, 0, 1.0, 1.0, 1.0, 3) == 0


def test_products_that_underflow_are_unsure() -> None:
    """1e-150 cubed is no float64: the computed determinant is zero or noise."""
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, -1.0]]) * 1e-150
    assert predicates.orient3d(points, 0, 1, 2, 3) == 0


@pytest.mark.parametrize("scale", [5e-324, 1e-300, 1.0, 1e300, 1.7e308])
def test_scaling_to_unit_size_is_by_a_power_of_two(scale: float) -> None:
    points = np.array([[1.0, -0.25, 0.5]]) * scale
    scaled, exponent = unit_scaled(points)
    assert 0.5 <= np.abs(scaled).max() < 1.0
    assert np.array_equal(np.ldexp(scaled, exponent), points)


def test_no_points_and_zero_points_scale_to_themselves() -> None:
    assert unit_scaled(np.empty((0, 3)))[0].shape == (0, 3)
    assert not unit_scaled(np.zeros((2, 3)))[0].any()


def test_faces_called_not_collinear_never_are() -> None:
    rng = np.random.default_rng(0)
    start, along = rng.standard_normal((2, 2000, 1, 3))
    corners = nudged(start + rng.standard_normal((2000, 3, 1)) * along, rng)
    points, _ = unit_scaled(corners.reshape(-1, 3))
    faces = np.arange(6000).reshape(-1, 3)
    sure = certainly_not_collinear(points, faces)
    for face in faces[sure]:
        a, b, c = rational(points[face])
        u, v = ([e - s for e, s in zip(x, a, strict=True)] for x in (b, c))
        assert any(u[i] * v[j] != u[j] * v[i] for i, j in ((0, 1), (1, 2), (2, 0)))
    assert not certainly_not_collinear(np.tile(points[:1], (3, 1)), np.array([[0, 1, 2]])).any()
    assert certainly_not_collinear(np.eye(3), np.array([[0, 1, 2]])).all()

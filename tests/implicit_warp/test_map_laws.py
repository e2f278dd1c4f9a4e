"""The laws of `Map`, for every registered map, back end and dtype."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from implicit_warp.affine import axis_vector
from implicit_warp.errors import InputError
from implicit_warp.evaluate import back_end
from implicit_warp.maps import Composition, Map
from tests.implicit_warp.registered_maps import (
    BUILDERS,
    COVERED,
    random_affine,
    random_net,
    within,
)

MAPS = pytest.mark.parametrize("build", BUILDERS.values(), ids=BUILDERS.keys())
BACK_END = pytest.mark.parametrize("name", ["torch", "numba"])
DTYPE = pytest.mark.parametrize("dtype", [torch.float64, torch.float32], ids=str)


@pytest.fixture
def points(seed: int) -> torch.Tensor:
    """Points in and around the unit domain: some in no layer's square, some far away."""
    generator = torch.Generator().manual_seed(seed)
    near = 6.0 * torch.rand(400, 3, generator=generator, dtype=torch.float64) - 3.0
    return torch.cat([near, 1e3 * near[:20], torch.zeros(1, 3, dtype=torch.float64)])


def conditioning(jacobian: torch.Tensor) -> torch.Tensor:
    """(n,) the factor by which a map's inverse may magnify an error, |J^-1| (1 + |J|)."""
    stretch = torch.linalg.matrix_norm(jacobian.double(), 2)
    return torch.linalg.matrix_norm(torch.linalg.inv(jacobian.double()), 2) * (1.0 + stretch)


def rounding(m: Map, x: torch.Tensor, dtype: torch.dtype) -> torch.Tensor:
    """(n,) bound on |m.inv(m(x)) - x|.

    Both traversals make some tens of roundings a layer, each relative to the size of the point;
    the inverse magnifies them by at most its own stretch. 100 covers a dozen layers.
    """
    with back_end("torch"):
        y, jacobian = m.call_and_jacobian(x.double())
    size = 1.0 + x.double().norm(dim=-1) + y.norm(dim=-1)
    return 100.0 * torch.finfo(dtype).eps * conditioning(jacobian) * size


def all_subclasses(kind: type) -> set[type]:
    return {s for c in kind.__subclasses__() for s in {c, *all_subclasses(c)}}


def test_every_kind_of_map_is_registered():
    import implicit_warp.affine
    import implicit_warp.bend
    import implicit_warp.shear
    import implicit_warp.tuttenet
    import implicit_warp.warp  # noqa: F401

    ours = {k for k in all_subclasses(Map) if k.__module__.startswith("implicit_warp")}
    assert ours == set(COVERED)


@MAPS
@BACK_END
@DTYPE
@torch.no_grad()
def test_round_trip_both_ways(build, name, dtype, points, seed):
    m = build(seed)
    for there in (m, m.inv):
        x = within(there, points).to(dtype)
        assert len(x) > 300
        with back_end(name):
            error = there.inv(there(x)) - x
        assert (error.double().norm(dim=-1) <= rounding(there, x, dtype)).all()


@MAPS
def test_double_inverse_is_the_map_itself(build, seed):
    m = build(seed)
    assert m.inv.inv is m


@MAPS
@BACK_END
@torch.no_grad()
def test_jacobians_of_map_and_inverse_are_inverse(build, name, points, seed):
    m = build(seed)
    points = within(m, points)
    with back_end(name):
        y, forward = m.call_and_jacobian(points)
        backward = m.inv.jacobian(y)
    error = (backward @ forward - torch.eye(3, dtype=torch.float64)).abs().amax((-1, -2))
    # A point within rounding of a crease may be found on its other side; nothing else may differ.
    wrong = error > 1e-13 * conditioning(forward) ** 2
    assert wrong.float().mean() <= 0.01, f"{int(wrong.sum())} of {len(points)} points"


@MAPS
@torch.no_grad()
def test_orientation_is_kept(build, points, seed):
    m = build(seed)
    assert (torch.linalg.det(m.jacobian(within(m, points))) > 0).all()


@MAPS
@torch.no_grad()
def test_jacobian_equals_central_differences_away_from_creases(build, points, seed):
    m = build(seed)
    x, step = within(m, points[:400]), 1e-6
    offsets = step * torch.eye(3, dtype=torch.float64)
    columns = [(m(x + d) - m(x - d)) / (2.0 * step) for d in offsets]
    difference = torch.stack(columns, -1) - m.jacobian(x)
    # Exact for affine pieces, up to rounding of values near 10 over the step; creases within the
    # step of a point are rare.
    scale = 1.0 + m.jacobian(x).abs().amax((-1, -2))
    wrong = difference.abs().amax((-1, -2)) > 1e-7 * scale
    assert wrong.float().mean() <= 0.01, f"{int(wrong.sum())} of {len(x)} points"


@MAPS
def test_jacobian_equals_autograd(build, points, seed):
    m = build(seed)
    x = within(m, points[:50]).clone().requires_grad_()
    with back_end("torch"):
        y, jacobian = m.call_and_jacobian(x)
        rows = [torch.autograd.grad(y[:, i].sum(), x, retain_graph=True)[0] for i in range(3)]
    torch.testing.assert_close(torch.stack(rows, 1), jacobian, rtol=1e-10, atol=1e-10)


@torch.no_grad()
def test_composition_applies_the_right_one_first(points, seed):
    a, b, c = random_net(seed), random_affine(seed), random_net(seed + 1)
    expected = a(b(c(points)))
    assert torch.equal((a @ b @ c)(points), expected)
    assert torch.equal((a @ (b @ c))(points), expected)
    assert torch.equal((a @ b @ c).inv(expected), c.inv(b.inv(a.inv(expected))))


@MAPS
@torch.no_grad()
def test_leading_shapes_are_kept_and_numpy_stays_numpy(build, seed):
    m = build(seed)
    x = torch.rand(2, 3, 4, 3, dtype=torch.float64)
    y, jacobian = m.call_and_jacobian(x)
    assert y.shape == (2, 3, 4, 3)
    assert jacobian.shape == (2, 3, 4, 3, 3)
    assert m(x[0, 0, 0]).shape == (3,)
    assert m(x[:0]).shape == (0, 3, 4, 3)
    as_array = m(x.numpy())
    assert isinstance(as_array, np.ndarray)
    np.testing.assert_array_equal(as_array, y.numpy())
    torch.testing.assert_close(m(x.transpose(0, 2)), y.transpose(0, 2), rtol=0, atol=1e-13)


@MAPS
@DTYPE
@torch.no_grad()
def test_dtype_is_kept(build, dtype, seed):
    y, jacobian = build(seed).call_and_jacobian(torch.rand(5, 3, dtype=dtype))
    assert y.dtype == jacobian.dtype == dtype


@pytest.mark.parametrize(
    ("points", "words"),
    [
        (torch.zeros(4, 2), ["points = (4, 2)", "length 3"]),
        (torch.full((4, 3), torch.nan), ["4 of 4 rows", "row 0", "division by zero"]),
        (np.array([[0, 0, 0], [0, np.inf, 0.0]]), ["1 of 2 rows", "row 1"]),
        ("abc", ["not an array of numbers"]),
        (torch.zeros(4, 3, dtype=torch.bool), ["not real numbers"]),
    ],
)
def test_bad_points_are_named(points, words, seed):
    with pytest.raises(InputError) as caught:
        random_net(seed)(points)
    for word in words:
        assert word in str(caught.value)


@MAPS
@torch.no_grad()
def test_numpy_arrays_of_any_layout(build, seed):
    m = build(seed)
    x = np.random.default_rng(seed).normal(size=(6, 3))
    expected = m(x)
    np.testing.assert_array_equal(m(x[::-1]), expected[::-1])
    np.testing.assert_array_equal(m(x.astype(">f8")), expected)
    np.testing.assert_array_equal(m(np.asfortranarray(x)), expected)


@MAPS
@torch.no_grad()
def test_jacobians_of_points_are_independent(build, seed):
    jacobian = build(seed).jacobian(torch.zeros(3, 3, dtype=torch.float64))
    before = jacobian[1].clone()
    jacobian[0] = 7.0
    assert torch.equal(jacobian[1], before)


@MAPS
@torch.no_grad()
def test_lipschitz_constants_hold(build, seed):
    m = build(seed)
    x = torch.randn(300, 3, dtype=torch.float64)
    stretch = torch.linalg.matrix_norm(m.jacobian(within(m, x)), 2).max()
    shrink = torch.linalg.matrix_norm(m.inv.jacobian(within(m.inv, x)), 2).max()
    for value, bound in zip((stretch, shrink), m.lipschitz, strict=True):
        assert bound is None or value <= bound * (1.0 + 1e-12)
    assert m.inv.lipschitz == m.lipschitz[::-1]


@BACK_END
@torch.no_grad()
def test_overflow_gives_no_crash(name, seed):
    """Coordinates near the largest number become infinite on their way, and then NaN."""
    warp = random_net(seed).freeze()
    huge = torch.full((700, 3), 1.7e308, dtype=torch.float64)
    with back_end(name):
        for m in (warp, warp.inv):
            assert m(huge).shape == (700, 3)
            assert m(huge.float().nan_to_num()).shape == (700, 3)


@BACK_END
def test_a_net_that_diverged_says_so(name, seed):
    net = random_net(seed)
    net.theta_weights.data.fill_(torch.nan)
    with back_end(name), pytest.raises(InputError, match="diverged"):
        net(torch.zeros(4, 3))


def test_inference_mode_leaves_nothing_behind(seed):
    net = random_net(seed, resolution=6)
    x = torch.rand(4, 3, dtype=torch.float64)
    for name in ("torch", "numba"):
        with back_end(name):
            with torch.inference_mode():
                net(x)
                net.inv(x)
            net(x).sum().backward()
            net.inv(x).sum().backward()


def test_a_forced_back_end_stays_in_its_thread():
    import threading

    from implicit_warp.evaluate import forced_back_end

    seen = []
    with back_end("torch"):
        thread = threading.Thread(target=lambda: seen.append(forced_back_end()))
        thread.start()
        thread.join()
    assert seen == ["auto"]


def test_unknown_back_end_is_refused():
    with pytest.raises(InputError, match=r"cuda9.*auto, torch, numba"), back_end("cuda9"):
        pass


@pytest.mark.parametrize(("maps", "words"), [([], "there are none"), ([1, 2], "not a map")])
def test_a_composition_of_nothing_or_of_other_things_is_refused(maps, words):
    with pytest.raises(InputError, match=words):
        Composition(maps)


@pytest.mark.parametrize("size", [1e-310, 1e-200, 1.0, 1e200, 1.7e308])
def test_an_axis_of_any_length_is_a_direction(size):
    expected = np.array([1.0, 1.0, 0.0]) / np.sqrt(2.0)
    np.testing.assert_allclose(axis_vector([size, size, 0.0]), expected, rtol=1e-13)

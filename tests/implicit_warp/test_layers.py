"""Prismatic layers: location, continuity across creases, accuracy, gradients, proof of areas."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import torch

from implicit_warp import numba_backend, numba_location, torch_backend
from implicit_warp.embedding import embed
from implicit_warp.energy import elastic_energy, layer_energy
from implicit_warp.errors import InputError, NotInjective
from implicit_warp.evaluate import back_end
from implicit_warp.frames import make_frames
from implicit_warp.layers import LayerStack, determinant_3x3, inverse_3x3
from implicit_warp.square_mesh import rest_forms, square_mesh
from implicit_warp.tuttenet import TutteNet
from implicit_warp.warp import Warp
from tests.implicit_warp.registered_maps import random_net, random_warp

BACK_END = pytest.mark.parametrize("name", ["torch", "numba"])


def coordinates_at_rest(mesh, xy: np.ndarray) -> np.ndarray:
    """(n, C, 3) coordinates of points in every rest cell, in the plainest way."""
    homogeneous = np.concatenate([xy, np.ones((len(xy), 1))], 1)
    return np.einsum("cka,na->nck", rest_forms(mesh), homogeneous)


def special_points(mesh) -> np.ndarray:
    """Rest positions where something meets: vertices, edges, diagonals, rays, far, corners."""
    v = mesh.vertices
    middles = 0.5 * (v[mesh.edges[:, 0]] + v[mesh.edges[:, 1]])
    outline = v[mesh.boundary]
    half = 0.5 * (outline + np.roll(outline, -1, 0))
    far = [s * outline for s in (1.0 + 1e-15, 1.5, 1e6)] + [s * half for s in (1.0, 2.0, 1e6)]
    axes = np.array([[0.0, 5.0], [5.0, 0.0], [0.0, -5.0], [-5.0, 0.0], [3.0, 3.0], [-1e6, 1e6]])
    return np.concatenate([v, middles, half, *far, axes])


@pytest.mark.parametrize("resolution", [2, 3, 5, 11, 64])
def test_location_at_rest_is_a_cell_that_holds_the_point(resolution, rng):
    mesh = square_mesh(resolution)
    xy = np.concatenate([special_points(mesh)[:3000], rng.uniform(-2, 2, (500, 2))])
    cell = torch_backend.locate_at_rest(torch.tensor(xy), mesh).numpy()
    coordinates = coordinates_at_rest(mesh, xy)[np.arange(len(xy)), cell]
    # Coordinates scale with the point's size over the cell's.
    size = (1.0 + np.abs(xy).max(1)) * resolution
    assert (coordinates.min(1) >= -1e-14 * size).all()


@BACK_END
@torch.no_grad()
def test_maps_are_continuous_across_every_crease(name, seed):
    """One layer, points on all creases against neighbours 1e-9 away in twelve directions."""
    net = random_net(seed, layers=1, resolution=7, frames="triplane")
    on = torch.tensor(special_points(net.mesh))
    on = torch.cat([on, torch.full((len(on), 1), 0.3, dtype=torch.float64)], 1)
    step = 1e-9
    angles = np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)
    with back_end(name):
        for m in (net, net.inv):
            # The creases of the inverse are the images of the map's.
            base = on if m is net else net(on)
            image = m(base)
            stretch = _largest_stretch(net, inverse=m is not net)
            for angle in angles:
                size = base.norm(dim=1, keepdim=True).clamp(min=1.0)
                offset = step * size * torch.tensor([np.cos(angle), np.sin(angle), 0.0])
                moved = (m(base + offset) - image).norm(dim=1)
                bound = stretch * offset.norm(dim=1) * 1.01 + 1e-14 * size[:, 0] * stretch
                assert (moved <= bound).all(), f"jump of {float((moved / bound).max()):.3g} bounds"


def _largest_stretch(net, inverse: bool) -> float:
    stack = net.stack()
    tables = stack.inverse_tables if inverse else stack.tables
    linear = tables[..., :4].unflatten(-1, (2, 2))
    return max(1.0, float(torch.linalg.matrix_norm(linear, 2).max()))


@pytest.mark.parametrize("resolution", [2, 3, 5, 11, 64])
@pytest.mark.parametrize("spread", [0.3, 3.0])
@torch.no_grad()
def test_location_in_the_image_equals_exhaustive_search(resolution, spread, seed):
    net = random_net(seed, layers=2, resolution=resolution, spread=spread, frames="triplane")
    stack = net.stack()
    rest = torch.tensor(special_points(net.mesh))[::3][:600]
    rest = torch.cat([rest, torch.zeros(len(rest), 1, dtype=torch.float64)], 1)
    generator = torch.Generator().manual_seed(seed)
    inside = 3.0 * torch.rand(500, 3, generator=generator, dtype=torch.float64) - 1.5
    # Exactly on image vertices and edges, one unit in the last place beside them, and anywhere.
    y = net(torch.cat([rest, inside]))
    y = torch.cat([y, torch.nextafter(y, y + 1.0), torch.nextafter(y, y - 1.0)])
    fast, _ = numba_backend.traverse_inverse(stack, y, False)
    slow, _ = torch_backend.inverse(stack, y, jacobian=False)
    size = 1.0 + y.norm(dim=1)
    tolerance = 1e-14 * size * _largest_stretch(net, inverse=True) ** 2
    assert ((fast - slow).norm(dim=1) <= tolerance).all()


@pytest.mark.parametrize("outline", [None, 0.6, 1.0, 1.7])
@torch.no_grad()
def test_a_sure_look_up_is_the_cell_that_holds_the_point(outline, seed):
    """In every sample of every grid, and outside; also for boundaries on circles of any radius."""
    net = random_net(seed, layers=3, resolution=5, spread=3.0)
    stack = net.stack()
    if outline is not None:
        border = stack.embeddings[:, net.mesh.boundary.tolist()]
        circle = outline * border / border.norm(dim=-1, keepdim=True)
        weights = net.theta_weights.detach().sigmoid() + 0.1
        layers = embed(weights, circle, net.mesh)
        stack = LayerStack(net.mesh, layers, stack.transitions)
    location = numba_backend.compiled_location(stack, torch.float64)
    tables = stack.inverse_tables.flip(0)
    forms = torch.tensor(rest_forms(net.mesh))
    sure = 0
    for k in range(stack.n_layers):
        xy = location_grid(location.extent, seed)
        at, which = np.empty(len(xy), np.int32), np.empty(len(xy), np.int32)
        unsure = numba_location.look_up(
            location.guesses[k], location.lines[k], location.sides, location.extent,
            *np.ascontiguousarray(xy.T), at, which, len(xy),
        )  # fmt: skip
        certain = np.setdiff1d(np.arange(len(xy)), which[:unsure])
        table = tables[k, at[certain]]
        linear, points = table[:, :4].unflatten(-1, (2, 2)), torch.tensor(xy[certain])
        rest = (linear @ points[..., None])[..., 0] + table[:, 4:]
        homogeneous = torch.cat([rest, torch.ones(len(rest), 1, dtype=torch.float64)], 1)
        coordinates = torch.einsum("nka,na->nk", forms[at[certain]], homogeneous)
        size = 1.0 + homogeneous.norm(dim=1) * forms.norm(dim=(1, 2)).max()
        stretch = torch.linalg.matrix_norm(linear, 2).max()
        assert (coordinates.amin(1) >= -1e-14 * size * stretch).all()
        sure += len(certain)
    assert sure > 0.5 * 3 * len(xy)


def location_grid(extent: float, seed: int) -> np.ndarray:
    """(n, 2) points: two in every sample of a layer's grid, its corners, and some outside."""
    rng = np.random.default_rng(seed)
    side = numba_location.GUESS_GRID
    corner = np.stack(np.meshgrid(*[np.arange(side)] * 2, indexing="ij"), -1).reshape(-1, 2)
    inside = [corner + rng.uniform(0.0, 1.0, corner.shape) for _ in range(2)]
    on_square = np.concatenate([*inside, corner]) * (2.0 * extent / side) - extent
    return np.concatenate([on_square, rng.uniform(-3.0, 3.0, (2000, 2))])


@torch.no_grad()
def test_walk_ends_in_the_right_cell_from_any_start(seed):
    net = random_net(seed, layers=1, resolution=6, spread=10.0, frames="triplane")
    mesh, stack = net.mesh, net.stack()
    table = stack.inverse_tables[0]
    xy = torch.tensor(special_points(mesh))[:200]
    image = net(torch.cat([xy, torch.zeros(len(xy), 1, dtype=torch.float64)], 1))[:, :2]
    forms = rest_forms(mesh)
    flat, neighbours = table.flatten().numpy(), mesh.neighbours.astype(np.int32)
    for (x, y), start in itertools.product(image.numpy()[::7], range(0, mesh.n_cells, 11)):
        cell = numba_location.walk(flat, forms.reshape(-1, 9), neighbours, x, y, start)
        linear, offset = table[cell, :4].numpy().reshape(2, 2), table[cell, 4:].numpy()
        at_rest = linear @ (x, y) + offset
        smallest = (forms[cell] @ (*at_rest, 1.0)).min()
        assert smallest > -1e-10 * (1.0 + abs(x) + abs(y))


@pytest.mark.parametrize(
    ("spread", "dtype", "bound"),
    [(1.0, torch.float64, 1e-11), (3.0, torch.float64, 1e-8), (0.3, torch.float32, 5e-5)],
)
@torch.no_grad()
def test_accuracy_of_24_random_layers_on_a_large_cube(spread, dtype, bound):
    """The stated accuracy on 10^5 points of [-3, 3]^3, both ways round.

    The seed is fixed: at spread 3 the inverse of one map in eight stretches by more than 10^7, and
    then rounding the image alone costs more than the bound.
    """
    net = random_net(1, layers=24, resolution=11, spread=spread)
    warp = net.freeze()
    generator = torch.Generator().manual_seed(1)
    x = (6.0 * torch.rand(100_000, 3, generator=generator, dtype=torch.float64) - 3.0).to(dtype)
    assert (warp.inv(warp(x)) - x).abs().max() < bound
    assert (warp(warp.inv(x)) - x).abs().max() < bound


@pytest.mark.parametrize("frames", ["triplane", "cubic", "free"])
@torch.no_grad()
def test_zero_parameters_are_the_identity(frames):
    net = TutteNet(24, 11, frames)
    x = torch.linspace(-3.0, 3.0, 3000, dtype=torch.float64).reshape(-1, 3)
    assert (net(x) - x).abs().max() < 1e-14 * 4.0
    assert (net.jacobian(x) - torch.eye(3, dtype=torch.float64)).abs().max() < 1e-13


def test_gradients_of_everything_through_value_and_jacobian(seed):
    net = random_net(seed, layers=3, resolution=3, frames="free")
    x = torch.rand(4, 3, dtype=torch.float64) * 2.0 - 1.0
    names, parameters = zip(*net.named_parameters(), strict=True)
    parameters = [p.detach().clone().requires_grad_() for p in parameters]

    def run(x, *values):
        for name, value in zip(names, values, strict=True):
            delattr(net, name)
            setattr(net, name, value)
        return net.call_and_jacobian(x)

    assert {*names} == {"theta_weights", "theta_boundary", "theta_frames"}
    assert torch.autograd.gradcheck(run, (x.requires_grad_(), *parameters))


@torch.no_grad()
def test_layer_energy_is_the_integral(seed):
    net = random_net(seed, layers=1, resolution=5, frames="triplane")
    x = 2.0 * torch.rand(200_000, 3, dtype=torch.float64) - 1.0
    energy = elastic_energy(net.jacobian(x))
    error = float(energy.std()) / len(x) ** 0.5
    assert abs(float(energy.mean()) - float(layer_energy(net.stack()))) < 5.0 * error


def test_elastic_energy_vanishes_exactly_for_rotations():
    turned = make_frames("cubic", 8)
    assert elastic_energy(turned).max() < 1e-28
    stretched = torch.diag(torch.tensor([2.0, 1.0, 1.0]))
    assert float(elastic_energy(stretched)) == 9.0


def test_a_folded_layer_is_refused_by_name(seed):
    warp = random_warp(seed, layers=3, resolution=5)
    u = warp.embeddings.clone()
    centre = warp.mesh.triangles[12, 0]
    u[1, centre] += 1.0
    with pytest.raises(NotInjective, match="layer 1, triangle") as caught:
        Warp(u, warp.frames)
    assert caught.value.layer == 1
    folded = int(torch.tensor(caught.value.cell))
    assert centre in warp.mesh.triangles[folded]


def test_lipschitz_bounds_hold(seed):
    warp = random_warp(seed)
    forward, backward = warp.lipschitz
    x = 4.0 * torch.rand(2000, 3, dtype=torch.float64) - 2.0
    y = warp(x)
    rest, image = (p[1:] - p[:-1] for p in (x, y))
    ratio = image.norm(dim=1) / rest.norm(dim=1)
    assert ratio.max() <= forward
    assert 1.0 / ratio.min() <= backward
    assert torch.linalg.matrix_norm(warp.jacobian(x), 2).max() <= forward


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"layers": 0}, "layers = 0"),
        ({"resolution": 1}, "resolution = 1"),
        ({"frames": "diagonal"}, "triplane, cubic, free"),
        ({"frames": np.ones((2, 3, 3))}, "not all of the matrices are rotations"),
        ({"frames": -np.eye(3)[None]}, "orientation"),
        ({"boundary": "loose"}, "free, fixed"),
        ({"init": "random"}, "identity, paper"),
    ],
)
def test_bad_arguments_of_the_net_are_named(arguments, words):
    with pytest.raises(InputError) as caught:
        TutteNet(**arguments)
    assert words in str(caught.value)


@torch.no_grad()
def test_fixed_boundary_keeps_the_outline_and_seeds_repeat():
    net = TutteNet(2, 5, boundary="fixed", init="paper", seed=3)
    outline = net.embeddings()[:, net.mesh.boundary.copy()]
    assert (outline - torch.tensor(net.mesh.vertices)[net.mesh.boundary.copy()]).abs().max() < 1e-15
    again, other = (TutteNet(2, 5, boundary="fixed", init="paper", seed=s) for s in (3, 4))
    assert torch.equal(net.theta_weights, again.theta_weights)
    assert not torch.equal(net.theta_weights, other.theta_weights)


def test_small_matrices_are_inverted_exactly_enough(seed):
    matrices = torch.randn(200, 3, 3, dtype=torch.float64)
    product = inverse_3x3(matrices) @ matrices
    condition = torch.linalg.cond(matrices)
    error = (product - torch.eye(3, dtype=torch.float64)).abs().amax((-1, -2))
    # Cofactors lose at most the square of the condition number.
    assert (error < 1e-15 * condition**2).all()
    torch.testing.assert_close(determinant_3x3(matrices), torch.linalg.det(matrices))


def test_tables_made_without_gradients_still_carry_them(seed):
    net = random_net(seed, layers=2, resolution=3)
    stack = net.stack()
    x = torch.rand(5, 3, dtype=torch.float64)
    with torch.no_grad():
        torch_backend.forward(stack, x, False)
    image, _ = torch_backend.forward(stack, x, False)
    assert torch.autograd.grad(image.sum(), net.theta_weights)[0].abs().max() > 0


@torch.no_grad()
@pytest.mark.parametrize("layers", [1, 64])
@pytest.mark.parametrize("resolution", [2, 3, 5, 64])
def test_thin_cases_agree_between_back_ends(layers, resolution, seed):
    warp = random_net(seed, layers=layers, resolution=resolution, spread=0.5).freeze()
    generator = torch.Generator().manual_seed(seed)
    x = (3.0 * torch.rand(60, 6, generator=generator, dtype=torch.float64) - 1.5)[:, ::2]
    assert not x.is_contiguous()
    for n in (0, 1, 7, 60):
        results = []
        for name in ("torch", "numba"):
            with back_end(name):
                results.append([*warp.call_and_jacobian(x[:n]), *warp.inv.call_and_jacobian(x[:n])])
        for slow, fast in zip(*results, strict=True):
            # Sixty-four random layers stretch by at most some thousands.
            torch.testing.assert_close(fast, slow, rtol=1e-9, atol=1e-9)


@torch.no_grad()
def test_a_triangle_of_area_1e_10_is_no_trouble(seed):
    net = random_net(seed, layers=1, resolution=5, spread=0.0, frames="triplane")
    u = net.embeddings()
    corner, side = net.mesh.triangles[20, 0], net.mesh.triangles[20, 1:].copy()
    middle = u[0, side].mean(0)
    u[0, corner] = middle + 1e-9 * (u[0, corner] - middle)
    warp = Warp(u, net.frames())
    assert 0 < warp.smallest_area < 2e-10
    generator = torch.Generator().manual_seed(seed)
    x = 2.0 * torch.rand(5000, 3, generator=generator, dtype=torch.float64) - 1.0
    y = warp(x)
    for name in ("torch", "numba"):
        with back_end(name):
            # The inverse stretches by 1e9 there, and rounding with it.
            assert (warp.inv(y) - x).abs().max() < 1e9 * 1e-15
            assert (warp(warp.inv(x)) - x).abs().max() < 1e-13


@torch.no_grad()
def test_results_are_identical_from_run_to_run_and_in_blocks(seed):
    warp = random_warp(seed)
    x = torch.rand(100_003, 3, dtype=torch.float32)
    first = warp.inv.call_and_jacobian(x)
    again = warp.inv.call_and_jacobian(x)
    in_blocks = [warp.inv.call_and_jacobian(part) for part in x.split(1000)]
    for i in range(2):
        assert torch.equal(first[i], again[i])
        assert torch.equal(first[i], torch.cat([part[i] for part in in_blocks]))


@torch.no_grad()
@pytest.mark.slow
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_back_ends_agree_to_rounding_on_a_million_points(dtype, seed):
    warp = random_net(seed, layers=24, spread=1.0).freeze()
    generator = torch.Generator().manual_seed(seed)
    x = (4.0 * torch.rand(1_000_000, 3, generator=generator, dtype=torch.float64) - 2.0).to(dtype)
    results = {}
    for name in ("torch", "numba"):
        with back_end(name):
            results[name] = [*warp.call_and_jacobian(x), *warp.inv.call_and_jacobian(x)]
    # One rounding of size eps |x| in each of 24 layers, magnified by at most the stretch of the
    # layers that follow; its largest value over the samples is taken as what a point may see.
    stretch = max(float(results["torch"][i].double().flatten(1).norm(dim=1).max()) for i in (1, 3))
    tolerance = 24 * 4 * torch.finfo(dtype).eps * stretch
    for which, (slow, fast) in enumerate(zip(results["torch"], results["numba"], strict=True)):
        error = (slow - fast).double().abs().flatten(1).amax(1)
        if which % 2 == 0:
            assert error.max() < tolerance, f"result {which}, seed {seed}"
        else:
            # Within rounding of a crease the two may stand on different sides of it, and the
            # share of space that close to one is 24 layers x 40 lines x the tolerance.
            wrong = (error > stretch * tolerance).double().mean()
            assert wrong < 24 * 40 * tolerance + 1e-6, f"result {which}, seed {seed}"


@torch.no_grad()
@pytest.mark.slow
def test_ten_million_points_are_mapped_like_a_few(seed):
    warp = random_net(seed, layers=2, resolution=5).freeze()
    generator = torch.Generator().manual_seed(seed)
    x = 2.0 * torch.rand(10_000_000, 3, generator=generator) - 1.0
    y = warp(x)
    back = warp.inv(y)
    some = torch.randint(len(x), (1000,), generator=generator)
    assert torch.equal(y[some], warp(x[some]))
    assert torch.equal(back[some], warp.inv(y[some]))

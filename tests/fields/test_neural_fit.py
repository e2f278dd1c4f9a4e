"""Fits of networks to shapes: how good, repeatable, resumable, and what is refused."""

from __future__ import annotations

import json

import numpy as np
import pytest
import torch

import fields as sdf
from fields import FileFormatError, HashGrid, InputError, NeuralOptions, Siren
from fields.neural import training
from fields.neural.losses import distance_loss, eikonal_loss, loss_terms
from fields.neural.samples import Cube, draw, surface_points
from tests.fields.catalogue.neural import tiny_network

TORUS = sdf.torus(1.0, 0.4)
SMALL_GRID = HashGrid(levels=4, coarsest=4, finest=24, log2_table=12, width=32, layers=1)
FAST = {"batch": 1024, "gradient_batch": 128, "near_samples": 10_000, "box_samples": 5_000}


@pytest.fixture(scope="module")
def fitted():
    return sdf.fit_neural(TORUS, SMALL_GRID, steps=250, **FAST)


def test_a_torus_is_learned_by_a_hash_grid(fitted):
    learned, report = fitted
    assert report.status == "finished"
    assert report.steps == 250
    # Measured: 0.07 %, 0.24 %, 6.4 degrees and 0.06 %.
    assert report.accuracy.near_error < 0.0015
    assert report.accuracy.box_error < 0.004
    assert report.accuracy.normal_error < 10
    assert report.accuracy.chamfer < 0.001
    assert not learned.exact
    assert learned.lipschitz is None
    assert "neural hash grid" in repr(learned)


def test_the_report_agrees_with_an_independent_measurement(fitted, rng):
    learned, report = fitted
    points = rng.uniform(*TORUS.bounds, (20_000, 3))
    diagonal = np.linalg.norm(np.ptp(TORUS.bounds, axis=0))
    error = np.abs(learned(points) - TORUS(points)).mean() / diagonal
    assert report.accuracy.box_error == pytest.approx(error, rel=0.1)
    assert report.history[-1][0] == 250
    assert json.loads(json.dumps(report.to_dict()))["accuracy"]["points"] == 10_000
    assert "250 steps" in str(report)


def test_a_sphere_is_learned_by_a_siren():
    learned, report = sdf.fit_neural(sdf.sphere(1), Siren(32, 2, 10.0), steps=200, **FAST)
    assert report.accuracy.near_error < 0.003
    assert report.accuracy.normal_error < 6
    assert learned([0, 0, 0]) < -0.5 < 0.5 < learned([0, 0, 2])


def test_nothing_is_claimed_outside_the_box(fitted, rng):
    learned, _ = fitted
    low, high = learned.bounds
    points = rng.uniform(-6, 6, (20_000, 3))
    outside = ((points < low) | (points > high)).any(axis=1)
    beyond = np.linalg.norm(points - np.clip(points, low, high), axis=1)
    assert (learned(points)[outside] >= beyond[outside] - 1e-12).all()
    assert (beyond[outside] > 0).all()
    padding = NeuralOptions().padding * np.linalg.norm(np.ptp(TORUS.bounds, axis=0))
    np.testing.assert_allclose(learned.bounds[0], TORUS.bounds[0] - padding)


def test_a_mesh_is_learned_and_takes_part_in_expressions():
    trimesh = pytest.importorskip("trimesh")
    pytest.importorskip("open3d")
    ball = trimesh.creation.icosphere(3)
    learned, report = sdf.fit_neural(ball, SMALL_GRID, steps=120, **FAST)
    assert report.accuracy.near_error < 0.005
    part = learned.translate((5, 0, 0)) - sdf.box(1, (5, 0, 0))
    assert part([5, 0, 0.75]) == pytest.approx(-0.25, abs=0.1)
    points = torch.tensor([[5.0, 0.2, 0.9]], requires_grad=True)
    part(points).sum().backward()
    assert points.grad.norm() == pytest.approx(1, abs=0.3)


def test_a_field_that_is_no_distance_is_learned_as_it_is():
    steep = sdf.from_function(
        lambda p: 3 * (p.norm(dim=-1) - 1), bounds=((-1, -1, -1), (1, 1, 1)), name="steep"
    )
    learned, report = sdf.fit_neural(
        steep, Siren(32, 2, 10.0), steps=200, learning_rate=0.03, **FAST
    )
    assert report.options["eikonal_weight"] == 0
    assert learned([0.5, 0, 0]) == pytest.approx(-1.5, abs=0.2)
    assert np.linalg.norm(learned.gradient([0.9, 0.2, 0])) == pytest.approx(3, abs=0.3)


def test_the_same_seed_gives_the_same_numbers_and_another_does_not():
    values = []
    for seed in (1, 1, 2):
        learned, _ = sdf.fit_neural(TORUS, SMALL_GRID, steps=20, seed=seed, **FAST)
        values.append(learned([0.3, 0.9, 0.1]))
    assert values[0] == values[1]
    assert values[0] != values[2]


# --- checkpoints ----------------------------------------------------------------------


@pytest.mark.parametrize("architecture", [SMALL_GRID, Siren(16, 2)], ids=["hash", "siren"])
def test_a_resumed_run_is_the_uninterrupted_one_bit_for_bit(architecture, tmp_path, monkeypatch):
    path = tmp_path / "state.safetensors"
    whole, expected = sdf.fit_neural(TORUS, architecture, steps=160, **FAST)
    monkeypatch.setattr(training, "CHECKPOINT_SECONDS", 0.0)

    def stop(done, total, text):
        if done == 100:
            raise KeyboardInterrupt

    _, cut = sdf.fit_neural(TORUS, architecture, steps=160, checkpoint=path, progress=stop, **FAST)
    assert cut.status == "interrupted"
    resumed, report = sdf.fit_neural(
        TORUS, architecture, steps=160, checkpoint=path, resume=True, **FAST
    )
    points = np.random.default_rng(0).uniform(-1.5, 1.5, (1000, 3))
    np.testing.assert_array_equal(resumed(points), whole(points))
    assert report.accuracy == expected.accuracy
    assert [row[::2] for row in report.history] == [row[::2] for row in expected.history]


def test_ctrl_c_returns_the_best_so_far(monkeypatch):
    def stop(done, total, text):
        if done == 100:
            raise KeyboardInterrupt

    learned, report = sdf.fit_neural(TORUS, SMALL_GRID, steps=4000, progress=stop, **FAST)
    assert report.status == "interrupted"
    assert report.steps == 100
    assert report.accuracy.box_error < 0.03
    assert learned([1, 0, 0]) < 0


def test_a_time_limit_ends_a_fit():
    _, report = sdf.fit_neural(TORUS, SMALL_GRID, steps=10**6, seconds=0.5, **FAST)
    assert report.status == "out of time"
    assert 0.5 <= report.seconds < 5


def test_a_checkpoint_of_another_fit_is_refused(tmp_path):
    path = tmp_path / "state.safetensors"
    sdf.fit_neural(TORUS, SMALL_GRID, steps=3, checkpoint=path, **FAST)
    with pytest.raises(InputError, match="of a fit of another shape"):
        sdf.fit_neural(sdf.sphere(1), SMALL_GRID, checkpoint=path, resume=True, steps=3, **FAST)
    with pytest.raises(InputError, match="coarsest = 4"):
        sdf.fit_neural(TORUS, HashGrid(levels=3), checkpoint=path, resume=True, steps=3, **FAST)
    with pytest.raises(InputError, match=r"learning_rate = 0\.01"):
        sdf.fit_neural(
            TORUS, SMALL_GRID, checkpoint=path, resume=True, steps=3, learning_rate=0.02, **FAST
        )
    with pytest.raises(InputError, match="no such file"):
        sdf.fit_neural(TORUS, checkpoint=tmp_path / "none.safetensors", resume=True, **FAST)
    with pytest.raises(InputError, match="there is no checkpoint"):
        sdf.fit_neural(TORUS, resume=True, **FAST)
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(FileFormatError, match="truncated"):
        sdf.fit_neural(TORUS, SMALL_GRID, checkpoint=path, resume=True, steps=3, **FAST)


# --- losses and samples ---------------------------------------------------------------


def test_terms_are_the_formulas(rng):
    """On batches as large as can be recomputed from the definitions, with the same draws."""
    network = tiny_network(Siren(8, 1, 3.0))
    options = NeuralOptions(
        batch=64, gradient_batch=16, near_samples=200, box_samples=200,
        off_surface_weight=1.0, sharpness=7.0,
    )  # fmt: skip
    cube = Cube.around(TORUS.bounds, 0.05)
    samples = draw(TORUS, cube, options)
    generator = torch.Generator().manual_seed(9)
    terms = loss_terms(network, samples, options, generator, clamp=0.1)

    generator.manual_seed(9)
    i, j, k, m = (torch.randint(200, (n,), generator=generator) for n in (48, 16, 16, 16))
    points = torch.cat([samples.near[i], samples.box[j]])
    d = torch.cat([samples.near_distances[i], samples.box_distances[j]])
    expected = (network(points).clamp(-0.1, 0.1) - d.clamp(-0.1, 0.1)).abs().mean()
    terms = {name: float(term.detach()) for name, term in terms.items()}
    assert terms["distance"] == pytest.approx(float(expected.detach()), rel=1e-6)
    at = samples.surface[k].clone().requires_grad_()
    value = network(at)
    (slope,) = torch.autograd.grad(value.sum(), at)
    assert terms["surface"] == pytest.approx(float(value.detach().abs().mean()), rel=1e-5)
    normal = ((slope - samples.gradients[k]) ** 2).sum(-1).mean()
    assert terms["normal"] == pytest.approx(float(normal), rel=1e-5)
    at = samples.box[m].clone().requires_grad_()
    value = network(at)
    (slope,) = torch.autograd.grad(value.sum(), at)
    eikonal = ((slope.norm(dim=-1) - 1) ** 2).mean()
    assert terms["eikonal"] == pytest.approx(float(eikonal), rel=1e-4)
    off = torch.exp(-7 * value.abs()).mean()
    assert terms["off_surface"] == pytest.approx(float(off.detach()), rel=1e-5)


def test_weights_of_zero_cost_nothing():
    options = NeuralOptions(normal_weight=0.0, surface_weight=0.0, eikonal_weight=0.0)
    samples = draw(TORUS, Cube.around(TORUS.bounds, 0.05), options.with_changes(FAST))
    network = tiny_network(Siren(8, 1, 3.0))
    assert set(loss_terms(network, samples, options, torch.Generator())) == {"distance"}


def test_losses_of_simple_numbers():
    values, distances = torch.tensor([0.5, -0.3]), torch.tensor([0.2, -0.1])
    assert float(distance_loss(values, distances, None)) == pytest.approx(0.25)
    assert float(distance_loss(values, distances, 0.2)) == pytest.approx(0.05)
    gradient = torch.tensor([[3.0, 4.0, 0.0], [0.0, 0.0, 0.0]], requires_grad=True)
    loss = eikonal_loss(gradient)
    loss.backward()
    assert float(loss.detach()) == pytest.approx((16 + 1) / 2, abs=1e-4)
    assert gradient.grad.isfinite().all()


@pytest.mark.parametrize("kind", ["field", "mesh"])
def test_surface_points_are_on_the_surface_and_all_over_it(kind, rng):
    """Uniform by area: on a box of 1 x 2 x 3, as many on each side as its area says."""
    source = sdf.box((1, 2, 3))
    if kind == "mesh":
        pytest.importorskip("open3d")
        source = sdf.mesh(pytest.importorskip("trimesh").creation.box((1, 2, 3)))
    points, gradients = surface_points(source, Cube.around(source.bounds, 0.05), 6000, rng)
    np.testing.assert_allclose(sdf.box((1, 2, 3))(points), 0, atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(gradients, axis=1), 1, atol=1e-9)
    for axis, area in enumerate((6, 3, 2)):
        share = (np.abs(gradients[:, axis]) > 0.99).mean()
        # Binomial scatter is below 0.007; the band's edges and corners add up to 3 %.
        assert share == pytest.approx(area / 11, abs=0.05)


def test_samples_hold_the_source_s_own_distances():
    options = NeuralOptions(**FAST)
    cube = Cube.around(TORUS.bounds, 0.05)
    samples = draw(TORUS, cube, options)
    for points, distances in (
        (samples.near, samples.near_distances),
        (samples.box, samples.box_distances),
        (samples.surface, torch.zeros(len(samples.surface))),
    ):
        assert points.abs().max() <= 1 + 1e-6
        where = points.double().numpy() * cube.unit + cube.box.mean(axis=0)
        np.testing.assert_allclose(distances * cube.unit, TORUS(where), atol=2e-4)


# --- what is refused ------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "argument", "cause"),
    [
        ({"steps": 0}, "steps", "whole number from"),
        ({"seconds": -1.0}, "seconds", "greater than zero"),
        ({"near_samples": 10}, "near_samples", "too few"),
        ({"box_samples": 10}, "box_samples", "too few"),
        ({"near_fraction": 1.5}, "near_fraction", "no fraction"),
        ({"near_scales": ()}, "near_scales", "no scale"),
        ({"near_scales": (0.1, -0.1)}, "near_scales", "negative"),
        ({"normal_weight": -1.0}, "normal_weight", "negative"),
        ({"clamp": 0.0}, "clamp", "greater than zero"),
        ({"seed": -1}, "seed", "whole number from"),
        ({"device": "abacus"}, "device", "torch cannot use it"),
        ({"stepz": 3}, "stepz", "no such option"),
        (
            dict.fromkeys(
                ("distance_weight", "surface_weight", "normal_weight", "eikonal_weight"), 0.0
            ),
            "distance_weight",
            "all weights are zero",
        ),
    ],
)
def test_options_out_of_range_are_refused(changes, argument, cause):
    with pytest.raises(InputError, match=cause) as caught:
        NeuralOptions().with_changes(changes)
    assert caught.value.argument == argument


def _nan_inside(points):
    return torch.where(points.norm(dim=-1) < 0.3, torch.nan, points.norm(dim=-1) - 1)


@pytest.mark.parametrize(
    ("source", "cause"),
    [
        (sdf.cylinder(1), "it has no bounds"),
        (sdf.sphere(0.5, (-1, 0, 0)) & sdf.sphere(0.5, (1, 0, 0)), "its bounds hold nothing"),
        (sdf.from_function(_nan_inside, bounds=[[-1] * 3, [1] * 3]), "its value at .* is nan"),
        (sdf.from_function(lambda p: p.norm(dim=-1) + 1, bounds=[[-1] * 3, [1] * 3]), "only 0"),
    ],
)
def test_sources_that_cannot_be_learned_are_refused(source, cause):
    with pytest.raises(InputError, match=cause):
        sdf.fit_neural(source, steps=1, **FAST)


def test_an_open_mesh_is_refused():
    trimesh = pytest.importorskip("trimesh")
    box = trimesh.creation.box()
    holed = trimesh.Trimesh(box.vertices, box.faces[1:], process=False)
    with pytest.raises(InputError, match="it is open"):
        sdf.fit_neural(holed, steps=1, **FAST)


def test_a_loss_that_becomes_nan_says_so():
    with pytest.raises(InputError, match="the loss became NaN") as caught:
        sdf.fit_neural(TORUS, SMALL_GRID, steps=100, learning_rate=1e30, **FAST)
    assert caught.value.argument == "learning_rate"


def test_an_unknown_architecture_is_refused():
    with pytest.raises(InputError, match="no such network"):
        sdf.fit_neural(TORUS, "transformer")


def test_a_fit_works_whatever_mode_the_caller_is_in():
    with torch.inference_mode():
        _, report = sdf.fit_neural(TORUS, SMALL_GRID, steps=50, **FAST)
    assert report.accuracy.box_error < 0.05


@pytest.mark.gpu
def test_a_fit_on_a_cuda_device():
    learned, report = sdf.fit_neural(TORUS, SMALL_GRID, steps=400, device="cuda", **FAST)
    assert report.accuracy.near_error < 0.0015
    points = torch.rand(100, 3, device="cuda")
    assert torch.allclose(learned(points).cpu(), learned(points.cpu()), atol=1e-5)


@pytest.mark.slow
def test_a_mesh_of_a_hundred_thousand_faces_in_a_minute():
    """The goal: mean error below 0.2 % of the diagonal. Twenty seconds leave room for a busy
    machine."""
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=6)  # 81,920 faces, dented
    directions = np.asarray(ball.vertices)
    waves = 0.1 * np.prod(np.sin(7 * directions), axis=1, keepdims=True)
    dented = trimesh.Trimesh(directions * (1 + waves), ball.faces, process=False)
    _, report = sdf.fit_neural(dented, steps=10**6, seconds=20.0)
    assert report.accuracy.near_error < 0.002
    assert report.accuracy.box_error < 0.002

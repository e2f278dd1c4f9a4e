"""Fitting: the errors fall and are measured as stated, and what is promised around that."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import trimesh

import implicit_warp as iw
from implicit_warp.benchmark.workloads import sphere_mesh
from implicit_warp.errors import FileFormatError, InputError
from implicit_warp.fitting.problem import FitProblem, correspondence
from implicit_warp.mesh_gradient import MeshGradient
from tests.implicit_warp.registered_maps import random_warp

POINTS, FACES = sphere_mesh(600)
SOURCE = trimesh.Trimesh(POINTS * [30.0, 20.0, 60.0] + [400.0, 0.0, -50.0], FACES, process=False)
"""An ellipsoid in other units than the net's, and far from the origin."""

SMALL = {"layers": 8, "resolution": 7, "progress": False}


def moved(mesh: trimesh.Trimesh, seed: int = 3) -> trimesh.Trimesh:
    """The mesh under a random injective map of moderate strength, in its own units."""
    scale = 60.0
    warp = random_warp(seed, layers=6, spread=0.8)
    inside = warp((mesh.vertices - mesh.centroid) / scale)
    return trimesh.Trimesh(scale * inside + [7.0, -300.0, 0.0], mesh.faces, process=False)


TARGET = moved(SOURCE)


@pytest.fixture(scope="module")
def fitted() -> iw.Warp:
    return iw.fit(SOURCE, TARGET, steps=400, **SMALL)


def test_errors_fall_and_the_best_state_is_kept(fitted):
    report = fitted.report
    first = report.history[0]
    assert report.vertex_error < first[3] / 100
    assert report.gradient_error < first[4] / 10
    assert report.loss == pytest.approx(min(row[2] for row in report.history), rel=1e-5)
    assert report.steps == 400
    assert report.status == "stopped at the step limit"


def test_the_report_states_the_errors_of_the_map_it_comes_with(fitted):
    """The paper's table in plain numpy, from the returned map in the user's units."""
    scale = 1.4 / np.ptp(SOURCE.vertices, axis=0).max()
    image, goal = fitted(SOURCE.vertices), TARGET.vertices
    report = fitted.report
    assert report.height == pytest.approx(1.4 / scale)
    # The report comes from float32 points, whose rounding is 1e-7 of 1: far below the errors.
    vertex = 1e3 * np.mean((scale * (image - goal)) ** 2)
    assert report.vertex_error == pytest.approx(vertex, rel=1e-3)
    gradient = MeshGradient(SOURCE.vertices, SOURCE.faces)
    apart = gradient(torch.from_numpy(image)) - gradient(torch.from_numpy(np.array(goal)))
    assert report.gradient_error == pytest.approx(1e3 * float(apart.square().mean()), rel=1e-3)
    assert report.loss == pytest.approx(report.vertex_error + 0.1 * report.gradient_error)
    assert f"{report.vertex_error:.3g}" in str(report)


@pytest.mark.parametrize("align", ["rigid", "affine"])
def test_the_slope_is_the_derivative_of_the_errors(align):
    """Against autograd through the errors as they are defined, in the user's units."""
    marks = (POINTS[:4], POINTS[4:8])
    weights = np.linspace(0.1, 2.0, 600)
    options = iw.FitOptions(height=3.0, align=align, precision="float64", landmark_weight=0.7)
    given = correspondence(
        trimesh.Trimesh(POINTS, FACES, process=False), POINTS @ np.diag([1.0, 1.3, 0.8]), marks,
        weights,
    )  # fmt: skip
    problem = FitProblem(given, options)
    image = problem.source + 0.1 * torch.randn(604, 3, dtype=torch.float64)
    image.requires_grad_()
    after = problem.after
    moved = 1.4 / 3.0 * (image @ after[:, :3].T + after[:, 3])
    goal = 1.4 / 3.0 * given.target
    vertex = ((moved - goal)[:600] ** 2).mean(1) @ torch.from_numpy(weights / weights.mean()) / 600
    operator = MeshGradient(1.4 / 3.0 * POINTS, FACES)
    gradient = (operator(moved[:600]) - operator(goal[:600])).square().mean()
    landmark = ((moved - goal)[600:] ** 2).mean()
    total = 1000.0 * (vertex + 0.1 * gradient + 0.7 * landmark)
    errors, slope = problem.errors(image.detach())
    assert errors["total"] == pytest.approx(float(total.detach()), rel=1e-12)
    assert errors["gradient"] == pytest.approx(1000.0 * float(gradient.detach()), rel=1e-10)
    assert torch.allclose(slope, torch.autograd.grad(total, image)[0], rtol=1e-9, atol=1e-12)


def test_the_result_is_certified_and_comes_back_from_a_file(fitted, tmp_path):
    assert iw.certify(fitted).proved
    points = torch.from_numpy(np.array(SOURCE.vertices))
    assert (fitted.inv(fitted(points)) - points).abs().max() < 1e-9 * 400
    iw.save(fitted, tmp_path / "warp.safetensors")
    again = iw.load(tmp_path / "warp.safetensors")
    assert torch.equal(again(points), fitted(points))
    assert again.report == fitted.report


def test_a_rigidly_moved_mesh_is_met_at_once():
    motion = iw.rigid_motion(rotate=("x", 150), translate=(5.0, 0.0, 1.0))
    target = motion(SOURCE.vertices)
    report = iw.fit(SOURCE, target, steps=1, **SMALL).report
    # The first step starts from random parameters of 0.01.
    assert report.history[0][3] < 0.05
    assert report.gradient_error < 5.0


def test_an_affine_start_is_closer_than_a_rigid_one():
    target = iw.Affine(np.diag([1.6, 0.7, 1.0]), [0.0, 0.0, 3.0])(SOURCE.vertices)
    starts = [
        iw.fit(SOURCE, target, steps=1, align=align, **SMALL).report.history[0][2]
        for align in ("none", "rigid", "affine")
    ]
    assert starts[0] > starts[1] > 20 * starts[2]


def test_points_without_faces_have_the_vertex_term_only():
    report = iw.fit(SOURCE.vertices, TARGET.vertices, steps=200, **SMALL).report
    assert report.gradient_error is None
    assert report.vertex_error < report.history[0][3] / 50
    assert report.loss == pytest.approx(report.vertex_error)


def test_landmarks_alone_and_in_addition():
    marks, goals = POINTS[:5] * 2.0, POINTS[:5] * 2.0 + [0.0, 0.0, 0.3]
    goals[0] += [0.2, 0.0, 0.0]
    warp = iw.fit(landmarks=(marks, goals), steps=150, **SMALL)
    assert np.abs(warp(marks) - goals).max() < 0.01
    assert warp.report.vertex_error is None

    # A landmark off the surface is met beside the vertices.
    mark = SOURCE.centroid[None]
    goal = TARGET.centroid[None] + [2.0, 0.0, 0.0]
    plain = iw.fit(SOURCE, TARGET, steps=200, **SMALL)
    pulled = iw.fit(SOURCE, TARGET, landmarks=(mark, goal), steps=200, **SMALL)
    assert np.linalg.norm(pulled(mark) - goal) < 0.2 * np.linalg.norm(plain(mark) - goal)
    assert pulled.report.landmark_error is not None


def test_vertex_weights_shift_the_error():
    left = SOURCE.vertices[:, 0] < SOURCE.centroid[0]

    def error_on_the_left(weights) -> float:
        # Six layers of 3 x 3 cannot meet it everywhere.
        warp = iw.fit(
            SOURCE.vertices, TARGET.vertices, vertex_weights=weights,
            steps=200, layers=3, resolution=4, progress=False,
        )  # fmt: skip
        return float(((warp(SOURCE.vertices) - TARGET.vertices)[left] ** 2).mean())

    assert error_on_the_left(np.where(left, 1.0, 0.01)) < 0.7 * error_on_the_left(None)


def test_same_seed_same_warp_other_seed_another():
    first, again, other = (iw.fit(SOURCE, TARGET, steps=5, seed=s, **SMALL) for s in (3, 3, 4))
    assert torch.equal(first.embeddings, again.embeddings)
    assert not torch.equal(first.embeddings, other.embeddings)


def interrupt_at(step: int):
    def callback(at: int, warp: iw.Warp) -> None:
        if at == step:
            raise KeyboardInterrupt

    return callback


def test_a_resumed_fit_ends_bit_for_bit_where_it_would_have_ended(tmp_path):
    whole = iw.fit(SOURCE, TARGET, steps=150, **SMALL)
    path = tmp_path / "state.safetensors"
    part = iw.fit(SOURCE, TARGET, steps=150, checkpoint=path, callback=interrupt_at(100), **SMALL)
    assert part.report.status == "interrupted"
    assert part.report.loss == pytest.approx(min(row[2] for row in part.report.history), rel=1e-6)
    resumed = iw.fit(SOURCE, TARGET, steps=150, checkpoint=path, **SMALL)
    assert torch.equal(resumed.embeddings, whole.embeddings)
    assert [row[2:] for row in resumed.report.history] == [row[2:] for row in whole.report.history]
    # A finished fit is not made again.
    again = iw.fit(SOURCE, TARGET, steps=150, checkpoint=path, **SMALL)
    assert torch.equal(again.embeddings, whole.embeddings)


def test_checkpoints_of_other_fits_and_damaged_ones_are_refused(tmp_path):
    path = tmp_path / "state.safetensors"
    iw.fit(SOURCE, TARGET, steps=2, checkpoint=path, **SMALL)
    with pytest.raises(InputError, match="other points or with other options"):
        iw.fit(SOURCE, TARGET, steps=3, checkpoint=path, **SMALL)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(FileFormatError, match="not a readable"):
        iw.fit(SOURCE, TARGET, steps=2, checkpoint=path, **SMALL)
    iw.save(iw.TutteNet(2, 3), path)
    with pytest.raises(FileFormatError, match="holds no fit"):
        iw.fit(SOURCE, TARGET, steps=2, checkpoint=path, **SMALL)


def test_it_stops_at_goals_at_a_plateau_and_in_time():
    at_goal = iw.fit(SOURCE, TARGET, steps=400, vertex_goal=0.5, gradient_goal=1000.0, **SMALL)
    assert at_goal.report.status == "reached the goals"
    assert at_goal.report.steps < 400
    assert at_goal.report.vertex_error <= 0.5
    plateau = iw.fit(SOURCE, SOURCE, steps=2000, tolerance=0.5, align="none", **SMALL)
    assert plateau.report.status == "converged"
    in_time = iw.fit(SOURCE, TARGET, steps=100_000, seconds=0.3, **SMALL)
    assert in_time.report.status == "stopped at the time limit"


def test_a_relapse_goes_back_to_the_best_state_more_slowly():
    """What is nearly met at the start is lost by steps of the usual size, and found again."""
    report = iw.fit(SOURCE, SOURCE, steps=300, **SMALL).report
    assert report.relapses
    assert report.loss < report.history[0][2] / 4
    assert iw.fit(SOURCE, TARGET, steps=50, **SMALL).report.relapses == []


def test_the_parts_of_the_descent_can_be_changed_one_by_one():
    def report(**options):
        return iw.fit(SOURCE, SOURCE, steps=300, **SMALL, **options).report

    usual = report()
    never = report(relapse=None)
    assert never.relapses == []
    assert never.history[-1][2] > usual.history[-1][2]
    # At a constant rate the last steps are as long as the first ones, and the loss stays up.
    constant = report(schedule="constant", learning_rate=0.05)
    falling = report(learning_rate=0.05)
    assert constant.history[-1][2] > 10 * falling.history[-1][2]
    # A random start is far from the identity, where all of these begin.
    assert report(init="paper").history[0][2] > 1000 * usual.history[0][2]
    for one in ({"memory": 0.999}, {"boundary_rate": 1.0}):
        assert report(**one).history[1][2] != usual.history[1][2]


EMPTY = trimesh.Trimesh(POINTS, np.empty((0, 3), dtype=int), process=False)
FLIPPED = trimesh.Trimesh(TARGET.vertices, TARGET.faces[:, ::-1], process=False)
FEWER = trimesh.Trimesh(TARGET.vertices, TARGET.faces[:-1], process=False)
NAN = np.where(np.arange(600)[:, None] == 17, np.nan, TARGET.vertices)
DEGENERATE = trimesh.Trimesh(POINTS, np.vstack([FACES, [[0, 0, 1]]]), process=False)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((SOURCE, TARGET.vertices[:-1]), "599 points.*the source has 600"),
        ((SOURCE, FLIPPED), "faces are not those of the source"),
        ((SOURCE, FEWER), "numbers differ"),
        ((SOURCE, NAN), "target.*the first is 17"),
        ((NAN, TARGET.vertices), "source.*the first is 17"),
        ((EMPTY, TARGET), "without faces"),
        ((np.empty((0, 3)), np.empty((0, 3))), r"should be \(n, 3\)"),
        ((POINTS[:, :2], POINTS[:, :2]), r"should be \(n, 3\)"),
        (("ball", TARGET), "neither a mesh nor points"),
        ((SOURCE, 1e-3 * np.array(SOURCE.vertices)), "units seem to differ"),
        ((SOURCE, np.ones((600, 3))), "all of its points coincide"),
        ((DEGENERATE, DEGENERATE.vertices), "without area.*1196"),
        ((SOURCE, None), "the other one is given"),
        ((), "nothing to fit"),
    ],
)
def test_bad_shapes_are_named(arguments, message):
    with pytest.raises(InputError, match=message):
        iw.fit(*arguments, steps=1, **SMALL)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"landmarks": POINTS}, "landmarks.*not a pair"),
        ({"landmarks": (POINTS, POINTS[:3])}, "600 points, 3 targets"),
        ({"landmarks": (POINTS, np.full((600, 3), np.inf))}, r"landmarks\[1\].*infinite"),
        ({"landmarks": (POINTS * 1e5, POINTS)}, r"landmarks\[0\].*landmark 0 is out of range"),
        ({"landmarks": (SOURCE.vertices[:3], POINTS[:3] * 1e5)}, r"landmarks\[1\].*out of range"),
        ({"vertex_weights": np.ones(3)}, r"should be \(600,\)"),
        ({"vertex_weights": -np.ones(600)}, "not negative"),
        ({"vertex_weights": np.zeros(600)}, "not all zero"),
        ({"steps": 0}, "steps"),
        ({"layers": 2.5}, "layers"),
        ({"seed": -1}, "seed"),
        ({"learning_rate": 0.0}, "not a positive number"),
        ({"gradient_weight": -1.0}, "number >= 0"),
        ({"height": float("nan")}, "height"),
        ({"radius": 0}, "radius.*not a positive number"),
        ({"align": "best"}, "use one of none, rigid, affine"),
        ({"precision": "float16"}, "precision"),
        ({"schedule": "linear"}, "use one of cosine, constant"),
        ({"memory": 1.0}, "memory.*not below 1"),
        ({"relapse": 0.5}, "relapse.*every step would be one"),
        ({"boundary_rate": 0}, "boundary_rate.*not a positive number"),
        ({"init": "zero"}, "no such initialisation"),
        ({"speed": 3}, "no such option.*learning_rate"),
        ({"device": "abacus"}, "device"),
        ({"checkpoint": "state.pt"}, "safetensors"),
    ],
)
def test_bad_options_are_named(options, message):
    with pytest.raises(InputError, match=message):
        iw.fit(SOURCE, TARGET, **{"steps": 1, **SMALL, **options})

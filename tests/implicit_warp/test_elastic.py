"""The elastic solve: it reaches its handles, and what it promises around that."""

from __future__ import annotations

import pytest
import torch

import fields as sdf
import implicit_warp as iw
from implicit_warp.errors import InputError

BAR = sdf.box((1.0, 1.0, 3.0)).translate((10.0, -20.0, 5.0))
HANDLES = (
    iw.hold(sdf.below(3.9), name="bottom"),
    iw.move(sdf.above(6.1), rotate=("z", 60), pivot=(10, -20, 0), name="top"),
)
SMALL = {"layers": 8, "resolution": 7, "steps": 100, "samples": 512, "handle_samples": 128}


@pytest.fixture(scope="module")
def twisted() -> iw.Warp:
    return iw.elastic(BAR, HANDLES, **SMALL)


def test_handles_are_reached_in_the_users_units(twisted):
    report = twisted.report
    assert report.handle_error_relative < 0.02
    assert set(report.handles) == {"bottom", "top"}
    corner = torch.tensor([[10.5, -19.5, 6.5], [9.5, -20.5, 3.5]], dtype=torch.float64)
    target = torch.stack([HANDLES[1].motion(corner[0]), corner[1]])
    assert ((twisted(corner) - target).norm(dim=1) < 0.15).all()


def test_report_is_measured_on_the_map_it_comes_with(twisted):
    generator = torch.Generator().manual_seed(1)
    low, high = torch.tensor(BAR.bounds)
    x = low + (high - low) * torch.rand(20_000, 3, generator=generator, dtype=torch.float64)
    jacobian = twisted.jacobian(x)
    energy = iw.elastic_energy(jacobian)
    # The report's own integral has 32768 samples: both are within five standard errors.
    error = 5.0 * float(energy.std()) * (1 / 20_000 + 1 / 32_768) ** 0.5
    assert abs(float(energy.mean()) - twisted.report.loss["elastic"]) < error
    assert (torch.linalg.det(jacobian) > 0).all()
    squares = [
        (h.motion(p) - twisted(p)).square().sum(1) for h in HANDLES for p in [x[h.region(x) <= 0]]
    ]
    rms = float(torch.cat(squares).mean().sqrt())
    assert rms == pytest.approx(twisted.report.handle_error, rel=0.2)


def test_loss_falls_and_the_best_state_is_kept(twisted):
    losses = [loss for _, loss in twisted.report.history]
    assert losses[0] > 20.0 * twisted.report.loss["total"]
    assert twisted.report.loss["total"] == pytest.approx(min(losses), rel=1e-5)


def test_same_seed_same_warp_other_seed_another(twisted):
    short = {**SMALL, "steps": 5}
    first, again, other = (iw.elastic(BAR, HANDLES, **short, seed=s) for s in (3, 3, 4))
    assert torch.equal(first.embeddings, again.embeddings)
    assert not torch.equal(first.embeddings, other.embeddings)


def test_a_common_rigid_motion_is_found_exactly():
    motion = {"rotate": ((1, 1, 0), 170), "translate": (3, 0, 0)}
    handles = [iw.move(sdf.below(4.5), **motion), iw.move(sdf.above(5.5), **motion)]
    warp = iw.elastic(BAR, handles, **{**SMALL, "steps": 60})
    assert warp.report.handle_error_relative < 1e-3
    assert warp.report.loss["elastic"] < 1e-3


def test_interruption_returns_the_best_so_far():
    def interrupt(step, warp):
        if step == 25:
            raise KeyboardInterrupt

    warp = iw.elastic(BAR, HANDLES, **SMALL, callback=interrupt)
    assert warp.report.status == "interrupted"
    assert warp.report.steps == 25
    assert warp.report.loss["total"] == pytest.approx(
        min(loss for _, loss in warp.report.history), rel=1e-5
    )


@pytest.mark.parametrize(("scale", "shift"), [(1e-6, 0.0), (1e-6, 1.0), (1.0, 1e6), (1e6, 1e9)])
def test_neither_size_nor_place_costs_accuracy(scale, shift):
    bar = sdf.box((1.0, 1.0, 3.0))
    moved = bar.scale(scale).translate((shift, shift, shift))
    short = {**SMALL, "steps": 40}
    reports = []
    for shape, low, high, pivot in (
        (bar, -1.1, 1.1, 0.0),
        (moved, shift - 1.1 * scale, shift + 1.1 * scale, shift),
    ):
        turn = {"rotate": ("z", 60), "pivot": (pivot, pivot, pivot)}
        handles = [iw.hold(sdf.below(low)), iw.move(sdf.above(high), **turn)]
        reports.append(iw.elastic(shape, handles, **short).report.handle_error_relative)
    assert reports[1] == pytest.approx(reports[0], rel=0.05)


def test_a_solve_runs_in_any_gradient_mode_and_leaves_nothing_behind():
    short = {**SMALL, "steps": 5}
    expected = iw.elastic(BAR, HANDLES, **short).embeddings
    with torch.no_grad():
        assert torch.equal(iw.elastic(BAR, HANDLES, **short).embeddings, expected)
    with torch.inference_mode():
        warp = iw.elastic(BAR, HANDLES, **short)
        warp(torch.zeros(2, 3))
    x = torch.zeros(2, 3, dtype=torch.float64, requires_grad=True)
    warp(x).sum().backward()
    with iw.back_end("torch"):
        warp(x).sum().backward()


def test_a_closed_mesh_is_a_shape():
    import trimesh

    ball = trimesh.creation.icosphere(3, 1.0)
    handles = [iw.hold(sdf.below(-0.5)), iw.move(sdf.above(0.5), translate=(0, 0, 0.5))]
    warp = iw.elastic(ball, handles, **{**SMALL, "steps": 30})
    assert warp.report.handle_error_relative < 0.1


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"shape": 3}, "neither a field nor a mesh"),
        ({"handles": []}, "nothing is held or moved"),
        ({"handles": [sdf.above(0)]}, "make it with iw.hold or iw.move"),
        ({"steps": 0}, "steps = 0"),
        ({"step": 10}, "no such option of the solve"),
        ({"learning_rate": -1.0}, "learning_rate = -1.0"),
        ({"handle_weight": float("nan")}, "handle_weight = nan"),
        ({"frames": "sideways"}, "triplane, cubic, free"),
        ({"seed": 0.5}, "seed = 0.5"),
        ({"seed": 2**70}, "seed = "),
        ({"learning_rate": "fast"}, "learning_rate = 'fast'"),
        ({"device": "abacus"}, "torch cannot use it"),
        ({"handles": [HANDLES[0], HANDLES[0]]}, "two handles have this name"),
    ],
)
def test_bad_arguments_are_named(arguments, words):
    call = {"shape": BAR, "handles": HANDLES, **arguments}
    with pytest.raises(InputError) as caught:
        iw.elastic(call.pop("shape"), call.pop("handles"), **call)
    assert words in str(caught.value)

"""Meshes that are no surface of a solid: refused, mended, or signed by winding number."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
import torch

import fields as sdf
from fields import InputError

trimesh = pytest.importorskip("trimesh", reason="builds the meshes of these tests")

BALL = trimesh.creation.icosphere(subdivisions=3)
V, F = np.asarray(BALL.vertices), np.asarray(BALL.faces)
CLEAN = sdf.mesh(BALL)


class Soup:
    def __init__(self, vertices, faces):
        self.vertices, self.faces = np.asarray(vertices), np.asarray(faces)


def _joined(*parts):
    offsets = np.cumsum([0] + [len(p.vertices) for p in parts])
    return Soup(
        np.concatenate([p.vertices for p in parts]),
        np.concatenate([p.faces + o for p, o in zip(parts, offsets, strict=False)]),
    )


def _turned(faces, chosen):
    result = faces.copy()
    result[chosen] = result[chosen, ::-1]
    return result


def _inner(scale):
    """A smaller ball, inside out: a cavity."""
    return Soup(scale * V, F[:, ::-1])


FAN = Soup([*V, 2 * V[F[0, 0]]], [*F, [F[0, 0], F[0, 1], len(V)]])
"""A fin on an edge, where three faces meet."""

MENDABLE = {
    "every third face turned": Soup(V, _turned(F, np.arange(0, len(F), 3))),
    "most faces of it turned, as a whole inside out": Soup(V, _turned(F, np.arange(40, len(F)))),
    "inside out": Soup(V, F[:, ::-1]),
    "degenerate faces": Soup(V, [*F, [0, 0, 1], [5, 5, 5]]),
    "a cavity, and a turned face of it": Soup(
        *(lambda m: (m.vertices, _turned(m.faces, [len(F) + 3])))(_joined(BALL, _inner(0.5)))
    ),
}
UNMENDABLE = {
    "a missing face": Soup(V, F[1:]),
    "a tenth of the faces missing": Soup(V, F[np.arange(len(F)) % 10 != 0]),
    "vertices not merged, some faces missing": Soup(
        V[F[30:]].reshape(-1, 3), np.arange(3 * len(F[30:])).reshape(-1, 3)
    ),
    "a face doubled": Soup(V, [*F, F[7]]),
    "a fin": FAN,
    "open, and turned faces": Soup(V, _turned(F, np.arange(1, 100, 7))[3:]),
}


@pytest.mark.parametrize("broken", [*MENDABLE.values(), *UNMENDABLE.values()])
def test_by_default_it_is_refused_and_the_option_named(broken):
    with pytest.raises(InputError, match=r"imperfect=\"accept\"") as caught:
        sdf.mesh(broken)
    assert caught.value.argument == "mesh"


@pytest.mark.parametrize("broken", MENDABLE.values(), ids=MENDABLE.keys())
def test_what_can_be_mended_is_exact(broken, rng):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        field = sdf.mesh(broken, imperfect="accept")
    assert field.exact
    points = rng.uniform(-1.3, 1.3, (2_000, 3))
    expected = CLEAN(points)
    if len(broken.faces) > 2 * len(F) - 1:
        expected = np.maximum(expected, -sdf.mesh(Soup(0.5 * V, F))(points))
        near = np.abs(field(points)) < 0.2  # an intersection is exact near its surface
        points, expected = points[near], expected[near]
    np.testing.assert_allclose(field(points), expected, atol=1e-12)


@pytest.mark.parametrize("broken", UNMENDABLE.values(), ids=UNMENDABLE.keys())
def test_signs_are_right_away_from_the_defect(broken, rng):
    with pytest.warns(UserWarning, match="imperfect, its sign is by winding number"):
        field = sdf.mesh(broken, imperfect="warn")
    assert not field.exact
    points = rng.uniform(-1.3, 1.3, (4_000, 3))
    expected = CLEAN(points)
    # The largest hole is two triangles wide. At half the width of a round hole the winding number
    # of a ball is off by no more than its solid angle there, a quarter.
    far = np.abs(expected) > 0.2
    assert far.mean() > 0.5
    np.testing.assert_array_equal(field(points)[far] < 0, expected[far] < 0)
    in_box = (points >= field.bounds[0]) & (points <= field.bounds[1])
    assert (field(points)[~in_box.all(axis=1)] > 0).all()


def test_the_size_is_the_distance_to_the_triangles_that_are_left(rng):
    field = sdf.mesh(UNMENDABLE["a tenth of the faces missing"], imperfect="accept")
    whole = np.abs(CLEAN(points := rng.uniform(-1.3, 1.3, (1_000, 3))))
    assert (np.abs(field(points)) >= whole - 1e-12).all()
    centre = V[F[0]].mean(axis=0)  # of a missing face: nearest is its rim
    middles = (V[F[0]] + V[np.roll(F[0], 1)]) / 2
    rim = np.linalg.norm(middles - centre, axis=1).min()
    assert abs(field(centre)) == pytest.approx(rim, rel=0.01)  # the triangle is nearly regular


def test_overlapping_balls_have_the_inside_of_their_union(rng):
    shift = np.array([0.9, 0.0, 0.0])
    pair = _joined(BALL, Soup(V + shift, F))
    points = rng.uniform((-1.2, -1.2, -1.2), (2.1, 1.2, 1.2), (4_000, 3))
    union = np.minimum(CLEAN(points), CLEAN(points - shift))
    field = sdf.mesh(pair, sign="winding")
    np.testing.assert_array_equal(field(points) < 0, union < 0)
    outside = union > 0
    np.testing.assert_allclose(field(points)[outside], union[outside], atol=1e-12)
    assert not field.exact
    assert field.lipschitz == 1
    step = 1e-3 * rng.normal(size=points.shape)
    change = np.abs(field(points + step) - field(points))
    assert (change <= np.linalg.norm(step, axis=1) + 1e-12).all()
    # By normals the sheets inside the other ball take their word for it.
    assert (sdf.mesh(pair)(points) < 0).sum() < (union < 0).sum()


def test_a_surface_through_itself_is_signed_by_winding(rng):
    """A ring whose tube is wider than its hole: a spindle. Around its axis the tube comes out on
    the other side turned over, so that there one covering cancels the other: a cavity."""
    u, v = np.meshgrid(*[np.arange(48) * 2 * np.pi / 48] * 2, indexing="ij")
    r = 0.5 + 0.8 * np.cos(v)
    corners = np.stack([r * np.cos(u), r * np.sin(u), 0.8 * np.sin(v)], axis=-1).reshape(-1, 3)
    i, j = (a.reshape(-1) for a in np.indices((48, 48)))
    a, b = 48 * i + j, 48 * ((i + 1) % 48) + j
    c, d = 48 * ((i + 1) % 48) + (j + 1) % 48, 48 * i + (j + 1) % 48
    spindle = Soup(corners, np.concatenate([np.stack(t, 1) for t in ((a, b, c), (a, c, d))]))
    field = sdf.mesh(spindle, sign="winding")
    points = rng.uniform(-1.4, 1.4, (4_000, 3))
    radius = np.hypot(points[:, 0], points[:, 1])
    apple = np.hypot(radius - 0.5, points[:, 2]) - 0.8
    truth = np.maximum(apple, 0.8 - np.hypot(radius + 0.5, points[:, 2]))
    clear = np.abs(truth) > 0.02  # beyond the chords of 48 pieces
    np.testing.assert_array_equal(field(points)[clear] < 0, truth[clear] < 0)


def test_tags_say_what_is_left():
    opened = sdf.mesh(UNMENDABLE["a missing face"], imperfect="accept")
    assert (opened.exact, opened.lipschitz) == (False, None)
    np.testing.assert_array_equal(opened.bounds, CLEAN.bounds)
    used_twice = _joined(BALL, BALL)
    pinched = trimesh.util.concatenate([BALL, BALL])
    pinched.merge_vertices()  # every edge has four faces, twice in each direction
    field = sdf.mesh(pinched, imperfect="accept")
    assert (field.exact, field.lipschitz) == (False, 1.0)
    assert sdf.mesh(used_twice).exact  # two surfaces, as far as anybody looked


def test_boxes_hold_the_values_of_an_open_mesh(rng):
    field = sdf.mesh(UNMENDABLE["a tenth of the faces missing"], imperfect="accept")
    oracle = field.expression.arguments[0].payload
    low = rng.uniform(-1.3, 1.0, (200, 3))
    boxes = np.stack([low, low + rng.uniform(0, 0.5, (200, 3))], axis=1)
    bounds = oracle.enclose(boxes)[:, 0]
    inside = boxes[:, :1] + rng.uniform(0, 1, (200, 50, 3)) * (boxes[:, 1:] - boxes[:, :1])
    values = field(inside)
    assert (values >= bounds[:, :1]).all()
    assert (values <= bounds[:, 1:]).all()
    assert (bounds[:, 0] > 0).mean() < 0.5


def test_gradients_of_an_open_mesh_are_unit():
    points = torch.rand(500, 3, dtype=torch.float64) * 2.6 - 1.3
    gradient = sdf.mesh(UNMENDABLE["a missing face"], imperfect="accept").gradient(points)
    torch.testing.assert_close(gradient.norm(dim=1), torch.ones(500, dtype=torch.float64))
    on_surface = sdf.mesh(FAN, imperfect="accept").gradient(V[F[1:]].mean(axis=1))
    np.testing.assert_allclose(on_surface, BALL.face_normals[1:], atol=1e-9)


def test_normals_need_a_closed_mesh():
    with pytest.raises(InputError, match='choose sign="winding"'):
        sdf.mesh(UNMENDABLE["a missing face"], sign="normals", imperfect="accept")
    assert sdf.mesh(MENDABLE["inside out"], sign="normals", imperfect="accept").exact


@pytest.mark.parametrize("option", [{"sign": "rays"}, {"imperfect": "ignore"}])
def test_other_choices_are_refused(option):
    with pytest.raises(InputError, match="no such choice"):
        sdf.mesh(BALL, **option)


@pytest.mark.parametrize("choice", ["warn", "accept"])
def test_what_cannot_be_used_is_refused_all_the_same(choice):
    with pytest.raises(InputError, match="NaN"):
        sdf.mesh(Soup(V * np.nan, F), imperfect=choice)
    with pytest.raises(InputError, match="empty"):
        sdf.mesh(Soup(V, F[:0]), imperfect=choice)


def test_options_of_files_are_written_and_read(tmp_path):
    path = tmp_path / "open.ply"
    trimesh.Trimesh(V, F[1:], process=False).export(path)
    field = sdf.mesh(path, sign="winding", imperfect="accept")
    assert repr(field) == f"mesh({str(path)!r}, sign='winding', imperfect='accept')"
    again = sdf.parse(repr(field), allow_files=True)
    assert again([0.1, 0.2, 0.3]) == field([0.1, 0.2, 0.3])


@pytest.mark.parametrize("sides", [1, 2])
def test_a_one_sided_band_is_signed_somehow_and_finite(sides, rng):
    """A Moebius band has no orientation that agrees everywhere; a cylinder has."""
    t = np.arange(60) * 2 * np.pi / 60
    tilt = t / 2 if sides == 1 else 0 * t
    rows = [
        np.stack([(1 + s * np.cos(tilt)) * np.cos(t), (1 + s * np.cos(tilt)) * np.sin(t),
                  s * np.sin(tilt) + s * (sides == 2)], axis=1)
        for s in (-0.3, 0.3)
    ]  # fmt: skip
    i = np.arange(60)
    j, flip = (i + 1) % 60, (i == 59) & (sides == 1)
    a, b = np.where(flip, 60, 0) + j, np.where(flip, 0, 60) + j
    faces = np.concatenate([np.stack([i, a, 60 + i], 1), np.stack([60 + i, a, b], 1)])
    field = sdf.mesh(Soup(np.concatenate(rows), faces), imperfect="accept")
    assert np.isfinite(field(rng.uniform(-1.5, 1.5, (500, 3)))).all()
    assert field.lipschitz is None

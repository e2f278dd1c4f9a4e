"""What extracted meshes say of their vertices."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

import fields as sdf
import implicit_warp as iw
from implicit_warp import extraction
from implicit_warp.errors import InputError
from implicit_warp.extraction import NEAREST

# Signs and crossings alone: what is done at edges of the shape has tests of its own.
extract = partial(extraction.extract, sharp=False)
extract_mesh = partial(extraction.extract_mesh, sharp=False)


def test_rest_positions_lead_through_all_maps():
    first, second = iw.TutteNet(2).freeze(), iw.Warp(*_bent())
    field = iw.deform(iw.deform(sdf.sphere(1.0), first), second)
    mesh = extract(field, 24, attributes=["rest_position"])
    rest = mesh.vertex_attributes["rest_position"]
    assert np.allclose(second(first(rest)), mesh.vertices, atol=1e-9)
    assert np.abs(np.linalg.norm(rest, axis=1) - 1).max() < 0.02
    plain = extract(sdf.sphere(1.0), 24, attributes=["rest_position"])
    assert np.array_equal(plain.vertex_attributes["rest_position"], plain.vertices)


def _bent():
    import torch

    net = iw.TutteNet(3, resolution=5)
    generator = torch.Generator().manual_seed(0)
    with torch.no_grad():
        for parameter in net.parameters():
            parameter += 0.3 * torch.randn(parameter.shape, generator=generator)
    warp = net.freeze()
    return warp.embeddings, warp.frames


def test_normals_and_errors_are_the_fields_own():
    mesh, report = extract_mesh(
        sdf.sphere(1.0), 24, attributes=["normal", "distance_error"], polishing=0
    )
    radius = np.linalg.norm(mesh.vertices, axis=1)
    normal = mesh.vertex_attributes["normal"]
    assert np.allclose(normal, mesh.vertices / radius[:, None], atol=1e-6)
    assert np.allclose(mesh.vertex_attributes["distance_error"], np.abs(radius - 1), atol=1e-6)
    assert mesh.vertex_attributes["distance_error"].max() < report.voxel * (NEAREST + 0.1)


def test_colours_follow_the_points_at_rest(tmp_path):
    def stripes(points):
        return np.where(points[:, [2]] > 0, [[1.0, 0.0, 0.0]], [[0.0, 0.0, 1.0]])

    mesh = extract(
        iw.deform(sdf.sphere(1.0), iw.Affine(translation=(0, 0, 5))), 24, colours=stripes
    )
    red = np.array(mesh.visual.vertex_colors)[:, 0] == 255
    assert (red == (mesh.vertices[:, 2] > 5)).all()
    mesh.export(tmp_path / "ball.ply")


@pytest.mark.parametrize(
    ("argument", "options"),
    [
        ("attributes", {"attributes": ["colour"]}),
        ("colours", {"colours": lambda p: p[:, 0]}),
        ("colours", {"colours": lambda p: 255.0 * np.ones_like(p)}),
    ],
)
def test_bad_attributes_are_refused(argument, options):
    with pytest.raises(InputError) as refusal:
        extract(sdf.sphere(1.0), 16, **options)
    assert refusal.value.argument == argument

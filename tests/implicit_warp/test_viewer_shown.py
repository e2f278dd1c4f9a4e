"""How the editor's page shows the mesh and its figures: parts by regions, and text as HTML."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

import fields
from implicit_warp.color_scales import color_scale
from implicit_warp.viewer import markup
from implicit_warp.viewer.region_parts import Part, cut_by_regions

BALL = trimesh.creation.icosphere(3)
HALF, TIP, LEAF = fields.above(0.1), fields.above(0.6), fields.sphere(0.3, (1.0, 0.0, 0.0))
CASES = {
    "none": [],
    "one": [HALF],
    "two apart": [TIP, LEAF],
    "overlapping": [HALF, TIP],
    "crossing": [fields.above(0.0), fields.right(0.0), fields.sphere(0.5, (0.6, 0.6, 0.6))],
    "empty": [fields.above(2.0)],
    "all": [fields.above(-2.0)],
}


def placed(part: Part | None) -> trimesh.Trimesh:
    if part is None:
        return trimesh.Trimesh()
    return trimesh.Trimesh(part.weights @ BALL.vertices, part.faces, process=False)


@pytest.mark.parametrize("name", CASES)
def test_parts_are_the_mesh_once(name):
    regions = CASES[name]
    parts = cut_by_regions(BALL, regions)
    assert len(parts) == len(regions) + 1
    meshes = [placed(part) for part in parts]
    np.testing.assert_allclose(sum(mesh.area for mesh in meshes), BALL.area, rtol=1e-12)
    filled = [mesh for mesh in meshes if len(mesh.faces)]
    outward = np.concatenate([mesh.area_faces[:, None] * mesh.face_normals for mesh in filled])
    np.testing.assert_allclose(outward.sum(axis=0), 0.0, atol=1e-9)  # no face is turned over
    np.testing.assert_allclose(sum(mesh.volume for mesh in filled), BALL.volume, rtol=1e-9)


@pytest.mark.parametrize("name", CASES)
def test_each_part_lies_in_its_region_and_outside_of_later_ones(name):
    regions = CASES[name]
    for number, part in enumerate(cut_by_regions(BALL, regions)):
        if part is None:
            continue
        middles = placed(part).triangles_center
        if number:
            assert regions[number - 1](middles).max() < 0.02  # borders are found by halving
        for later in regions[number:]:
            assert later(middles).min() > -0.02


def test_parts_follow_the_mesh_wherever_it_goes():
    shear = np.array([[1.0, 0.3, 0.0], [0.0, 1.0, 0.2], [0.0, 0.0, 0.7]])
    for part in cut_by_regions(BALL, CASES["crossing"]):
        assert part is not None
        np.testing.assert_allclose(part.weights.sum(axis=1), 1.0)
        assert part.weights.min() >= 0.0
        assert part.faces.max() < part.weights.shape[0]
        moved = part.weights @ (BALL.vertices @ shear)
        np.testing.assert_allclose(moved, (part.weights @ BALL.vertices) @ shear, atol=1e-12)


def test_text_from_elsewhere_is_escaped():
    bad = "<script>alert('x')</script>"
    shown = [
        markup.status(bad, True, [(bad, bad)]),
        markup.handle_row(bad, (1, 2, 3), 1.0, held=True, active=False),
        markup.report(f"{bad}\n  {bad}   {bad}", True, command=bad),
    ]
    for html in shown:
        assert "<script" not in html
        assert "&lt;script&gt;" in html


def test_a_report_keeps_its_columns_and_its_command():
    html = markup.report("a.stl: ok\n  mesh      4 vertices\n  watertight  yes", True, "run 'a b'")
    for text in ("a.stl: ok", ">mesh</span>", ">4 vertices</span>", ">watertight</span>", "yes<"):
        assert text in html
    assert "run &#x27;a b&#x27;" in html
    assert "<code" not in markup.report("plain")


def test_a_legend_names_its_quantity_and_ends():
    scale = color_scale("stretch", np.array([0.8, 1.0, 1.6]))
    html = markup.legend(scale)
    assert scale.label in html
    for _, text in scale.ticks(4):
        assert f">{text}<" in html

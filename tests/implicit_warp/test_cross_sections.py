"""Sections of meshes and fields, their pictures, and self-intersections as things to draw."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

import fields
import implicit_warp as iw
from implicit_warp.cross_sections import (
    as_segments,
    chains,
    iso_lines,
    mesh_section,
    plane_through,
    section_picture,
)
from implicit_warp.highlights import self_intersection_highlights
from implicit_warp.slices import frame_of


def enclosed_area(lines, plane):
    """By the shoelace formula: holes, which run the other way, count negatively."""
    frame = frame_of(plane)
    sense = np.cross(frame.right, frame.up) @ np.array(fields.arguments.direction("n", plane[0]))
    total = 0.0
    for line in lines:
        x, y = (line - frame.origin) @ frame.right, (line - frame.origin) @ frame.up
        total += 0.5 * np.sum(x[:-1] * y[1:] - x[1:] * y[:-1])
    return sense * total


@pytest.mark.parametrize("normal", ["x", "y", "z", (1.0, 2.0, -0.5)])
def test_a_hollow_ball_is_cut_in_two_circles(normal):
    ball = trimesh.creation.icosphere(subdivisions=4, radius=1.0)
    hole = trimesh.creation.icosphere(subdivisions=4, radius=0.5)
    hole.invert()
    both = trimesh.util.concatenate([ball, hole])
    plane = plane_through((0.1, 0.05, 0.2), normal)
    lines = mesh_section(both, plane)
    assert len(lines) == 2
    unit, offset = plane
    for line in lines:
        np.testing.assert_array_equal(line[0], line[-1])
        np.testing.assert_allclose(line @ unit, offset, atol=1e-12)
    expected = np.pi * ((1 - offset**2) - (0.25 - offset**2))
    assert enclosed_area(lines, plane) == pytest.approx(expected, rel=5e-3)


def test_vertices_in_the_plane_make_no_trouble():
    box = trimesh.creation.box((2, 2, 2)).subdivide()  # has vertices at z = 0
    (line,) = mesh_section(box, ("z", 0.0))
    assert enclosed_area([line], ("z", 0.0)) == pytest.approx(4.0)
    # The bottom face counts as above the plane, so there is nothing to cut.
    assert mesh_section(box, ("z", -1.0)) == []
    assert enclosed_area(mesh_section(box, ("z", 1.0)), ("z", 1.0)) == pytest.approx(4.0)


def test_an_open_mesh_gives_open_lines():
    tube = trimesh.creation.cylinder(1.0, 2.0, sections=32)
    keep = np.abs(tube.face_normals[:, 2]) < 0.5
    keep[np.flatnonzero(keep)[:2]] = False
    tube.update_faces(keep)
    (line,) = mesh_section(tube, ("z", 0.1))
    assert np.abs(line[0] - line[-1]).max() > 0.1


def test_the_section_agrees_with_that_of_the_field():
    shape = fields.sphere(1) - fields.box(0.8)
    mesh = iw.extract(shape, 96)
    plane = ((1.0, 1.0, 1.0), 0.3)
    of_mesh = enclosed_area(mesh_section(mesh, plane), plane)
    of_field = enclosed_area(iso_lines(shape, plane)[0.0], plane)
    assert of_mesh == pytest.approx(of_field, rel=5e-3)


def test_chains_use_every_link_once(rng):
    links = np.array([[0, 1], [1, 2], [2, 0], [5, 6], [6, 7], [3, 4], [4, 3], [2, 2]])
    found = chains(links[rng.permutation(len(links))])
    used = sorted((int(a), int(b)) for c in found for a, b in pairwise(c))
    assert used == sorted(map(tuple, links.tolist()))
    assert [5, 6, 7] in [c.tolist() for c in found]


def test_iso_lines_of_a_distance_are_circles():
    found = iso_lines(fields.sphere(1), ("x", 0.0), (-0.25, 0.0, 0.1), 128)
    for level, lines in found.items():
        (line,) = lines
        np.testing.assert_allclose(np.linalg.norm(line, axis=1), 1 + level, atol=2e-3)
    segments = as_segments(found[0.0])
    assert segments.shape == (len(found[0.0][0]) - 1, 2, 3)
    assert as_segments([]).shape == (0, 2, 3)


@pytest.mark.parametrize("plane", [("x", 0.1), ("y", -0.2), ("z", 0.3), ((1.0, 2.0, 3.0), 0.2)])
def test_every_pixel_lies_where_the_pose_says(plane):
    shape = fields.sphere(1).translate((0.3, -0.1, 0.2)) | fields.box(0.5)
    found = section_picture(shape, plane, 64)
    height, width = found.image.shape[:2]
    rows, columns = np.indices((height, width))
    local = np.stack(
        [
            ((columns + 0.5) / width - 0.5) * found.width,
            ((rows + 0.5) / height - 0.5) * found.height,
            np.zeros((height, width)),
        ],
        axis=-1,
    )
    turn = Rotation.from_quat(found.wxyz, scalar_first=True)
    points = turn.apply(local.reshape(-1, 3)) + found.center
    values = shape(points).reshape(height, width)
    clear = np.abs(values) > 0.1  # beside the surface's line
    assert clear.sum() > 1000
    red, blue = found.image[..., 0].astype(int), found.image[..., 2].astype(int)
    np.testing.assert_array_equal((blue > red)[clear], (values < 0)[clear])
    assert (found.image[..., 3][values < 0] == 255).all()


def test_bad_input_is_refused():
    with pytest.raises(iw.InputError, match="opacity"):
        section_picture(fields.sphere(1), opacity=2)
    with pytest.raises(iw.InputError, match="spacing"):
        section_picture(fields.sphere(1), spacing=0)
    with pytest.raises(iw.InputError, match="normal"):
        plane_through((0, 0, 0), (0, 0, 0))


def test_two_balls_meet_in_a_circle():
    ball = trimesh.creation.icosphere(subdivisions=3)
    other = ball.copy()
    other.apply_translation((0.6, 0.05, 0.02))
    report = iw.check(trimesh.util.concatenate([ball, other]), referees=())
    found = self_intersection_highlights(report)
    assert found
    assert found.kinds.keys() == {"crossing"}
    assert len(found.contacts) == report.num_self_intersections
    # All contacts join to one closed line, on both balls.
    assert np.abs(np.linalg.norm(found.contacts, axis=-1) - 1).max() < 0.02
    assert np.abs(np.linalg.norm(found.contacts - (0.6, 0.05, 0.02), axis=-1) - 1).max() < 0.02
    length = np.linalg.norm(np.diff(found.contacts, axis=1), axis=-1).sum()
    apart = np.linalg.norm((0.6, 0.05, 0.02))
    assert length == pytest.approx(2 * np.pi * np.sqrt(1 - apart**2 / 4), rel=0.01)
    assert found.face_mask(len(report.faces)).sum() == len(found.faces)
    corners = report.vertices[report.faces[found.faces]].reshape(-1, 3)
    assert set(map(tuple, found.edges.reshape(-1, 3))) == set(map(tuple, corners))


def test_a_clean_mesh_has_nothing_to_highlight():
    found = self_intersection_highlights(iw.check(trimesh.creation.icosphere(), referees=()))
    assert not found
    assert found.edges.shape == found.contacts.shape == (0, 2, 3)

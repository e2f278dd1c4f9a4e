"""Edges and corners: as sharp as the shape's, in meshes that stay sound."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import fields as sdf
import implicit_warp as iw
from fields import Field
from implicit_warp.checking import check
from implicit_warp.extraction import NEAREST, extract, extract_mesh
from implicit_warp.extraction.sides import MARGIN, REACH


def part() -> Field:
    bars = sdf.cylinder(0.5).orient("x") | sdf.cylinder(0.5).orient("y") | sdf.cylinder(0.5)
    return (sdf.sphere(1.0) & sdf.box(1.5)) - bars


TURN = (33, (1, 2, 3))
SHAPES: dict[str, Field] = {
    "box": sdf.box(1.5),
    "tilted box": sdf.box((1.5, 1.0, 0.7)).rotate(*TURN),
    "part": part(),
    "tilted part": part().rotate(*TURN),
    "cone": sdf.cone(0.8, 1.6).rotate(20, "x"),
    "cylinder": sdf.cylinder(0.5, 1.3).rotate(17, (1, 1, 0)),
    "concave": sdf.box(1.0) | sdf.box(0.8).translate((0.5, 0.5, 0.3)),
    "tilted concave": (sdf.box(1.0) | sdf.box(0.8).translate((0.5, 0.5, 0.3))).rotate(*TURN),
    "cut by a wall": sdf.sphere(1.0) - sdf.box((3.0, 0.1, 3.0)).rotate(11, "z"),
    "octahedron": sdf.octahedron(1.0).rotate(*TURN),
    "wedge": sdf.box((2.0, 1.0, 1.0)) & sdf.plane((1, 0, 3)).rotate(3, "y"),
    "sphere": sdf.sphere(1.0),
}


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("resolution", [16, 31])
def test_sharp_meshes_are_sound_and_nothing_has_zero_area(name, resolution):
    mesh, report = extract_mesh(SHAPES[name], resolution, sharp=True)
    verdict = check(mesh)
    assert verdict.ok, str(verdict)
    assert mesh.area_faces.min() > 1e-6 * report.voxel**2
    assert len(mesh.vertices) == len(np.unique(mesh.faces))  # none is left unused


@pytest.mark.parametrize("seed", range(8))
def test_random_scenes_of_slabs_come_out_sound(seed):
    """Many edges of all angles in few voxels, far more than a voxel can show."""
    rng = np.random.default_rng(seed)
    field = sdf.box(rng.uniform(0.5, 1.5, 3)).rotate(*_random_turn(rng))
    for _ in range(6):
        other = sdf.box(rng.uniform(0.1, 1.5, 3)).rotate(*_random_turn(rng))
        other = other.translate(rng.uniform(-0.5, 0.5, 3))
        field = field - other if rng.random() < 0.4 else field | other
    verdict = check(extract(field, 24, sharp=True))
    assert verdict.ok, f"seed {seed}: {verdict}"


def _random_turn(rng: np.random.Generator) -> tuple[float, np.ndarray]:
    return rng.uniform(0, 360), rng.normal(size=3)


def edge_points(size: tuple[float, float, float]) -> np.ndarray:
    """Points on the twelve edges of a box, none within 0.15 of their length of a corner."""
    half, along = np.array(size) / 2, np.linspace(-0.7, 0.7, 161)
    points = []
    for axis in range(3):
        for signs in ((-1, -1), (-1, 1), (1, -1), (1, 1)):
            edge = np.empty((len(along), 3))
            edge[:, axis] = along * half[axis]
            edge[:, [i for i in range(3) if i != axis]] = signs * np.delete(half, axis)
            points.append(edge)
    return np.concatenate(points)


@pytest.mark.parametrize("resolution", [32, 57])
def test_edges_of_a_tilted_box_are_met_within_a_twentieth_of_a_voxel(resolution):
    size = (1.5, 1.0, 0.7)
    mesh, report = extract_mesh(SHAPES["tilted box"], resolution, sharp=True)
    places = edge_points(size) @ _turn_matrix().T
    sharp = np.abs(sdf.mesh(mesh)(places)) / report.voxel
    plain_mesh = extract(SHAPES["tilted box"], resolution, sharp=False)
    plain = np.abs(sdf.mesh(plain_mesh)(places)) / report.voxel
    assert sharp.max() < 0.05
    assert plain.max() > 0.3  # what the test would see of bevelled edges


def _turn_matrix() -> np.ndarray:
    x, y, z = (sdf.plane(axis).rotate(*TURN) for axis in "xyz")
    zero = np.zeros(3)
    return np.stack([f.gradient(zero) for f in (x, y, z)], axis=1)


def test_the_rims_of_the_part_are_circles():
    """Where the cylinders leave the flat faces: radius 0.5 in the planes at 0.75."""
    mesh, report = extract_mesh(part(), 64, sharp=True)
    angle = np.linspace(0, 2 * np.pi, 2000)
    rim = np.stack([0.5 * np.cos(angle), 0.5 * np.sin(angle), np.full(2000, 0.75)], axis=1)
    for turned in (rim, rim[:, [2, 0, 1]], -rim[:, [1, 2, 0]]):
        assert np.abs(sdf.mesh(mesh)(turned)).max() < 0.05 * report.voxel


def test_vertices_stay_at_the_surface():
    """Crossings may be moved by NEAREST, points of edges by the margin and what is brought back."""
    for name, field in SHAPES.items():
        mesh, report = extract_mesh(field, 40, sharp=True)
        off = np.abs(field(mesh.vertices)) / report.voxel
        if name == "cone":  # its tip may be left blunt
            off = np.sort(off)[:-1]
        assert off.max() < max(NEAREST, MARGIN + REACH) + 0.05, name


@pytest.mark.parametrize(
    ("field", "volume"),
    [
        (sdf.box((1.5, 1.0, 0.7)).rotate(*TURN), 1.05),
        (sdf.octahedron(1.0).rotate(*TURN), 4.0 / 3.0),
    ],
    ids=["box", "octahedron"],
)
def test_volumes_are_much_nearer_than_with_bevelled_edges(field, volume):
    sharp, plain = (extract(field, 40, sharp=s).volume for s in (True, False))
    assert abs(sharp - volume) < 0.15 * abs(plain - volume)
    assert abs(sharp - volume) < 1.5e-3 * volume


def test_the_twisted_plate_has_its_volume():
    """2 x 0.2 x 4, a full turn a unit of length: |grad| up to 6.4 where a distance was assumed."""
    plate = sdf.box((2.0, 0.2, 4.0)).twist(360.0)
    mesh = extract(plate, 128, sharp=True)
    verdict = check(mesh)
    assert verdict.ok, str(verdict)
    assert list(verdict.topology.genus) == [0]
    assert mesh.volume == pytest.approx(1.6, rel=3e-3)


def test_smooth_shapes_are_left_alone():
    plain, sharp = (extract(sdf.sphere(1.0), 40, sharp=s) for s in (False, True))
    assert np.array_equal(plain.vertices, sharp.vertices)
    assert np.array_equal(plain.faces, sharp.faces)


def test_the_scale_of_the_field_does_not_matter():
    steep = Field(1000.0 * SHAPES["tilted box"].expression, bounds=SHAPES["tilted box"].bounds)
    one, other = extract(SHAPES["tilted box"], 30, sharp=True), extract(steep, 30, sharp=True)
    assert len(one.faces) == len(other.faces)
    assert np.abs(one.vertices - other.vertices).max() < 1e-4


def test_a_warped_shape_keeps_its_edges():
    net = iw.TutteNet(4, resolution=5, frames="cubic")
    generator = torch.Generator().manual_seed(4)
    with torch.no_grad():
        for parameter in net.parameters():
            parameter += 0.2 * torch.randn(parameter.shape, generator=generator)
    warp = net.freeze()
    mesh, report = extract_mesh(iw.deform(sdf.box(1.2), warp), 64, sharp=True)
    assert report.search == "guided"
    assert check(mesh).ok
    places = warp(edge_points((1.2, 1.2, 1.2)))
    off = np.abs(sdf.mesh(mesh)(places)) / report.voxel
    # The map's own creases bend the edges, and are not followed where they are flat.
    assert np.quantile(off, 0.95) < 0.05


def test_shapes_cut_at_walls_have_sharp_rims():
    mesh = extract(sdf.sphere(1.0), 40, bounds=[[-0.5] * 3, [2.0] * 3], at_wall="close", sharp=True)
    assert check(mesh).ok

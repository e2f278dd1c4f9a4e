"""Meshes of known fields under known maps: no count may grow, no topology may change.

The table is what the library promises: sharp edges, smooth blends and thin walls, at rest and
under maps up to extreme ones, come out closed and free of self-intersections. The stored figures
are in `__mesh_baselines__`; `pytest tests/regression --update-mesh-baselines` rewrites them.

A map changes no topology, so each shape's is known and held against the mesh, apart from what is
stored. The extreme map is left out of that: it squeezes walls below a voxel, where marching cubes
drops or joins parts, which is no self-intersection and differs from resolution to resolution.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import pytest
import trimesh

import fields as sdf
import implicit_warp as iw


def drilled_ball() -> sdf.Field:
    """A ball cut flat on six sides and drilled along three axes."""
    shape = sdf.sphere(1) & sdf.box(1.5)
    for axis in "xyz":
        shape -= sdf.cylinder(0.5).orient(axis)
    return shape


def bracket() -> sdf.Field:
    """An angle of two plates with a hole in each."""
    foot = sdf.box((1.6, 1.0, 0.25)).translate((0, 0, -0.6))
    back = sdf.box((0.25, 1.0, 1.4)).translate((-0.675, 0, 0))
    holes = sdf.cylinder(0.2).translate((0.3, 0, 0)) | sdf.cylinder(0.2).orient("x")
    return (foot | back) - holes


def blended_joint() -> sdf.Field:
    """Three bars in a smooth union."""
    bars = [sdf.capsule((-0.7, 0, 0), (0.7, 0, 0), 0.25)]
    bars += [sdf.capsule((0, 0, 0), tip, 0.2) for tip in ((0, 0.8, 0.1), (0, -0.1, 0.8))]
    return sdf.union(*bars, smooth=0.2)


def bowl() -> sdf.Field:
    """Half of a hollow ball; its wall is a few voxels thick."""
    return sdf.sphere(0.9).shell(0.12) - sdf.above(0.2)


def tube() -> sdf.Field:
    """An open pipe with square ends."""
    return sdf.cylinder(0.5, 1.6) - sdf.cylinder(0.36)


def linked_rings() -> sdf.Field:
    """Two rings through each other, which do not touch."""
    one = sdf.torus(0.55, 0.15).translate((-0.3, 0, 0))
    return one | sdf.torus(0.55, 0.15).orient("y").translate((0.3, 0, 0))


def die() -> sdf.Field:
    """A box with a spherical hollow inside, that nothing opens."""
    return sdf.box(1.4) - sdf.sphere(0.5)


def identity() -> iw.Map:
    """No change."""
    return iw.Affine()


def sheared() -> iw.Map:
    """Sheared, stretched and shifted."""
    return iw.Affine([[1.2, 0.4, 0.0], [0.0, 0.9, -0.3], [0.1, 0.0, 1.1]], (0.3, -0.2, 0.1))


def random_net(layers: int, strength: float, seed: int) -> Callable[[], iw.Map]:
    """A TutteNet with normally distributed parameters of that standard deviation."""
    return cache(lambda: _random_net(layers, strength, seed))


def _random_net(layers: int, strength: float, seed: int) -> iw.Map:
    import torch

    net = iw.TutteNet(layers=layers, resolution=7, init="paper", seed=seed)
    with torch.no_grad():
        for parameter in net.parameters():
            parameter.mul_(strength)
    return net.freeze()


@cache
def twisted() -> iw.Map:
    """The tube, held below and turned by 50 degrees above; a short solve."""
    handles = [iw.hold(sdf.below(-0.6)), iw.move(sdf.above(0.6), rotate=("z", 50))]
    return iw.elastic(tube(), handles, layers=8, resolution=7, steps=60, samples=512, seed=1)


GENTLE = random_net(layers=4, strength=0.5, seed=11)
DEEP = random_net(layers=24, strength=0.5, seed=12)
STEEP = random_net(layers=1, strength=4.0, seed=14)
STRONG = random_net(layers=8, strength=1.0, seed=13)
EXTREME = random_net(layers=8, strength=4.0, seed=13)

GENERA = {
    drilled_ball: [5],
    bracket: [2],
    blended_joint: [0],
    bowl: [0],
    tube: [1],
    linked_rings: [1, 1],
    die: [0, 0],
}
"""Genus of each component of each shape, counted by hand."""

CASES = {
    "drilled_ball-identity-48": (drilled_ball, identity, 48),
    "drilled_ball-deep-40": (drilled_ball, DEEP, 40),
    "bracket-identity-33": (bracket, identity, 33),
    "bracket-sheared-40": (bracket, sheared, 40),
    "bracket-strong-40": (bracket, STRONG, 40),
    "blended_joint-gentle-32": (blended_joint, GENTLE, 32),
    "blended_joint-strong-40": (blended_joint, STRONG, 40),
    "bowl-identity-24": (bowl, identity, 24),
    "bowl-deep-48": (bowl, DEEP, 48),
    "tube-sheared-32": (tube, sheared, 32),
    "tube-twisted-48": (tube, twisted, 48),
    "tube-steep-40": (tube, STEEP, 40),
    "linked_rings-deep-40": (linked_rings, DEEP, 40),
    "linked_rings-strong-64": (linked_rings, STRONG, 64),
    "die-gentle-32": (die, GENTLE, 32),
}

SQUEEZED = {
    "drilled_ball-48": (drilled_ball, 48),
    "bracket-40": (bracket, 40),
    "bowl-64": (bowl, 64),
    "linked_rings-32": (linked_rings, 32),
}


@pytest.mark.parametrize(("make_field", "make_map", "resolution"), CASES.values(), ids=CASES.keys())
def test_a_warped_field_has_no_more_defects_than_stored(
    mesh_baseline, make_field, make_map, resolution
):
    mesh = iw.extract(iw.deform(make_field(), make_map()), resolution)
    report = mesh_baseline.check(mesh, topology=True)
    assert sorted(report.topology.genus) == GENERA[make_field]


@pytest.mark.parametrize(("make_field", "resolution"), SQUEEZED.values(), ids=SQUEEZED.keys())
def test_a_field_squeezed_below_a_voxel_has_no_more_defects_than_stored(
    mesh_baseline, make_field, resolution
):
    mesh_baseline.check(iw.extract(iw.deform(make_field(), EXTREME()), resolution))


def test_a_coarse_mesh_moved_by_its_vertices_has_the_stored_intersections(mesh_baseline):
    """Two sheets close together: the promise holds for fields, and not for flat faces.

    This entry is not zero, so that the comparison has something to compare.
    """
    sheets = [
        trimesh.creation.box((1.8, 1.8, 0.02)).apply_translation((0, 0, z)) for z in (0, 0.05)
    ]
    mesh = trimesh.util.concatenate(sheets)
    moved = iw.deform(trimesh.Trimesh(mesh.vertices, mesh.faces, process=False), EXTREME())
    report = mesh_baseline.check(moved, topology=True)
    assert report.num_self_intersections > 0


def test_one_more_defect_than_stored_fails(mesh_baseline):
    """The same comparison, sabotaged: a face less than in the stored mesh."""
    mesh = iw.extract(drilled_ball(), 24)
    mesh_baseline.check(mesh, "whole", topology=True)
    if mesh_baseline.update:
        return
    holed = trimesh.Trimesh(mesh.vertices, mesh.faces[1:], process=False)
    again = type(mesh_baseline)(mesh_baseline.path, mesh_baseline.key, update=False)
    with pytest.raises(AssertionError, match=r"open_edges +0 -> 3"):
        again.check(holed, "whole", topology=True)

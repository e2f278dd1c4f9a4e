"""Parts thinner than a voxel: found, or warned of, and never a hole."""

from __future__ import annotations

import warnings
from functools import partial

import numpy as np
import pytest

import fields as sdf
import implicit_warp as iw
from implicit_warp import extraction
from implicit_warp.checking import check
from implicit_warp.errors import InputError
from implicit_warp.extraction import ThinParts

# Signs and crossings alone: what is done at edges of the shape has tests of its own.
extract = partial(extraction.extract, sharp=False)
extract_mesh = partial(extraction.extract_mesh, sharp=False)


def sheet(voxels: float, resolution: int) -> sdf.Field:
    """A sheet of 2 x 1.6, so many voxels thick at a resolution, tilted against the lattice."""
    voxel = 2.0 / (resolution - 4)
    return sdf.box((2.0, 1.6, voxels * voxel)).rotate(23, (1, 2, 0.3))


def test_a_sheet_of_a_third_of_a_voxel_is_found_whole():
    field = sheet(0.3, 32)
    holed = extract(field, 32)
    mesh, report = extract_mesh(field, 32, thin="refine", sharp=True)
    verdict = check(mesh)
    assert verdict.ok, str(verdict)
    assert list(verdict.topology.genus) == [0]
    assert report.resolution in (64, 128, 256)
    thickness = 0.3 * 2.0 / 28
    assert mesh.volume == pytest.approx(2.0 * 1.6 * thickness, rel=0.02)
    assert len(holed.split()) > 1 or holed.volume < 0.9 * mesh.volume


@pytest.mark.parametrize("size", [0.5, 1.0])
def test_a_ball_of_a_voxel_is_found_and_a_missed_one_is_named(size):
    box = [[-1.0] * 3, [1.0] * 3]
    voxel = 2.0 / 32
    ball = sdf.sphere(size * voxel / 2, np.full(3, 0.5 * voxel))  # in the middle of a cell
    with pytest.raises(InputError, match=r'between the lattice points.*thin="refine"'):
        extract(ball, 32, bounds=box)
    mesh = extract(ball, 32, bounds=box, thin="refine")
    assert check(mesh).ok
    assert np.allclose(mesh.vertices.mean(axis=0), 0.5 * voxel, atol=0.1 * voxel)


def test_small_parts_beside_large_ones_are_found():
    crumb = sdf.sphere(0.015, (0.874, 0.874, 0.874))  # less than a voxel of 0.05
    field, box = sdf.sphere(0.8) | crumb, [[-1] * 3, [1] * 3]
    with pytest.warns(ThinParts, match=r'1 cells.*thin="refine"'):
        assert len(extract(field, 40, bounds=box).split()) == 1
    mesh, report = extract_mesh(field, 40, bounds=box, thin="refine")
    assert len(mesh.split()) == 2
    assert report.resolution > 40


def test_a_gap_in_a_solid_is_a_thin_part_too():
    field = sdf.box(1.5) - sdf.box((3.0, 3.0, 0.02)).rotate(20, "x")
    assert len(extract(field, 40).split()) == 1
    assert len(extract(field, 40, thin="refine").split()) == 2


def test_what_voxels_resolve_is_not_called_thin():
    with warnings.catch_warnings():
        warnings.simplefilter("error", ThinParts)
        for field in (
            sdf.sphere(1.0),
            sdf.box((1.5, 1.0, 0.7)).rotate(33, (1, 2, 3)),
            sdf.cone(0.8, 1.6).rotate(20, "x"),
            (sdf.sphere(1) & sdf.box(1.5)) - sdf.cylinder(0.5),
            iw.deform(sdf.box(1.0), iw.TutteNet(2).freeze()),
        ):
            _, report = extract_mesh(field, 40, thin="refine")
            assert report.resolution == 40
            assert report.thin_cells == 0


def test_thin_parts_of_distances_and_of_carried_fields_are_seen():
    field = sheet(0.3, 32)
    opaque = sdf.from_function(lambda p: field.tape.evaluate(p), lipschitz=1.0, bounds=field.bounds)
    for thing in (opaque, iw.deform(field, iw.TutteNet(2).freeze())):
        mesh = extract(thing, 32, thin="refine")
        assert list(check(mesh).topology.genus) == [0]


def test_there_is_no_such_choice():
    with pytest.raises(InputError, match="thin"):
        extract(sdf.sphere(1.0), 16, thin="maybe")

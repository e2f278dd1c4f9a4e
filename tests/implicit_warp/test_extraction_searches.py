"""Three ways to find the crossed cells: the same cells as by sampling every lattice point."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
import torch

import fields as sdf
import implicit_warp as iw
from fields.expression import exp
from implicit_warp import extraction
from implicit_warp.checking import check
from implicit_warp.errors import InputError
from implicit_warp.extraction import NEAREST
from implicit_warp.extraction import guided as guided_search
from implicit_warp.extraction.lattice import lattice_for
from implicit_warp.extraction.meshing import _COARSE
from implicit_warp.extraction.placement import PRECISION
from tests.implicit_warp.dense_marching_cubes import crossed_edges, dense_crossings

# Signs and crossings alone: what is done at edges of the shape has tests of its own.
extract = partial(extraction.extract, sharp=False)
extract_mesh = partial(extraction.extract_mesh, sharp=False)


def part() -> sdf.Field:
    bars = sdf.cylinder(0.5).orient("x") | sdf.cylinder(0.5).orient("y") | sdf.cylinder(0.5)
    return (sdf.sphere(1.0) & sdf.box(1.5)) - bars


def random_warp(seed: int = 0, strength: float = 0.5) -> iw.Warp:
    net = iw.TutteNet(6, resolution=7, frames="cubic")
    generator = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        for parameter in net.parameters():
            parameter += strength * torch.randn(parameter.shape, generator=generator)
    return net.freeze()


def noise(lipschitz: float, seed: int) -> sdf.Field:
    """A random smooth field with a stated Lipschitz bound, positive at the border of its box."""
    rng = np.random.default_rng(seed)
    waves = rng.normal(size=(6, 3)) * 3
    phases, sizes = rng.uniform(0, 6, 6), rng.uniform(0.5, 1.0, 6)
    sizes *= lipschitz / (sizes * np.linalg.norm(waves, axis=1)).sum()

    def value(points: torch.Tensor) -> torch.Tensor:
        phase = points @ points.new_tensor(waves.T) + points.new_tensor(phases)
        waved = (points.new_tensor(sizes) * torch.sin(phase)).sum(-1)
        return torch.maximum(waved, lipschitz * (points.abs().amax(-1) - 0.9))

    return sdf.from_function(value, lipschitz=lipschitz, bounds=[[-1] * 3, [1] * 3])


FIELDS = {
    "part": part(),
    "tilted box": sdf.box((1.5, 1.0, 0.7)).rotate(33, (1, 2, 3)),
    "uneven scale": sdf.torus(1.0, 0.3).scale((1.0, 1.5, 1.1)),
    "noise": noise(2.0, 1),
}


@pytest.mark.parametrize("search", ["enclosures", "distance"])
@pytest.mark.parametrize("name", FIELDS)
@pytest.mark.parametrize("resolution", [21, 37])
def test_searches_find_every_crossed_edge_and_no_other(search, name, resolution):
    field = FIELDS[name]
    mesh = extract(field, resolution, search=search)
    edges, doubled, faces = dense_crossings(field, resolution)
    assert crossed_edges(mesh.vertices, field, resolution) == edges
    assert len(mesh.faces) == len(faces)
    assert len(mesh.vertices) == len(doubled)


@pytest.mark.parametrize("seed", range(3))
def test_the_guided_search_finds_what_the_others_find(seed):
    field = iw.deform(part(), random_warp(seed))
    mesh, report = extract_mesh(field, 48)
    assert report.search == "guided"
    edges, _, faces = dense_crossings(field, 48)
    assert crossed_edges(mesh.vertices, field, 48) == edges
    assert len(mesh.faces) == len(faces)
    assert report.samples_at_rest > 0


def test_the_guided_search_samples_little_of_the_lattice():
    _, report = extract_mesh(iw.deform(part(), random_warp(3, 0.2)), 128)
    # Two lattice points a crossed cell, of which a surface of area A has A / voxel^2 times 1.5.
    assert report.lattice_samples < 2.2 * report.cells
    assert report.share_sampled < 0.1


@pytest.mark.parametrize("kept", [1, 7])
def test_the_guided_surface_is_closed_whatever_the_seeds(kept, monkeypatch):
    """All but a few seeds are lost, and what is found is the same."""
    field = iw.deform(part(), random_warp(1))
    whole = extract(field, 32)
    seeds = guided_search.seeds
    monkeypatch.setattr(guided_search, "seeds", lambda *a: seeds(*a)[:kept])
    few = extract(field, 32)
    assert len(few.faces) == len(whole.faces)
    assert check(few).ok


def test_warps_of_warps_are_guided_by_the_guided():
    field = iw.deform(iw.deform(part(), random_warp(1, 0.2)), random_warp(2, 0.2))
    mesh, report = extract_mesh(field, 40)
    assert report.search == "guided"
    assert crossed_edges(mesh.vertices, field, 40) == dense_crossings(field, 40)[0]


def test_unions_of_warped_fields_are_searched_by_enclosures_of_the_map():
    field = iw.deform(part(), random_warp(1, 0.2)) | sdf.sphere(0.3, (0.0, 0.0, 1.0))
    mesh, report = extract_mesh(field, 160)
    assert report.search == "enclosures"
    assert report.share_sampled < 0.3  # with less voxels blocks of eight are too large for bounds
    guided = extract(iw.deform(part(), random_warp(1, 0.2)), 160, bounds=field.bounds)
    both = check(mesh).topology
    assert sorted(both.genus) == sorted([*check(guided).topology.genus, 0])


def test_walls_cut_a_guided_surface():
    field, box = iw.deform(sdf.sphere(1.0), random_warp(1, 0.2)), [[-0.5] * 3, [2.0] * 3]
    with pytest.raises(InputError, match="x min, y min, z min"):
        extract(field, 40, bounds=box)
    mesh = extract(field, 40, bounds=box, at_wall="close")
    assert check(mesh).ok
    dense = extract(field, 40, bounds=box, at_wall="close", search="enclosures")
    assert len(mesh.faces) == len(dense.faces)


def test_a_box_inside_of_a_warped_shape_is_closed_at_all_walls():
    field, box = iw.deform(sdf.sphere(9.0), random_warp(1, 0.2)), [[-0.5] * 3, [0.5] * 3]
    mesh = extract(field, 20, bounds=box, at_wall="close")
    assert mesh.volume == pytest.approx(1.0, rel=0.01)


def test_distances_are_sampled_near_the_surface_only():
    seen = []

    def counted(points: torch.Tensor) -> torch.Tensor:
        seen.append(len(points))
        return points.norm(dim=-1) - 1.0

    field = sdf.from_function(counted, exact=True, bounds=[[-1] * 3, [1] * 3])
    _, report = extract_mesh(field, 128, polishing=0)
    assert report.search == "distance"
    assert sum(seen) == report.samples
    # Cells with a corner within 1.73 voxels of the surface, of one point each, and their borders.
    assert report.lattice_samples < 6 * report.cells


def test_auto_chooses_by_what_the_field_is():
    chosen = {
        name: extract_mesh(field, 16)[1].search
        for name, field in {
            "arithmetic": part(),
            "function": noise(2.0, 0),
            "unknown": sdf.from_function(lambda p: p.norm(dim=-1) - 1, bounds=[[-1] * 3, [1] * 3]),
            "warped": iw.deform(part(), random_warp()),
        }.items()
    }
    assert chosen == {
        "arithmetic": "enclosures",
        "function": "distance",
        "unknown": "enclosures",
        "warped": "guided",
    }


@pytest.mark.parametrize("seed", range(12))
def test_random_fields_of_lipschitz_bound_two_have_no_hole(seed):
    field = noise(2.0, seed)
    report = check(extract(field, 40))
    assert report.ok, str(report)


def test_results_repeat_bit_for_bit():
    for field in (part(), iw.deform(part(), random_warp())):
        first, second = extract(field, 30), extract(field, 30)
        assert np.array_equal(first.vertices, second.vertices)
        assert np.array_equal(first.faces, second.faces)


def test_vertices_lie_on_the_surface_of_a_field_that_is_no_distance():
    """exp(20 d) - 1 bends so much within a voxel h = 0.07 that linear interpolation errs by 20 h
    over 8 of a voxel in the middle of an edge, at first order."""
    sphere = sdf.sphere(1.0)
    bent = sdf.Field(exp(20.0 * sphere.expression) - 1.0, bounds=sphere.bounds)
    voxel = lattice_for(bent, 32, None).voxel
    plain = extract(bent, 32, polishing=0, dtype=torch.float64)
    polished = extract(bent, 32, dtype=torch.float64)
    off = [np.abs(np.linalg.norm(m.vertices, axis=1) - 1).max() / voxel for m in (plain, polished)]
    assert off[0] > 0.1
    assert off[1] < NEAREST + PRECISION


def test_a_carried_field_that_a_coarse_look_misses_is_still_found():
    """Two balls far apart: at rest, each lies between the points of the coarse lattice."""
    ball = sdf.sphere(0.015)
    balls = ball.translate((-1, 0.013, 0.017)) | ball.translate((1, 0.01, 0))
    with pytest.raises(InputError, match="no surface"):
        extract(balls, _COARSE, thin="ignore")
    mesh = iw.extract(iw.deform(balls, random_warp(1, 0.1)), 400, search="guided")
    assert mesh.is_watertight
    assert mesh.body_count == 2

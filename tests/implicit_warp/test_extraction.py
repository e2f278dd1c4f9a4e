"""Laws of `extract`: sound meshes from any samples whatever, and true surfaces from fields."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
import torch

import fields as sdf
from implicit_warp import extraction
from implicit_warp.checking import check
from implicit_warp.errors import InputError
from implicit_warp.extraction import NEAREST
from implicit_warp.extraction.lattice import lattice_for

# Signs and crossings alone: what is done at edges of the shape has tests of its own.
extract = partial(extraction.extract, sharp=False)


def field_of_samples(values: np.ndarray) -> tuple[sdf.Field, np.ndarray]:
    """A field that takes given values at the points of an integer lattice, and its box."""
    table = torch.from_numpy(np.asarray(values, dtype=np.float64))

    def look_up(points: torch.Tensor) -> torch.Tensor:
        i, j, k = points.round().long().unbind(-1)
        return table[i, j, k].to(points.dtype)

    box = np.array([[0, 0, 0], values.shape]) - [[0], [1]]
    return sdf.from_function(look_up), box


def extract_samples(values: np.ndarray, **options):
    field, box = field_of_samples(values)
    resolution = max(values.shape) - 1
    return extract(field, resolution, bounds=box, dtype=torch.float64, **options)


def walled(values: np.ndarray) -> np.ndarray:
    """The same samples with a wall of outside ones around them."""
    return np.pad(values, 1, constant_values=1.0)


def assert_sound(mesh, *, referee: bool = True) -> None:
    report = check(mesh, referees=("manifold3d",) if referee else ())
    assert report.ok, str(report)
    assert not len(report.topology.unreferenced_vertices)


HARD_VALUES = {
    "signs": [-1.0, 1.0],
    "ties": [-1.0, 0.0, 1.0],
    "zeros and negatives": [-1.0, 0.0],
    "nearly zero": [-1e-300, 1e-300, 0.0, -1.0, 1.0],
    "all scales": [s * 10.0**e for s in (-1, 1) for e in (-300, -30, -3, 0, 3, 30, 300)],
}


@pytest.mark.parametrize("at_wall", ["error", "close"])
@pytest.mark.parametrize("palette", HARD_VALUES)
@pytest.mark.parametrize("seed", range(3))
def test_any_samples_give_a_sound_mesh(palette: str, seed: int, at_wall: str) -> None:
    values = np.random.default_rng(seed).choice(HARD_VALUES[palette], (13, 9, 11))
    if at_wall == "error":
        values = walled(values)
    assert_sound(extract_samples(values, at_wall=at_wall))


@pytest.mark.parametrize("seed", range(4))
def test_each_of_the_256_corner_masks_gives_a_sound_mesh(seed: int) -> None:
    """Every sign pattern of a cell, its crossings at either extreme of their edges."""
    rng = np.random.default_rng(seed)
    volume = np.ones((4 * 16, 4 * 16, 4))
    for mask in range(256):
        corners = np.array([mask >> bit & 1 for bit in range(8)]).reshape(2, 2, 2)
        i, j = 4 * (mask // 16), 4 * (mask % 16)
        volume[i + 1 : i + 3, j + 1 : j + 3, 1:3] = 1.0 - 2.0 * corners
    volume *= 10.0 ** rng.choice([-6, 0, 6], volume.shape)
    mesh = extract_samples(volume)
    assert_sound(mesh)


def test_smooth_noise_through_a_lattice_gives_a_sound_mesh() -> None:
    from scipy.ndimage import gaussian_filter

    values = gaussian_filter(np.random.default_rng(0).standard_normal((40, 40, 40)), 1.0)
    assert_sound(extract_samples(walled(np.round(values, 1))))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("size", [1.0, 1.25, 2.0])
def test_cube_with_its_faces_on_lattice_planes_is_sound(size: float, dtype: torch.dtype) -> None:
    mesh = extract(
        sdf.box(size), 16, bounds=[[-2, -2, -2], [2, 2, 2]], dtype=dtype
    )  # voxels of 1/4: faces on lattice planes for 1 and 2, between them for 1.25
    assert_sound(mesh)
    # Edges are bevelled within half a voxel at most: less than 12 edges of that section.
    assert size**3 - 12 * size * 0.25**2 < mesh.volume < (size + 2 * NEAREST * 0.25) ** 3


def test_plane_through_samples_is_closed_at_the_walls() -> None:
    mesh = extract(sdf.below(0.0), 10, bounds=[[-1, -1, -1], [1, 1, 1]], at_wall="close")
    assert_sound(mesh)
    slack = 0.2 * NEAREST * (1 + 1e-9)
    assert np.abs(mesh.bounds - [[-1, -1, -1], [1, 1, 0]]).max() <= slack


def test_vertices_lie_on_the_surface_up_to_interpolation() -> None:
    """Linear interpolation over a voxel h of a distance with curvature 1/r errs by h^2 / (8 r)
    at most, to leading order; twice that is allowed, and NEAREST of a voxel for the push."""
    mesh = extract(sdf.sphere(1.0), 40, dtype=torch.float64)
    voxel = lattice_for(sdf.sphere(1.0), 40, None).voxel
    off = np.abs(np.linalg.norm(mesh.vertices, axis=1) - 1.0)
    assert off.max() < voxel**2 / 4 + NEAREST * voxel


def test_volume_of_a_sphere_converges_with_second_order() -> None:
    exact = 4.0 / 3.0 * np.pi
    errors = [exact - extract(sdf.sphere(1.0), n, dtype=torch.float64).volume for n in (20, 40, 80)]
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    # The voxel is the side over n - 4, so doubling n shrinks it by 36/16 and 76/36.
    expected = 2 * np.log2([36 / 16, 76 / 36])
    assert np.allclose(orders, expected, atol=0.3), orders


def test_faces_point_outward() -> None:
    mesh = extract(sdf.sphere(1.0) - sdf.sphere(0.5), 32)
    outward = np.einsum("ij,ij->i", mesh.face_normals, mesh.triangles_center)
    outer = np.linalg.norm(mesh.triangles_center, axis=1) > 0.75
    assert (outward[outer] > 0).all()
    assert (outward[~outer] < 0).all()


def part() -> sdf.Field:
    bars = sdf.cylinder(0.5).orient("x") | sdf.cylinder(0.5).orient("y") | sdf.cylinder(0.5)
    return (sdf.sphere(1.0) & sdf.box(1.5)) - bars


def untagged(field: sdf.Field, factor: float = 1.0) -> sdf.Field:
    """The same field without its Lipschitz bound, so that nothing is skipped."""
    return sdf.from_function(lambda p: factor * field.evaluate(p), bounds=field.bounds)


@pytest.mark.parametrize("resolution", [13, 48, 90])
def test_skipping_blocks_changes_nothing(resolution: int) -> None:
    pruned, dense = extract(part(), resolution), extract(untagged(part()), resolution)
    assert np.array_equal(pruned.faces, dense.faces)
    # A function is evaluated by torch, whose norms round otherwise than the compiled ones.
    assert np.allclose(pruned.vertices, dense.vertices, rtol=0, atol=1e-6)


def test_skipping_blocks_spares_most_samples() -> None:
    seen = []

    def counted(points: torch.Tensor) -> torch.Tensor:
        seen.append(len(points))
        return points.norm(dim=-1) - 1.0

    extract(sdf.from_function(counted, exact=True, bounds=[[-1, -1, -1], [1, 1, 1]]), 256)
    # Corners of cells within 1.73 voxels of a sphere of radius 126 are sampled: a band that is 0.04
    # of the volume; blocks of two that it touches have corners up to that far again.
    assert sum(seen) < 0.09 * 256**3


def test_skipped_inside_is_capped_at_the_walls() -> None:
    """The walls' own points are never near the surface here, and are not sampled."""
    box = [[-1, -1, -1], [1, 1, 1]]
    mesh = extract(sdf.sphere(10.0), 64, bounds=box, at_wall="close")
    assert_sound(mesh)
    assert mesh.volume == pytest.approx(8.0, rel=4 * NEAREST)


@pytest.mark.parametrize("factor", [1e-20, 1e20])
def test_scale_of_the_field_does_not_matter(factor: float) -> None:
    plain = extract(untagged(part()), 40, dtype=torch.float64)
    scaled = extract(untagged(part(), factor), 40, dtype=torch.float64)
    assert np.array_equal(plain.faces, scaled.faces)
    assert np.allclose(plain.vertices, scaled.vertices, rtol=0, atol=1e-12)


def test_batch_size_does_not_matter() -> None:
    small, large = extract(part(), 24, block=7), extract(part(), 24)
    # Vectorised kernels may round differently at the end of a batch, by an ulp of float32.
    assert np.array_equal(small.faces, large.faces)
    assert np.allclose(small.vertices, large.vertices, rtol=0, atol=1e-5)


def test_level_moves_the_surface() -> None:
    box = [[-2, -2, -2], [2, 2, 2]]
    mesh = extract(sdf.sphere(1.0), 40, bounds=box, level=0.5)
    assert np.allclose(np.linalg.norm(mesh.vertices, axis=1), 1.5, atol=0.1**2)


def test_flat_boxes_get_cubic_voxels_and_few_of_them() -> None:
    lattice = lattice_for(sdf.sphere(1.0), 100, [[0, 0, 0], [1.0, 0.25, 0.031]])
    assert lattice.shape == (101, 26, 5)
    assert lattice.voxel == pytest.approx(0.01)
    assert np.allclose(lattice.origin, [0, 0, -0.0045])


def test_progress_rises_to_its_total() -> None:
    calls = []
    extract(part(), 300 // 2, progress=lambda done, total: calls.append((done, total)))
    done, totals = zip(*calls, strict=True)
    assert list(done) == sorted(set(done))
    assert done[-1] == totals[-1]


# --- bad input --------------------------------------------------------------------------------


def test_inside_at_a_wall_is_refused_by_name_of_the_wall() -> None:
    with pytest.raises(InputError, match=r"wall of this box at y max, so.*at_wall=\"close\""):
        extract(sdf.sphere(1.0), 32, bounds=[[-2, -2, -2], [2, 0.5, 2]])


def test_every_wall_that_is_reached_is_named() -> None:
    with pytest.raises(InputError, match="x min, x max, y min, y max, z min, z max"):
        extract(sdf.sphere(9.0), 8, bounds=[[-1, -1, -1], [1, 1, 1]])


def test_empty_surface_is_refused_with_the_range_of_values() -> None:
    field = untagged(sdf.sphere(1.0).translate([9, 0, 0]))
    with pytest.raises(InputError, match=r"between 7 and 9\.\d+, and none"):
        extract(field, 16, bounds=[[-1, -1, -1], [1, 1, 1]])


def test_empty_bounds_are_refused() -> None:
    with pytest.raises(InputError, match="bounds"):
        extract(sdf.box(1.0) & sdf.box(1.0).translate([3, 3, 3]), 16)


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_values_that_are_not_finite_are_refused_with_count_and_place(bad: float) -> None:
    values = np.ones((6, 6, 6))
    values[3, 3, 3] = -1.0
    values[2, 4, 1] = values[5, 5, 5] = bad
    with pytest.raises(
        InputError, match=r"values in one batch are NaN or inf.* at \[2\.0, 4\.0, 1\.0\]"
    ):
        extract_samples(values)


def test_unbounded_field_needs_bounds() -> None:
    with pytest.raises(InputError, match="Pass bounds="):
        extract(sdf.below(0.0))


def test_false_lipschitz_bound_is_detected() -> None:
    liar = sdf.from_function(
        lambda p: 1.5 * (p.norm(dim=-1) - 1.0), lipschitz=1.0, bounds=[[-1, -1, -1], [1, 1, 1]]
    )
    with pytest.raises(InputError, match="Lipschitz bound, or what encloses its values, rules out"):
        extract(liar, 64)


def test_field_with_values_of_the_wrong_shape_is_refused() -> None:
    field = sdf.from_function(lambda p: p[..., :2], bounds=[[-1, -1, -1], [1, 1, 1]])
    with pytest.raises(InputError):
        extract(field, 16)


@pytest.mark.parametrize(
    ("argument", "options"),
    [
        ("resolution", {"resolution": 3}),
        ("resolution", {"resolution": 64.0}),
        ("resolution", {"bounds": [[1e6, 0, 0], [1e6 + 1, 1, 1]]}),
        ("bounds", {"bounds": [[1, 1, 1], [0, 0, 0]]}),
        ("bounds", {"bounds": [[0, 0], [1, 1]]}),
        ("bounds", {"bounds": [[0, 0, 0], [1, 1, float("nan")]]}),
        ("bounds", {"bounds": "box"}),
        ("at_wall", {"at_wall": "open"}),
        ("level", {"level": float("nan")}),
        ("dtype", {"dtype": torch.float16}),
        ("block", {"block": 0}),
        ("search", {"search": "octree"}),
        ("search", {"search": "guided"}),
        ("polishing", {"polishing": -1}),
    ],
)
def test_bad_arguments_are_refused_by_name(argument: str, options: dict) -> None:
    with pytest.raises(InputError) as refusal:
        extract(sdf.sphere(1.0), **options)
    assert refusal.value.argument == argument


def test_a_function_is_no_field_and_the_remedy_says_so() -> None:
    with pytest.raises(InputError, match="from_function"):
        extract(lambda p: p.norm(dim=-1) - 1)

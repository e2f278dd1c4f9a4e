"""Deformation gradients: exact for affine maps, and the same as a plain loop over faces."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import torch
import trimesh

from implicit_warp.errors import InputError
from implicit_warp.mesh_gradient import MeshGradient

DTYPES = pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=str)


def source_mesh() -> tuple[torch.Tensor, torch.Tensor]:
    mesh = trimesh.creation.icosphere(subdivisions=1)
    vertices = torch.tensor(mesh.vertices) * torch.tensor([1.0, 0.7, 1.3])
    return vertices, torch.tensor(mesh.faces)


def loop_oracle(vertices, faces, positions) -> np.ndarray:
    """Each face on its own: the least-squares gradient along the face's two edges."""
    gradients = []
    for face in faces.tolist():
        rest = np.stack([(vertices[c] - vertices[face[0]]).numpy() for c in face[1:]], -1)
        moved = np.stack([(positions[c] - positions[face[0]]).numpy() for c in face[1:]], -1)
        gradients.append(moved @ np.linalg.pinv(rest))
    return np.stack(gradients)


def normals(vertices, faces) -> torch.Tensor:
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    normal = torch.linalg.cross(b - a, c - a)
    return normal / normal.norm(dim=-1, keepdim=True)


@DTYPES
def test_affine_maps_have_their_own_gradient_within_each_face(dtype, rng):
    vertices, faces = source_mesh()
    linear, offset = torch.tensor(rng.normal(size=(3, 3))), torch.tensor(rng.normal(size=3))
    found = MeshGradient(vertices, faces)((vertices @ linear.T + offset).to(dtype))
    n = normals(vertices, faces)
    expected = linear @ (torch.eye(3, dtype=torch.float64) - n[:, :, None] * n[:, None, :])
    # Three products with hat gradients of at most 1 / height; heights here are above 0.3, so the
    # rounding of positions of size about 3 is multiplied by some 3 * 3 / 0.3.
    tolerance = 100 * torch.finfo(dtype).eps
    assert found.dtype == dtype
    assert (found - expected).abs().max() < tolerance
    assert (found.double() @ n[:, :, None]).abs().max() < tolerance  # nothing along the normal


def test_the_identity_has_gradient_i_minus_nn(rng):
    vertices, faces = source_mesh()
    n = normals(vertices, faces)
    found = MeshGradient(vertices, faces)(vertices)
    expected = torch.eye(3, dtype=torch.float64) - n[:, :, None] * n[:, None, :]
    torch.testing.assert_close(found, expected, rtol=0, atol=1e-13)


def test_equal_to_a_loop_over_faces(rng):
    vertices, faces = source_mesh()
    positions = torch.tensor(rng.normal(size=vertices.shape))
    found = MeshGradient(vertices, faces)(positions)
    np.testing.assert_allclose(
        found.numpy(), loop_oracle(vertices, faces, positions), rtol=0, atol=1e-12
    )


def test_equal_to_central_differences_along_each_face(rng):
    """D_f t is the derivative of the piecewise-linear map along any tangent t of the face."""
    vertices, faces = source_mesh()
    positions = torch.tensor(rng.normal(size=vertices.shape))
    gradient = MeshGradient(vertices, faces)(positions)
    step = 1e-3  # the map is linear within a face, so only rounding / step is lost

    def mapped(face: torch.Tensor, point: torch.Tensor) -> torch.Tensor:
        """Interpolate by areas, each measured on its own."""
        corners = vertices[face]

        def area(a, b, c):
            return torch.linalg.cross(b - a, c - a).norm()

        parts = torch.stack([
            area(point, corners[1], corners[2]),
            area(corners[0], point, corners[2]),
            area(corners[0], corners[1], point),
        ])  # fmt: skip
        return (parts / parts.sum()) @ positions[face]

    for f in range(0, len(faces), 7):
        corners = vertices[faces[f]]
        centre = corners.mean(0)
        for corner in range(2):
            tangent = corners[corner] - centre
            ahead, behind = (mapped(faces[f], centre + s * step * tangent) for s in (1, -1))
            np.testing.assert_allclose(
                gradient[f] @ tangent, (ahead - behind) / (2 * step), rtol=0, atol=1e-10
            )


@DTYPES
@pytest.mark.parametrize("weighting", ["area", "uniform"])
def test_squared_distance_is_the_weighted_mean_over_faces(dtype, weighting, rng):
    vertices, faces = source_mesh()
    operator = MeshGradient(vertices, faces, weighting)
    a, b = (torch.tensor(rng.normal(size=vertices.shape)) for _ in range(2))
    per_face = np.square(loop_oracle(vertices, faces, a - b)).sum((1, 2))
    areas = trimesh.Trimesh(vertices.numpy(), faces.numpy(), process=False).area_faces
    np.testing.assert_allclose(operator.areas.numpy(), areas, rtol=1e-12)
    expected = np.average(per_face, weights=areas if weighting == "area" else None)
    found = operator.squared_distance(a.to(dtype), b.to(dtype))
    # The terms of a row of L are at most a few times its sum; 42 vertices and 3 coordinates.
    assert float(found) == pytest.approx(expected, rel=200 * torch.finfo(dtype).eps)


def test_gradients_are_right_to_second_order(rng):
    vertices, faces = source_mesh()
    operator = MeshGradient(vertices, faces)
    target = torch.tensor(rng.normal(size=vertices.shape))
    positions = torch.tensor(rng.normal(size=vertices.shape), requires_grad=True)
    chosen = torch.arange(0, len(faces), 9)

    def energy(p):
        return operator(p)[chosen].pow(3).sum()

    def distance(p):
        return operator.squared_distance(p, target)

    for function in (energy, distance):
        assert torch.autograd.gradcheck(function, positions)
        assert torch.autograd.gradgradcheck(function, positions)


@DTYPES
def test_both_ways_to_the_loss_have_one_gradient(dtype, rng):
    vertices, faces = source_mesh()
    operator = MeshGradient(vertices, faces)
    target, start = (torch.tensor(rng.normal(size=vertices.shape), dtype=dtype) for _ in range(2))
    weights = (operator.areas / operator.areas.sum()).to(dtype)
    found = []
    for form in ("faces", "quadratic"):
        p = start.clone().requires_grad_()
        if form == "faces":
            squared = (operator(p) - operator(target)).square().sum((-1, -2))
            loss = (squared * weights).sum()
        else:
            loss = operator.squared_distance(p, target)
        found.append(torch.autograd.grad(loss, p)[0])
    error = (found[0] - found[1]).norm() / found[0].norm()
    assert error < 50 * torch.finfo(dtype).eps


def test_batches_are_single_meshes_side_by_side(rng):
    vertices, faces = source_mesh()
    operator = MeshGradient(vertices, faces)
    batch = torch.tensor(rng.normal(size=(2, 3, *vertices.shape)))
    gradients, distances = operator(batch), operator.squared_distance(batch, vertices)
    assert gradients.shape == (2, 3, len(faces), 3, 3)
    assert distances.shape == (2, 3)
    for i, j in itertools.product(range(2), range(3)):
        torch.testing.assert_close(gradients[i, j], operator(batch[i, j]))
        torch.testing.assert_close(
            distances[i, j], operator.squared_distance(batch[i, j], vertices)
        )


def test_scale_of_the_mesh_does_not_matter(rng):
    vertices, faces = source_mesh()
    positions = torch.tensor(rng.normal(size=vertices.shape))
    for scale in (1e-9, 1e9):
        scaled = MeshGradient(scale * vertices, faces)(scale * positions)
        torch.testing.assert_close(scaled, MeshGradient(vertices, faces)(positions))


def test_arrays_are_taken_as_well_as_tensors():
    vertices, faces = source_mesh()
    from_arrays = MeshGradient(vertices.numpy(), faces.numpy().astype(np.uint32))
    assert torch.equal(from_arrays(vertices), MeshGradient(vertices, faces)(vertices))
    assert repr(from_arrays) == "MeshGradient(vertices=42, faces=80)"


@pytest.mark.parametrize("kind", ["repeated vertex", "coincident vertices", "collinear"])
def test_faces_without_area_are_named(kind):
    vertices, faces = source_mesh()
    a, b, c = faces[17].tolist()
    if kind == "repeated vertex":
        faces[17, 1] = a
        named = "17"
    else:
        vertices = torch.cat([vertices, vertices[[a]]])
        # 0.3 and 0.7 are no binary fractions: the third point is collinear only to rounding.
        vertices[-1] = vertices[a] if kind[:3] == "coi" else 0.3 * vertices[b] + 0.7 * vertices[c]
        faces = torch.cat([faces, torch.tensor([[len(vertices) - 1, a, b]])])
        if kind == "collinear":
            faces[-1] = torch.tensor([len(vertices) - 1, b, c])
        named = "80"
    with pytest.raises(InputError, match=rf"faces without area have no gradient: {named}\."):
        MeshGradient(vertices, faces)


def test_thin_faces_with_an_area_are_kept():
    vertices = torch.tensor([[0.0, 0, 0], [1, 0, 0], [0.5, 1e-9, 0]], dtype=torch.float64)
    found = MeshGradient(vertices, torch.tensor([[0, 1, 2]]))(vertices)
    torch.testing.assert_close(found[0], torch.diag(torch.tensor([1.0, 1.0, 0.0]).double()))


def test_bad_arguments_are_explained(rng):
    vertices, faces = source_mesh()
    operator = MeshGradient(vertices, faces)
    nan = vertices.clone()
    nan[5, 1] = float("nan")
    for arguments, message in [
        ((vertices[:, :2], faces), r"vertices = \(42, 2\)"),
        ((vertices, faces[:, :2]), r"faces = \(80, 2\)"),
        ((vertices, faces[:0]), r"faces = \(0, 3\)"),
        ((vertices, faces.double()), "not whole numbers"),
        ((vertices[:-1], faces), "only vertices 0 to 40"),
        ((vertices, faces - 1), "faces = -1"),
        ((nan, faces), "the first is row 5"),
        ((vertices, faces, "volume"), "use one of area, uniform"),
    ]:
        with pytest.raises(InputError, match=message):
            MeshGradient(*arguments)
    with pytest.raises(InputError, match=r"end in \(42, 3\)"):
        operator(vertices[1:])
    with pytest.raises(InputError, match="b = "):
        operator.squared_distance(vertices, vertices.numpy())

"""Reference back end: any device, any dtype, differentiable through everything, simple.

Gradients flow to the points, the embeddings and the transitions, also through the Jacobian.  The
map is piecewise linear: which cell a point lies in is not differentiated (its derivative is zero
almost everywhere), and on a crease the gradient is that of the cell that was chosen.
"""

from __future__ import annotations

import torch
from torch import Tensor

from implicit_warp.layers import LayerStack
from implicit_warp.square_mesh import SquareMesh, mesh_tensor

_PAIRS_A_BLOCK = 1 << 22
"""Bound on (points x cells) tested at once by the exhaustive search of the inverse."""


def forward(stack: LayerStack, points: Tensor, jacobian: bool) -> tuple[Tensor, Tensor | None]:
    """f(points) for points (n, 3), and the Jacobians (n, 3, 3) if asked for."""
    tables = stack.tables.to(points.dtype)
    return _traverse(
        tables, stack.transitions, points, jacobian, lambda k, xy: locate_at_rest(xy, stack.mesh)
    )


def inverse(stack: LayerStack, points: Tensor, jacobian: bool) -> tuple[Tensor, Tensor | None]:
    """f^-1(points) for points (n, 3), and the Jacobians of f^-1 (n, 3, 3) if asked for."""
    tables = stack.inverse_tables.to(points.dtype).flip(0)
    return _traverse(
        tables,
        stack.inverse_transitions,
        points,
        jacobian,
        lambda k, xy: locate_in_image(xy, tables[k].detach(), stack.mesh),
    )


def _traverse(tables, transitions, points, jacobian, locate):
    transitions = transitions.to(points.dtype)
    linear, offset = transitions[..., :3], transitions[..., 3]
    q = points @ linear[0].T + offset[0]
    jac = linear[0].expand(len(points), 3, 3) if jacobian else None
    for k in range(len(tables)):
        with torch.no_grad():
            cell = locate(k, q[:, :2].detach())
        a00, a01, a10, a11, d0, d1 = tables[k].index_select(0, cell).unbind(-1)
        x, y, z = q.unbind(-1)
        q = torch.stack([a00 * x + a01 * y + d0, a10 * x + a11 * y + d1, z], -1)
        q = q @ linear[k + 1].T + offset[k + 1]
        if jac is not None:
            row_x, row_y, row_z = jac.unbind(-2)
            plane_x = a00[:, None] * row_x + a01[:, None] * row_y
            plane_y = a10[:, None] * row_x + a11[:, None] * row_y
            jac = linear[k + 1] @ torch.stack([plane_x, plane_y, row_z], -2)
    return q, jac


def locate_at_rest(xy: Tensor, mesh: SquareMesh) -> Tensor:
    """(n,) the cell of the rest mesh that holds each point (n, 2).

    Points on an edge belong to one of its cells; the map is continuous, so either serves.
    """
    n = mesh.resolution - 1
    scale = 0.5 * n
    x, y = xy.unbind(-1)
    # NaN stays NaN through every step; it is given a cell, so that it reaches the result.
    u, v = ((x + 1.0) * scale).nan_to_num(0.0), ((y + 1.0) * scale).nan_to_num(0.0)
    i = u.floor().clamp(0, n - 1)
    j = v.floor().clamp(0, n - 1)
    du, dv = u - i - 0.5, v - j - 0.5
    towards_x_or_y, towards_x_or_minus_y = du + dv >= 0, du - dv >= 0
    side = torch.where(
        towards_x_or_y,
        torch.where(towards_x_or_minus_y, 0, 1),
        torch.where(towards_x_or_minus_y, 3, 2),
    )
    triangle = 4 * (i * n + j).long() + side
    reach = torch.maximum(x.abs(), y.abs())
    return torch.where(reach <= 1.0, triangle, mesh.n_triangles + _cone_at_rest(x, y, reach, n))


def _cone_at_rest(x: Tensor, y: Tensor, reach: Tensor, n: int) -> Tensor:
    """(n,) the cone that holds each point, numbered along the boundary loop."""
    # The loop runs along the bottom, right, top and left side; the first two in the direction of
    # increasing x and y, the last two against it.
    vertical = x.abs() >= y.abs()
    first_half = torch.where(vertical, x, -y) > 0
    along = torch.where(vertical, y, x) / reach
    along = torch.where(first_half, along, -along)
    step = ((along + 1.0) * (0.5 * n)).nan_to_num(0.0).floor().clamp(0, n - 1).long()
    side = torch.where(vertical, 1, 0) + torch.where(first_half, 0, 2)
    return side * n + step


def locate_in_image(xy: Tensor, inverse_table: Tensor, mesh: SquareMesh) -> Tensor:
    """(n,) the cell whose image holds each point (n, 2), by testing every cell.

    The barycentric coordinates in the image cell are those of the pulled-back point in the rest
    cell.  Among all cells the one with the largest smallest coordinate is taken, so that rounding
    on a shared edge cannot leave a point without a cell.
    """
    forms = _coordinate_forms(inverse_table, mesh)
    cells = []
    for block in xy.split(max(1, _PAIRS_A_BLOCK // mesh.n_cells)):
        homogeneous = torch.cat([block, torch.ones_like(block[:, :1])], -1)
        coordinates = torch.einsum("kca,na->knc", forms, homogeneous)
        cells.append(coordinates.amin(0).argmax(-1))
    return torch.cat(cells) if cells else xy.new_empty(0, dtype=torch.int64)


def _coordinate_forms(inverse_table: Tensor, mesh: SquareMesh) -> Tensor:
    """(3, C, 3) each cell's signed coordinates as affine forms of an image point."""
    on = (inverse_table.dtype, inverse_table.device)
    vertices = mesh_tensor(mesh, "vertices", *on)
    cells = mesh_tensor(mesh, "cells", torch.int64, on[1])
    corners = torch.cat([vertices, vertices.new_zeros(1, 2)])[cells]
    v0 = corners[:, 0]
    e1, e2 = corners[:, 1] - v0, corners[:, 2] - v0
    area = e1[:, 0] * e2[:, 1] - e1[:, 1] * e2[:, 0]
    b1 = torch.stack([e2[:, 1], -e2[:, 0]], -1) / area[:, None]
    b2 = torch.stack([-e1[:, 1], e1[:, 0]], -1) / area[:, None]
    linear = inverse_table[:, :4].unflatten(-1, (2, 2))
    offset = inverse_table[:, 4:] - v0
    forms = [
        torch.cat([(b[:, None] @ linear)[:, 0], (b * offset).sum(-1, keepdim=True)], -1)
        for b in (b1, b2)
    ]
    first = -forms[0] - forms[1]
    first[:, 2] += 1.0
    # Beyond a cone's edge the origin's coordinate is negative: there the inside is its negative.
    first[mesh.n_triangles :] *= -1.0
    return torch.stack([first, *forms])

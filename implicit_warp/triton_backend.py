"""CUDA back end, in Triton: map, inverse, Jacobians, and their gradients.

One kernel launch takes all points through all layers; nothing is stored between layers.  Float32
and float64, first-order gradients.  Needs `triton`, which comes with the CUDA builds of torch, and
for the first launch of each kernel a C compiler, as Triton always does.  With TRITON_INTERPRET=1
set before the first import of Triton the same code runs on the CPU, slowly, for tests.

Guarantee: the results, gradients included, are the same bits from run to run on one machine; no
floating-point atomics are used.  Memory beyond inputs and results is constant without gradients;
with them, four bytes a point and layer for the cells found, and a fixed-size chunk's history.

Non-guarantee: speed.  The kernels were compiled for sm_90 (no register spills) and run under
Triton's interpreter, but block sizes, the guess grid's size and the way tables are gathered (see
`triton_kernels`) were chosen on paper and not timed on a GPU yet.
"""

from __future__ import annotations

import weakref
from typing import NamedTuple

import torch
import triton
from torch import Tensor

from implicit_warp import triton_gradient_kernels, triton_kernels
from implicit_warp.layers import LayerStack
from implicit_warp.square_mesh import SquareMesh, rest_forms

GUESS_GRID = 128
"""Samples a side of the grid of guessed cells, from which the inverse starts."""

_BLOCK = 256
"""Points a program: two a lane at the default of four warps."""

_SUM_BLOCK = 128
"""Points that a program of `sum_cells` adds at once; a cell rarely holds more of a chunk."""

_CHUNK = 1 << 16
"""Points whose history is kept at once by the backward pass: about 130 MB for 24 layers with
Jacobians in float32."""

_LARGEST_SHARED = 0
"""Largest number of cells of a layer whose table is gathered from shared memory; 0 for never."""


class _Tables(NamedTuple):
    """A stack in one direction, as the kernels read it."""

    cells: Tensor  # (K, 6, C)
    transitions: Tensor  # (K + 1, 12)


class _Location(NamedTuple):
    """What the inverse needs to find cells."""

    guesses: Tensor  # (K, G * G) int32
    forms: Tensor  # (9, C) coordinates of a rest cell as affine forms
    neighbours: Tensor  # (3, C) int32


def fits(points: Tensor) -> bool:
    """Can the kernels run where these points are, in their dtype?"""
    on_device = points.is_cuda or (triton_kernels.INTERPRETED and points.device.type == "cpu")
    return on_device and points.dtype in (torch.float32, torch.float64)


def forward(stack: LayerStack, points: Tensor, jacobian: bool) -> tuple[Tensor, Tensor | None]:
    """f(points) for points (n, 3), and the Jacobians (n, 3, 3) if asked for; differentiable."""
    return _run(stack, points, jacobian, inverse=False)


def inverse(stack: LayerStack, points: Tensor, jacobian: bool) -> tuple[Tensor, Tensor | None]:
    """f^-1(points) and the Jacobians of f^-1 if asked for; differentiable."""
    return _run(stack, points, jacobian, inverse=True)


def _run(stack, points, jacobian, *, inverse):
    if not (torch.is_grad_enabled() and (points.requires_grad or stack.requires_grad)):
        image, jacobians, _ = _traverse(stack, points, jacobian, inverse, record=False)
    else:
        tables = stack.inverse_tables.flip(0) if inverse else stack.tables
        transitions = stack.inverse_transitions if inverse else stack.transitions
        image, jacobians = _Traverse.apply(points, tables, transitions, stack, jacobian, inverse)
    return image, jacobians if jacobian else None


class _Traverse(torch.autograd.Function):
    @staticmethod
    def forward(ctx, points, tables, transitions, stack, jacobian, inverse):
        image, jacobians, found = _traverse(stack, points, jacobian, inverse, record=True)
        ctx.n_side, ctx.with_jacobian = stack.mesh.resolution - 1, jacobian
        ctx.dtypes = tables.dtype, transitions.dtype
        compiled = _compiled(stack, points.dtype, inverse)
        ctx.save_for_backward(points, *compiled, found)
        if not jacobian:
            ctx.mark_non_differentiable(jacobians)
        return image, jacobians

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx, grad_image, grad_jacobians):
        points, cells, transitions, found = ctx.saved_tensors
        wanted = _Wanted(*ctx.needs_input_grad[1:3], ctx.with_jacobian)
        grad_points, grad_cells, grad_transitions = _differentiate(
            points, _Tables(cells, transitions), found, grad_image, grad_jacobians, wanted
        )
        dtype_tables, dtype_transitions = ctx.dtypes
        if wanted.cells:
            grad_cells = grad_cells.transpose(1, 2).to(dtype_tables)
        if wanted.transitions:
            grad_transitions = grad_transitions.unflatten(1, (3, 4)).to(dtype_transitions)
        return grad_points, grad_cells, grad_transitions, None, None, None


class _Wanted(NamedTuple):
    """Which gradients, and whether any of them flows through the Jacobian."""

    cells: bool
    transitions: bool
    jacobian: bool


# --- forwards --------------------------------------------------------------------------


def _traverse(
    stack: LayerStack, points: Tensor, jacobian: bool, inverse: bool, record: bool
) -> tuple[Tensor, Tensor, Tensor]:
    """Images (n, 3), Jacobians (n, 3, 3) and cells found (K, n); empty where not asked for."""
    points = points.detach().contiguous()
    n = len(points)
    image = torch.empty_like(points)
    jacobians = points.new_empty(n if jacobian else 0, 3, 3)
    found = points.new_empty(stack.n_layers, n if record else 0, dtype=torch.int32)
    if n == 0:
        return image, jacobians, found
    tables = _compiled(stack, points.dtype, inverse)
    location = _location(stack, points.dtype) if inverse else (found, image, found)
    with torch.cuda.device_of(points):
        triton_kernels.traverse[(triton.cdiv(n, _BLOCK),)](
            points, *tables, *location, image, jacobians, found, n, stack.n_layers,
            N_SIDE=stack.mesh.resolution - 1, N_CELLS=stack.mesh.n_cells,
            GRID=GUESS_GRID, STEPS=_steps(stack.mesh),
            INVERSE=inverse, JACOBIAN=jacobian, RECORD=record,
            **_gather(stack.mesh.n_cells), BLOCK=_BLOCK,
        )  # fmt: skip
    return image, jacobians, found


def _steps(mesh: SquareMesh) -> int:
    """Bound on the walk of the inverse, generous for walks that end."""
    return 64 + mesh.n_cells // 8


def _gather(n_cells: int) -> dict[str, int | bool]:
    """How the kernels read tables."""
    return {"SHARED": n_cells <= _LARGEST_SHARED, "PADDED": triton.next_power_of_2(n_cells)}


_cache: weakref.WeakKeyDictionary = weakref.WeakKeyDictionary()


def _compiled(stack: LayerStack, dtype: torch.dtype, inverse: bool) -> _Tables:
    """Tables of a stack in one dtype and direction; made once, and dropped with the stack."""
    parts = _cache.setdefault(stack, {})
    key = (dtype, inverse)
    if key not in parts:
        cells = stack.inverse_tables.flip(0) if inverse else stack.tables
        transitions = stack.inverse_transitions if inverse else stack.transitions
        parts[key] = _Tables(
            cells.detach().to(dtype).transpose(1, 2).contiguous(),
            transitions.detach().to(dtype).flatten(1).contiguous(),
        )
    return parts[key]


def _location(stack: LayerStack, dtype: torch.dtype) -> _Location:
    """The same for what the inverse needs besides.

    The grid is filled on the device by the search that the inverse itself uses, started where the
    layer would be the identity, so that a solve never waits for a copy to the CPU and back.
    """
    parts = _cache.setdefault(stack, {})
    key = (dtype, "location")
    if key not in parts:
        mesh, device = stack.mesh, stack.embeddings.device
        cells = _compiled(stack, dtype, inverse=True).cells
        forms, neighbours = _rest_tensors(mesh, dtype, device)
        samples = GUESS_GRID * GUESS_GRID
        guesses = torch.empty(stack.n_layers, samples, dtype=torch.int32, device=device)
        with torch.cuda.device_of(cells):
            triton_kernels.fill_guesses[(triton.cdiv(samples, _BLOCK), stack.n_layers)](
                cells, forms, neighbours, guesses,
                N_SIDE=mesh.resolution - 1, N_CELLS=mesh.n_cells,
                GRID=GUESS_GRID, STEPS=_steps(mesh), BLOCK=_BLOCK,
            )  # fmt: skip
        parts[key] = _Location(guesses, forms, neighbours)
    return parts[key]


_rest_cache: dict[tuple[SquareMesh, torch.dtype, torch.device], tuple[Tensor, Tensor]] = {}


def _rest_tensors(
    mesh: SquareMesh, dtype: torch.dtype, device: torch.device
) -> tuple[Tensor, Tensor]:
    """Coordinate forms (9, C) and neighbours (3, C) of a mesh on a device."""
    key = (mesh, dtype, device)
    if key not in _rest_cache:
        forms = torch.from_numpy(rest_forms(mesh)).flatten(1).T
        neighbours = torch.tensor(mesh.neighbours.T, dtype=torch.int32, device=device)
        _rest_cache[key] = forms.to(device, dtype).contiguous(), neighbours.contiguous()
    return _rest_cache[key]


# --- backwards -------------------------------------------------------------------------


def _differentiate(
    points: Tensor,
    tables: _Tables,
    found: Tensor,
    grad_image: Tensor,
    grad_jacobians: Tensor,
    wanted: _Wanted,
) -> tuple[Tensor, Tensor | None, Tensor | None]:
    """Gradients for the points (n, 3), the cells (K, 6, C) and the transitions (K + 1, 12)."""
    points = points.contiguous()
    grad_image, grad_jacobians = grad_image.contiguous(), grad_jacobians.contiguous()
    n, n_layers, n_cells = len(points), len(tables.cells), tables.cells.shape[2]
    grad_points = torch.empty_like(points)
    grad_cells = torch.zeros_like(tables.cells) if wanted.cells else None
    grad_transitions = torch.zeros_like(tables.transitions) if wanted.transitions else None
    rows = 12 if wanted.jacobian else 3
    options = {"N_CELLS": n_cells, "JACOBIAN": wanted.jacobian, "BLOCK": _BLOCK, **_gather(n_cells)}
    for first in range(0, n, _CHUNK):
        m = min(_CHUNK, n - first)
        programs = triton.cdiv(m, _BLOCK)
        sizes = (n, n_layers, first, m)
        remember = m if wanted.cells or wanted.transitions else 0
        history = points.new_empty(n_layers, rows, remember)
        contributions = points.new_empty(n_layers, 6, m if wanted.cells else 0)
        shares = points.new_empty(programs if wanted.transitions else 0, n_layers + 1, 12)
        with torch.cuda.device_of(points):
            if remember:
                triton_gradient_kernels.replay[(programs,)](
                    points, *tables, found, history, *sizes, **options
                )
            triton_gradient_kernels.differentiate[(programs,)](
                points, *tables, found, history, grad_image, grad_jacobians,
                grad_points, contributions, shares, *sizes,
                CELLS=wanted.cells, TRANSITIONS=wanted.transitions, **options,
            )  # fmt: skip
            if wanted.cells:
                _sum_by_cell(contributions, found[:, first : first + m], grad_cells)
        if wanted.transitions:
            grad_transitions += shares.sum(0)
    return grad_points, grad_cells, grad_transitions


def _sum_by_cell(contributions: Tensor, found: Tensor, grad_cells: Tensor) -> None:
    """Add contributions (K, 6, m) of points in the cells found (K, m) to grad_cells (K, 6, C)."""
    n_layers, _, n_cells = grad_cells.shape
    cells, order = found.sort(dim=1, stable=True)
    bounds = torch.arange(n_cells + 1, dtype=torch.int32, device=found.device)
    starts = torch.searchsorted(cells, bounds.expand(n_layers, -1).contiguous())
    triton_gradient_kernels.sum_cells[(n_cells, n_layers)](
        contributions, order, starts, grad_cells, found.shape[1],
        N_CELLS=n_cells, BLOCK=_SUM_BLOCK,
    )  # fmt: skip

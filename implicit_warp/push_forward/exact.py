"""The exact image of a triangle mesh under a warp: a bent piecewise-linear surface, as triangles.

Layer by layer the mesh is moved into the layer's frame, cut along the borders of the layer's cells
(`cutting`), and moved by each cell's own affine map.  Pieces stay convex planar polygons between
the layers, because triangulating them there would multiply slivers; triangles are made at the end.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from implicit_warp.affine import Affine
from implicit_warp.errors import InputError
from implicit_warp.layers import compose_affine
from implicit_warp.maps import Composition, Map
from implicit_warp.numba_backend import Tables, compiled_tables, run
from implicit_warp.push_forward.cutting import cut_layer
from implicit_warp.push_forward.polygon_mesh import PolygonMesh
from implicit_warp.square_mesh import SquareMesh, square_mesh
from implicit_warp.threads import threads_for_steps
from implicit_warp.tuttenet import TutteNet
from implicit_warp.warp import Warp

_IDENTITY = torch.eye(3, 4, dtype=torch.float64)


class CutLayer(NamedTuple):
    """One layer of a map, and the affine map from its frame to the next one's."""

    mesh: SquareMesh
    tables: Tables


def cut_and_push(
    points: NDArray[np.float64],
    triangles: NDArray[np.int64],
    map_: Map,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[PolygonMesh, int]:
    """The image of a mesh, as polygons each of which lies in one cell of every layer.

    Args:
        points: (V, 3).
        triangles: (F, 3), with three distinct corners each.
        map_: a Warp, TutteNet or Affine, or a composition of these.
        progress: called with the layers done and in all.

    Returns:
        The polygons, whose points are the images, and the number of polygons left uncut.

    Raises:
        InputError: the map is none of these.
    """
    into_first, layers = layers_of(map_)
    mesh = PolygonMesh(points, triangles)
    unit = square_mesh(2)
    no_cells = np.empty((0, 6 * unit.n_cells))
    _move(mesh, CutLayer(unit, Tables(no_cells, into_first.reshape(1, 12).numpy())))
    uncut = 0
    for k, layer in enumerate(layers):
        with threads_for_steps(mesh.n_polygons):
            uncut += cut_layer(mesh, layer.mesh.resolution)
            _move(mesh, layer)
        if progress is not None:
            progress(k + 1, len(layers))
    return mesh, uncut


def layers_of(map_: Map) -> tuple[Tensor, list[CutLayer]]:
    """The affine map (3, 4) into the first layer's frame, and the layers in order.

    Raises:
        InputError: the map is no composition of warps, nets and affine maps.
    """
    first, layers = _IDENTITY, []

    def append(affine: Tensor) -> None:
        nonlocal first
        if layers:
            mesh, (cells, transitions) = layers[-1]
            last = compose_affine(affine, torch.from_numpy(transitions[1]).view(3, 4))
            layers[-1] = CutLayer(mesh, Tables(cells, np.stack([transitions[0], last.flatten()])))
        else:
            first = compose_affine(affine, first)

    for part in map_.maps if isinstance(map_, Composition) else (map_,):
        if isinstance(part, Affine):
            append(part.matrix.cpu())
            continue
        if isinstance(part, TutteNet):
            part = part.freeze()
        if not isinstance(part, Warp):
            raise InputError(
                "map_",
                part,
                "the surface cannot be cut along the creases of this map: only those of a Warp or "
                "TutteNet, forwards, lie on lines known beforehand",
                'use method="adaptive", which works for every map',
            )
        stack = part.stack.to(torch.device("cpu"))
        append(stack.transitions[0])
        cells = compiled_tables(stack, torch.float64, inverse=False).cells
        for k in range(stack.n_layers):
            after = torch.stack([_IDENTITY, stack.transitions[k + 1]])
            layers.append(CutLayer(stack.mesh, Tables(cells[k : k + 1], as_flat(after))))
    return first, layers


def as_flat(transitions: Tensor) -> NDArray[np.float64]:
    """Affine maps (k, 3, 4) as the kernels read them, (k, 12)."""
    return np.ascontiguousarray(transitions.flatten(1).numpy())


def _move(mesh: PolygonMesh, layer: CutLayer) -> None:
    points = torch.from_numpy(mesh.points[: mesh.n_vertices])
    moved, _ = run(points, layer.tables, None, layer.mesh, jacobian=False)
    mesh.points[: mesh.n_vertices] = moved.numpy()

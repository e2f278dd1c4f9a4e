"""A field's surface as a triangle mesh, by marching cubes on a lattice of cubic voxels.

What makes the mesh sound is how its vertices are found:

* A sample is inside where its value is below the level, else outside; there is no third
  case. Marching cubes (Lorensen and Cline, 1987) is run on these signs alone, so that its
  topology cannot depend on rounding and every vertex names its lattice edge exactly.
* The vertex is then placed along that edge by linear interpolation of the two samples, in
  float64, but never nearer than `NEAREST` of a voxel to either end. This is what pushing
  near-level samples off the level would do, but it needs no idea of the field's scale: the
  field may be scaled or warped, and no distance at all. Vertices of different edges
  therefore never coincide, and no face is degenerate.
* Every lattice point is sampled once, so that slabs agree where they meet; they are joined
  by the identity of lattice edges, not by coordinates.

Guarantees: the mesh is watertight, edge- and vertex-manifold, and oriented outward, whatever
the samples are. With coordinates in float64 no case of self-intersection is known; `check`
decides it for the mesh at hand.
Non-guarantees: parts thinner than a voxel may be missed or merged, edges and corners of the
shape are bevelled at the scale of a voxel, and faces may be slivers.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray

from fields import Field
from implicit_warp.errors import InputError, MissingDependency
from implicit_warp.lattice import Lattice, lattice_for
from implicit_warp.pruning import BLOCK, active_blocks

if TYPE_CHECKING:
    import trimesh

NEAREST = 1e-3
"""Closest that a vertex comes to an end of its lattice edge, in voxels."""

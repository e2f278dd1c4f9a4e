"""The preview mesh in the page: in the colours of its handles, or of what the map does to it."""

from __future__ import annotations

import functools
import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from implicit_warp.pipeline import PALETTE
from implicit_warp.viewer.region_parts import Part, cut_by_regions
from implicit_warp.viewer.session import EditState

if TYPE_CHECKING:
    import viser

Colour = tuple[int, int, int]

BODY: Colour = (212, 210, 205)
PICKED: Colour = (252, 196, 60)


def handle_colour(number: int) -> Colour:
    """Of the handle with a number, from 0, as in all pictures."""
    return PALETTE[number % len(PALETTE)]


def _alone(method: Callable[..., Any]) -> Callable[..., Any]:
    """Only one thread at a time: the solver moves what a click may be colouring anew."""

    @functools.wraps(method)
    def guarded(self: Shown, *arguments: Any) -> Any:
        with self._lock:
            return method(self, *arguments)

    return guarded


class Shown:
    """The preview mesh in the page.

    Attributes:
        rest: the mesh at rest.
        vertices: (n, 3) float32, as shown.
    """

    def __init__(self, server: viser.ViserServer, rest: trimesh.Trimesh) -> None:
        self._server, self._lock = server, threading.RLock()
        self._parts: list[tuple[Any, Part]] = []
        self._coloured: Any = None
        self._key: tuple[Any, ...] | None = None  # what the parts are cut by, unless outdated
        self._turn = 0
        self.set_rest(rest)

    @_alone
    def set_rest(self, rest: trimesh.Trimesh) -> None:
        """Another shape; shown with the next colouring."""
        self.rest, self._key = rest, None
        self.vertices = np.asarray(rest.vertices, np.float32)

    @property
    def mesh(self) -> trimesh.Trimesh:
        """What is shown."""
        return trimesh.Trimesh(self.vertices, self.rest.faces, process=False)

    @_alone
    def show_handles(self, state: EditState) -> None:
        """Colour the mesh by its handles and the selection, where they are."""
        regions, colours = [], []
        for number, handle in enumerate(state.handles):
            if handle.visible:
                regions.append(handle.region)
                colours.append(handle_colour(number))
        if state.selection is not None:
            regions.append(state.selection)
            colours.append(PICKED)
        key = (*regions, *colours)
        if self._key is not None and len(key) == len(self._key) and all(
            a is b or (isinstance(a, tuple) and a == b)
            for a, b in zip(key, self._key, strict=True)
        ):  # fmt: skip
            return
        old = self._nodes()
        self._key, self._parts, self._coloured = key, [], None
        self._turn += 1
        parts = cut_by_regions(self.rest, regions)
        with self._server.atomic():
            for number, (part, colour) in enumerate(zip(parts, (BODY, *colours), strict=True)):
                if part is not None:
                    node = self._server.scene.add_mesh_simple(
                        f"/shape/{self._turn}-{number}", self._placed(part), part.faces,
                        color=colour, side="double",
                    )  # fmt: skip
                    self._parts.append((node, part))
            self._remove(old)

    @_alone
    def show_colours(self, vertices: NDArray[np.float32], colours: NDArray[np.uint8]) -> None:
        """The mesh with vertices (n, 3) in colours (n, 4), put there before the old one goes."""
        old = self._nodes()
        self.vertices = vertices
        self._turn += 1
        mesh = self.mesh
        mesh.visual.vertex_colors = colours
        self._key, self._parts = None, []
        self._coloured = self._server.scene.add_mesh_trimesh(f"/shape/{self._turn}", mesh)
        self._remove(old)

    @_alone
    def move(self, vertices: NDArray[np.float32]) -> None:
        """Put the mesh, in its handles' colours, elsewhere."""
        self.vertices = vertices
        with self._server.atomic():
            for node, part in self._parts:
                node.vertices = self._placed(part)

    def _placed(self, part: Part) -> NDArray[np.float32]:
        return (part.weights @ self.vertices).astype(np.float32)

    def _nodes(self) -> list[Any]:
        coloured = [] if self._coloured is None else [self._coloured]
        return [*(node for node, _ in self._parts), *coloured]

    def _remove(self, nodes: list[Any]) -> None:
        for node in nodes:
            node.remove()

"""What the page shows of the shape: the mesh in its handles' colours, gizmos, contact edges."""

from __future__ import annotations

import functools
import threading
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from implicit_warp.affine import Affine
from implicit_warp.color_scales import color_scale
from implicit_warp.distortion import handle_distance, measure_distortion
from implicit_warp.handles import Handle
from implicit_warp.maps import Map
from implicit_warp.pipeline import PALETTE
from implicit_warp.viewer.regions import selected
from implicit_warp.viewer.session import EditState

if TYPE_CHECKING:
    import viser

BODY, PICKED = (208, 206, 200), (252, 196, 60)

QUANTITY = {"Stretch": "stretch", "Volume": "det", "Energy": "energy", "Handle error": "error"}
"""The quantities by their names in the page."""

PLAIN, COLOURS = "Handles", ("Handles", *QUANTITY)


def fit_camera(server: viser.ViserServer, bounds: NDArray[np.float64]) -> None:
    """Where every tab's camera starts: all of the shape, from above, to the left of the panel."""
    low, high = bounds
    centre, size = 0.5 * (low + high), float(np.linalg.norm(high - low))
    way = np.array([0.42, -0.8, 0.43])
    right = np.cross(-way, [0.0, 0.0, 1.0])
    aim = centre + 0.16 * size * right / np.linalg.norm(right)
    server.initial_camera.fov = np.radians(40.0)
    server.initial_camera.look_at = aim
    server.initial_camera.position = aim + 1.7 * size * way
    server.initial_camera.near = 0.002 * size
    server.initial_camera.far = 100.0 * size


def set_stage(server: viser.ViserServer, bounds: NDArray[np.float64]) -> None:
    """A floor, and three lights: key, fill and rim."""
    low, high = bounds
    centre, size = 0.5 * (low + high), float(np.linalg.norm(high - low))
    server.scene.set_up_direction("+z")
    server.scene.configure_default_lights(enabled=False)
    server.scene.add_light_hemisphere(
        "/light/sky", sky_color=(255, 252, 246), ground_color=(196, 198, 206), intensity=0.75
    )
    for name, place, intensity, shadow in (
        ("key", (0.5, -1.2, 1.9), 1.25, True),
        ("fill", (-1.6, -0.8, 0.7), 0.3, False),
        ("rim", (-0.4, 1.8, 1.2), 0.5, False),
    ):
        server.scene.add_light_directional(
            f"/light/{name}",
            color=(255, 250, 242),
            intensity=intensity,
            cast_shadow=shadow,
            position=tuple(centre + size * np.array(place)),
        )
    cell = 10.0 ** np.floor(np.log10(size / 2.0)) / 4.0
    server.scene.add_grid(
        "/floor",
        width=5 * size,
        height=5 * size,
        cell_size=cell,
        section_size=4 * cell,
        cell_color=(236, 236, 236),
        section_color=(222, 222, 222),
        plane_color=(250, 250, 249),
        plane_opacity=0.0,
        shadow_opacity=0.18,
        fade_distance=4 * size,
        position=(centre[0], centre[1], low[2] - 0.02 * size),
    )


def _alone(method: Callable[..., Any]) -> Callable[..., Any]:
    """Only one thread at a time: the solver moves what a click may be colouring anew."""

    @functools.wraps(method)
    def guarded(self: Shown, *arguments: Any) -> Any:
        with self._lock:
            return method(self, *arguments)

    return guarded


class Shown:
    """The preview mesh in the page, in parts of one colour each.

    Attributes:
        vertices: (n, 3) float32, as shown.
    """

    def __init__(self, server: viser.ViserServer, rest: trimesh.Trimesh) -> None:
        self._server, self._lock = server, threading.RLock()
        self._parts: dict[str, tuple[Any, NDArray[np.int64]]] = {}
        self._key: Any = None
        self.set_rest(rest)

    def set_rest(self, rest: trimesh.Trimesh) -> None:
        """Another shape."""
        self.rest, self._key = rest, None
        self.vertices = np.asarray(rest.vertices, np.float32)
        self._faces = np.asarray(rest.faces)

    @_alone
    def paint(self, state: EditState) -> None:
        """Colour the mesh by its handles and the selection."""
        shown = [(h.name, h.region) for h in state.handles if h.visible]
        # Fields have no order and no equality: the same ones are kept, or others came.
        key = [*(h.name for h in state.handles), *(part for pair in shown for part in pair)]
        key.append(state.selection)
        if self._key is not None and [*map(id, key)] == [*map(id, self._key)]:
            return
        self._key = key
        at_rest = np.asarray(self.rest.vertices)
        owner = np.zeros(len(self._faces), np.int64)
        names, colours = ["body"], [BODY]
        numbers = {h.name: i for i, h in enumerate(state.handles)}
        for name, region in shown:
            names.append(f"handle-{numbers[name]}")
            colours.append(PALETTE[numbers[name] % len(PALETTE)])
            owner[self._held_by(selected(region, at_rest))] = len(names) - 1
        if state.selection is not None:
            names.append("picked")
            colours.append(PICKED)
            owner[self._held_by(selected(state.selection, at_rest))] = len(names) - 1
        self._clear()
        for number, (name, colour) in enumerate(zip(names, colours, strict=True)):
            faces = self._faces[owner == number]
            used, local = np.unique(faces, return_inverse=True)
            if len(faces):
                node = self._server.scene.add_mesh_simple(
                    f"/shape/{name}", self.vertices[used], local.reshape(-1, 3), color=colour,
                    side="double",
                )  # fmt: skip
                self._parts[name] = (node, used)

    @_alone
    def paint_distortion(
        self, map: Map | None, quantity: str, handles: Sequence[Handle]
    ) -> tuple[float, float]:
        """Colour the mesh by what a map does; returns the values of both ends of the scale."""
        name = QUANTITY[quantity]
        at_rest = np.asarray(self.rest.vertices)
        if name == "error":
            values = handle_distance(map or Affine(), handles, at_rest)[0]
        else:
            values = measure_distortion(map or Affine(), at_rest).quantity(name)
        scale = color_scale(name, values)
        colours = scale(values)
        mesh = trimesh.Trimesh(self.vertices, self._faces, vertex_colors=colours, process=False)
        self._clear()
        self._key = None
        self._server.scene.add_mesh_trimesh("/shape/distortion", mesh)
        self._parts["distortion"] = (None, np.empty(0, np.int64))
        return scale.low, scale.high

    @_alone
    def move(self, vertices: NDArray[np.float32]) -> None:
        """Put the mesh elsewhere, as it is coloured."""
        self.vertices = vertices
        with self._server.atomic():
            for node, used in self._parts.values():
                if node is not None:
                    node.vertices = vertices[used]

    @_alone
    def repaint(self, state: EditState) -> None:
        """Colour the mesh by its handles, whatever it shows now."""
        self._key = None
        self.paint(state)

    def _held_by(self, mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
        return mask[self._faces].sum(axis=1) >= 2

    def _clear(self) -> None:
        for name, (node, _) in self._parts.items():
            if node is None:
                self._server.scene.remove_by_name(f"/shape/{name}")
            else:
                node.remove()
        self._parts.clear()

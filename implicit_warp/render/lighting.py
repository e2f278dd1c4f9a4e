"""Light on one panel: three lamps, a bright sky, and the ground that it stands on.

Lamps are placed relative to the camera, so that any view is lit alike: a warm key light from the
upper left that casts soft shadows, a cool fill from the right, a rim light from behind.  The
sky's light is integrated over what each point sees of it (ambient occlusion).  The ground is
invisible but for its shadows; it also throws light back.

Everything happens in the scene's frame, where what is shown has a diagonal of about one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates, uniform_filter

from implicit_warp.render.camera import Camera
from implicit_warp.render.sampling import (
    TILE,
    cone,
    cosine_lobe,
    in_tiles,
    smooth_on_surface,
    turned,
    unit_square,
)
from implicit_warp.render.scene import Hits, Scene
from implicit_warp.render.surface import Array

HALO = TILE // 2  # rows of the sample grid beyond a band that its filter reaches

SKY_RAYS = 4  # for each sample; the filter averages TILE**2 times as many
KEY_RAYS = 1
SKY_REACH = 0.6  # farther surfaces do not darken
KEY_REACH = 4.0
KEY_SPREAD = 0.10  # the key light's radius at distance one: how soft its shadows are
SKIN = 2e-4  # rays start this far off the surface, above float32 rounding
SAME_SURFACE = 4e-3  # two pixels farther apart than this, along the normal, are not smoothed

KEY_COLOR = np.array([1.02, 0.98, 0.92], dtype=np.float32) * 0.78
FILL_COLOR = np.array([0.90, 0.96, 1.05], dtype=np.float32) * 0.24
RIM_COLOR = np.array([0.95, 0.98, 1.05], dtype=np.float32) * 0.3
SKY_COLOR = np.array([0.95, 0.99, 1.05], dtype=np.float32) * 0.52
BOUNCE_COLOR = np.array([1.03, 1.00, 0.96], dtype=np.float32) * 0.24
# Light that has met other surfaces first: what an occluded direction still gives.
MUTUAL = 0.22

GROUND_TEXELS = 192
GROUND_HALF = 1.25  # half the side of the square of ground that can be in shadow
GROUND_TILE = 4
GROUND_RAYS = 12


@dataclass(frozen=True)
class Stage:
    """The camera in the scene's frame, its lamps' unit directions, and the ground's height."""

    camera: Camera
    up: Array
    key: Array
    fill: Array
    rim: Array
    ground: float | None

    @classmethod
    def around(cls, camera: Camera, lowest: float, *, ground: bool) -> Stage:
        """Lamps for `camera`; `ground` at height `lowest`, unless the camera is below it."""
        up = np.array(camera.up) / np.linalg.norm(camera.up)
        right = camera.axes()[0]
        front = np.cross(right, up)

        def lamp(along: float, above: float, before: float) -> Array:
            towards = along * right + above * up + before * front
            return (towards / np.linalg.norm(towards)).astype(np.float32)

        seen_from_above = float(up @ camera.eye) > lowest
        return cls(
            camera=camera,
            up=up.astype(np.float32),
            key=lamp(-0.62, 0.95, 0.55),
            fill=lamp(0.9, 0.2, 0.45),
            rim=lamp(0.45, 0.6, -0.9),
            ground=lowest if ground and seen_from_above else None,
        )

    def sky(self, directions: Array) -> tuple[Array, Array]:
        """Brightness of the sky and of the lit ground along unit directions `(..., 3)`."""
        height = directions @ self.up
        above = height > 0
        return above * (0.62 + 0.38 * height), ~above


class Ground:
    """How much of its light reaches each place of the ground, as a square texture."""

    def __init__(self, scene: Scene, stage: Stage, height: float) -> None:
        self._up, self._height = stage.up, height
        across = stage.camera.axes()[0]
        self._axes = np.stack([across, np.cross(stage.up, across)])
        low, high = scene.vertices.min(axis=0), scene.vertices.max(axis=0)
        self._middle = self._axes @ ((low + high) / 2)

        rows, columns = (grid.ravel() for grid in np.indices((GROUND_TEXELS, GROUND_TEXELS)))
        unit = (np.stack([rows, columns], axis=1) + 0.5) / GROUND_TEXELS * 2 - 1
        plane = self._middle + GROUND_HALF * unit
        origins = plane @ self._axes + (height + SKIN) * self._up
        square = unit_square(GROUND_RAYS, GROUND_TILE)
        up = np.broadcast_to(self._up, (len(square), 3))
        skyward = in_tiles(turned(cosine_lobe(square), up), rows, columns)
        lampward = in_tiles(cone(square, stage.key, KEY_SPREAD), rows, columns)
        open_sky = ~scene.blocked(origins[:, None], skyward, SKY_REACH)
        lit = ~scene.blocked(origins[:, None], lampward, KEY_REACH)
        light = 0.5 * open_sky.mean(axis=1) + 0.5 * lit.mean(axis=1)
        image = light.reshape(GROUND_TEXELS, GROUND_TEXELS)
        self._light = uniform_filter(image, GROUND_TILE, mode="nearest")

    def light_along(self, origin: Array, directions: Array) -> Array:
        """Relative light, 1 where nothing is in its way, where rays `(n, 3)` meet the ground."""
        fall = directions @ self._up.astype(np.float64)
        down = np.flatnonzero(fall < 0)
        distance = (self._height - origin @ self._up) / fall[down]
        from_middle = origin @ self._axes.T - self._middle
        unit = ((directions @ self._axes.T)[down] * distance[:, None] + from_middle) / GROUND_HALF
        radius = np.hypot(unit[:, 0], unit[:, 1])
        near = np.flatnonzero(radius < 1)  # no shadow falls farther out
        texels = (unit[near].T + 1) / 2 * GROUND_TEXELS - 0.5
        found = map_coordinates(self._light, texels, order=1, mode="nearest")
        light = np.ones(len(directions))
        light[down[near]] = 1 - smoothstep(1.0, 0.6, radius[near]) * (1 - found)
        return light


def smoothstep(low: float, high: float, values: Array) -> Array:
    """0 at `low`, 1 at `high`, smooth between and constant beyond; `low` may be the larger."""
    t = np.clip((values - low) / (high - low), 0, 1)
    return t * t * (3 - 2 * t)


def shade(
    scene: Scene, stage: Stage, hits: Hits, rows: NDArray[np.int64], columns: NDArray[np.int64]
) -> Array:
    """Linear RGB `(n, 3)` of hits at the given rows and columns of the sample grid."""
    normal = hits.normal
    visible = _smoothed_visibility(scene, stage, hits, rows, columns)
    sky, bounce, hidden, key = visible.T[..., None]
    albedo = scene.paint(hits.face, hits.weights, hits.point).astype(np.float32)
    view = np.float32(stage.camera.eye) - hits.position
    view /= np.linalg.norm(view, axis=1, keepdims=True)
    open_sky = 1 - hidden

    facing = np.clip(normal @ stage.key, 0, 1)[:, None]
    # The fill wraps a little around the terminator, which keeps dark sides readable.
    filled = np.clip((normal @ stage.fill + 0.35) / 1.35, 0, 1)[:, None]
    light = KEY_COLOR * facing * key + FILL_COLOR * filled * open_sky
    light = light + SKY_COLOR * sky + BOUNCE_COLOR * bounce
    color = albedo * (light + MUTUAL * albedo * hidden)

    grazing = (1 - np.clip(np.einsum("ni,ni->n", normal, view), 0, 1))[:, None]
    behind = np.clip(normal @ stage.rim, 0, 1)[:, None]
    color = color + RIM_COLOR * behind * grazing**3 * open_sky
    half = view + stage.key
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    gloss = np.clip(np.einsum("ni,ni->n", normal, half), 0, 1)[:, None] ** 48
    return color + 0.10 * gloss * key * (facing > 0)


def _smoothed_visibility(
    scene: Scene, stage: Stage, hits: Hits, rows: NDArray[np.int64], columns: NDArray[np.int64]
) -> Array:
    """Light from the sky and the ground, the hidden part, and the key's visible part, `(n, 4)`."""
    origins = hits.lifted + SKIN * hits.normal
    lobes = in_tiles(cosine_lobe(unit_square(SKY_RAYS)), rows, columns)
    directions = turned(lobes, hits.normal)
    blocked = scene.blocked(origins[:, None], directions, SKY_REACH)
    sky, ground = stage.sky(directions)
    values = np.ones((len(rows), 4), dtype=np.float32)
    values[:, 0] = (sky * ~blocked).mean(axis=1)
    values[:, 1] = (ground & ~blocked).mean(axis=1)
    values[:, 2] = blocked.mean(axis=1)

    # Faces turned away from the key light are dark by the cosine; they need no shadow rays.
    # Those just beyond the terminator are traced too, because the filter mixes them in.
    lit = np.flatnonzero(hits.normal @ stage.key > -0.1)
    pattern = cone(unit_square(KEY_RAYS), stage.key, KEY_SPREAD)
    towards = in_tiles(pattern, rows[lit], columns[lit])
    values[lit, 3] = 1 - scene.blocked(origins[lit, None], towards, KEY_REACH).mean(axis=1)

    row, column = rows - rows.min(), columns - columns.min()
    shape = (int(row.max()) + 1, int(column.max()) + 1)
    return smooth_on_surface(
        _spread(values, row, column, shape),
        _spread(hits.position, row, column, shape),
        _spread(hits.normal, row, column, shape),
        _spread(np.ones((len(rows), 1)), row, column, shape)[..., 0] > 0,
        SAME_SURFACE,
    )[row, column]


def _spread(
    values: NDArray, row: NDArray[np.int64], column: NDArray[np.int64], shape: tuple[int, int]
) -> NDArray[np.float32]:
    grid = np.zeros((*shape, values.shape[1]), dtype=np.float32)
    grid[row, column] = values
    return grid

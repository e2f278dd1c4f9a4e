"""Where the shape stands: the first camera, three lights, a floor."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import viser


def fit_camera(server: viser.ViserServer, bounds: NDArray[np.float64]) -> None:
    """Where every tab's camera starts: all of the shape, a little from above."""
    low, high = bounds
    centre, size = 0.5 * (low + high), float(np.linalg.norm(high - low))
    camera = server.initial_camera
    camera.fov = np.radians(36.0)
    camera.look_at = centre + 0.06 * size * np.array([0.0, 0.0, 1.0])
    camera.position = centre + 1.75 * size * np.array([0.42, -0.8, 0.46])
    camera.near, camera.far = 0.002 * size, 100.0 * size


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

"""Films of a shape: a turn around it, and its way from rest to deformed and back.

Both loop: the last frame is next to the first.  Frames are pictures of `render`, made one after the
other when the film is run through, all with one camera distance, light and ground.

Of an animation, every frame shows the image of the mesh under a map of its own, all of them
injective (`morph`).  Non-guarantee: vertices are moved and faces stay flat, as in `deform`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fields.arguments import positive
from implicit_warp.color_scales import ColorScale, color_scale
from implicit_warp.distortion import measure_distortion
from implicit_warp.errors import InputError
from implicit_warp.maps import Map
from implicit_warp.render import Camera, render
from implicit_warp.render.camera import DEFAULT_DIRECTION, picture_size
from implicit_warp.render.legend import legend_height, with_legend
from implicit_warp.render.picture import Image
from implicit_warp.render.surface import Array, Color, checked_arrays

if TYPE_CHECKING:
    import trimesh

FILM_SIZE = (640, 480)
MOST_FRAMES = 3600


@dataclass(frozen=True, eq=False)
class Film:
    """Pictures in a row, made when they are asked for.

    Attributes:
        size: width and height in pixels.
        fps: frames a second.
        order: for each frame, which of the different pictures it is.
        picture: makes one of these pictures, `(height, width, 3)` uint8.
    """

    size: tuple[int, int]
    fps: float
    order: tuple[int, ...]
    picture: Callable[[int], Image]

    def __len__(self) -> int:
        return len(self.order)

    def __iter__(self) -> Iterator[Image]:
        """The frames; a picture that is shown again later is kept until then."""
        last = {number: k for k, number in enumerate(self.order)}
        kept: dict[int, Image] = {}
        for k, number in enumerate(self.order):
            image = kept.pop(number, None)
            image = self.picture(number) if image is None else image
            if last[number] > k:
                kept[number] = image
            yield image


@dataclass(frozen=True)
class Look:
    """How the frames look.

    Attributes:
        size: width and height in pixels, the legend included.
        seconds: of the loop.
        fps: frames a second.
        direction: from the shape to the camera; three numbers or an axis such as "-y".
        supersampling: samples along each side of a pixel.
    """

    size: tuple[int, int] = FILM_SIZE
    seconds: float = 4.0
    fps: float = 24.0
    direction: tuple[float, float, float] | str = DEFAULT_DIRECTION
    supersampling: int = 2

    @property
    def frames(self) -> int:
        """Their number.

        Raises:
            InputError: seconds and frames a second that give none, or too many.
        """
        count = round(positive("seconds", self.seconds) * positive("fps", self.fps))
        if not 2 <= count <= MOST_FRAMES:
            raise InputError(
                "seconds",
                self.seconds,
                f"at {self.fps:g} frames a second these are {count} frames",
                f"choose both so that there are 2 to {MOST_FRAMES}",
            )
        return count


def turntable(
    mesh: trimesh.Trimesh,
    *,
    color: Color = None,
    places: ArrayLike | None = None,
    scale: ColorScale | None = None,
    look: Look | None = None,
) -> Film:
    """Once around a mesh, at constant speed.

    The camera, its lamps with it, goes around the vertical through the middle of the mesh's box, at
    the smallest distance from which every frame shows all of it.

    Args:
        mesh: what to show.
        color, places: as in `render`.
        scale: whose legend is drawn under the pictures.
        look: of the frames.

    Raises:
        InputError: as `render`, and `Look.frames`.
    """
    look = look or Look()
    vertices, faces = checked_arrays(mesh)
    count, size = look.frames, picture_size(look.size)
    shown = vertices[np.unique(faces)]
    box = np.stack([shown.min(axis=0), shown.max(axis=0)])
    inner = _inner_size(size, scale)
    camera = Camera.fit_points(_revolved(shown, box), direction=look.direction, size=inner)

    def picture(number: int) -> Image:
        turned = _turned(camera, box.mean(axis=0), 2 * np.pi * number / count)
        image = render(
            mesh,
            size=inner,
            camera=turned,
            color=color,
            places=places,
            within=box,
            supersampling=look.supersampling,
        )
        return _finished(image, scale, size)

    return Film(size, look.fps, tuple(range(count)), picture)


@dataclass(frozen=True, eq=False)
class Motion:
    """A mesh on its way: what an animation shows.

    Attributes:
        amounts: (m,) from 0 to 1, increasing.
        vertices: (m, V, 3) float32 where the vertices are at each amount.
        values: (m, V) of a quantity that is shown in colours; None for none.
        scale: of these values.
    """

    amounts: Array
    vertices: NDArray[np.float32]
    values: Array | None
    scale: ColorScale | None


def loop_order(count: int) -> tuple[tuple[int, ...], Array]:
    """Frames of a way there and back that loops, and the amounts of its different pictures.

    Frame k is at (1 - cos(2 pi k / count)) / 2: it starts and turns back without a jerk, and comes
    back through the pictures of the way there.
    """
    order = tuple(min(k, count - k) for k in range(count))
    amounts = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(count // 2 + 1) / count)
    return order, np.clip(amounts, 0.0, 1.0)


def motion(
    mesh: trimesh.Trimesh,
    path: Callable[[float], Map],
    amounts: ArrayLike,
    *,
    quantity: str | None = None,
    progress: Callable[[int, int, str], None] | None = None,
) -> Motion:
    """Carry a mesh along a path of maps.

    Args:
        mesh: at rest.
        path: from an amount to a map: a `Morph`, or solves for parts of the handles' motions.
        amounts: (m,) increasing; the scale is that of the last one's values.
        quantity: shown in colours, one of `distortion.QUANTITIES`.
        progress: called with (done, of how many, text).

    Raises:
        InputError: from the path, or an unknown quantity.
        NotInjective: a map of the path fails its proof.
    """
    rest, _ = checked_arrays(mesh)
    amounts = np.asarray(amounts, dtype=np.float64)
    vertices = np.empty((len(amounts), *rest.shape), dtype=np.float32)
    values = None if quantity is None else np.empty(vertices.shape[:2])
    for k, amount in enumerate(amounts):
        map_ = path(float(amount))
        if values is None:
            vertices[k] = map_(rest)
        else:
            found = measure_distortion(map_, rest)
            vertices[k], values[k] = found.image, found.quantity(quantity)
        if progress is not None:
            progress(k + 1, len(amounts), "maps")
    scale = None if quantity is None else color_scale(quantity, values[-1])
    return Motion(amounts, vertices, values, scale)


def animation(
    mesh: trimesh.Trimesh,
    path: Callable[[float], Map],
    *,
    color: Color = None,
    quantity: str | None = None,
    look: Look | None = None,
    progress: Callable[[int, int, str], None] | None = None,
) -> Film:
    """From rest to deformed and back.

    Args:
        mesh: at rest.
        path, quantity, progress: as for `motion`.
        color: as in `render`, if no quantity is shown; a function is asked about points at rest.
        look: of the frames.

    Raises:
        InputError: as `render`, `motion` and `Look.frames`.
        NotInjective: a map of the path fails its proof.
    """
    look = look or Look()
    rest, faces = checked_arrays(mesh)
    size = picture_size(look.size)
    count = look.frames
    order, amounts = loop_order(count + count % 2)  # so that one frame shows all of the motion
    moved = motion(mesh, path, amounts, quantity=quantity, progress=progress)
    inner = _inner_size(size, moved.scale)
    places = moved.vertices[:, np.unique(faces)].reshape(-1, 3)
    box = np.stack([places.min(axis=0), places.max(axis=0)]).astype(np.float64)
    camera = Camera.fit_points(places, direction=look.direction, size=inner)

    def picture(number: int) -> Image:
        shown = mesh.copy()
        shown.vertices = moved.vertices[number]
        paint = color
        if moved.scale is not None:
            paint = moved.scale(moved.values[number])[:, :3] / 255.0
        image = render(
            shown,
            size=inner,
            camera=camera,
            color=paint,
            places=rest,
            within=box,
            supersampling=look.supersampling,
        )
        return _finished(image, moved.scale, size)

    return Film(size, look.fps, order, picture)


def _inner_size(size: tuple[int, int], scale: ColorScale | None) -> tuple[int, int]:
    return size if scale is None else (size[0], size[1] - legend_height(size))


def _finished(image: Image, scale: ColorScale | None, size: tuple[int, int]) -> Image:
    return image if scale is None else with_legend(image, scale, legend_height(size))


def _revolved(points: Array, box: Array) -> Array:
    """Points (n, 3) that a camera sees at some time when it goes around the middle of a box."""
    middle = box.mean(axis=0)
    radius = np.hypot(*(points[:, :2] - middle[:2]).T)
    # Of every level only the farthest point counts.
    level = np.rint((points[:, 2] - box[0, 2]) / max(np.ptp(box[:, 2]), 1e-300) * 64)
    farthest = np.lexsort((-radius, level))
    farthest = farthest[np.unique(level[farthest], return_index=True)[1]]
    angle = np.linspace(0, 2 * np.pi, 72, endpoint=False)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=-1) / np.cos(np.pi / 72)
    around = middle[:2] + radius[farthest, None, None] * circle
    height = np.broadcast_to(points[farthest, None, 2:], (*around.shape[:2], 1))
    return np.concatenate([around, height], axis=-1).reshape(-1, 3)


def _turned(camera: Camera, middle: Array, angle: float) -> Camera:
    """A camera gone around the vertical through a point, counter-clockwise from above."""
    cos, sin = np.cos(angle), np.sin(angle)
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    eye, target = (middle + turn @ (np.array(p) - middle) for p in (camera.eye, camera.target))
    return Camera(tuple(eye), tuple(target), camera.up, camera.fov)

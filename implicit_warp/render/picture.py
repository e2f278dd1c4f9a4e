"""From meshes to pixels: framing, supersampling, tone, labels, PNG."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fields.arguments import box_bounds, number
from implicit_warp.errors import InputError, MissingDependency
from implicit_warp.files import atomic_write
from implicit_warp.render.camera import (
    DEFAULT_DIRECTION,
    DEFAULT_SIZE,
    Camera,
    box_corners,
    picture_size,
)
from implicit_warp.render.lighting import HALO, Ground, Stage, shade, smoothstep
from implicit_warp.render.sampling import ordered
from implicit_warp.render.scene import Scene
from implicit_warp.render.surface import (
    Array,
    Color,
    Paint,
    checked_arrays,
    linear_to_srgb,
    rgb,
    srgb_to_linear,
)

if TYPE_CHECKING:
    import trimesh
    from PIL.ImageFont import FreeTypeFont

Image = NDArray[np.uint8]

BACKGROUND = ((0.975, 0.975, 0.970), (0.890, 0.895, 0.905))
"""Off-white at the top, a cool grey at the bottom."""

SHADOW_STRENGTH = 0.62
BAND_SAMPLES = 400_000  # samples shaded at once; bounds the memory


@dataclass(frozen=True)
class Panel:
    """One mesh of a row: its colour and places as in `render`, and words to print under it."""

    mesh: trimesh.Trimesh
    color: Color = None
    label: str = ""
    places: ArrayLike | None = None


def render(
    mesh: trimesh.Trimesh,
    *,
    size: tuple[int, int] = DEFAULT_SIZE,
    camera: Camera | None = None,
    color: Color = None,
    places: ArrayLike | None = None,
    background: ArrayLike = BACKGROUND,
    ground: bool = True,
    within: ArrayLike | None = None,
    crease_angle: float = 50.0,
    supersampling: int = 2,
) -> Image:
    """A picture of one mesh, `(height, width, 3)` uint8.

    Args:
        mesh: what to show; open meshes are shown from both sides.
        size: width and height in pixels.
        camera: where to look from; None takes the closest `Camera` that sees every vertex from
            the front, right and above.
        color: sRGB in [0, 1]: one triple, one for each vertex `(V, 3)` or face `(F, 3)`, or a
            function that takes hit points `(n, 3)` in the mesh's units and gives `(n, 3)`, so
            that a boundary between colours is as sharp as the pixels.  None is `CLAY`.
        places: `(V, 3)` positions of the vertices that such a function is to be asked about instead
            of those shown: a deformed mesh is painted by where its points were at rest.
        background: one colour `(3,)`, or two `(2, 3)` for top and bottom.
        ground: whether the mesh stands on an invisible ground that catches its shadow; there is
            none anyway if the camera is below the mesh.
        within: a box `(2, 3)` that decides where the ground is and how far shadows reach, instead
            of the mesh's own: the frames of a film share one.
        crease_angle: edges sharper than so many degrees stay sharp; others are shaded smoothly.
        supersampling: samples along each side of a pixel.

    Raises:
        InputError: a mesh without faces or with vertices that are not finite, colours of another
            shape or range, an impossible size, background, angle or supersampling.
        MissingDependency: Open3D cannot be imported.
    """
    return render_row(
        [Panel(mesh, color, places=places)],
        size=size,
        camera=camera,
        background=background,
        ground=ground,
        within=within,
        crease_angle=crease_angle,
        supersampling=supersampling,
    )


def render_row(
    panels: Sequence[Panel],
    *,
    size: tuple[int, int] = DEFAULT_SIZE,
    camera: Camera | None = None,
    background: ArrayLike = BACKGROUND,
    ground: bool = True,
    within: ArrayLike | None = None,
    crease_angle: float = 50.0,
    supersampling: int = 2,
) -> Image:
    """Pictures side by side, all with one camera, scale, light and ground.

    The arguments are those of `render`; `size` is that of one panel.  If any panel has a label,
    all of them grow by a strip at the bottom.  Without a `camera`, the closest one that sees
    every vertex of every mesh is taken.

    Returns:
        `(height + strip, width * len(panels), 3)` uint8.

    Raises:
        InputError: as in `render`, or there are no panels.
        MissingDependency: Open3D (or Pillow, for labels) cannot be imported.
    """
    if len(panels) == 0:
        raise InputError("panels", panels, "there is nothing to show", "pass at least one Panel")
    width, height = size = picture_size(size)
    _check_options(crease_angle, supersampling)
    top, bottom = _gradient_ends(background)
    surfaces = [checked_arrays(panel.mesh) for panel in panels]
    paints = [Paint(p.color, *arrays, p.places) for p, arrays in zip(panels, surfaces, strict=True)]
    if within is None:
        shown = np.concatenate([vertices[np.unique(faces)] for vertices, faces in surfaces])
    else:
        shown = box_corners(box_bounds("within", within))
    if camera is None:
        camera = Camera.fit_points(shown, direction=DEFAULT_DIRECTION, size=size)

    low, high = shown.min(axis=0), shown.max(axis=0)
    center, diagonal = (low + high) / 2, float(np.linalg.norm(high - low))
    near = Camera(
        eye=tuple((np.array(camera.eye) - center) / diagonal),
        target=tuple((np.array(camera.target) - center) / diagonal),
        up=camera.up,
        fov=camera.fov,
    )
    up = np.array(camera.up) / np.linalg.norm(camera.up)
    stage = Stage.around(near, float(((shown - center) / diagonal @ up).min()), ground=ground)

    strip = _strip_height(size) if any(panel.label for panel in panels) else 0
    backdrop = _gradient(top, bottom, height + strip)
    rows = []
    for (vertices, faces), paint in zip(surfaces, paints, strict=True):
        scene = Scene(
            vertices, faces, paint, center=center, size=diagonal, crease_angle=crease_angle
        )
        canvas = np.repeat(backdrop[:, None], width, axis=1)
        canvas[:height] = _expose(scene, stage, canvas[:height], supersampling)
        rows.append(canvas)
    image = _quantised(np.concatenate(rows, axis=1))
    if strip:
        image = _with_labels(image, [panel.label for panel in panels], size, strip)
    return image


def save_png(path: str | Path, image: Image) -> None:
    """Write a picture `(height, width, 3)` uint8; the old file stays until the new one is whole.

    Raises:
        InputError: not such an array, a name without `.png`, or a folder that does not exist.
        MissingDependency: Pillow cannot be imported.
    """
    if Path(path).suffix.lower() != ".png":
        raise InputError("path", str(path), "not the name of a PNG file", "end it in .png")
    if getattr(image, "dtype", None) != np.uint8 or image.ndim != 3 or image.shape[2] != 3:
        raise InputError(
            "image",
            image,
            "not an array of shape (height, width, 3) and dtype uint8",
            "pass what `render` or `render_row` returned",
        )
    with atomic_write(path) as temporary:
        pillow("Image").fromarray(image).save(temporary, format="PNG", optimize=True)


def _expose(scene: Scene, stage: Stage, backdrop: Array, supersampling: int) -> Array:
    """The mesh and its shadow over a linear `backdrop` `(h, w, 3)`, in bands of rows."""
    height, width = backdrop.shape[:2]
    floor = None if stage.ground is None else Ground(scene, stage, stage.ground)
    step = max(1, BAND_SAMPLES // (width * supersampling**2))
    done = np.empty_like(backdrop)
    for first in range(0, height, step):
        last = min(first + step, height)
        done[first:last] = _band(
            scene, stage, floor, backdrop[first:last], first, height, supersampling
        )
    return done


def _band(
    scene: Scene,
    stage: Stage,
    floor: Ground | None,
    backdrop: Array,
    first: int,
    height: int,
    s: int,
) -> Array:
    """Rows `first` and on of the picture, as many as `backdrop` `(rows, w, 3)` has."""
    count, width = backdrop.shape[:2]
    low, high = max(0, first * s - HALO), min(height * s, (first + count) * s + HALO)
    rows, columns = (grid.ravel() for grid in np.indices((high - low, width * s)))
    rows = rows + low
    # N-rooks inside each pixel: no two samples share a row or a column, so that nearly
    # level edges get s * s grey levels and not s.
    x = (columns + (rows % s + 0.5) / s) / s
    y = (rows + (s - columns % s - 0.5) / s) / s
    eye = np.array(stage.camera.eye)
    rays = stage.camera.directions(x, y, (width, height))
    hits = scene.cast(eye, rays)

    color = np.zeros((len(rays), 3))
    light = np.zeros(len(rays))
    missed = np.ones(len(rays), dtype=bool)
    missed[hits.ray] = False
    light[missed] = 1.0
    if len(hits.ray):
        color[hits.ray] = _tone(shade(scene, stage, hits, rows[hits.ray], columns[hits.ray]))
    if floor is not None:
        darkness = 1 - floor.light_along(eye, rays[missed])
        margin = np.minimum(x / width, 1 - x / width)[missed]
        margin = np.minimum(margin, np.minimum(y, height - y)[missed] / height)
        light[missed] -= SHADOW_STRENGTH * darkness * smoothstep(0.0, 0.06, margin)

    keep = slice(first * s - low, first * s - low + count * s)
    color = _boxed(color.reshape(high - low, width * s, 3)[keep], s)
    light = _boxed(light.reshape(high - low, width * s, 1)[keep], s)
    return color + light * backdrop


def _boxed(samples: Array, s: int) -> Array:
    """The mean over each pixel's samples."""
    h, w, c = samples.shape
    return samples.reshape(h // s, s, w // s, s, c).mean(axis=(1, 3))


def _tone(linear: Array) -> Array:
    """Compress highlights: the identity up to a knee, then a curve that never reaches one."""
    knee = 0.55
    over = np.maximum(linear - knee, 0)
    return np.minimum(linear, knee) + (1 - knee) * np.tanh(over / (1 - knee))


def _quantised(linear: Array) -> Image:
    """Linear RGB to sRGB bytes, with an ordered dither that keeps soft gradients free of bands."""
    height, width = linear.shape[:2]
    pattern = (ordered(8) + 0.5) / 64 - 0.5
    dither = np.tile(pattern, (-(-height // 8), -(-width // 8)))[:height, :width, None]
    levels = linear_to_srgb(np.clip(linear, 0, 1)) * 255 + dither
    return np.clip(np.rint(levels), 0, 255).astype(np.uint8)


def _gradient_ends(background: ArrayLike) -> tuple[Array, Array]:
    ends = np.asarray(background)
    if ends.shape == (2, 3):
        return rgb("background", ends[0]), rgb("background", ends[1])
    single = rgb("background", background)
    return single, single


def _gradient(top: Array, bottom: Array, height: int) -> Array:
    """A vertical gradient, linear RGB `(height, 3)`; even to the eye, so mixed as sRGB."""
    t = smoothstep(0.0, 1.0, (np.arange(height) + 0.5) / height)[:, None]
    return srgb_to_linear(top + t * (bottom - top))


def _strip_height(size: tuple[int, int]) -> int:
    return max(24, round(min(size) * 0.085))


def _with_labels(image: Image, labels: Sequence[str], size: tuple[int, int], strip: int) -> Image:
    """Draw each label in the middle of its panel's strip."""
    picture = pillow("Image").fromarray(image)
    draw = pillow("ImageDraw").Draw(picture)
    width, height = size
    dark = image[-1].mean() < 128
    for index, label in enumerate(labels):
        font = _font_for(label, round(strip * 0.48), width * 0.92)
        place = ((index + 0.5) * width, height + strip * 0.42)
        draw.text(place, label, fill=(225,) * 3 if dark else (84, 88, 94), font=font, anchor="mm")
    return np.asarray(picture)


def _font_for(label: str, points: int, width: float) -> FreeTypeFont:
    """Pillow's own font, as large as asked, or smaller so that the label fits."""
    load = pillow("ImageFont").load_default
    font = load(points)
    length = font.getlength(label)
    return font if length <= width else load(points * width / length)


def pillow(part: str) -> ModuleType:
    """A module of Pillow, or an error that says how to get it."""
    try:
        return import_module(f"PIL.{part}")
    except ImportError as error:
        raise MissingDependency(
            "pillow", "writing or labelling a picture", "Install it with `pip install pillow`"
        ) from error


def _check_options(crease_angle: float, supersampling: int) -> None:
    if not 0 <= number("crease_angle", crease_angle) <= 180:
        raise InputError(
            "crease_angle", crease_angle, "not in 0 to 180 degrees", "50 suits most parts"
        )
    if not isinstance(supersampling, int) or not 1 <= supersampling <= 8:
        raise InputError("supersampling", supersampling, "not 1 to 8", "2 is smooth, 3 smoother")

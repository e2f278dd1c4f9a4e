"""A picture of where a mesh is bad: the whole of it, and a close view of its worst place."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from implicit_warp.checking.evidence import CLASSES, SOUND, Evidence
from implicit_warp.checking.predicates import unit_scaled
from implicit_warp.errors import InputError
from implicit_warp.files import refuse_target
from implicit_warp.render import Camera, render, save_png
from implicit_warp.render.camera import DEFAULT_DIRECTION
from implicit_warp.render.open3d_library import import_open3d

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

PANEL = (800, 640)
_LINE = 3.0  # pixels, for what can be seen; a third of it for what is hidden
_CELLS = 24  # offenders in one cell of such a lattice are one cluster
_RINGS = 40  # clusters marked in the overview
_SAMPLE = 400  # offenders that vote on the direction of the view
_HIDDEN = 0.2  # with fewer than this part of the offenders in sight, the mesh is cut open
_SAME = 1e-5  # of the distance to the eye: nearer hits are the place itself, to float32 rounding
_FINE = 2  # overlays are drawn so much larger and reduced, so that lines are smooth
_INK = (70, 74, 80)


@dataclass(frozen=True, eq=False)
class _Shape:
    """What can be drawn: finite faces, scaled to about unit size and centred."""

    vertices: Array
    faces: Indices
    face_class: NDArray[np.int8]
    diagonal: float

    def places(self, offenders: Indices) -> Array:
        """The middles `(n, 3)` of offenders, which are given as in `_offenders`."""
        return self.vertices[offenders].mean(axis=1)


def write_picture(path: Path, vertices: Array, faces: Indices, found: Evidence, title: str) -> None:
    """Draw and save it; see `CheckReport.write_picture`."""
    refuse_target(path, (".png",))
    shape = _shape(vertices, faces, found)
    offenders = _offenders(shape, found)
    if len(offenders):
        cluster = _clusters(offenders, shape)
        largest = offenders[cluster == np.bincount(cluster).argmax()]
        direction, in_sight = _best_view(shape, shape.places(largest))
        rings = [shape.places(offenders[cluster == n]) for n in _largest_first(cluster)[:_RINGS]]
        cut_open = in_sight < _HIDDEN
        overview = _panel(shape, found, direction, rings=rings)
        close = _panel(
            shape, found, direction, focus=shape.vertices[largest].reshape(-1, 3), cut_open=cut_open
        )
        image = np.concatenate([overview, close], axis=1)
        place = (
            "the only place" if len(rings) == 1 else f"the largest of {cluster.max() + 1} places"
        )
        captions = ("whole mesh", place + (", cut open" if cut_open else ""))
    else:
        image = _panel(shape, found, np.array(DEFAULT_DIRECTION))
        captions = ("whole mesh",)
    save_png(path, _with_legend(image, found, title, captions))


def _shape(vertices: Array, faces: Indices, found: Evidence) -> _Shape:
    finite = np.isfinite(vertices).all(axis=1)
    shown = np.flatnonzero(finite[faces].all(axis=1))
    used = vertices[np.unique(faces[shown])]
    extent = float(np.ptp(unit_scaled(used)[0], axis=0).max()) if len(used) else 0.0
    if extent == 0.0:
        raise InputError(
            "mesh",
            f"{len(faces)} faces",
            "no face with finite coordinates and an extent: there is nothing to show",
            "read the report's text, or write_coloured_mesh",
        )
    # Extent one: neither a picture's float32 nor the squares of lengths can overflow then.
    low, high = used.min(axis=0), used.max(axis=0)
    scaled, exponent = unit_scaled(np.where(finite[:, None], vertices, low))
    middle = 0.5 * np.ldexp(low, -exponent) + 0.5 * np.ldexp(high, -exponent)
    scaled = (scaled - middle) / np.ldexp(high - low, -exponent).max()
    span = np.ldexp(high - low, -exponent)
    return _Shape(
        scaled, faces[shown], found.face_class[shown], float(np.linalg.norm(span) / span.max())
    )


def _offenders(shape: _Shape, found: Evidence) -> Indices:
    """Three vertices `(n, 3)` of each bad face, edge and vertex; some twice or three times."""
    pinched = _pinched(found)
    return np.concatenate(
        [
            shape.faces[shape.face_class >= 0],
            found.edges[:, [0, 1, 1]],
            np.column_stack([pinched] * 3),
        ]
    )


def _pinched(found: Evidence) -> Indices:
    """Bad vertices that have a place; those that are not finite have none."""
    names = np.array([c.count for c in CLASSES])[found.vertex_class]
    return found.vertices[names == "pinched_vertices"]


def _clusters(offenders: Indices, shape: _Shape) -> Indices:
    """Cluster number of each offender `(n,)`: joined by a vertex, or by a cell of a lattice."""
    cells = np.floor((shape.places(offenders) / shape.diagonal + 0.5) * _CELLS).astype(np.int64)
    cell = np.ravel_multi_index(tuple(cells.clip(0, _CELLS - 1).T), (_CELLS,) * 3)
    meeting = np.column_stack([offenders, len(shape.vertices) + cell])
    _, node = np.unique(meeting, return_inverse=True)
    node = node.reshape(meeting.shape) + len(offenders)
    items = np.repeat(np.arange(len(offenders)), 4)
    size = int(node.max()) + 1
    graph = coo_array((np.ones(node.size, dtype=np.int8), (items, node.ravel())), (size, size))
    labels = connected_components(graph, directed=False)[1][: len(offenders)]
    return np.unique(labels, return_inverse=True)[1]


def _largest_first(cluster: Indices) -> Indices:
    return np.argsort(-np.bincount(cluster), kind="stable")


def _best_view(shape: _Shape, places: Array) -> tuple[Array, float]:
    """The direction from which most of the places can be seen, and which part of them."""
    sample = places[np.linspace(0, len(places) - 1, min(len(places), _SAMPLE)).astype(int)]
    caster = _caster(shape.vertices, shape.faces)
    directions = [d for d in product((-1.0, 0.0, 1.0), repeat=3) if any(d)]
    # Among equals the one nearest to the usual view, so that simple cases look alike.
    directions.sort(key=lambda d: -np.dot(d, DEFAULT_DIRECTION) / np.linalg.norm(d))
    # A little askew, so that no view looks straight along the sides of a box.
    candidates = [
        np.array(d) + 0.25 * np.array(DEFAULT_DIRECTION) + (0.05, 0.09, 0.13) for d in directions
    ]
    candidates = [d / np.linalg.norm(d) for d in (np.array(DEFAULT_DIRECTION), *candidates)]
    seen = [
        _in_sight(caster, sample, sample.mean(axis=0) + 3 * shape.diagonal * d).mean()
        for d in candidates
    ]
    best = int(np.argmax(np.round(seen, 2)))
    return candidates[best], float(seen[best])


def _caster(vertices: Array, faces: Indices) -> Any:
    open3d = import_open3d("drawing a picture")
    caster = open3d.t.geometry.RaycastingScene()
    caster.add_triangles(
        open3d.core.Tensor(vertices.astype(np.float32)), open3d.core.Tensor(faces.astype(np.uint32))
    )
    return caster


def _in_sight(caster: Any, places: Array, eye: Array) -> NDArray[np.bool_]:
    """Which places `(n, 3)` on the surface the eye sees, `(n,)`."""
    open3d = import_open3d("drawing a picture")
    rays = np.empty((len(places), 6), dtype=np.float32)
    rays[:, :3], rays[:, 3:] = eye, places - eye
    return caster.cast_rays(open3d.core.Tensor(rays))["t_hit"].numpy() > 1 - _SAME


def _panel(
    shape: _Shape,
    found: Evidence,
    direction: Array,
    *,
    rings: Sequence[Array] = (),
    focus: Array | None = None,
    cut_open: bool = False,
) -> NDArray[np.uint8]:
    """One view: of the whole, with rings round groups of places; or close to the `focus`.

    Cut open, sound faces before the focus are left out.
    """
    faces, face_class = shape.faces, shape.face_class
    points = shape.vertices[np.unique(faces)]
    if focus is not None:
        low, high = focus.min(axis=0), focus.max(axis=0)
        centre = (low + high) / 2
        # At least so large that float32 still tells the places apart.
        around = centre + 1e-4 * shape.diagonal * np.array([*np.eye(3), *-np.eye(3)])
        points = np.concatenate([focus, around])
        if cut_open:
            behind = (shape.places(faces) - centre) @ direction < 0
            kept = (face_class >= 0) | behind
            faces, face_class = faces[kept], face_class[kept]
    camera = Camera.fit_points(
        points, direction=tuple(direction), size=PANEL, margin=0.06 if focus is None else 0.14
    )
    image = render(
        SimpleNamespace(vertices=shape.vertices, faces=faces),
        size=PANEL,
        camera=camera,
        color=np.array([*(c.color for c in CLASSES), SOUND])[face_class],
        ground=False,
        crease_angle=20.0,
    )
    return _overlaid(image, shape, found, faces, camera, rings)


def _overlaid(
    image: NDArray[np.uint8],
    shape: _Shape,
    found: Evidence,
    faces: Indices,
    camera: Camera,
    rings: Sequence[Array],
) -> NDArray[np.uint8]:
    """Bad edges as lines, bad vertices as dots, and rings round groups of places."""
    from PIL import Image, ImageDraw

    picture = Image.fromarray(image).resize((PANEL[0] * _FINE, PANEL[1] * _FINE))
    draw = ImageDraw.Draw(picture)
    size = (PANEL[0] * _FINE, PANEL[1] * _FINE)
    caster, eye = _caster(shape.vertices, faces), np.array(camera.eye)
    ends = shape.vertices[found.edges]
    visible = _in_sight(caster, ends.mean(axis=1), eye)
    lines = camera.project(ends, size)
    for k in np.argsort(visible, kind="stable"):
        if np.isfinite(lines[k]).all():
            width = _LINE * _FINE * (1.0 if visible[k] else 1 / 3)
            color = _bytes(CLASSES[found.edge_class[k]].color, 0.75)
            draw.line([tuple(p) for p in lines[k]], fill=color, width=round(width))
    pinched = _pinched(found)
    dots = camera.project(shape.vertices[pinched], size)
    color = _bytes(next(c for c in CLASSES if c.count == "pinched_vertices").color, 0.75)
    seen = _in_sight(caster, shape.vertices[pinched], eye)
    for dot, visible_ in zip(dots, seen, strict=True):
        if np.isfinite(dot).all():
            draw.circle(tuple(dot), _FINE * (6 if visible_ else 3), fill=color)
    for places in rings:
        spots = camera.project(places, size)
        low, high = spots.min(axis=0), spots.max(axis=0)
        radius = float(np.linalg.norm(high - low)) / 2 + 16 * _FINE
        if radius < 0.25 * size[1]:  # larger ones are seen without a ring
            draw.circle(tuple((low + high) / 2), radius, outline=_INK, width=2 * _FINE)
    return np.asarray(picture.resize(PANEL, Image.Resampling.LANCZOS))


def _with_legend(
    image: NDArray[np.uint8], found: Evidence, title: str, captions: tuple[str, ...]
) -> NDArray[np.uint8]:
    """The picture over a strip with the title, the captions and the classes that occur."""
    from PIL import Image, ImageDraw, ImageFont

    height, width = image.shape[:2]
    font, large = ImageFont.load_default(17), ImageFont.load_default(21)
    present = [
        (f"{c.label}: {n}", _bytes(c.color))
        for c, n in zip(CLASSES, found.counts, strict=True)
        if n
    ][::-1]
    rows, x = [[]], 24.0
    for text, color in present:
        length = 62 + font.getlength(text)
        if x + length > width and rows[-1]:
            rows.append([])
            x = 24.0
        rows[-1].append((x, text, color))
        x += length
    strip = 92 + 30 * len(rows) if present else 92
    canvas = Image.new("RGB", (width, height + strip), (250, 250, 249))
    canvas.paste(Image.fromarray(image), (0, 0))
    draw = ImageDraw.Draw(canvas)
    for k, caption in enumerate(captions):
        place = ((k + 0.5) * width / len(captions), height + 18)
        draw.text(place, caption, fill=_INK, font=font, anchor="mm")
    draw.text((24, height + 56), title, fill=(20, 20, 20), font=large, anchor="lm")
    for r, row in enumerate(rows):
        y = height + 92 + 30 * r
        for x, text, color in row:
            draw.rounded_rectangle((x, y - 9, x + 22, y + 9), 4, fill=color)
            draw.text((x + 30, y), text, fill=_INK, font=font, anchor="lm")
    return np.asarray(canvas)


def _bytes(color: tuple[float, float, float], darkened: float = 1.0) -> tuple[int, ...]:
    return tuple(round(255 * darkened * c) for c in color)

"""Plane sections of fields: values, contour lines, and SVG files of them.

Contours are polylines between samples, placed by linear interpolation: their error is of second
order in the step where the field is smooth. With the plane's first axis to the right and its
second upwards they run counter-clockwise around what is below the level, so around holes they run
clockwise. They are closed (the first point again at the end) unless they leave the picture.

Non-guarantees: parts thinner than a step may be missed or merged.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fields import Field, arguments
from implicit_warp.errors import InputError, MissingDependency
from implicit_warp.files import atomic_write, refuse_target

Plane = tuple[str | ArrayLike, float]
"""A normal, as an axis name or a vector, and where along it the plane is."""

_MARGIN = 0.08
"""Room around a field's own bounds, of the longest side."""

_UPRIGHT = {"x": ("y", "z"), "y": ("x", "z"), "z": ("x", "y")}
"""The axes to the right and upwards in planes square to an axis."""


@dataclass(frozen=True, eq=False)
class Frame:
    """A plane with axes in it.

    Attributes:
        origin: `(3,)`, the plane's point nearest to the origin of space.
        right, up: `(3,)`, unit vectors along its axes, at right angles.
        names: of the axes, and of the plane, for people.
    """

    origin: NDArray[np.float64]
    right: NDArray[np.float64]
    up: NDArray[np.float64]
    names: tuple[str, str, str]

    def in_space(self, places: NDArray[np.float64]) -> NDArray[np.float64]:
        """Points `(..., 3)` of places `(..., 2)` in the plane."""
        return self.origin + places[..., :1] * self.right + places[..., 1:] * self.up


@dataclass(frozen=True, eq=False)
class Slice:
    """Values of a field on a lattice of a plane.

    Attributes:
        frame: the plane.
        right: `(w,)`, coordinates along its first axis, evenly spaced.
        up: `(h,)`, along its second.
        values: `(h, w)`.
    """

    frame: Frame
    right: NDArray[np.float64]
    up: NDArray[np.float64]
    values: NDArray[np.float64]

    @property
    def points(self) -> NDArray[np.float64]:
        """The points in space, `(h, w, 3)`."""
        return self.frame.in_space(np.stack(np.meshgrid(self.right, self.up), axis=-1))

    def contours(self, level: float = 0.0) -> list[NDArray[np.float64]]:
        """The lines where the field equals a level, `(n, 2)` each, in the plane's coordinates."""
        try:
            from skimage.measure import find_contours
        except ImportError as error:
            raise MissingDependency(
                "scikit-image", "tracing contours", "Install it with `pip install scikit-image`"
            ) from error
        step = self.right[1] - self.right[0]
        corner = np.array([self.right[0], self.up[0]])
        # Rows count upwards here, so that what is "high" to the library is what is low to us.
        at = arguments.number("level", level)
        lines = find_contours(self.values, at, positive_orientation="high")
        return [corner + step * line[:, ::-1] for line in lines]


def frame_of(plane: Plane) -> Frame:
    """The frame of a plane such as `("z", 0.5)` or `((1, 1, 0), 0.2)`.

    Raises:
        InputError: it is none.
    """
    if not isinstance(plane, tuple | list) or len(plane) != 2:
        raise InputError("plane", plane, "not a normal and an offset", 'Pass e.g. ("z", 0.0)')
    normal = np.array(arguments.direction("plane[0]", plane[0]))
    offset = arguments.number("plane[1]", plane[1])
    axis = "xyz"[int(np.argmax(np.abs(normal)))]
    if np.abs(normal).max() == 1:
        names = _UPRIGHT[axis]
        right, up = (np.array(arguments.direction("axis", name)) for name in names)
        at = offset * normal["xyz".index(axis)] + 0.0
        return Frame(offset * normal, right, up, (*names, f"{axis} = {at:g}"))
    right = np.cross((0.0, 0.0, 1.0), normal)
    right = right / np.linalg.norm(right)
    said = ", ".join(f"{n:.3g}" for n in normal)
    names = ("right", "up", f"({said}) \u00b7 p = {offset:g}")
    return Frame(offset * normal, right, np.cross(normal, right), names)


def read_plane(text: str) -> Plane:
    """The plane that a text such as "z=0.5" or "1,1,0=0.2" describes; without "=" it is at 0.

    Raises:
        InputError: it describes none.
    """
    normal, _, offset = text.partition("=")
    parts = normal.split(",")
    try:
        direction = normal.strip() if len(parts) == 1 else tuple(float(part) for part in parts)
        plane = (direction, float(offset) if offset else 0.0)
    except ValueError:
        raise InputError(
            "plane", text, "not a normal and an offset", "Write z=0.5, or 1,1,0=0.2"
        ) from None
    frame_of(plane)
    return plane


def slice_values(
    field: Field,
    plane: Plane = ("z", 0.0),
    resolution: int = 256,
    *,
    bounds: ArrayLike | None = None,
) -> Slice:
    """Sample a field on a plane.

    Args:
        field: what to sample.
        plane: its normal, an axis name or a vector of any length, and how far along the unit
            normal it is.
        resolution: samples along the longer side of the picture.
        bounds: the box `(2, 3)` to cover; by default the field's own and 8 % more on every side.

    Raises:
        InputError: no plane, no bounds, too few samples, or the field is NaN or infinite there.
    """
    if not isinstance(field, Field):
        raise InputError("field", field, "not a field", "Wrap a function by fields.from_function")
    frame = frame_of(plane)
    low, high = _window(frame, _box(field, bounds))
    right, up = _lattice(low, high, resolution)
    section = Slice(frame, right, up, np.empty((len(up), len(right))))
    for row, points in enumerate(section.points):
        section.values[row] = field(points)
    bad = ~np.isfinite(section.values)
    if bad.any():
        where = section.points[tuple(np.argwhere(bad)[0])]
        raise InputError(
            "field",
            field,
            f"{int(bad.sum())} of {bad.size} values are NaN or infinite, the first at "
            f"{where.tolist()}",
            "Mend the field there, or choose bounds that leave the place out",
        )
    return section


def contours(
    field: Field,
    plane: Plane = ("z", 0.0),
    level: float = 0.0,
    resolution: int = 256,
    *,
    bounds: ArrayLike | None = None,
) -> list[NDArray[np.float64]]:
    """The lines of a plane where a field equals a level, as points in space `(n, 3)` each.

    Arguments and errors as for `slice_values`; the module's docstring says how the lines run.
    """
    section = slice_values(field, plane, resolution, bounds=bounds)
    return [section.frame.in_space(line) for line in section.contours(level)]


def save_contours(
    path: str | Path, section: Slice, levels: Sequence[float] = (0.0,), *, units: str = "mm"
) -> None:
    """Write contours to an SVG file in true size, one path a level, for cutters and drawings.

    Args:
        path: of the file, `.svg`; written under a temporary name and renamed.
        section: from `slice_values`.
        levels: each a path of its own, named by its level.
        units: the length that one unit of the field stands for: "mm", "cm", "in", "pt" or "px".

    Raises:
        InputError: the file cannot be written there, unknown units, or no level is met.
    """
    if units not in ("mm", "cm", "in", "pt", "px"):
        raise InputError("units", units, "not a length of SVG", "Use mm, cm, in, pt or px")
    refuse_target(path, (".svg",))
    low = np.array([section.right[0], section.up[0]])
    high = np.array([section.right[-1], section.up[-1]])
    width, height = high - low
    paths = []
    for level in levels:
        # Up is negative in SVG.
        lines = [(line - (low[0], high[1])) * (1, -1) for line in section.contours(level)]
        if lines:
            text = " ".join(map(_path_of, lines))
            paths.append(f'  <path id="level {level:g}" d="{text}"/>')
    if not paths:
        raise InputError(
            "levels",
            list(levels),
            f"none is met: values here lie between {section.values.min():.6g} and "
            f"{section.values.max():.6g}",
            "Choose another plane or other levels",
        )
    thin = max(width, height) / 1000
    text = "\n".join(
        (
            f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.9g}{units}" '
            f'height="{height:.9g}{units}" viewBox="0 0 {width:.9g} {height:.9g}">',
            f'<g fill="none" fill-rule="evenodd" stroke="black" stroke-width="{thin:.3g}">',
            *paths,
            "</g>",
            "</svg>\n",
        )
    )
    with atomic_write(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def _path_of(line: NDArray[np.float64]) -> str:
    closed = np.array_equal(line[0], line[-1])
    places = [f"{x:.7g},{y:.7g}" for x, y in (line[:-1] if closed else line)]
    return "M" + " ".join(places) + ("Z" if closed else "")


def _box(field: Field, bounds: ArrayLike | None) -> NDArray[np.float64]:
    if bounds is not None:
        return arguments.box_bounds("bounds", bounds)
    box = field.bounds
    if box is None or not np.ptp(box, axis=0).max() > 0:
        raise InputError(
            "bounds",
            None,
            "the field is empty, unbounded, or its bounds are unknown",
            "Pass bounds=[[x0, y0, z0], [x1, y1, z1]]",
        )
    margin = _MARGIN * np.ptp(box, axis=0).max()
    return box + np.array([[-margin], [margin]])


def _window(
    frame: Frame, box: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The box's shadow on the plane, in the plane's coordinates."""
    corners = np.array([[box[i, 0], box[j, 1], box[k, 2]] for i, j, k in np.ndindex(2, 2, 2)])
    places = np.stack([corners @ frame.right, corners @ frame.up], axis=1)
    return places.min(axis=0), places.max(axis=0)


def _lattice(
    low: NDArray[np.float64], high: NDArray[np.float64], resolution: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Coordinates with one step on both axes; the shorter side is rounded up to whole steps."""
    if isinstance(resolution, bool) or not isinstance(resolution, int) or resolution < 4:
        raise InputError(
            "resolution", resolution, "too few samples, or no number", "Use 64 or more"
        )
    step = float((high - low).max()) / (resolution - 1)
    middle, cells = (low + high) / 2, np.maximum(np.ceil((high - low) / step - 1e-9), 1)
    first = middle - step * cells / 2
    right, up = (a + step * np.arange(int(n) + 1) for a, n in zip(first, cells, strict=True))
    return right, up

"""Pictures of plane sections: inside and outside in colours, lines of equal value, the surface.

The idea is the paper's Figure 7: lines at equal spacing show where a field is a distance (evenly
spaced) and where it is not. Matplotlib draws, without a display and without its global state.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fields import Field
from implicit_warp.errors import InputError, MissingDependency
from implicit_warp.files import atomic_write, refuse_target
from implicit_warp.handles import Handle
from implicit_warp.slices import Plane, Slice, slice_values

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SUFFIXES = (".png", ".pdf", ".jpg")

_INSIDE = ("#16415e", "#2f6f94", "#6fa8c4", "#b5d5e2", "#ddecf1")
"""From the deepest value to the surface."""
_OUTSIDE = ("#fbf1e2", "#f6dbb8", "#eebd87", "#dd9456", "#b9652c")
"""From the surface to the farthest value."""
_INK = "#1d2429"
_FAINT = "#5b6670"
_HANDLES = ("#4682b4", "#c8502d", "#4c8f4c", "#8a5596", "#b58a1a")

_LINES = 14
"""About so many lines of equal value, if their spacing is not given."""

_PANEL = 4.6  # inches, the longer side of a panel
_DOTS = 200  # an inch


def slice_plot(
    field: Field | Sequence[Field],
    plane: Plane = ("z", 0.0),
    path: str | Path | None = None,
    *,
    levels: Sequence[float] | None = None,
    spacing: float | None = None,
    bounds: ArrayLike | None = None,
    resolution: int = 512,
    titles: Sequence[str] = (),
    handles: Sequence[Handle] = (),
    units: str = "",
) -> Figure:
    """A picture of a field on a plane, or of several side by side with the same colours and scale.

    Inside is blue, outside warm, both paler towards the surface, which is the thick line; the thin
    lines are at equal spacing.

    Args:
        field: one field or several, such as a shape at rest and warped.
        plane: as for `slice_values`.
        path: where to write the picture: .png, .pdf or .jpg; None to only return it.
        levels: the values of the thin lines; by default multiples of `spacing`.
        spacing: between the lines; a round number that gives about 14 if None.
        bounds: the box `(2, 3)` to cover; by default the fields' own and 8 % more.
        resolution: samples along the longer side of a panel.
        titles: one a panel.
        handles: drawn on the first panel where they select points of the shape, and on the others
            where their motions bring these.
        units: of values and coordinates, such as "mm".

    Returns:
        Matplotlib's figure, not yet shown.

    Raises:
        InputError: as `slice_values` does; no fields; titles of another number; levels that are no
            numbers; a spacing that is not positive or gives more than 1,000 lines.
        MissingDependency: Matplotlib is not installed.
    """
    many = [field] if isinstance(field, Field) else list(field)
    if not many or (titles and len(titles) != len(many)):
        raise InputError(
            "titles",
            titles,
            f"there are {len(many)} fields",
            "Pass a field or more, one title each",
        )
    if path is not None:
        refuse_target(path, SUFFIXES)
    figure_class, colours = matplotlib_parts("a picture of a section")
    if bounds is None:
        bounds = _common_box(many)
    sections = [slice_values(one, plane, resolution, bounds=bounds) for one in many]
    lowest = min(float(s.values.min()) for s in sections)
    highest = max(float(s.values.max()) for s in sections)
    lines, step = _levels(lowest, highest, levels, spacing)

    figure = _empty_figure(figure_class, sections[0], len(many))
    axes = figure.subplots(1, len(many), squeeze=False, sharex=True, sharey=True)[0]
    # Both sides have some of the scale, also where only one of them is seen.
    little = 1e-3 * max(highest - lowest, 1e-9)
    norm = colours.Normalize(min(lowest, -little), max(highest, little))
    colour_map = colours.LinearSegmentedColormap.from_list("section", _gradient(norm), N=1024)
    image = None
    for number, (ax, section) in enumerate(zip(axes, sections, strict=True)):
        image = _draw(ax, section, lines, norm, colour_map)
        for handle, colour in zip(handles, _colours_of(handles), strict=True):
            _draw_handle(ax, section, many[0], handle, colour, moved=number > 0)
        _label(ax, section, titles[number] if titles else "", units, first=number == 0)
    if handles:
        _legend(axes[0], handles)
    what = "distance" if all(one.exact for one in many) else "value"
    _colour_bar(figure, axes, image, step, f"{what} ({units})" if units else what)
    if path is not None:
        with atomic_write(path) as temporary:
            figure.savefig(temporary, dpi=_DOTS, bbox_inches="tight", pad_inches=0.12)
    return figure


def matplotlib_parts(needed_for: str) -> tuple[Any, Any]:
    """Matplotlib's `Figure` class and its `colors`, without its global state.

    Raises:
        MissingDependency: it is not installed; the message names the extra.
    """
    try:
        from matplotlib import colors
        from matplotlib.figure import Figure
    except ImportError as error:
        raise MissingDependency(
            "matplotlib",
            needed_for,
            'Install it with `pip install "implicit_warp[plot]"`',
        ) from error
    return Figure, colors


def _common_box(many: Sequence[Field]) -> NDArray[np.float64] | None:
    boxes = [one.bounds for one in many if one.bounds is not None]
    if len(boxes) < len(many):
        return None  # slice_values says of which and why
    low, high = np.min([b[0] for b in boxes], axis=0), np.max([b[1] for b in boxes], axis=0)
    margin = 0.08 * (high - low).max()
    return np.stack([low - margin, high + margin])


# --- levels and colours ---------------------------------------------------------------


def _levels(
    lowest: float, highest: float, levels: Sequence[float] | None, spacing: float | None
) -> tuple[NDArray[np.float64], float]:
    """The values of the thin lines, and their spacing."""
    if levels is not None:
        lines = np.array(sorted(levels), dtype=np.float64)
        if not np.isfinite(lines).all():
            raise InputError("levels", levels, "not finite numbers", "Leave it out")
        return lines[lines != 0], float(np.diff(lines).min()) if len(lines) > 1 else 1.0
    step = round_step((highest - lowest) / _LINES) if spacing is None else spacing
    if not 0 < step < np.inf or (highest - lowest) / step > 1000:
        raise InputError(
            "spacing",
            spacing,
            f"values here lie between {lowest:.6g} and {highest:.6g}",
            "Leave it out, or pass a positive number that gives some 10 lines",
        )
    numbers = np.arange(np.ceil(lowest / step), np.floor(highest / step) + 1)
    return step * numbers[numbers != 0], step


def round_step(step: float) -> float:
    """The least of 1, 2, 2.5 and 5 times a power of ten that is not below a step."""
    if not step > 0:
        return 1.0
    power = 10.0 ** np.floor(np.log10(step))
    return float(next(m * power for m in (1, 2, 2.5, 5, 10) if m * power >= step * (1 - 1e-9)))


def _gradient(norm: Any) -> list[tuple[float, str]]:
    """The colours between the least and the largest value, with their break at zero."""
    zero = -norm.vmin / (norm.vmax - norm.vmin)
    return [
        *((zero * i / (len(_INSIDE) - 1), c) for i, c in enumerate(_INSIDE)),
        *((zero + (1 - zero) * i / (len(_OUTSIDE) - 1), c) for i, c in enumerate(_OUTSIDE)),
    ]


def _colours_of(handles: Sequence[Handle]) -> list[str]:
    return [_HANDLES[i % len(_HANDLES)] for i in range(len(handles))]


# --- drawing --------------------------------------------------------------------------


def _empty_figure(figure_class: Any, section: Slice, panels: int) -> Figure:
    width, height = np.ptp(section.right), np.ptp(section.up)
    scale = _PANEL / max(width, height)
    size = (panels * (scale * width + 0.45) + 1.35, scale * height + 0.95)
    return figure_class(figsize=size, layout="compressed", facecolor="white")


def _draw(ax: Axes, section: Slice, lines: NDArray[np.float64], norm: Any, colour_map: Any) -> Any:
    half = 0.5 * (section.right[1] - section.right[0])
    edges = (section.right[0] - half, section.right[-1] + half)
    edges += (section.up[0] - half, section.up[-1] + half)
    image = ax.imshow(
        section.values,
        origin="lower",
        extent=edges,
        cmap=colour_map,
        norm=norm,
        interpolation="bilinear",
        interpolation_stage="data",
    )
    places = (section.right, section.up, section.values)
    if len(lines):
        ax.contour(*places, levels=lines, colors=_INK, linewidths=0.55, alpha=0.45, linestyles="-")
    if section.values.min() < 0 < section.values.max():
        ax.contour(*places, levels=[0.0], colors=_INK, linewidths=2.0)
    ax.set(aspect="equal", xlim=section.right[[0, -1]], ylim=section.up[[0, -1]])
    return image


def _draw_handle(
    ax: Axes, section: Slice, shape: Field, handle: Handle, colour: str, moved: bool
) -> None:
    """The part of the shape at rest that a handle selects, or where its motion brings that."""
    points = handle.motion.inv(section.points) if moved else section.points
    values = np.maximum(handle.region(points), shape(points))
    if values.min() < 0:
        places = (section.right, section.up, values)
        ax.contourf(*places, levels=[values.min(), 0.0], colors=[colour], alpha=0.45)
        ax.contour(*places, levels=[0.0], colors=[colour], linewidths=1.6)


def _label(ax: Axes, section: Slice, title: str, units: str, first: bool) -> None:
    suffix = f" ({units})" if units else ""
    ax.set_xlabel(section.frame.names[0] + suffix, color=_FAINT)
    if first:
        ax.set_ylabel(section.frame.names[1] + suffix, color=_FAINT)
    name = section.frame.names[2]
    ax.set_title(f"{title} ({name})" if title else name, color=_INK, fontsize=11)
    ax.tick_params(colors=_FAINT, labelsize=8, length=3, labelleft=first)
    for side in ax.spines.values():
        side.set(color=_FAINT, linewidth=0.6)


def _legend(ax: Axes, handles: Sequence[Handle]) -> None:
    from matplotlib.patches import Patch

    marks = [
        Patch(
            facecolor=colour,
            edgecolor=colour,
            alpha=0.8,
            label=f"{handle.name}: {'held' if handle.is_held else 'moved'}",
        )
        for handle, colour in zip(handles, _colours_of(handles), strict=True)
    ]
    ax.legend(handles=marks, fontsize=8, loc="best", framealpha=0.9, edgecolor="none")


def _colour_bar(figure: Figure, axes: Sequence[Axes], image: Any, step: float, text: str) -> None:
    low, high = image.norm.vmin, image.norm.vmax
    every = step * max(1, round((high - low) / step / 10))
    ticks = every * np.arange(np.ceil(low / every), np.floor(high / every) + 1)
    bar = figure.colorbar(image, ax=list(axes), ticks=ticks, pad=0.02, aspect=28, fraction=0.05)
    bar.set_label(text, color=_FAINT)
    bar.ax.tick_params(colors=_FAINT, labelsize=8, length=3)
    bar.outline.set(edgecolor=_FAINT, linewidth=0.6)
    if low < 0 < high:
        bar.ax.axhline(0.0, color=_INK, linewidth=2.0)

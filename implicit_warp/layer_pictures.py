"""The prismatic layers of a warp as they are in their planes: one grid picture, or line segments.

Each layer is a square mesh and its Tutte embedding (the paper's Figure 1 shows them so).  A panel
shows the embedding, its triangles coloured by how much larger or smaller they became, the rest
square's outline behind it, and short rays where the cones begin that carry the map on to the whole
plane.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from implicit_warp.color_scales import ColorScale, color_scale
from implicit_warp.errors import InputError
from implicit_warp.files import atomic_write, refuse_target
from implicit_warp.slice_picture import SUFFIXES, matplotlib_parts
from implicit_warp.square_mesh import SquareMesh
from implicit_warp.warp import Warp

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

_INK, _FAINT, _EDGE = "#1d2429", "#8a939b", "#3b464e"
_PANEL = 1.55  # inches
_REACH = 1.16  # how far out the cones are hinted; the square reaches to 1
_DOTS = 200


@dataclass(frozen=True, eq=False)
class LayerMesh:
    """One layer in its plane.

    Attributes:
        number: from 1, in the order of application.
        rest, image: (V, 2) vertices of the square and of its embedding.
        triangles: (T, 3).
        edges: (E, 2) each once.
        boundary: (M,) vertices around the square.
        axes: (3, 3) columns: the plane's two axes and its normal, in the space that the warp's
            layers act in.
    """

    number: int
    rest: Array
    image: Array
    triangles: NDArray[np.int64]
    edges: NDArray[np.int64]
    boundary: NDArray[np.int64]
    axes: Array

    @property
    def normal(self) -> Array:
        """(3,) the direction that the layer leaves alone."""
        return self.axes[:, 2]

    @property
    def growth(self) -> Array:
        """(T,) area of each triangle in the image over that at rest: the layer's det J."""
        return _areas(self.image[self.triangles]) / _areas(self.rest[self.triangles])

    def segments(self, *, rest: bool = False) -> Array:
        """(E, 2, 2) the edges of the image, or of the square at rest."""
        return (self.rest if rest else self.image)[self.edges]

    def cones(self, reach: float = _REACH) -> Array:
        """(M, 2, 2) where cones border on each other, from the boundary outwards."""
        start = self.image[self.boundary]
        return np.stack([start, reach * start], axis=1)


def layer_meshes(warp: Warp, layers: Sequence[int] | None = None) -> list[LayerMesh]:
    """The layers of a warp, all or those of some numbers (from 1).

    Raises:
        InputError: no warp, or no layer of such a number.
    """
    if not isinstance(warp, Warp):
        raise InputError(
            "warp",
            warp,
            "only warps have layers",
            "pass what a solve or a fit returned; freeze() makes a warp of a TutteNet",
        )
    wanted = list(range(1, warp.n_layers + 1) if layers is None else layers)
    for number in wanted:
        if not isinstance(number, int | np.integer) or not 1 <= number <= warp.n_layers:
            raise InputError(
                "layers", number, f"the layers have the numbers 1 to {warp.n_layers}", "pass those"
            )
    mesh, edges = warp.mesh, _edges(warp.mesh)
    images, frames = warp.embeddings.cpu().numpy(), warp.frames.cpu().numpy()
    return [
        LayerMesh(
            number=int(number),
            rest=mesh.vertices,
            image=images[number - 1],
            triangles=mesh.triangles,
            edges=edges,
            boundary=mesh.boundary,
            axes=frames[number - 1],
        )
        for number in wanted
    ]


def layer_segments(warp: Warp, number: int) -> Array:
    """(E, 2, 3) the edges of a layer's image in the layer's plane, in the user's units.

    The plane goes through the middle of the domain in which the warp was solved; the warp's own
    `before` is undone, so that the mesh stands where the shape at rest is.

    Raises:
        InputError: as `layer_meshes`.
    """
    from implicit_warp.layers import invert_affine

    (layer,) = layer_meshes(warp, [number])
    back = invert_affine(warp.before).cpu().numpy()
    return layer.segments() @ layer.axes[:, :2].T @ back[:, :3].T + back[:, 3]


def layer_picture(
    warp: Warp,
    path: str | Path | None = None,
    layers: Sequence[int] | None = None,
    *,
    columns: int | None = None,
) -> Figure:
    """All layers as one grid of panels, with the square at rest first.

    Args:
        warp: the map.
        path: where to write the picture: .png, .pdf or .jpg; None to only return it.
        layers: their numbers, from 1; all of them if None.
        columns: panels in a row; a number that leaves few panels of a wide picture empty if
            None.

    Returns:
        Matplotlib's figure.

    Raises:
        InputError: as `layer_meshes`; a file that cannot be written.
        MissingDependency: Matplotlib is not installed.
    """
    if path is not None:
        refuse_target(path, SUFFIXES)
    shown = layer_meshes(warp, layers)
    if not shown:
        raise InputError("layers", layers, "there are none to show", "pass numbers from 1")
    figure_class, _ = matplotlib_parts("a picture of layers")
    scale = color_scale("det", np.concatenate([layer.growth for layer in shown]))
    count = len(shown) + 1
    across = min(columns or _columns(count), count)
    down = -(-count // across)
    figure = figure_class(
        figsize=(across * _PANEL, down * (_PANEL + 0.22) + 0.62), facecolor="white"
    )
    high = figure.get_figheight()
    grid = figure.subplots(
        down,
        across,
        squeeze=False,
        gridspec_kw={
            "left": 0.005,
            "right": 0.995,
            "top": 1 - 0.24 / high,
            "bottom": 0.62 / high,
            "wspace": 0.03,
            "hspace": 0.24 / _PANEL,
        },
    )
    flat = list(grid.flat)
    for ax in flat:
        ax.set(aspect="equal", xlim=(-1.2, 1.2), ylim=(-1.2, 1.2))
        ax.axis("off")
    _draw_rest(flat[0], shown[0])
    for ax, layer in zip(flat[1:], shown, strict=False):
        _draw_layer(ax, layer, scale)
    _legend(figure, scale)
    if path is not None:
        with atomic_write(path) as temporary:
            figure.savefig(temporary, dpi=_DOTS)
    return figure


def normal_text(normal: Array) -> str:
    """A direction in words: an axis, whole numbers in its proportions, or its components."""
    axis = int(np.abs(normal).argmax())
    scaled = normal / np.abs(normal[axis])
    whole = np.rint(scaled)
    if np.abs(scaled - whole).max() > 1e-6:
        said = [f"{c:.2f}" for c in normal + 0.0]
    elif np.count_nonzero(whole) == 1:
        return "xyz"[axis] if normal[axis] > 0 else f"\u2212{'xyz'[axis]}"
    else:
        said = [f"{c:.0f}" for c in whole + 0.0]
    return f"({', '.join(said)})".replace("-", "\u2212")


def _columns(count: int) -> int:
    """Panels in a row: few empty ones, and a picture rather wide than high."""

    def cost(across: int) -> float:
        down = -(-count // across)
        empty = across * down - count
        return empty / count + 0.3 * abs(np.log(across / down / 1.8))

    return min(range(1, count + 1), key=cost)


def _edges(mesh: SquareMesh) -> NDArray[np.int64]:
    t = mesh.triangles
    return np.unique(np.sort(np.concatenate([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]])), axis=0)


def _areas(corners: Array) -> Array:
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return 0.5 * (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


def _draw_rest(ax: Axes, layer: LayerMesh) -> None:
    from matplotlib.collections import LineCollection

    ax.add_collection(
        LineCollection(list(layer.segments(rest=True)), colors=_FAINT, linewidths=0.5)
    )
    _outline(ax, layer.rest[layer.boundary], _FAINT, 1.1)
    ax.set_title("at rest", fontsize=8, color=_INK, pad=2)


def _draw_layer(ax: Axes, layer: LayerMesh, scale: ColorScale) -> None:
    from matplotlib.collections import LineCollection, PolyCollection

    _outline(ax, layer.rest[layer.boundary], "#c3c9ce", 0.8, dashed=True)
    ax.add_collection(
        LineCollection(list(layer.cones()), colors=_FAINT, linewidths=0.45, alpha=0.8)
    )
    fill = scale(layer.growth) / 255.0
    ax.add_collection(
        PolyCollection(
            list(layer.image[layer.triangles]), facecolors=fill, edgecolors=fill, linewidths=0.3
        )
    )
    ax.add_collection(
        LineCollection(list(layer.segments()), colors=_EDGE, linewidths=0.4, alpha=0.75)
    )
    _outline(ax, layer.image[layer.boundary], _INK, 1.1)
    title = f"{layer.number} \u00b7 {normal_text(layer.normal)}"
    ax.set_title(title, fontsize=8, color=_INK, pad=2)


def _outline(ax: Axes, loop: Array, color: str, width: float, dashed: bool = False) -> None:
    closed = np.concatenate([loop, loop[:1]])
    style = (0, (3, 2)) if dashed else "-"
    ax.plot(*closed.T, color=color, linewidth=width, linestyle=style, solid_joinstyle="round")


def _legend(figure: Figure, scale: ColorScale) -> None:
    high = figure.get_figheight()
    ax = figure.add_axes((0.3, 0.34 / high, 0.4, 0.12 / high))
    ax.imshow(scale.bar(512, 4), aspect="auto", extent=(0, 1, 0, 1))
    ticks = scale.ticks()
    ax.set_xticks([at for at, _ in ticks], [text for _, text in ticks])
    ax.set_yticks([])
    ax.tick_params(colors=_FAINT, labelsize=7, length=2, pad=1.5)
    figure.text(
        0.985,
        0.4 / high,
        "number \u00b7 normal of the plane",
        ha="right",
        va="center",
        fontsize=7,
        color=_FAINT,
    )
    ax.set_ylabel("area, \u00d7", rotation=0, ha="right", va="center", fontsize=8, color=_INK)
    for side in ax.spines.values():
        side.set(color=_FAINT, linewidth=0.5)

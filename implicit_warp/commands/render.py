"""The command ``implicit-warp render``."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import Positional, arg

from implicit_warp.commands.common import GOOD, Common, say
from implicit_warp.errors import InputError

if TYPE_CHECKING:
    import trimesh

    from fields import Field
    from implicit_warp.films import Film, Look
    from implicit_warp.handles import Handle
    from implicit_warp.maps import Map
    from implicit_warp.portrait import Portrait
    from implicit_warp.slices import Plane

Quantity = Literal["none", "det", "stretch", "squeeze", "ratio", "energy", "error"]


@dataclass(frozen=True, kw_only=True)
class Render(Common):
    """Draw a shape: a picture, a film around it, its way from rest to deformed, its warp's layers.

    SHAPE is a field script, a learned field, a volume or a mesh. It is deformed by a saved map
    (--warp), or by solving for handles (--handles), and coloured by how the map distorts it:
    det (of volumes), stretch and squeeze (the largest and the smallest factor on lengths), ratio
    (of both), energy (elastic), error (distance of the handles' points from their targets).

    Films are MP4 or GIF files, and loop. In an animation every frame shows the image under an
    injective map of its own.

    Example: implicit-warp render part.py --handles part.toml -o part.png --color stretch
    --turntable part.mp4 --animate bend.gif --layers layers.png
    """

    shape: Positional[Path]
    """Field script (.py), learned field (.safetensors), volume or mesh file."""
    out: Annotated[Path | None, arg(aliases=["-o"])] = None
    """The picture (.png)."""
    warp: Path | None = None
    """A map (.safetensors) to deform the shape by."""
    handles: Path | None = None
    """Handle file (.toml) to solve for; with --warp, only to colour by and to hold regions."""
    color: Quantity = "none"
    """What the colours show; handles' regions if there are handles and this is none."""
    section: str | None = None
    """Cut the shape open, such as y=0 or 1,1,0=0.2, in the picture and the turntable."""
    turntable: Path | None = None
    """A film once around the shape (.mp4 or .gif)."""
    animate: Path | None = None
    """A film from rest to deformed and back (.mp4 or .gif)."""
    layers: Path | None = None
    """A picture of the layers of the warp (.png, .pdf, .jpg)."""
    size: str | None = None
    """Width x height, such as 1280x960; by default that for the picture, and 640x480 for films."""
    seconds: float = 4.0
    """Length of a film's loop."""
    fps: float = 24.0
    """Frames a second."""
    resolution: int = 160
    """Voxels along the longest side of a field's box; meshes are drawn as they are."""

    def run(self) -> int:
        """Carry out the command; returns the exit code."""

        look, plane = self._checked()
        handles, solve = [], {}
        if self.handles is not None:
            from implicit_warp.handles import load_handles

            handles, solve = load_handles(self.handles)
        field, rest = self._shape(plane is not None)
        map_ = self._map(field, rest, handles, solve)
        if self.out is not None or self.turntable is not None:
            self._draw_portrait(self._portrait(field, rest, map_, handles, plane), look)
        if self.animate is not None:
            self._animate(rest, map_, handles, look)
        if self.layers is not None:
            from implicit_warp.layer_pictures import layer_picture
            from implicit_warp.tuttenet import TutteNet

            layer_picture(map_.freeze() if isinstance(map_, TutteNet) else map_, self.layers)
            say(f"{self.layers}: the layers of the warp")
        return GOOD

    def _checked(self) -> tuple[Look, Plane | None]:
        """The films' look and the section; raises for all that can be seen to fail at once."""
        from implicit_warp.files import refuse_target
        from implicit_warp.film_files import refuse_film
        from implicit_warp.films import FILM_SIZE, Look
        from implicit_warp.slice_picture import SUFFIXES, matplotlib_parts
        from implicit_warp.slices import read_plane

        asked = [self.out, self.turntable, self.animate, self.layers]
        targets = [path for path in asked if path is not None]
        if not targets:
            raise InputError(
                "out",
                None,
                "nothing is to be drawn",
                "pass -o picture.png, --turntable, --animate or --layers",
            )
        if len({path.resolve() for path in targets}) < len(targets):
            raise InputError(
                "out", [str(path) for path in targets], "two share a file", "name them apart"
            )
        look = Look(_size(self.size) or FILM_SIZE, self.seconds, self.fps)
        if self.out is not None:
            refuse_target(self.out, (".png",))
        for film in (self.turntable, self.animate):
            if film is not None:
                refuse_film(film, look.size, look.fps)
                _ = look.frames
        if self.layers is not None:
            refuse_target(self.layers, SUFFIXES)
            matplotlib_parts("a picture of layers")
        self._refuse_combinations()
        return look, None if self.section is None else read_plane(self.section)

    def _refuse_combinations(self) -> None:
        given = self.warp is not None or self.handles is not None
        for name, wanted in (
            ("animate", self.animate is not None),
            ("layers", self.layers is not None),
            ("color", self.color != "none"),
        ):
            if wanted and not given:
                raise InputError(
                    name,
                    str(getattr(self, name)),
                    "there is no deformation to show",
                    "pass --warp or --handles as well",
                )
        if self.color == "error" and (self.handles is None or self.animate is not None):
            raise InputError(
                "color",
                self.color,
                "it shows how far handles' points are from their targets, at the end of the motion",
                "pass --handles, and another --color for --animate",
            )
        if self.section is not None and self.out is None and self.turntable is None:
            raise InputError(
                "section", self.section, "it is for pictures and turntables", "pass -o picture.png"
            )

    def _shape(self, as_field: bool) -> tuple[Field | None, trimesh.Trimesh]:
        """The field, if it is one or is needed, and the mesh at rest."""
        from fields.grid_files import VOLUMES
        from implicit_warp.mesh_files import read_mesh
        from implicit_warp.shapes import FIELDS, load_shape

        if self.shape.suffix.lower() not in (*FIELDS, *VOLUMES):
            mesh = read_mesh(self.shape)
            solved = self.handles is not None and self.warp is None
            if not as_field and not solved:
                return None, mesh
            import fields

            return fields.mesh(mesh), mesh
        from implicit_warp.extraction import extract_mesh
        from implicit_warp.progress import progress_bar

        field = load_shape(self.shape)
        with progress_bar("extract") as update:
            return field, extract_mesh(field, self.resolution, progress=update)[0]

    def _map(
        self, field: Field | None, rest: trimesh.Trimesh, handles: list[Handle], solve: dict
    ) -> Map | None:
        if self.warp is not None:
            from implicit_warp.files import load

            return load(self.warp)
        if not handles:
            return None
        from implicit_warp.elastic_solve import ElasticOptions, elastic

        warp = elastic(field, handles, options=ElasticOptions.from_mapping(solve))
        if warp.report.status == "interrupted":
            raise KeyboardInterrupt
        return warp

    def _portrait(
        self,
        field: Field | None,
        rest: trimesh.Trimesh,
        map_: Map | None,
        handles: list[Handle],
        plane: Plane | None,
    ) -> Portrait:
        from implicit_warp.portrait import cut_portrait, portrait

        quantity = None if self.color == "none" else self.color
        if plane is None:
            return portrait(rest, map_, handles, quantity)
        return cut_portrait(rest, field, plane, map_, handles, quantity)

    def _draw_portrait(self, portrait: Portrait, look: Look) -> None:
        from implicit_warp.portrait import PICTURE_SIZE
        from implicit_warp.render import save_png

        if self.out is not None:
            save_png(self.out, portrait.picture(_size(self.size) or PICTURE_SIZE))
            say(f"{self.out}: the picture")
        if self.turntable is not None:
            _write(portrait.turntable(look), self.turntable, "turntable")

    def _animate(self, rest: trimesh.Trimesh, map_: Map, handles: list[Handle], look: Look) -> None:
        import numpy as np

        from implicit_warp.films import animation
        from implicit_warp.morph import Morph
        from implicit_warp.pipeline import handle_colors
        from implicit_warp.progress import progress_bar

        regions = [handle.region(rest.vertices) <= 0 for handle in handles if handle.is_held]
        held = rest.vertices[np.any(regions, axis=0)] if regions else None
        path = Morph(map_, rest.bounds.mean(axis=0), held)
        with progress_bar("maps") as update:
            film = animation(
                rest,
                path,
                color=handle_colors(handles) if handles else None,
                quantity=None if self.color == "none" else self.color,
                look=look,
                progress=update,
            )
        _write(film, self.animate, "animation")


def _write(film: Film, path: Path, what: str) -> None:
    from implicit_warp.film_files import write_film
    from implicit_warp.progress import progress_bar

    with progress_bar(what) as update:
        write_film(film, path, update)
    say(f"{path}: the {what}, {len(film)} frames")


def _size(text: str | None) -> tuple[int, int] | None:
    """The width and height of a text such as "1280x960".

    Raises:
        InputError: it is none, or no picture can have it.
    """
    if text is None:
        return None
    found = re.fullmatch(r"\s*(\d{1,5})\s*[xX\u00d7]\s*(\d{1,5})\s*", text)
    if found is None:
        raise InputError("size", text, "not a width and a height", "write e.g. 1280x960")
    from implicit_warp.render.camera import picture_size

    return picture_size((int(found[1]), int(found[2])))

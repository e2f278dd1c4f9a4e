"""The command ``implicit-warp slice``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from tyro.conf import Positional

from implicit_warp.commands.common import GOOD, Common, Out, say


@dataclass(frozen=True, kw_only=True)
class Slice(Common):
    """Cut a shape by a plane: a picture with lines of equal value, or contours for a cutter.

    The plane is an axis and where along it, such as z=0.5, or a vector, such as 1,1,0=0.2. With
    --warp the picture shows the shape at rest and warped, side by side, and the contours are those
    of the warped shape.

    Example: implicit-warp slice part.py -o slice.png --plane z=0
    """

    shape: Positional[Path]
    """Field script (.py) or mesh file."""
    out: Out
    """A picture (.png, .pdf, .jpg), or the contours in true size (.svg)."""
    plane: str = "z=0"
    """The plane's normal and how far along it the plane is."""
    levels: tuple[float, ...] | None = None
    """Values of the lines; in a picture multiples of the spacing and in an .svg 0 if not given."""
    spacing: float | None = None
    """Between the lines of a picture; a round number that gives about 14 if not given."""
    resolution: int = 512
    """Samples along the longer side."""
    warp: Path | None = None
    """A map (.safetensors) to warp the shape by."""
    handles: Path | None = None
    """Handle file (.toml) whose regions the picture shows."""
    units: str = ""
    """Of the shape's coordinates; an .svg takes mm if not given."""

    def run(self) -> int:
        """Carry out the command; returns the exit code."""
        from implicit_warp.deformation import deform
        from implicit_warp.errors import InputError
        from implicit_warp.files import load, refuse_target
        from implicit_warp.handles import load_handles
        from implicit_warp.shapes import load_shape
        from implicit_warp.slice_picture import SUFFIXES, slice_plot
        from implicit_warp.slices import read_plane, save_contours, slice_values

        refuse_target(self.out, (*SUFFIXES, ".svg"))
        plane = read_plane(self.plane)
        rest = load_shape(self.shape)
        fields, titles = [rest], []
        if self.warp is not None:
            fields.append(deform(rest, load(self.warp)))
            titles = ["rest", "warped"]
        if self.out.suffix.lower() == ".svg":
            if self.handles is not None or self.spacing is not None:
                raise InputError(
                    "out",
                    str(self.out),
                    "handles and spacing are for pictures",
                    "leave them out, or write a .png",
                )
            section = slice_values(fields[-1], plane, self.resolution)
            save_contours(self.out, section, self.levels or (0.0,), units=self.units or "mm")
        else:
            slice_plot(
                fields,
                plane,
                self.out,
                levels=self.levels,
                spacing=self.spacing,
                resolution=self.resolution,
                titles=titles,
                handles=[] if self.handles is None else load_handles(self.handles)[0],
                units=self.units,
            )
        say(f"{self.out}: the section {self.plane}")
        return GOOD

"""Pictures of meshes as PNG files, without a display and without a GPU.

    from implicit_warp.render import Panel, render_row, save_png

    save_png("bent.png", render_row([Panel(rest, label="before"), Panel(bent, label="after")]))

Rays are cast with Open3D's `RaycastingScene`; Open3D is imported on the first picture.

Guarantees: the same arguments give the same bytes on the same machine; every panel of a row
has the same camera, scale and light; memory does not grow with the picture's height beyond
the picture itself.

Non-guarantees: this is a picture, not a measurement.  Light does not bounce between surfaces
(an even grey stands in for it), normals are smoothed below a crease angle, and coordinates
are rounded to float32 within the box of what is shown.
"""

from __future__ import annotations

from implicit_warp.render.camera import Camera
from implicit_warp.render.picture import Panel, render, render_row, save_png
from implicit_warp.render.surface import CLAY, HELD, MOVED

__all__ = ["CLAY", "HELD", "MOVED", "Camera", "Panel", "render", "render_row", "save_png"]

"""From a field to a checked-by-construction triangle mesh; see `extraction.meshing`."""

from implicit_warp.extraction.meshing import ExtractionReport, extract, extract_mesh
from implicit_warp.extraction.placement import NEAREST
from implicit_warp.extraction.refining import ThinParts

__all__ = ["NEAREST", "ExtractionReport", "ThinParts", "extract", "extract_mesh"]

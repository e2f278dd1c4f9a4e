"""Fitting a map to a pair of meshes, points or landmarks."""

from implicit_warp.fitting.options import FitOptions
from implicit_warp.fitting.report import FitReport
from implicit_warp.fitting.solve import fit

__all__ = ["FitOptions", "FitReport", "fit"]

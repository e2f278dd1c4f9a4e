"""Carrying meshes forward by a map: by their vertices, adaptively, or exactly."""

from __future__ import annotations

from implicit_warp.push_forward.methods import METHODS, Method, deform_mesh
from implicit_warp.push_forward.report import PushForwardReport

__all__ = ["METHODS", "Method", "PushForwardReport", "deform_mesh"]

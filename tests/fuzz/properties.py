"""What must hold for every random case, whatever is drawn.

A property returns counters of things worth knowing, and raises where it does not hold.
"""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np
import torch

import implicit_warp as iw
from implicit_warp.warp import Warp
from tests.fuzz.cases import (
    build_mesh,
    build_scene,
    build_warp,
    draw_mesh,
    draw_scene,
    draw_warp,
)
from tests.implicit_warp.planted_defects import KINDS, planted

Case = dict[str, Any]


class Property(NamedTuple):
    """How cases of a kind are drawn, and what must hold for them."""

    draw: Callable[[int], Case]
    holds: Callable[[Case], dict[str, int]]


def _draw_warp(seed: int) -> Case:
    return {"kind": "warp", "warp": draw_warp(np.random.default_rng(seed))}


def _any_warp_is_proved(case: Case) -> dict[str, int]:
    warp = build_warp(case["warp"])
    certificate = iw.certify(warp)
    assert certificate.proved, str(certificate)
    return {}


def _draw_flip(seed: int) -> Case:
    rng = np.random.default_rng(seed)
    return {
        "kind": "flip",
        "warp": draw_warp(rng, max_layers=4),
        "layer": int(rng.integers(4)),
        "triangle": int(rng.integers(2**31)),
        "depth": float(10.0 ** rng.uniform(-300, -3)) if rng.random() < 0.9 else 0.0,
    }


def _a_flipped_triangle_is_found(case: Case) -> dict[str, int]:
    """Move a cell's centre onto or through one of its sides; rationals say what must follow."""
    warp = build_warp(case["warp"])
    u = warp.embeddings.clone()
    layer = case["layer"] % warp.n_layers
    triangle = case["triangle"] % warp.mesh.n_triangles
    centre, a, b = warp.mesh.triangles[triangle].tolist()
    # Near the origin tiny numbers survive, so that the sign is decided far below 1e-16.
    shift = 0.5 * (u[layer, a] + u[layer, b])
    side = u[layer, b] - u[layer, a]
    outward = torch.stack([side[1], -side[0]]) / side.norm()
    u[layer, centre] = shift + case["depth"] * outward
    star = warp.mesh.triangles[(warp.mesh.triangles == centre).any(1)]
    folded = any(_turn(u[layer], corners) <= 0 for corners in star.tolist())
    try:
        Warp(u, warp.frames)
        refused = False
    except iw.NotInjective:
        refused = True
    assert refused == folded, "refused wrongly" if refused else "a flipped triangle was accepted"
    return {"refused": int(refused)}


def _turn(points: torch.Tensor, corners: list[int]) -> Fraction:
    (ax, ay), (bx, by), (cx, cy) = ([Fraction(v) for v in points[i].tolist()] for i in corners)
    return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)


def _draw_push_forward(seed: int) -> Case:
    rng = np.random.default_rng(seed)
    mesh, warp = draw_mesh(rng), draw_warp(rng, max_layers=6)
    return {"kind": "push_forward", "mesh": mesh, "warp": warp}


def _an_exact_image_is_clean(case: Case) -> dict[str, int]:
    mesh, warp = build_mesh(case["mesh"]), build_warp(case["warp"])
    before = iw.check(mesh, referees=())
    if not before.ok:
        return {"not clean at rest": 1}
    image = iw.deform(mesh, warp, method="exact")
    after = iw.check(image, referees=())
    counts = after.counts()
    bad = {k: counts[k] for k in ("self_intersections.crossing", "self_intersections.overlap")}
    assert not any(bad.values()), f"{bad}\n{after}"
    assert after.watertight, str(after)
    assert sorted(after.topology.genus) == sorted(before.topology.genus), str(after)
    plain = iw.check(iw.deform(mesh, warp), referees=()).num_self_intersections
    contacts = {f"with {k}": int(v > 0) for k, v in counts.items() if v}
    return {"faces": len(image.faces), "bad by vertices only": int(plain > 0), **contacts}


def _draw_extract(seed: int) -> Case:
    rng = np.random.default_rng(seed)
    scene, warp = draw_scene(rng), draw_warp(rng, max_layers=24)
    return {"kind": "extract", "scene": scene, "warp": warp, "detail": int(rng.integers(12, 32))}


def _an_extracted_mesh_is_clean(case: Case) -> dict[str, int]:
    field = iw.deform(build_scene(case["scene"]), build_warp(case["warp"]))
    mesh = iw.extract(field, max(case["detail"], 4))
    report = iw.check(mesh, referees=())
    assert report.ok, str(report)
    return {"faces": len(mesh.faces)}


def _draw_defect(seed: int) -> Case:
    rng = np.random.default_rng(seed)
    return {"kind": "defect", "defect": str(rng.choice([*KINDS])), "seed": int(rng.integers(2**31))}


def _a_planted_defect_is_named(case: Case) -> dict[str, int]:
    import trimesh

    defect = planted(case["defect"], case["seed"])
    mesh = trimesh.Trimesh(defect.vertices, defect.faces, process=False, validate=False)
    found = {name for name, count in iw.check(mesh, referees=()).counts().items() if count}
    found.discard("self_intersections")
    assert found >= defect.required, f"{defect}: missed {defect.required - found}"
    false = found - defect.required - defect.implied
    assert not false, f"{defect}: false alarm {false}"
    return {}


PROPERTIES = {
    "warp": Property(_draw_warp, _any_warp_is_proved),
    "flip": Property(_draw_flip, _a_flipped_triangle_is_found),
    "push_forward": Property(_draw_push_forward, _an_exact_image_is_clean),
    "extract": Property(_draw_extract, _an_extracted_mesh_is_clean),
    "defect": Property(_draw_defect, _a_planted_defect_is_named),
}

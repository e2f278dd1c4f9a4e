"""Areas, heights and volumes of unit-scaled triangles, summed with compensation.

Sums carry their rounding error along (Neumaier 1974), so that ten million faces lose no more
digits than ten.
"""

from __future__ import annotations

import numpy as np

from fields.jit import kernel
from implicit_warp.checking.predicates import UNDERFLOW, UNIT_ROUNDOFF

# Shewchuk's bound of a 3 x 3 determinant of differences is 7 u times its permanent (see
# `predicates`); the compensated sum adds about 2 u of every term. 12 u leaves room.
_BOUND_VOLUME = 12.0 * UNIT_ROUNDOFF


@kernel
def face_measures(v, faces):
    """Total area, and smallest height over longest side of each face `(F,)`."""
    ratios = np.empty(len(faces))
    total = lost = 0.0
    for f in range(len(faces)):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        ux, uy, uz = v[b, 0] - v[a, 0], v[b, 1] - v[a, 1], v[b, 2] - v[a, 2]
        wx, wy, wz = v[c, 0] - v[a, 0], v[c, 1] - v[a, 1], v[c, 2] - v[a, 2]
        # In units of the face, so that no square underflows however small it is.
        m = max(abs(ux), abs(uy), abs(uz), abs(wx), abs(wy), abs(wz))
        if m == 0.0:
            ratios[f] = 0.0
            continue
        ux, uy, uz = ux / m, uy / m, uz / m
        wx, wy, wz = wx / m, wy / m, wz / m
        tx, ty, tz = wx - ux, wy - uy, wz - uz
        nx, ny, nz = uy * wz - uz * wy, uz * wx - ux * wz, ux * wy - uy * wx
        double = (nx * nx + ny * ny + nz * nz) ** 0.5
        longest = max(
            ux * ux + uy * uy + uz * uz, wx * wx + wy * wy + wz * wz, tx * tx + ty * ty + tz * tz
        )
        ratios[f] = double / longest
        total, lost = _added(total, lost, 0.5 * double * m * m)
    return total + lost, ratios


@kernel
def component_volumes(v, faces, labels, num_components):
    """Signed volume of each component, and a bound on its rounding error; each `(C,)`.

    Terms are taken about a vertex of the component itself: about a far origin the volume of a
    small component would drown in rounding.
    """
    total = np.zeros(num_components)
    lost = np.zeros(num_components)
    permanents = np.zeros(num_components)
    underflow = np.zeros(num_components)
    origins = np.full(num_components, -1, np.int64)
    for f in range(len(faces)):
        label = labels[f]
        if origins[label] < 0:
            origins[label] = faces[f, 0]
        o = origins[label]
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        ax, ay, az = v[a, 0] - v[o, 0], v[a, 1] - v[o, 1], v[a, 2] - v[o, 2]
        bx, by, bz = v[b, 0] - v[o, 0], v[b, 1] - v[o, 1], v[b, 2] - v[o, 2]
        cx, cy, cz = v[c, 0] - v[o, 0], v[c, 1] - v[o, 1], v[c, 2] - v[o, 2]
        det = az * (bx * cy - cx * by) + bz * (cx * ay - ax * cy) + cz * (ax * by - bx * ay)
        permanents[label] += (
            (abs(bx * cy) + abs(cx * by)) * abs(az)
            + (abs(cx * ay) + abs(ax * cy)) * abs(bz)
            + (abs(ax * by) + abs(bx * ay)) * abs(cz)
        )
        underflow[label] += UNDERFLOW
        total[label], lost[label] = _added(total[label], lost[label], det)
    return (total + lost) / 6.0, _BOUND_VOLUME * permanents + underflow


@kernel
def _added(total, lost, term):
    """One step of a compensated sum; its value is `total + lost`."""
    new = total + term
    if abs(total) >= abs(term):
        return new, lost + ((total - new) + term)
    return new, lost + ((term - new) + total)

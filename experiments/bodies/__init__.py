"""Bodies in poses: pairs of meshes of the same connectivity for the fitting experiments.

    from experiments.bodies import pairs

    for pair in pairs(20, seed=1):
        warp = iw.fit(pair.source, pair.target, height=pair.height)

The default bodies are those of `anny` (extra ``human``); `FigureBody` needs no extra, and
`SmplBody` with `AmassPoses` reads the licensed files of those who have them.
"""

from experiments.bodies.amass import AmassPoses
from experiments.bodies.anny_body import AnnyBody
from experiments.bodies.figure import FigureBody
from experiments.bodies.smpl import SmplBody
from experiments.bodies.sound_pairs import BodyModel, Pair, pairs

__all__ = ["AmassPoses", "AnnyBody", "BodyModel", "FigureBody", "Pair", "SmplBody", "pairs"]

"""Other ways to deform a body into a pose: the methods of the paper's comparison, and two more.

    from experiments.baselines import METHODS

    fitted = METHODS["neural_ode"](source, target, faces, height=1.7, seconds=60)
    fitted.map(points), fitted.vertices

==============  =========  =====================================================================
``tuttenet``    injective  this project's `fit`, with its defaults
``realnvp``     injective  affine couplings (zuko): 6 layers of width 32, one coordinate a layer
``realnvp_64``  injective  the same at width 64: as many parameters as the TutteNet
``i_resnet``    injective  residuals of Lipschitz constant below 1: 6 layers of width 256
``neural_ode``  injective  the flow of a network, four linear layers of width 120, dopri5 at 1e-4
``cage``        not        mean-value coordinates in a cage that is fitted by least squares
``arap``        not        as-rigid-as-possible between a fiftieth of the vertices (Open3D)
==============  =========  =====================================================================

All of them start from the same rigid motion, minimise the same loss where they minimise one, and
get the same budget of time; the sizes are those of the paper's supplement.
"""

from experiments.baselines.arap import fit_arap
from experiments.baselines.cage import fit_cage
from experiments.baselines.i_resnet import fit_i_resnet
from experiments.baselines.method import Fitted, Method
from experiments.baselines.neural_ode import fit_neural_ode
from experiments.baselines.realnvp import fit_realnvp, fit_realnvp_64
from experiments.baselines.tutte import fit_tuttenet

METHODS: dict[str, Method] = {
    "tuttenet": fit_tuttenet,
    "realnvp": fit_realnvp,
    "realnvp_64": fit_realnvp_64,
    "i_resnet": fit_i_resnet,
    "neural_ode": fit_neural_ode,
    "cage": fit_cage,
    "arap": fit_arap,
}
"""Every method by the name that the experiments' files and options use."""

__all__ = ["METHODS", "Fitted", "Method"]

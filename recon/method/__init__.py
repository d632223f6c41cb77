"""How a fit is assembled and run. Plug-ins with a prior or sensor of their own import from here.

A `Prior` changes variables into a motion with energies (`Decoded`), and is fitted by stages: each
`Stage` minimises the sum of weighted energies (`Term`) of an `Estimate`.
A `Sensor` holds data and predicts what it would measure of a `PosedBody`.
"""

from typing import TYPE_CHECKING

from recon.core.plugins import lazy_names

if TYPE_CHECKING:
    from recon.body.model import PosedBody as PosedBody
    from recon.method.cycle_prior import CyclePrior as CyclePrior
    from recon.method.free import FreeMotion as FreeMotion
    from recon.method.looks import Look as Look
    from recon.method.looks import ProposedMotions as ProposedMotions
    from recon.method.priors import Density as Density
    from recon.method.priors import Prior as Prior
    from recon.method.protocols import Decoded as Decoded
    from recon.method.protocols import Estimate as Estimate
    from recon.method.sensor import Sensor as Sensor
    from recon.method.stages import Stage as Stage
    from recon.method.terms import Term as Term
    from recon.method.terms import joint_acceleration as joint_acceleration
    from recon.method.terms import prior_energy as prior_energy
    from recon.method.terms import shape as shape
    from recon.solver.lbfgs import LBFGS as LBFGS

_HOMES = {
    "CyclePrior": "recon.method.cycle_prior",
    "Decoded": "recon.method.protocols",
    "Density": "recon.method.priors",
    "Estimate": "recon.method.protocols",
    "FreeMotion": "recon.method.free",
    "Look": "recon.method.looks",
    "LBFGS": "recon.solver.lbfgs",
    "PosedBody": "recon.body.model",
    "Prior": "recon.method.priors",
    "ProposedMotions": "recon.method.looks",
    "Sensor": "recon.method.sensor",
    "Stage": "recon.method.stages",
    "Term": "recon.method.terms",
    "joint_acceleration": "recon.method.terms",
    "prior_energy": "recon.method.terms",
    "shape": "recon.method.terms",
}

__getattr__, __dir__ = lazy_names(__name__, _HOMES)

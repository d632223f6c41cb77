"""The network without settling, beside a scaled copy and physics alone: one row per clip.

Every method gets the same clip and the same other body. `network` is what the network proposes,
`network, settled` the nearest motion to the proposal that obeys physics, `physics` the nearest
motion to the scaled copy that does. Nothing else differs between the last two.
"""

from collections.abc import Mapping
from typing import Any

from jaxtyping import Bool
from torch import Tensor

from benchmarks.retarget import Retargeter, itself
from benchmarks.retarget_baselines import copied, scaled, soles_down
from benchmarks.retarget_clips import Job, evenly
from priors.humos.prior import Humos
from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.motion import Motion
from recon.fitting.retargeting import by_physics, proposed, retarget
from recon.metrics import errors as metrics
from recon.physics.metrics import physics_metrics, physics_samples

TRUTH, COPY, SCALED, PHYSICS = "truth", "copy", "scaled copy", "physics"
NETWORK, SETTLED = "network", "network, settled"
BASELINES: Mapping[str, Retargeter] = {
    TRUTH: itself,
    COPY: copied,
    SCALED: scaled,
    PHYSICS: lambda body, motion, shape: by_physics(motion, shape, body),
}
"""Methods that have no network; `truth` is the clip on its own body."""


def of_network(prior: Humos, name: str = "") -> dict[str, Retargeter]:
    """The methods that one network takes part in; a `name` stands before those of another one."""
    before = f"{name}: " if name else ""

    return {
        before + NETWORK: lambda _, motion, shape: proposed(motion, shape, prior),
        before + SETTLED: lambda _, motion, shape: retarget(motion, shape, prior),
    }


def chosen(jobs: list[Job], each: int) -> list[Job]:
    """Clips of every subject, so many of each: half for bodies of people, half for drawn ones.

    Within each half they are spread evenly over the clips' names.
    """
    found: list[Job] = []
    for subject in sorted({job.subject for job in jobs}):
        for real, count in ((True, (each + 1) // 2), (False, each // 2)):
            own = {j.name: j for j in jobs if j.subject == subject and j.real == real}
            found += [own[name] for name in evenly(list(own), count)] if count > 0 else []
    return found


def clip_rows(
    job: Job, methods: Mapping[str, Retargeter], body: BodyModel
) -> list[dict[str, Any]]:
    """One row per method: physics of one clip, contacts, and how smoothly it moves."""
    down = soles_down(job.motion, body)
    smooth = _trembling(scaled(body, job.motion, job.target), body)
    rows: list[dict[str, Any]] = []
    for name, method in methods.items():
        made = method(body, job.motion, job.target).detach()
        found = physics_metrics(physics_samples(made, body, down))
        rows.append(
            {
                "clip": job.name,
                "subject": job.subject,
                "real": job.real,
                "flies": job.flies,
                "method": name,
                **found,
                "contacts": contacts_right(soles_down(made, body), down),
                "trembling": _trembling(made, body) / smooth,
                "turned": float(
                    so3.geodesic(made.rotations, job.motion.rotations).mean().rad2deg()
                ),
            }
        )
    return rows


def contacts_right(said: Bool[Tensor, "time 2"], true: Bool[Tensor, "time 2"]) -> float | None:
    """Balanced accuracy of soles on the ground; None where feet always or never stand."""
    if bool(true.all()) or not bool(true.any()):
        return None
    return float((said[true].double().mean() + (~said[~true]).double().mean()) / 2)


def _trembling(motion: Motion, body: BodyModel) -> float:
    """Mean size of the third derivative of the joints' positions (jerk), m/s³."""
    jerk = body.pose(motion).joints.diff(n=3, dim=0) * motion.fps**3
    return metrics.mean(jerk.norm(dim=-1)) or 0.0

"""Metrics of physics: HUMOS's five numbers as released, and corrected ones.

Rates other than 20 Hz keep the meaning of every threshold; published numbers are at 20 Hz.
"""

from recon.metrics import errors as metrics
from recon.physics.energies import TOLERANCE
from recon.physics.samples import PhysicsSamples

SLIPPING = 0.1
"""m/s from which a foot in contact slips."""


def physics_metrics(samples: PhysicsSamples) -> dict[str, float | None]:
    """All metrics in SI units; None where there is nothing to average. See docs/physics.md."""
    return {**released(samples), **physdiff(samples), **balance(samples), **slipping(samples)}


def released(samples: PhysicsSamples) -> dict[str, float | None]:
    """The table of HUMOS as its released code computes it.

    `penetrate` and `float` are means over the frames that do so by more than 5 mm, 0 where none
    does. `skate` is the share of ankles and toes under 1.5 cm, whatever their speed.
    `dynamic_stability` is the share of frames whose released ZMP is inside the base of support;
    without a base it is not. `bos_distance` is the mean over the frames outside of one.
    """
    depth, out = -samples.lowest, samples.has_base & (samples.released_distance > 0)
    stable = samples.has_base & (samples.released_distance < 0)
    return {
        "penetrate": metrics.mean(depth, depth > TOLERANCE) or 0.0,
        "float": metrics.mean(-depth, -depth >= TOLERANCE) or 0.0,
        "skate": metrics.mean(samples.joints_touch.double()[samples.stepped]),
        "dynamic_stability": metrics.mean(stable.double()),
        "bos_distance": metrics.mean(samples.released_distance, out),
    }


def physdiff(samples: PhysicsSamples) -> dict[str, float | None]:
    """PhysDiff's penetration, float, skate (vertices, as in UHC) and their sum, metres.

    Means over all frames, those without an error counting as zero; skate per 1/20 s.
    """
    depth = -samples.lowest
    sunk = metrics.mean(depth.where(depth > TOLERANCE, 0.0))
    afloat = metrics.mean((-depth).where(-depth > TOLERANCE, 0.0))
    skate = metrics.mean(samples.sunk_step, samples.stepped)
    whole = None if sunk is None or afloat is None or skate is None else sunk + afloat + skate
    return {
        "physdiff_penetrate": sunk,
        "physdiff_float": afloat,
        "physdiff_skate": skate,
        "physdiff_error": whole,
    }


def balance(samples: PhysicsSamples) -> dict[str, float | None]:
    """Share of frames whose ZMP is inside the base of support, supported and in flight apart."""
    stable = (samples.has_base & (samples.distance < 0)).double()
    carried, flying = samples.known & samples.carried, samples.known & ~samples.carried
    out = carried & samples.has_base & (samples.distance > 0)
    return {
        "stability_supported": metrics.mean(stable, carried),
        "stability_flight": metrics.mean(stable, flying),
        "bos_distance_supported": metrics.mean(samples.distance, out),
        "flight": metrics.mean(flying.double(), samples.known),
    }


def slipping(samples: PhysicsSamples) -> dict[str, float | None]:
    """Mean horizontal speed of the lowest point of feet in contact, and share above 0.1 m/s."""
    return {
        "slip_in_contact": metrics.mean(samples.slip, samples.soles_touch),
        "slipping": metrics.mean((samples.slip > SLIPPING).double(), samples.soles_touch),
    }

"""Shape coefficients from descriptions: height, weight, words, coefficients or a motion file."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum
from functools import partial
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from recon.body.model import ODDEST, SHORTEST_BODY, TALLEST_BODY, BodyModel
from recon.body.motion_files import load_motion_of
from recon.body.parts import Parts
from recon.body.volumes import part_volumes
from recon.core.errors import ReconError

DENSITY = 1010.0
"""kg/m³ of a living person, lungs half full."""
ONE_IN_TWENTY = 1.645
"""Standard deviations beyond which one person in twenty lies, on one side; what `tall` means."""

FORMS = (
    "coefficients (0.5,-1,2), measures (height=1.80,weight=75; metres, kilograms), words (man or "
    "woman, tall or short, heavy or slim), words and measures (woman,height=1.65), or a motion "
    "file (.npz) of somebody"
)
"""The forms of description that `identity` takes."""


class _FromAverage(Enum):
    """A wish for a body measure below or above the average, such as short or tall."""

    BELOW = -1
    ABOVE = 1


_WORDS = {
    "man": ("sex", _FromAverage.ABOVE), "woman": ("sex", _FromAverage.BELOW),
    "tall": ("height", _FromAverage.ABOVE), "short": ("height", _FromAverage.BELOW),
    "heavy": ("weight", _FromAverage.ABOVE), "slim": ("weight", _FromAverage.BELOW),
}  # fmt: skip
_LIMITS = {"height": (1.0, 2.5, "metres"), "weight": (20.0, 250.0, "kilograms")}
"""Least and greatest values; beyond them a unit is wrong."""
_STEPS = 60
_CLOSE = 1e-5
"""Metres and kilograms."""
_MAX_STDS = 40.0
"""Standard deviations from which on a search has gone astray."""

Measure = Callable[[Float[Tensor, " shape"]], Float[Tensor, ""]]


@dataclass(frozen=True)
class _WantedMeasures:
    """Wanted sex, height (m) and weight (kg): a number, below or above average, or None."""

    sex: _FromAverage | None = None
    """ABOVE means a man, BELOW a woman."""
    height: _FromAverage | float | None = None
    weight: _FromAverage | float | None = None


def identity(spec: str, body: BodyModel) -> Float[Tensor, " shape"]:
    """Shape coefficients for a description of a person; see `FORMS`.

    Measures alone are those of the shape nearest to the average with them (|shape| least); beside
    `man` or `woman`, nearest to the average of that sex among shapes that differ from it in
    nothing that tells sexes apart. A measure that is not given goes with the other: taller
    people are heavier. `tall` is the height that one in twenty people (men, women) exceeds,
    `heavy` what one in twenty of the same height exceeds.

    Raises:
        FileNotFoundError: when there is no such motion file.
        ValueError: when this is nothing that is understood, is not a body's height or weight, or
            no shape has it.
    """
    words = [word.strip() for word in spec.split(",")]
    if _are_numbers(words):
        return _coefficients_of_words(spec, words, body)
    if spec.strip().endswith(".npz") or Path(spec).is_file():
        return load_motion_of(Path(spec.strip()), body).motion.shape
    return _shape_with_measures(_parsed_measures(spec, words), body)


def body_weight(body: BodyModel, shape: Float[Tensor, "*batch shape"]) -> Float[Tensor, "*batch"]:
    """Return the weight of a body in kg: its volume in rest pose times the human density."""
    return DENSITY * part_volumes(body.rest_vertices(shape), Parts.of(body)).sum(-1)


def reasons_for_doubt(body: BodyModel, shape: Float[Tensor, " shape"]) -> list[str]:
    """Reasons why no adult has this shape, as sentences; empty where an adult may have it."""
    tall, odd = float(body.height(shape)), float(shape.abs().max())
    found: list[str] = []
    if not SHORTEST_BODY < tall < TALLEST_BODY:
        found.append(
            f"the body is {tall:.2f} m tall; adults are {SHORTEST_BODY} to {TALLEST_BODY} m, and "
            "the body model knows no others"
        )
    if odd > ODDEST:
        found.append(
            f"the body's shape is {odd:.1f} standard deviations from the average; people are "
            f"within {ODDEST:g}"
        )
    return found


def nearest_shape(
    base: Float[Tensor, " shape"],
    measures: Sequence[Measure],
    wanted_values: Sequence[float],
    projection: Float[Tensor, "shape shape"],
) -> Float[Tensor, " shape"]:
    """The shape nearest to `base` that has the wanted measures.

    min |s - s0|² with c(s) = c, by s ← s0 + Jᵀ (J Jᵀ)⁻¹ (c - c(s) + J (s - s0)): heights are
    linear in the shape and volumes nearly so.

    Args:
        base: s0.
        measures: c(s), metres or kilograms.
        wanted_values: c.
        projection: projection onto the directions in which the shape may change.

    Raises:
        ValueError: when no shape is found that has them.
    """
    goal, shape = base.new_tensor(wanted_values), base
    for _ in range(_STEPS):
        values, slopes = _values_and_gradients(shape, measures, projection)
        if bool(((goal - values).abs() < _CLOSE).all()):
            return shape
        change = goal - values + slopes @ (shape - base)
        away = slopes.mT @ torch.linalg.solve(slopes @ slopes.mT, change)
        if not float(away.norm()) < _MAX_STDS:
            break
        shape = base + away
    raise ReconError(
        "no body of this model has these measures; give measures nearer to the average"
    )


def _are_numbers(words: list[str]) -> bool:
    try:
        return bool([float(word) for word in words])
    except ValueError:
        return False


def _coefficients_of_words(spec: str, words: list[str], body: BodyModel) -> Tensor:
    values = [float(word) for word in words]
    if len(values) > body.shape_size:
        raise ReconError(
            f"shape {spec!r}: the body {body.name!r} has {body.shape_size} coefficients, got "
            f"{len(values)}"
        )
    if not all(map(math.isfinite, values)):
        raise ReconError(f"shape {spec!r}: expected finite numbers as coefficients")
    return body.template.new_tensor(values + [0.0] * (body.shape_size - len(values)))


def _parsed_measures(spec: str, words: list[str]) -> _WantedMeasures:
    """Parse words such as "woman" or "height=1.65" to wanted sex, height and weight."""
    found: dict[str, Any] = {}
    for word in words:
        name, equals, value = (part.strip() for part in word.partition("="))
        if equals and name in _LIMITS:
            slot, wish = name, _parsed_measure(spec, name, value)
        elif not equals and name in _WORDS:
            slot, wish = _WORDS[name]
        else:
            raise ReconError(f"shape {spec!r}: {word or 'nothing'!r} is not known; give {FORMS}")
        if slot in found:
            raise ReconError(f"shape {spec!r}: gives the {slot} twice; give it once")
        found[slot] = wish
    return _WantedMeasures(**found)


def _parsed_measure(spec: str, name: str, value: str) -> float:
    least, most, unit = _LIMITS[name]
    try:
        number = float(value)
    except ValueError:
        raise ReconError(
            f"shape {spec!r}: expected a number of {unit} for the {name}, got {value!r}"
        ) from None
    if not least <= number <= most:
        raise ReconError(
            f"shape {spec!r}: expected a {name} of {least:g} to {most:g} {unit}, got {value}"
        )
    return number


def _shape_with_measures(wanted: _WantedMeasures, body: BodyModel) -> Tensor:
    exact = body.to(dtype=torch.float64)
    base, free = _mean_of_sex(wanted.sex, exact)
    height_of, weight_of = exact.height, partial(body_weight, exact)
    metres, kilograms = wanted.height, wanted.weight
    if isinstance(metres, _FromAverage):
        # height is linear in shape coefficients of std 1: its std is the length of its gradient
        values, slopes = _values_and_gradients(base, (height_of,), free)
        metres = float(values[0] + metres.value * ONE_IN_TWENTY * slopes[0].norm())
    if isinstance(kilograms, _FromAverage):
        # heavy and slim are meant relative to other people of the same height
        goal = float(height_of(base)) if metres is None else metres
        shape = nearest_shape(base, (height_of,), (goal,), free)
        _, slopes = _values_and_gradients(shape, (height_of, weight_of), free)
        up = slopes[0] / slopes[0].norm()
        wide = slopes[1] - (slopes[1] @ up) * up
        return (shape + kilograms.value * ONE_IN_TWENTY * wide / wide.norm()).to(body.template)
    pairs = [(of, x) for of, x in ((height_of, metres), (weight_of, kilograms)) if x is not None]
    if pairs:
        base = nearest_shape(base, [of for of, _ in pairs], [x for _, x in pairs], free)
    return base.to(body.template)


def _mean_of_sex(sex: _FromAverage | None, body: BodyModel) -> tuple[Tensor, Tensor]:
    """Return the mean shape of a sex, and the projection orthogonal to the male-female axis."""
    free = torch.eye(body.shape_size).to(body.male)
    if sex is None:
        return torch.zeros_like(body.male), free
    between = body.male - body.female
    if not bool((between != 0).any()):
        raise ReconError(
            f"the body {body.name!r} has no mean shapes of men and women: give height and "
            "weight, or coefficients"
        )
    axis = between / between.norm()
    mean = body.male if sex is _FromAverage.ABOVE else body.female
    return mean, free - axis[:, None] * axis


def _values_and_gradients(
    shape: Tensor, measures: Sequence[Measure], projection: Tensor
) -> tuple[Float[Tensor, " measures"], Float[Tensor, "measures shape"]]:
    """Return body measures of a shape, and their gradients times `projection`."""
    at = shape.detach().requires_grad_()
    values = [measure(at) for measure in measures]
    slopes = torch.stack([torch.autograd.grad(value, at)[0] for value in values])
    return torch.stack(values).detach(), slopes @ projection

"""What `--shape` says is the body that comes out."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from recon.body.identities import body_weight, identity, reasons_for_doubt
from recon.body.model import BodyModel
from recon.core.motion import MotionFile
from recon.formats.motions import save_motion
from tests.walking import a_walk

pytestmark = pytest.mark.numerics

BODY = BodyModel.load()


def measures(spec: str) -> tuple[float, float]:
    shape = identity(spec, BODY)
    assert shape.shape == (16,)
    return float(BODY.height(shape)), float(body_weight(BODY, shape))


def test_many_long_coefficients_are_no_file():
    """As pasted from a report: longer than a file's name may be."""
    spec = ",".join(f"{0.1 * k + 1 / 3:.17f}" for k in range(16))
    assert len(spec) > 255
    assert float(identity(spec, BodyModel.load())[3]) == pytest.approx(0.3 + 1 / 3)


def test_coefficients_are_themselves_and_the_others_zero():
    shape = identity(" -0.5, 1,2e-1", BODY)
    torch.testing.assert_close(shape, torch.tensor([-0.5, 1.0, 0.2] + [0.0] * 13))


@pytest.mark.parametrize(
    ("spec", "tall", "heavy"),
    [
        ("height=1.80,weight=75", 1.80, 75),
        ("weight=60, height=1.55", 1.55, 60),
        ("woman,height=1.75,weight=90", 1.75, 90),
        ("height=1.62", 1.62, None),
        ("weight=95", None, 95),
    ],
)
def test_a_body_has_the_measures_asked_for(spec, tall, heavy):
    found = measures(spec)
    assert tall is None or found[0] == pytest.approx(tall, abs=1e-4)  # metres
    assert heavy is None or found[1] == pytest.approx(heavy, abs=1e-2)  # kg


def test_no_other_body_with_these_measures_is_nearer_to_the_average():
    """At the nearest one, |shape| grows along every direction that keeps the measures."""
    exact = BODY.to(dtype=torch.float64)
    shape = identity("height=1.9,weight=70", BODY).double().requires_grad_()
    slopes = [
        torch.autograd.grad(tall_or_heavy, shape)[0]
        for tall_or_heavy in (exact.height(shape), body_weight(exact, shape))
    ]
    basis = torch.linalg.qr(torch.stack(slopes, 1)).Q
    off = shape - basis @ (basis.mT @ shape)
    assert float(off.detach().norm()) < 1e-3 * float(shape.detach().norm())


def test_words_mean_what_they_say():
    (average, usual), man, woman = measures("0"), measures("man"), measures("woman")
    assert woman[0] < average < man[0]
    assert measures("tall")[0] > man[0]
    assert measures("short")[0] < woman[0]
    for word, sign in (("heavy", 1), ("slim", -1)):
        tall, kilograms = measures(word)
        assert tall == pytest.approx(average, abs=1e-3)
        assert sign * (kilograms - usual) > 15
    assert measures("heavy,height=1.5")[0] == pytest.approx(1.5, abs=1e-3)


@pytest.mark.parametrize("sex", ["man", "woman"])
def test_a_measure_does_not_change_the_sex(sex):
    mean, other = identity(sex, BODY), identity(f"{sex},height=1.7,weight=60", BODY)
    axis = BODY.male - BODY.female
    assert float((other - mean) @ axis) == pytest.approx(0, abs=1e-4)


@pytest.mark.parametrize("size", ["", ",tall", ",short"])
@pytest.mark.parametrize("build", ["", ",heavy", ",slim"])
@pytest.mark.parametrize("sex", ["man", "woman"])
def test_all_that_words_can_say_is_plausible(sex, size, build):
    assert reasons_for_doubt(BODY, identity(sex + size + build, BODY)) == []


def test_an_implausible_body_is_doubted():
    assert "1.30 m tall" in reasons_for_doubt(BODY, identity("height=1.3", BODY))[0]
    assert "4.5 standard deviations" in reasons_for_doubt(BODY, identity("0,0,0,4.5", BODY))[0]


def test_a_motion_file_lends_its_shape(tmp_path: Path):
    motion = a_walk(BODY, seconds=0.1)
    shape = torch.linspace(-1, 1, 10)
    save_motion(tmp_path / "a.npz", MotionFile(motion.replace(shape=shape)))
    found = identity(str(tmp_path / "a.npz"), BODY)
    torch.testing.assert_close(found, torch.cat((shape, torch.zeros(6))))
    save_motion(tmp_path / "b.npz", MotionFile(motion, body="mine", checksum="0123"))
    with pytest.raises(ValueError, match="--body"):
        identity(str(tmp_path / "b.npz"), BODY)
    with pytest.raises(FileNotFoundError, match=r"c\.npz"):
        identity(str(tmp_path / "c.npz"), BODY)


@pytest.mark.parametrize(
    ("spec", "words"),
    [
        ("", "'nothing' is not known; give coefficients"),
        ("huge", "'huge' is not known"),
        ("1,2,tall", "'1' is not known"),
        ("nan,0", "finite"),
        (",".join(["0"] * 17), "has 16 coefficients, got 17"),
        ("height=180", "1 to 2.5 metres, got 180"),
        ("weight=0.08", "20 to 250 kilograms, got 0.08"),
        ("height=1,80", "'80' is not known"),
        ("height=big", "expected a number of metres"),
        ("height=nan", "got nan"),
        ("width=3", "'width=3' is not known"),
        ("tall,height=1.9", "gives the height twice"),
        ("man,woman", "gives the sex twice"),
    ],
)
def test_other_specifications_are_refused_in_words(spec, words):
    with pytest.raises(ValueError, match="shape ") as error:
        identity(spec, BODY)
    assert words in str(error.value)


def test_a_body_of_one_sex_has_no_other():
    neutral = replace(BODY, male=torch.zeros(16), female=torch.zeros(16))
    with pytest.raises(ValueError, match="no mean shapes of men and women"):
        identity("man", neutral)
    assert float(neutral.height(identity("tall", neutral))) > 1.85

"""The conformance suite: it passes good models and names every law that a model breaks."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest
from broken_models import BROKEN, AsymmetricNoise, NegativePoseNoise, WrongF, WrongHPose
from model_examples import name
from own_models import Differential, Driven, Mounted, Omnidirectional, Polar, PositionAndRange, Scooter, Watcher

from slamkit.arrays import Array
from slamkit.errors import InputError, ModelError
from slamkit.models import RangeBearing, Unicycle, check_model


@pytest.mark.parametrize(
    "model", [Differential(), Polar(), PositionAndRange(), Mounted(), Watcher(), Scooter(), Driven()], ids=name
)
def test_a_model_of_ones_own_passes(model: object) -> None:
    check_model(model)


def test_a_model_passes_at_other_points_and_with_its_own_controls() -> None:
    for seed in range(3):
        check_model(Polar(), rng=np.random.default_rng(seed))
    check_model(Omnidirectional(), controls=[[1.0, 0.2, 0.1], [0.5, -0.2, -0.4]], rng=np.random.default_rng(5))
    with pytest.raises(ModelError, match=r"u was given length 2: set control_dim or give examples"):
        check_model(Omnidirectional())


@pytest.mark.parametrize("model", BROKEN, ids=lambda model: model.__name__)
def test_a_model_that_breaks_a_law_is_told_which_and_where(model: Any) -> None:
    controls = [[1.0, 0.4], [-0.7, 0.2], [0.3, -1.1]] if hasattr(model, "move") else None
    with pytest.raises(ModelError) as caught:
        check_model(model(), controls=controls)
    message = str(caught.value)
    lines = [line for line in message.splitlines() if line.startswith(f"- {model.law}")]
    assert len(lines) == 1, message
    assert message.startswith(f"{model.__name__} breaks ")
    assert not model.alone or len(message.splitlines()) == 2, message
    if "raises no error" not in model.law and "functions" not in model.law and "survives pickle" not in model.law:
        assert "expected" in lines[0]


def test_every_broken_law_is_listed_at_once() -> None:
    class Worse(WrongF, NegativePoseNoise, AsymmetricNoise):
        pass

    Worse.__qualname__ = "nowhere.Worse"  # which pickle cannot find
    with pytest.raises(ModelError) as caught:
        check_model(Worse())
    laws = re.findall(r"^- (.*?)(?: \(at \d+ points, the first:\))? at ", str(caught.value), re.M)
    noise = {f"{n} is symmetric positive semidefinite" for n in ("control_noise", "pose_noise")}
    assert {"F is ∂move/∂pose", *noise} <= set(laws)
    assert "- survives pickle" in str(caught.value)
    assert "breaks 4 laws of MotionModel" in str(caught.value)


def test_a_broken_law_comes_with_its_numbers() -> None:
    with pytest.raises(ModelError) as caught:
        check_model(WrongHPose())
    line = str(caught.value).splitlines()[1]
    number = r"-?[\d.e+-]+"
    assert re.search(
        rf"at \d+ points, the first:\) at pose = \[.*\], landmark = \[.*\]: expected \[\[{number}.*\], got", line
    )


class Neither:
    def drive(self) -> None: ...


class Half:
    def move(self, pose: Array, u: Array, dt: float) -> Array:
        return pose

    jacobians = 3


class HalfSensor:
    R = np.eye(2)

    def predict(self, pose: Array, landmark: Array) -> Array:
        return landmark


@pytest.mark.parametrize(
    ("model", "message"),
    [
        (Neither(), r"Neither is neither .* MotionModel needs move, jacobians, .*; SensorModel needs R, predict, "),
        (None, "NoneType is neither"),
        (Half(), r"Half has no jacobians, control_noise, pose_noise: see slamkit\.protocols\.MotionModel"),
        (HalfSensor(), r"HalfSensor has no jacobians, residual, invert, inverse_jacobians: see .*SensorModel"),
        (RangeBearing, r"RangeBearing is a class, expected an instance"),
    ],
)
def test_what_is_no_model_is_told_what_it_misses(model: object, message: str) -> None:
    with pytest.raises(ModelError, match=message):
        check_model(model)


@pytest.mark.parametrize(
    "controls", [[], [[]], [1.0, 2.0], [[1.0, np.nan]], [[1.0, 2.0, 3.0]], "u", [[1.0], [1.0, 2.0]]]
)
def test_controls_that_cannot_be_are_refused(controls: Any) -> None:
    with pytest.raises(InputError, match=r"^controls "):
        check_model(Unicycle(0.1, 0.1), controls=controls)


@pytest.mark.parametrize("dim", [0, -1, 2.0, True, "2"])
def test_a_control_dim_that_cannot_be_is_refused(dim: Any) -> None:
    model = Omnidirectional()
    model.control_dim = dim  # type: ignore[attr-defined]
    with pytest.raises(ModelError, match="control_dim is"):
        check_model(model)

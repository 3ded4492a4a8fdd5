"""Registered models: their lists, and models as plain values in files."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import family
import model_examples
import numpy as np
import pytest
from own_models import Differential, Polar

from slamkit import EKFSLAM
from slamkit.errors import InputError
from slamkit.models import (
    MOTIONS,
    SENSORS,
    EulerUnicycle,
    Odometry,
    RangeBearing,
    Unicycle,
    check_model,
    model_from_dict,
    model_to_dict,
    parameters_of,
)
from slamkit.protocols import MotionModel, SensorModel

EXAMPLES: list[Any] = [*model_examples.MOTIONS, *model_examples.SENSORS]
REGISTERED: list[Any] = [*MOTIONS.values(), *SENSORS.values()]


@dataclass(frozen=True)
class Wheels(Differential):
    """A user's motion model with a vector among its arguments."""

    lengths: Any = field(default_factory=lambda: np.array([0.1, 0.2]))
    kind: str = "rubber"


class Twin(Polar):
    """A user's sensor model that is no dataclass but tells its arguments."""

    def __init__(self, offset: float = 0.0, bias: Any = None) -> None:
        super().__init__()
        self.offset, self.bias = offset, bias

    def arguments(self) -> dict[str, Any]:
        return {"offset": np.float64(self.offset), "bias": self.bias}


@pytest.fixture(autouse=True)
def _separate_lists() -> Iterator[None]:
    """What a test registers is gone after it."""
    lists = (MOTIONS, SENSORS)
    before = [dict(registry) for registry in lists]
    yield
    for registry, items in zip(lists, before, strict=True):
        for name in registry.keys() - items:
            registry.unregister(name)


def through_json(model: object) -> Any:
    return model_from_dict(json.loads(json.dumps(model_to_dict(model))))


# -- the lists --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", REGISTERED, ids=lambda kind: kind.__name__)
def test_every_registered_model_takes_part_in_the_laws(kind: Any) -> None:
    assert kind in {type(m) for m in EXAMPLES}
    assert kind in {type(m) for m in (*family.MOTIONS.values(), *family.SENSORS.values())}


@pytest.mark.parametrize("kind", REGISTERED, ids=lambda kind: kind.__name__)
def test_typical_values_make_a_good_model(kind: Any) -> None:
    parameters = parameters_of(kind)
    assert parameters and all(unit for unit, _ in parameters.values())
    model = kind(*[typical for _, typical in parameters.values()])
    for name, (_, typical) in parameters.items():
        assert getattr(model, name) == typical
    check_model(model, controls=model_examples.CONTROLS.get(kind))


def test_columns_identify_at_most_one_model() -> None:
    for registry in (MOTIONS, SENSORS):
        columns = [kind.columns for kind in registry.values() if kind.columns]
        assert len(columns) == len(set(columns))
    assert (Unicycle.columns, EulerUnicycle.columns) == (("v", "omega"), ())


def test_a_class_without_metadata_has_no_described_parameters() -> None:
    assert parameters_of(Differential) == parameters_of(Polar) == {}


@pytest.mark.parametrize(
    ("registry", "item", "message"),
    [
        (MOTIONS, Unicycle(0.1, 0.1), r"must be registered as a class, got Unicycle\("),
        (MOTIONS, RangeBearing, "RangeBearing is no motion model: it has no move, control_noise, pose_noise"),
        (SENSORS, Unicycle, "Unicycle is no sensor model: it has no predict, residual, invert, inverse_jacobians"),
        (SENSORS, len, "must be registered as a class"),
    ],
)
def test_what_is_no_model_class_is_not_registered(registry: Any, item: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        registry.register("mine", item)
    assert "mine" not in registry


def test_a_class_of_a_users_module_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "my_robot_models.py").write_text(
        "from slamkit.models import Unicycle\nclass Mine(Unicycle): ...\nmade = Mine(0.1, 0.1)\n", encoding="utf-8"
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    mine = MOTIONS.find("my_robot_models:Mine")
    check_model(mine(0.1, 0.1))
    with pytest.raises(InputError, match="must be registered as a class"):
        MOTIONS.find("my_robot_models:made")
    with pytest.raises(InputError, match="no sensor model"):
        SENSORS.find("my_robot_models:Mine")


# -- models as plain values -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("model", EXAMPLES, ids=repr)
def test_a_registered_model_is_read_as_it_was_written(model: Any) -> None:
    assert through_json(model) == model
    assert model_to_dict(model)["name"] == type(model).__name__  # type: ignore[index]


@pytest.mark.parametrize(
    ("written", "model"),
    [
        (
            {"name": "Unicycle", "sigma_v": 0.1, "sigma_omega": 0.2, "pose_noise": [[0.0] * 3] * 3},
            Unicycle(0.1, 0.2),
        ),
        ({"name": "Odometry", "alpha1": 1, "alpha2": 2, "alpha3": 3, "alpha4": 4}, Odometry(1, 2, 3, 4)),
        ({"name": "RangeBearing", "sigma_range": 0.1, "sigma_bearing": 0.2}, RangeBearing(0.1, 0.2)),
        ({"name": "range-bearing", "sigma_range": 0.1, "sigma_bearing": 0.2}, RangeBearing(0.1, 0.2)),
    ],
)
def test_the_form_in_files_stays_readable(written: dict[str, Any], model: Any) -> None:
    assert model_from_dict(written) == model


def test_a_users_model_is_written_and_read_once_it_is_registered(tmp_path: Path) -> None:
    wheels, twin = Wheels(0.5, np.array([0.3, 0.4]), "steel"), Twin(0.25, [1, None, True])
    assert model_to_dict(wheels) is None
    assert model_to_dict(twin) is None
    MOTIONS.register("wheels", Wheels)
    SENSORS.register("twin", Twin)
    again = through_json(wheels)
    assert (type(again), again.width, list(again.lengths), again.kind) == (Wheels, 0.5, [0.3, 0.4], "steel")
    assert through_json(twin).arguments() == twin.arguments()
    EKFSLAM(wheels, twin).save(tmp_path / "filter.npz")
    loaded = EKFSLAM.load(tmp_path / "filter.npz")
    assert (loaded.motion.kind, loaded.sensor.offset) == ("steel", 0.25)


def test_a_model_that_json_cannot_hold_is_not_written() -> None:
    MOTIONS.register("wheels", Wheels)
    SENSORS.register("polar", Polar)
    assert model_to_dict(Wheels(0.5, object())) is None
    assert model_to_dict(Polar()) is None  # it does not tell its arguments


def test_another_class_of_a_registered_name_is_not_taken_for_it() -> None:
    Other = dataclass(frozen=True)(type("Unicycle", (Differential,), {}))
    assert model_to_dict(Other()) is None
    MOTIONS.register("other", Other)
    assert model_to_dict(Other()) is None
    assert model_to_dict(Unicycle(0.1, 0.2)) is not None


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ({"name": "Rocket"}, "model is .*Rocket.*expected an object whose name is one of .*Unicycle"),
        ({"name": "json:JSONDecoder"}, "expected an object whose name is one of"),
        ({"name": ["Unicycle"]}, "expected an object whose name is one of"),
        ({}, "expected an object whose name is one of"),
        (None, "expected an object whose name is one of"),
        ("Unicycle", "expected an object whose name is one of"),
        ({"name": "Unicycle", "sigma_v": 0.1}, "Unicycle does not take these arguments"),
        ({"name": "Unicycle", "sigma_v": 0.1, "sigma_omega": 0.1, "wings": 2}, "Unicycle does not take .*wings"),
        ({"name": "Unicycle", "sigma_v": "0.1", "sigma_omega": 0.1}, "sigma_v is '0.1'"),
        ({"name": "Unicycle", "sigma_v": True, "sigma_omega": 0.1}, "sigma_v is True"),
        ({"name": "Unicycle", "sigma_v": 0.1, "sigma_omega": None}, "sigma_omega is None"),
        ({"name": "Unicycle", "sigma_v": 0.1, "sigma_omega": 0.1, "pose_noise": [[1]]}, "pose_noise has shape"),
    ],
)
def test_a_value_that_is_no_model_is_refused(value: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        model_from_dict(value)


def test_a_file_cannot_name_a_module_to_import(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "not_to_be_imported.py").write_text("class Mine: ...\n", encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(InputError, match="expected an object whose name"):
        model_from_dict({"name": "not_to_be_imported:Mine"})
    assert "not_to_be_imported" not in sys.modules


def test_the_examples_keep_their_protocols() -> None:
    assert all(isinstance(m, MotionModel) for m in model_examples.MOTIONS)
    assert all(isinstance(m, SensorModel) for m in model_examples.SENSORS)

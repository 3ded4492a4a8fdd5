"""Laws of all built-in models."""

from __future__ import annotations

import copy
import dataclasses
import itertools
import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from derivations import close, exact, symbolic
from hypothesis import given, settings
from hypothesis import strategies as st
from model_examples import CONTROL_DIM, MOTIONS, SENSORS, control, durations, headings, name, poses, rates, same_pose

import slamkit.models
from slamkit import se2
from slamkit.arrays import Array
from slamkit.errors import InputError
from slamkit.models import EulerUnicycle, Odometry, RangeBearing, RelativePosition, Unicycle, check_model
from slamkit.protocols import MotionModel, SensorModel


@pytest.mark.parametrize("model", [*MOTIONS, *SENSORS], ids=name)
def test_built_in_models_keep_every_law(model: object) -> None:
    check_model(model)


@pytest.mark.parametrize("model", [*MOTIONS, *SENSORS], ids=name)
def test_built_in_models_fit_their_protocol(model: object) -> None:
    assert isinstance(model, MotionModel if type(model) in CONTROL_DIM else SensorModel)


@pytest.mark.parametrize("model", [MOTIONS[0], MOTIONS[2], MOTIONS[3]], ids=name)
def test_motion_equals_its_symbolic_derivation(model: Any) -> None:
    rng = np.random.default_rng(7)
    value, F, G = symbolic(type(model))  # type: ignore[arg-type]  # a class is hashable
    for _ in range(40):
        pose, u, dt = rng.uniform(-3, 3, 3), rng.uniform(-2, 2, CONTROL_DIM[type(model)]), rng.uniform(0.1, 2)
        numbers = [*pose, *u, *([0.0] * (3 - len(u))), dt]
        expected = exact(value, *numbers)[:, 0]
        expected[2] = se2.wrap(expected[2])
        close(model.move(pose, u, dt), expected)
        close(model.jacobians(pose, u, dt)[0], exact(F, *numbers))
        close(model.jacobians(pose, u, dt)[1], exact(G, *numbers))


@pytest.mark.parametrize("model", [SENSORS[0], SENSORS[2]], ids=name)
def test_sensor_equals_its_symbolic_derivation(model: Any) -> None:
    rng = np.random.default_rng(8)
    value, H_pose, H_landmark, found, G_pose, G_z = symbolic(type(model))  # type: ignore[arg-type]  # a class is hashable
    for _ in range(40):
        pose, landmark = rng.uniform(-3, 3, 3), rng.uniform(-9, 9, 2)
        numbers = [*pose, *landmark, 0.0, 0.0]
        z = exact(value, *numbers)[:, 0]
        close(model.predict(pose, landmark), z)
        close(model.jacobians(pose, landmark)[0], exact(H_pose, *numbers))
        close(model.jacobians(pose, landmark)[1], exact(H_landmark, *numbers))
        numbers = [*pose, *z, 0.0, 0.0]
        close(model.invert(pose, z), exact(found, *numbers)[:, 0])
        close(model.inverse_jacobians(pose, z)[0], exact(G_pose, *numbers))
        close(model.inverse_jacobians(pose, z)[1], exact(G_z, *numbers))


@pytest.mark.parametrize("model", MOTIONS, ids=name)
@given(poses, poses, st.tuples(rates, rates, rates), durations)
@settings(max_examples=30, deadline=None)
def test_motion_does_not_depend_on_the_frame(
    model: Any, T: Array, pose: Array, numbers: tuple[float, float, float], dt: float
) -> None:
    u = control(model, numbers)
    there = se2.compose(T, pose)
    same_pose(model.move(there, u, dt), se2.compose(T, model.move(pose, u, dt)))
    turn = np.eye(3)
    turn[:2, :2] = se2.rotation(T[2])
    F, G = model.jacobians(pose, u, dt)
    F_there, G_there = model.jacobians(there, u, dt)
    np.testing.assert_allclose(F_there, turn @ F @ turn.T, atol=1e-10)
    np.testing.assert_allclose(G_there, turn @ G, atol=1e-10)


@pytest.mark.parametrize("model", SENSORS, ids=name)
@given(poses, poses, st.floats(0.1, 50), headings)
@settings(max_examples=30, deadline=None)
def test_measurements_do_not_depend_on_the_frame(model: Any, T: Array, pose: Array, r: float, bearing: float) -> None:
    there = se2.compose(T, pose)
    landmark = pose[:2] + r * np.array([np.cos(pose[2] + bearing), np.sin(pose[2] + bearing)])
    z = model.predict(pose, landmark)
    np.testing.assert_allclose(model.residual(model.predict(there, se2.transform(T, landmark)), z), 0, atol=1e-10)
    np.testing.assert_allclose(model.invert(there, z), se2.transform(T, model.invert(pose, z)), atol=1e-10)
    np.testing.assert_allclose(model.invert(pose, z), landmark, atol=1e-10)
    R = se2.rotation(T[2])
    H_pose, H_landmark = model.jacobians(pose, landmark)
    H_pose_there, H_landmark_there = model.jacobians(there, se2.transform(T, landmark))
    np.testing.assert_allclose(H_landmark_there @ R, H_landmark, atol=1e-9)
    np.testing.assert_allclose(H_pose_there[:, :2] @ R, H_pose[:, :2], atol=1e-9)
    np.testing.assert_allclose(H_pose_there[:, 2], H_pose[:, 2], atol=1e-9)
    # A translation of the robot and of the landmark together changes nothing.
    np.testing.assert_allclose(H_pose[:, :2], -H_landmark, atol=1e-12)


@pytest.mark.parametrize("model", [*MOTIONS, *SENSORS], ids=name)
def test_models_are_values(model: Any) -> None:
    again = type(model)(
        **{("pose_noise" if k == "pose_covariance" else k): v for k, v in dataclasses.asdict(model).items()}
    )
    for cached in ("params", "R"):  # what a model keeps of them changes no equality
        getattr(model, cached, None)
    for twin in (again, copy.copy(model), copy.deepcopy(model), pickle.loads(pickle.dumps(model))):
        assert twin == model
        assert hash(twin) == hash(model)
        assert repr(twin) == repr(model)
    for field in dataclasses.fields(model):
        with pytest.raises(dataclasses.FrozenInstanceError):
            setattr(model, field.name, 1.0)
        value = getattr(model, field.name)
        changed = tuple(tuple(x + 1.0 for x in row) for row in value) if isinstance(value, tuple) else value + 1.0
        other = copy.copy(model)
        object.__setattr__(other, field.name, changed)
        assert other != model


@pytest.mark.parametrize("model", [*MOTIONS, *SENSORS], ids=name)
def test_a_repr_is_short_and_makes_the_model_again(model: Any) -> None:
    assert eval(repr(model), vars(slamkit.models)) == model
    assert len(repr(model)) < 70 or "pose_noise" in repr(model)
    assert "pose_noise=((0.0, 0.0, 0.0)," not in repr(model)


@pytest.mark.parametrize("model", [*MOTIONS, *SENSORS], ids=name)
@pytest.mark.parametrize("duplicate", [copy.copy, copy.deepcopy, lambda m: pickle.loads(pickle.dumps(m))])
def test_a_copy_does_not_share_what_the_model_has_cached(model: Any, duplicate: Callable[[Any], Any]) -> None:
    twin = duplicate(model)
    for cached in ("params", "R"):
        if hasattr(model, cached):
            assert getattr(twin, cached) is not getattr(model, cached)
            assert np.array_equal(getattr(twin, cached), getattr(model, cached))
    if hasattr(twin, "R"):
        assert not twin.R.flags.writeable


def test_models_of_two_kinds_are_never_equal() -> None:
    models = [Unicycle(0.1, 0.1), EulerUnicycle(0.1, 0.1), RangeBearing(0.1, 0.1), RelativePosition(0.1)]
    assert all(a != b for a, b in itertools.combinations(models, 2))


@pytest.mark.parametrize("sensor", SENSORS, ids=name)
def test_r_cannot_be_changed_behind_the_models_back(sensor: Any) -> None:
    with pytest.raises(ValueError, match="read-only"):
        sensor.R[0, 0] = 1.0


@pytest.mark.parametrize("model", [*MOTIONS, *SENSORS], ids=name)
def test_methods_take_lists_integers_views_and_read_only_arrays(model: Any) -> None:
    frozen = np.array([1.0, 2.0, 3.0])
    frozen.flags.writeable = False
    column = np.array([[1.0, 9.0], [2.0, 9.0], [3.0, 9.0]])[:, 0]
    expected = None
    pose: Any
    for pose in ([1, 2, 3], (1.0, 2.0, 3.0), np.array([1, 2, 3]), frozen, column):
        if isinstance(model, MotionModel):
            u = control(model, (1.0, 0.5, 0.25))
            got = [model.move(pose, u, 1), *model.jacobians(pose, u, 1), model.pose_noise(pose, u, 1)]
        else:
            z = model.predict(pose, [4, 6])
            got = [z, *model.jacobians(pose, [4, 6]), model.invert(pose, z), *model.inverse_jacobians(pose, z)]
        expected = got if expected is None else expected
        for a, b in zip(got, expected, strict=True):
            np.testing.assert_array_equal(a, b)


not_a_deviation = st.sampled_from(
    [
        *(np.nan, np.inf, -np.inf, -1.0, -1e-300, 1e200, 10**400, True, np.True_, None, "x", "0.1"),
        *([0.1, 0.2], [0.1], {}, np.array([0.1]), np.datetime64("2020-01-01")),
        *(1j, np.complex128(0.1), np.array(0.1 + 0j)),
    ]
) | st.floats(max_value=-1e-12)
MAKERS: list[tuple[Callable[..., object], tuple[str, ...], bool]] = [
    (Unicycle, ("sigma_v", "sigma_omega"), True),
    (EulerUnicycle, ("sigma_v", "sigma_omega"), True),
    (Odometry, ("alpha1", "alpha2", "alpha3", "alpha4"), True),
    (RangeBearing, ("sigma_range", "sigma_bearing"), False),
    (RelativePosition, ("sigma",), False),
]


@pytest.mark.parametrize(("maker", "names", "zero"), MAKERS)
@given(st.data())
@settings(max_examples=40, deadline=None)
def test_constructors_refuse_bad_numbers_and_name_them(
    maker: Callable[..., object], names: tuple[str, ...], zero: bool, data: st.DataObject
) -> None:
    bad = data.draw(st.sampled_from(names))
    value = data.draw(not_a_deviation if zero else not_a_deviation | st.sampled_from([0, 0.0, -0.0, 1e-200]))
    with pytest.raises(InputError, match=f"^{bad} is .*expected"):
        maker(**{**dict.fromkeys(names, 0.1), bad: value})
    with pytest.raises(InputError):
        maker(**dict.fromkeys(names, value))


@given(st.floats(0, 1e6), st.floats(1e-6, 1e6))
def test_constructors_take_every_sensible_number(zero: float, positive: float) -> None:
    assert Unicycle(zero, positive).sigma_v == zero
    assert Odometry(zero, zero, positive, zero).alpha3 == positive
    assert np.linalg.eigvalsh(RangeBearing(positive, positive).R)[0] > 0
    assert RelativePosition(positive).R[1, 1] == positive**2


@pytest.mark.parametrize("model", [*MOTIONS, *SENSORS], ids=name)
@pytest.mark.parametrize("bad", [[1.0], [[1.0, 2.0, 3.0]], np.zeros(4), 1.0, "abc", None, [[1.0], [1.0, 2.0]]], ids=str)
def test_methods_refuse_wrong_shapes_and_name_the_argument(model: Any, bad: Any) -> None:
    pose, two = np.zeros(3), np.ones(2)
    calls: list[tuple[str, tuple[Any, ...], tuple[Callable[..., object], ...]]]
    if isinstance(model, MotionModel):
        u = np.zeros(CONTROL_DIM[type(model)])
        calls = [
            ("pose", (bad, u, 0.1), (model.move, model.jacobians, model.pose_noise)),
            ("u", (pose, bad, 0.1), (model.move, model.jacobians, model.pose_noise)),
            ("u", (bad, 0.1), (model.control_noise,)),
        ]
    else:
        calls = [
            ("pose", (bad, two), (model.predict, model.jacobians, model.invert, model.inverse_jacobians)),
            ("landmark", (pose, bad), (model.predict, model.jacobians)),
            ("z", (pose, bad), (model.invert, model.inverse_jacobians)),
            ("z", (bad, two), (model.residual,)),
            ("z_hat", (two, bad), (model.residual,)),
        ]
    for argument, arguments, methods in calls:
        for method in methods:
            with pytest.raises(InputError, match=f"^{argument} "):
                method(*arguments)


@pytest.mark.parametrize("model", [*MOTIONS, *SENSORS], ids=name)
@pytest.mark.parametrize("dtype", [complex, str])
def test_methods_refuse_what_is_no_real_number(model: Any, dtype: type) -> None:
    pose, two = np.array([1, 2, 3]).astype(dtype), np.ones(2).astype(dtype)
    if isinstance(model, MotionModel):
        u = np.zeros(CONTROL_DIM[type(model)])
        calls = [(model.move, (pose, u, 0.1)), (model.control_noise, (u.astype(dtype), 0.1))]
        for dt in (1j, "0.1", None, [0.1], 10**400, np.complex128(0.1)):
            calls.append((model.move, (np.zeros(3), u, dt)))
    else:
        calls = [(model.predict, (pose, np.ones(2))), (model.residual, (two, two)), (model.invert, (np.zeros(3), two))]
    for method, arguments in calls:
        with pytest.raises(InputError, match=r"^(pose|u|z|dt) "):
            method(*arguments)


@pytest.mark.parametrize("position", range(3))
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_what_is_not_finite_is_never_lost(position: int, bad: float) -> None:
    pose = np.array([1.0, 2.0, 0.5])
    pose[position] = bad
    for motion in MOTIONS:
        assert not np.all(np.isfinite(motion.move(pose, control(motion, (1.0, 0.5, 0.2)), 0.1)))
        u = control(motion, (1.0, 0.5, 0.2))
        if position < len(u):
            u[position] = bad
            assert not np.all(np.isfinite(motion.move(np.zeros(3), u, 0.1)))
    for sensor in SENSORS:
        assert not np.all(np.isfinite(sensor.predict(pose, [4.0, 5.0])))
        assert not np.all(np.isfinite(sensor.invert(pose, [4.0, 0.5])))
        z = np.array([4.0, 0.5])
        if position < 2:
            z[position] = bad
            assert not np.all(np.isfinite(sensor.residual(z, [4.0, 0.5])))
            assert not np.all(np.isfinite(sensor.invert(np.zeros(3), z)))

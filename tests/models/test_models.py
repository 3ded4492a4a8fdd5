"""Laws of the motion and sensor models, and of the suite that checks them."""

from __future__ import annotations

import copy
import dataclasses
import itertools
import pickle
import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any, ClassVar

import mpmath  # type: ignore[import-untyped]
import numba
import numpy as np
import pytest
import sympy  # type: ignore[import-untyped]
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from slamkit import se2
from slamkit.errors import InputError, ModelError
from slamkit.models import (
    EulerUnicycle,
    Odometry,
    RangeBearing,
    RelativePosition,
    Unicycle,
    check_model,
    numeric_jacobian,
)
from slamkit.protocols import MotionFunctions, MotionModel, SensorFunctions, SensorModel

Array = NDArray[np.float64]
PI = np.pi
POSE_NOISE = np.array([[0.04, 0.01, 0.002], [0.01, 0.09, -0.003], [0.002, -0.003, 0.01]])

MOTIONS = [
    Unicycle(0.1, 0.05),
    Unicycle(0.0, 0.0, POSE_NOISE),
    EulerUnicycle(0.2, 0.3, np.diag([0.01, 0.0, 0.0])),
    Odometry(0.1, 0.01, 0.05, 0.02),
    Odometry(0.0, 0.0, 0.0, 0.0),
]
SENSORS = [RangeBearing(0.1, 0.02), RangeBearing(1e-4, 3.0), RelativePosition(0.1), RelativePosition(25.0)]
CONTROL_DIM = {Unicycle: 2, EulerUnicycle: 2, Odometry: 3}

headings = st.floats(-PI, PI, exclude_max=True) | st.sampled_from([-PI, np.nextafter(PI, 0), 0.0, PI / 2])
poses = st.builds(lambda x, y, t: np.array([x, y, t]), st.floats(-100, 100), st.floats(-100, 100), headings)
rates = st.floats(-3, 3) | st.sampled_from([0.0, 1e-12, -1e-9, 1e-6, -1e-3])
durations = st.floats(1e-3, 2.0)


def name(model: object) -> str:
    return type(model).__name__


def same_pose(a: Array, b: Array, atol: float = 1e-9) -> None:
    np.testing.assert_allclose(a[:2], b[:2], rtol=0, atol=atol)
    np.testing.assert_allclose(se2.wrap(a[2] - b[2]), 0, rtol=0, atol=atol)


def control(model: object, numbers: tuple[float, float, float]) -> Array:
    return np.array(numbers[: CONTROL_DIM[type(model)]])


# -- the built-in models ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("model", [*MOTIONS, *SENSORS], ids=name)
def test_built_in_models_keep_every_law(model: object) -> None:
    check_model(model)


@pytest.mark.parametrize("model", [*MOTIONS, *SENSORS], ids=name)
def test_built_in_models_fit_their_protocol(model: object) -> None:
    assert isinstance(model, MotionModel if type(model) in CONTROL_DIM else SensorModel)


@cache
def symbolic(model: Any) -> tuple[Callable[..., Any], ...]:
    """Value and Jacobians, derived by SymPy from each model's definition, as functions of 60 digits."""
    x, y, t, a, b, c, dt = symbols = sympy.symbols("x y theta a b c dt", real=True)
    if model in CONTROL_DIM:
        if model is Unicycle:  # the integral of the body's velocity along the arc
            tau = sympy.Symbol("tau", real=True)
            path = [sympy.integrate(a * f(t + b * tau), (tau, 0, dt), conds="none") for f in (sympy.cos, sympy.sin)]
            path = [p.args[0][0] if isinstance(p, sympy.Piecewise) else p for p in path]
            value = sympy.Matrix([x + path[0], y + path[1], t + b * dt])
        elif model is EulerUnicycle:
            value = sympy.Matrix([x + a * dt * sympy.cos(t), y + a * dt * sympy.sin(t), t + b * dt])
        else:
            value = sympy.Matrix([x + b * sympy.cos(t + a), y + b * sympy.sin(t + a), t + a + c])
        groups: list[list[Any]] = [[x, y, t], [a, b, c][: CONTROL_DIM[model]]]
        values = [value]
    else:
        C = sympy.Matrix([[sympy.cos(t), -sympy.sin(t)], [sympy.sin(t), sympy.cos(t)]])
        body, p = C.T * sympy.Matrix([a - x, b - y]), sympy.Matrix([x, y])
        if model is RangeBearing:
            value = sympy.Matrix([sympy.sqrt(body.dot(body)), sympy.atan2(body[1], body[0])])
            found = p + C * sympy.Matrix([a * sympy.cos(b), a * sympy.sin(b)])
        else:
            value, found = body, p + C * sympy.Matrix([a, b])
        groups, values = [[x, y, t], [a, b]], [value, found]
    made = [sympy.lambdify(symbols, m, "mpmath") for v in values for m in (v, *(v.jacobian(g) for g in groups))]
    return tuple(made)


def exact(function: Callable[..., Any], *numbers: float) -> Array:
    with mpmath.workdps(60):
        matrix = function(*[mpmath.mpf(float(n)) for n in numbers])
        return np.array([[float(matrix[i, j]) for j in range(matrix.cols)] for i in range(matrix.rows)])


def close(got: Array, expected: Array) -> None:
    """Equal to 1e-12 of the largest number of the array."""
    np.testing.assert_allclose(got, expected.reshape(got.shape), rtol=0, atol=1e-12 * np.abs(expected).max())


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


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("exponent", np.arange(-12, 0.01, 0.25))
def test_unicycle_is_smooth_through_zero_turn(exponent: float, sign: int) -> None:
    value, F, G = symbolic(Unicycle)
    model, pose, v, dt = Unicycle(0.1, 0.1), np.array([0.3, -0.2, 0.7]), 1.3, 0.8
    omega = sign * 2 * 10**exponent / dt  # a = ω·dt/2 is ±10^exponent
    numbers = [*pose, v, omega, 0.0, dt]
    close(model.move(pose, [v, omega], dt), exact(value, *numbers)[:, 0])
    close(model.jacobians(pose, [v, omega], dt)[0], exact(F, *numbers))
    close(model.jacobians(pose, [v, omega], dt)[1], exact(G, *numbers))


def test_unicycle_is_continuous_at_zero_turn_and_where_its_series_end() -> None:
    model, pose, dt = Unicycle(0.1, 0.1), np.array([0.3, -0.2, 0.7]), 2.0  # so that a = ω
    for at in (0.0, 5e-324, 1e-2, 1e-1, -1e-2, -1e-1):
        for other in (np.nextafter(at, 1), np.nextafter(at, -1)):
            for f in (model.move, lambda *a: model.jacobians(*a)[0], lambda *a: model.jacobians(*a)[1]):
                np.testing.assert_allclose(f(pose, [1.0, at], dt), f(pose, [1.0, other], dt), rtol=0, atol=4e-15)


def test_unicycle_at_zero_turn_drives_straight() -> None:
    moved = Unicycle(0.1, 0.1).move([1.0, 2.0, 0.5], [2.0, 0.0], 0.25)
    np.testing.assert_allclose(moved, [1 + 0.5 * np.cos(0.5), 2 + 0.5 * np.sin(0.5), 0.5], rtol=1e-15)


@given(poses, rates, rates, durations)
@settings(max_examples=50, deadline=None)
def test_unicycle_composes_along_its_arc(pose: Array, v: float, omega: float, dt: float) -> None:
    model = Unicycle(0.1, 0.1)
    half = model.move(model.move(pose, [v, omega], dt / 2), [v, omega], dt / 2)
    same_pose(half, model.move(pose, [v, omega], dt), 1e-11)
    same_pose(model.move(model.move(pose, [v, omega], dt), [-v, -omega], dt), pose, 1e-11)


@given(poses, st.floats(0.1, 3), st.floats(0.1, 3))
@settings(max_examples=50, deadline=None)
def test_euler_unicycle_is_the_first_order_of_the_arc(pose: Array, v: float, omega: float) -> None:
    pose[:2] /= 100
    arc, euler = Unicycle(0.1, 0.1), EulerUnicycle(0.1, 0.1)
    errors = []
    for dt in (1e-2, 1e-3):
        difference = arc.move(pose, [v, omega], dt) - euler.move(pose, [v, omega], dt)
        assert difference[2] == 0
        errors.append(np.hypot(*difference[:2]))
        assert errors[-1] == pytest.approx(v * omega * dt**2 / 2, rel=0.02)  # halfway between chord and tangent
    assert errors[1] == pytest.approx(errors[0] / 100, rel=0.05)


@pytest.mark.parametrize("model", MOTIONS[:3], ids=name)
@given(rates, rates, durations, poses)
@settings(max_examples=20, deadline=None)
def test_unicycle_noise_is_what_was_given(model: Any, v: float, omega: float, dt: float, pose: Array) -> None:
    np.testing.assert_array_equal(
        model.control_noise([v, omega], dt), np.diag([model.sigma_v**2, model.sigma_omega**2])
    )
    np.testing.assert_array_equal(model.pose_noise(pose, [v, omega], dt), np.array(model.pose_covariance))


@given(st.tuples(*[st.floats(0, 2)] * 4), st.tuples(*[st.floats(-3, 3)] * 3), durations)
@settings(max_examples=50, deadline=None)
def test_odometry_noise_follows_the_book(alpha: tuple[float, ...], u: tuple[float, ...], dt: float) -> None:
    a1, a2, a3, a4 = alpha
    rot1, trans, rot2 = u
    variances = [a1 * rot1**2 + a2 * trans**2, a3 * trans**2 + a4 * (rot1**2 + rot2**2), a1 * rot2**2 + a2 * trans**2]
    model = Odometry(*alpha)
    np.testing.assert_allclose(model.control_noise(u, dt), np.diag(variances), rtol=1e-14, atol=0)
    assert not model.pose_noise(np.zeros(3), u, dt).any()


# -- odometry from consecutive poses ----------------------------------------------------------------------------------

steps = st.builds(
    lambda x, y, t: np.array([x, y, t]),
    st.floats(-5, 5) | st.sampled_from([0.0, 1e-12, -1e-12, 1e-9, -1e-9, 1e-6]),
    st.floats(-5, 5) | st.sampled_from([0.0, -0.0, 1e-12, -1e-12, 1e-10, 1e-6]),
    headings,
)


@given(poses, steps)
@settings(deadline=None)
def test_control_between_leads_from_pose_to_pose(before: Array, step: Array) -> None:
    after = se2.compose(before, step)
    u = Odometry.control_between(before, after)
    same_pose(Odometry(0.1, 0.1, 0.1, 0.1).move(before, u, 1.0), after, 3e-9)
    assert abs(u[0]) <= PI / 2
    assert -PI <= u[2] < PI


@given(poses, poses)
@settings(deadline=None)
def test_control_between_any_two_poses(before: Array, after: Array) -> None:
    u = Odometry.control_between(before, after)
    same_pose(Odometry(0.1, 0.1, 0.1, 0.1).move(before, u, 1.0), after, 3e-9)
    assert abs(u[0]) <= PI / 2


@given(headings, st.floats(0.01, 5), st.floats(-0.3, 0.3), st.floats(-0.3, 0.3))
@settings(deadline=None)
def test_a_reversing_robot_has_a_negative_translation(heading: float, d: float, rot1: float, rot2: float) -> None:
    before = np.array([0.0, 0.0, heading])
    after = Odometry(0.1, 0.1, 0.1, 0.1).move(before, [rot1, -d, rot2], 1.0)
    np.testing.assert_allclose(Odometry.control_between(before, after), [rot1, -d, rot2], atol=1e-12)


@given(headings, headings)
@settings(deadline=None)
def test_a_robot_at_rest_or_turning_on_the_spot_has_no_first_turn(heading: float, turn: float) -> None:
    before = np.array([0.0, 0.0, heading])
    np.testing.assert_array_equal(Odometry.control_between(before, before), np.zeros(3))
    for jitter in (0.0, 1e-12, -1e-10):
        after = np.array([jitter, -jitter, se2.wrap(heading + turn)])
        rot1, trans, rot2 = Odometry.control_between(before, after)
        assert rot1 == 0
        assert abs(trans) < 1e-9
        assert abs(se2.wrap(rot2 - turn)) <= 1e-12


@pytest.mark.parametrize("bad", [[0, 0], [[0, 0, 0]], [0, np.nan, 0], [0, 0, np.inf], "pose", [[1], [1, 2]], 0.0])
def test_control_between_refuses_what_is_no_pose(bad: Any) -> None:
    with pytest.raises(InputError, match="before"):
        Odometry.control_between(bad, [0, 0, 0])
    with pytest.raises(InputError, match="after"):
        Odometry.control_between([0, 0, 0], bad)


# -- equivariance -----------------------------------------------------------------------------------------------------


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


# -- values -----------------------------------------------------------------------------------------------------------


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


# -- bad input --------------------------------------------------------------------------------------------------------

not_a_deviation = st.sampled_from(
    [np.nan, np.inf, -np.inf, -1.0, -1e-300, 1e200, 10**400, None, "x", [0.1, 0.2], 1j]
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


NOT_PSD = [
    np.diag([1.0, 1.0, -1e-6]),
    np.array([[1.0, 2.0, 0.0], [2.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),
    np.array([[1.0, 0.5, 0.0], [0.4, 1.0, 0.0], [0.0, 0.0, 1.0]]),
    np.diag([1.0, np.nan, 1.0]),
    np.diag([np.inf, 1.0, 1.0]),
    np.eye(2),
    np.ones(3),
    0.1,
    "noise",
    [[1.0], [1.0, 2.0]],
]


@pytest.mark.parametrize("noise", NOT_PSD, ids=str)
@pytest.mark.parametrize("maker", [Unicycle, EulerUnicycle])
def test_pose_noise_must_be_a_covariance(maker: type, noise: Any) -> None:
    with pytest.raises(InputError, match="pose_noise"):
        maker(0.1, 0.1, noise)


@given(st.lists(st.floats(-3, 3), min_size=9, max_size=9))
@settings(max_examples=50, deadline=None)
def test_every_covariance_is_taken_and_kept(entries: list[float]) -> None:
    root = np.reshape(entries, (3, 3))
    covariance = root @ root.T
    kept = Unicycle(0.1, 0.1, covariance).pose_noise(np.zeros(3), np.zeros(2), 1.0)
    np.testing.assert_allclose(kept, covariance, rtol=1e-14, atol=1e-300)
    np.testing.assert_array_equal(kept, kept.T)


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


@given(poses, headings, st.floats(0, 9.9e-7))
@settings(max_examples=50, deadline=None)
def test_a_landmark_on_the_robot_has_no_bearing(pose: Array, direction: float, r: float) -> None:
    pose[:2] = 0.0  # at large coordinates a distance of 1e-6 m is not a number of its own
    model, landmark = RangeBearing(0.1, 0.1), r * np.array([np.cos(direction), np.sin(direction)])
    assert np.isnan(model.predict(pose, landmark)[0])
    assert np.isnan(model.jacobians(pose, landmark)[0]).any()
    assert np.isnan(model.invert(pose, [r, direction])).all()
    assert np.all(np.isfinite(RelativePosition(0.1).predict(pose, landmark)))


@pytest.mark.parametrize("r", [1.1e-6, 1e-5, 1e-3])
def test_a_landmark_a_little_further_has_one(r: float) -> None:
    model = RangeBearing(0.1, 0.1)
    for bearing in np.linspace(-3, 3, 13):
        z = model.predict([0.0, 0.0, 0.4], r * np.array([np.cos(0.4 + bearing), np.sin(0.4 + bearing)]))
        np.testing.assert_allclose(z, [r, bearing], rtol=1e-9, atol=1e-12)


@given(st.floats(max_value=-5e-324, min_value=-1e9), st.floats(-10, 10))
@settings(max_examples=50, deadline=None)
def test_a_negative_range_is_no_measurement(r: float, bearing: float) -> None:
    model = RangeBearing(0.1, 0.1)
    assert np.isnan(model.residual([r, bearing], [1.0, 0.0])[0])
    assert np.isnan(model.invert([0.0, 0.0, 0.0], [r, bearing])).all()
    with pytest.raises(InputError, match=re.escape(f"range is {r} m, expected a range ≥ 0")):
        model.validate([r, bearing])
    with pytest.raises(InputError, match=re.escape(f"range is {r} m")):
        model.validate([[1.0, 0.0], [r, bearing], [-1.0, 0.0]])
    model.validate([[0.0, bearing], [-r, bearing]])
    model.validate(np.empty((0, 2)))


@given(st.floats(0, 100), st.floats(0, 100), st.floats(-20, 20), st.floats(-20, 20))
@settings(max_examples=100, deadline=None)
def test_bearings_are_subtracted_as_angles(r: float, r_hat: float, b: float, b_hat: float) -> None:
    dr, db = RangeBearing(0.1, 0.1).residual([r, b], [r_hat, b_hat])
    assert dr == r - r_hat
    assert -PI <= db < PI
    assert abs(np.exp(1j * db) - np.exp(1j * (b - b_hat))) <= 1e-14


# -- a numeric Jacobian -----------------------------------------------------------------------------------------------


@given(st.floats(-3, 3), st.floats(-3, 3), st.floats(0.01, 1))
@settings(max_examples=50, deadline=None)
def test_numeric_jacobian_of_smooth_functions(x: float, y: float, step: float) -> None:
    def f(v: Array) -> Array:
        return np.array([np.sin(v[0]) * np.exp(v[1]), v[0] ** 5, np.cos(2 * v[1]), 7.0])

    expected = np.array(
        [[np.cos(x) * np.exp(y), np.sin(x) * np.exp(y)], [5 * x**4, 0], [0, -2 * np.sin(2 * y)], [0, 0]]
    )
    np.testing.assert_allclose(numeric_jacobian(f, [x, y]), expected, rtol=1e-9, atol=1e-10)
    np.testing.assert_allclose(numeric_jacobian(f, [x, y], step=[step, step]), expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(
    "A", [np.arange(6.0).reshape(2, 3), np.ones((1, 4)), np.zeros((3, 1)), np.empty((2, 0))], ids=str
)
def test_numeric_jacobian_of_a_linear_map_is_its_matrix(A: Array) -> None:
    x = np.linspace(-1, 1, A.shape[1])
    J = numeric_jacobian(lambda v: A @ v, x)
    assert J.shape == A.shape
    np.testing.assert_allclose(J, A, atol=1e-13)


@pytest.mark.parametrize("x", [1e-8, 1e-3, 1.0, 1e6, 1e12])
def test_numeric_jacobian_at_any_size(x: float) -> None:
    assert numeric_jacobian(lambda v: v**2, [x])[0, 0] == pytest.approx(2 * x, rel=1e-8, abs=1e-12)
    assert numeric_jacobian(np.log, [x], step=x / 10)[0, 0] == pytest.approx(1 / x, rel=1e-9)


@pytest.mark.parametrize("step", [None, 1.0])
def test_numeric_jacobian_is_extrapolated_not_merely_central(step: float | None) -> None:
    for x in (-1.0, 0.3, 2.0):
        for f, slope in ((np.exp, np.exp(x)), (np.sin, np.cos(x)), (np.arctan, 1 / (1 + x * x))):
            assert numeric_jacobian(f, [x], step=step)[0, 0] == pytest.approx(slope, rel=2e-12)


def test_numeric_jacobian_subtracts_angles_as_it_is_told() -> None:
    def heading(v: Array) -> Array:
        return np.array([se2.wrap(2 * v[0])])

    told = numeric_jacobian(heading, [PI / 2], difference=lambda a, b: se2.wrap(a - b))
    np.testing.assert_allclose(told, [[2.0]], rtol=1e-12)
    assert abs(numeric_jacobian(heading, [PI / 2])[0, 0] - 2) > 1


def test_numeric_jacobian_near_the_edge_of_a_domain() -> None:
    assert numeric_jacobian(np.sqrt, [1e-2])[0, 0] == pytest.approx(5.0, rel=1e-9)
    assert np.isnan(numeric_jacobian(np.sqrt, [-1.0]))


def test_a_periodic_function_is_not_sampled_in_phase() -> None:
    for step in (0.1, 0.2, 0.05):
        J = numeric_jacobian(lambda v: np.sin(20 * PI * v), [0.0], step=step)
        assert J[0, 0] == pytest.approx(20 * PI, rel=1e-8)


@pytest.mark.parametrize(
    ("x", "step"),
    [
        (np.nan, None),
        ([np.inf], None),
        ([[1.0]], None),
        ([1.0], 0.0),
        ([1.0], -1.0),
        ([1.0], [1.0, 1.0]),
        ([1.0], np.nan),
    ],
)
def test_numeric_jacobian_refuses_bad_points_and_steps(x: Any, step: Any) -> None:
    with pytest.raises(InputError, match=r"^(x|step) is .*expected"):
        numeric_jacobian(lambda v: v, x, step=step)


def test_numeric_jacobian_refuses_what_is_no_vector_function() -> None:
    with pytest.raises(InputError, match="one vector length"):
        numeric_jacobian(lambda v: float(v[0]), [1.0])


# -- models of one's own ----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Differential:
    """Two driven wheels, control (left, right) [m/s], in plain NumPy; exact arc."""

    width: float = 0.4

    def _twist(self, u: Array) -> tuple[float, float]:
        return (u[0] + u[1]) / 2, (u[1] - u[0]) / self.width

    def move(self, pose: Array, u: Array, dt: float) -> Array:
        v, omega = self._twist(u)
        return se2.compose(pose, se2.exp([v * dt, 0.0, omega * dt]))

    def jacobians(self, pose: Array, u: Array, dt: float) -> tuple[Array, Array]:
        v, omega = self._twist(u)
        x, y, _ = self.move(pose, u, dt) - pose
        F = np.array([[1, 0, -y], [0, 1, x], [0, 0, 1.0]])
        unicycle = Unicycle(0, 0).jacobians(pose, [v, omega], dt)[1]
        return F, unicycle @ np.array([[0.5, 0.5], [-1 / self.width, 1 / self.width]])

    def control_noise(self, u: Array, dt: float) -> Array:
        return np.diag(0.01 * u**2)

    def pose_noise(self, pose: Array, u: Array, dt: float) -> Array:
        return np.zeros((3, 3))


class Omnidirectional:
    """Three wheels: control (vx, vy, ω) in robot axes, Euler step; says nothing of its control's length."""

    def move(self, pose: Array, u: Array, dt: float) -> Array:
        return pose + dt * np.array([*(se2.rotation(pose[2]) @ u[:2]), u[2]])

    def jacobians(self, pose: Array, u: Array, dt: float) -> tuple[Array, Array]:
        C = se2.rotation(pose[2])
        F, G = np.eye(3), dt * np.eye(3)
        F[:2, 2] = dt * C @ [-u[1], u[0]]
        G[:2, :2] = dt * C
        return F, G

    def control_noise(self, u: Array, dt: float) -> Array:
        return 0.01 * np.eye(3)

    def pose_noise(self, pose: Array, u: Array, dt: float) -> Array:
        return 0.001 * dt * np.eye(3)


class Polar:
    """Bearing and range, in this order, in plain NumPy; refuses a landmark within 5 cm."""

    def __init__(self) -> None:
        self.R = np.array([[0.01, 0.001], [0.001, 0.04]])

    def predict(self, pose: Array, landmark: Array) -> Array:
        dx, dy = landmark - pose[:2]
        r = np.hypot(dx, dy)
        return np.array([se2.wrap(np.arctan2(dy, dx) - pose[2]), r if r > 0.05 else np.nan])

    def jacobians(self, pose: Array, landmark: Array) -> tuple[Array, Array]:
        dx, dy = landmark - pose[:2]
        r = np.hypot(dx, dy)
        H = np.array([[-dy / r**2, dx / r**2], [dx / r, dy / r]])
        return np.column_stack([-H, [-1.0, 0.0]]), H

    def residual(self, z: Array, z_hat: Array) -> Array:
        d = z - z_hat
        return np.array([se2.wrap(d[0]), d[1]])

    def invert(self, pose: Array, z: Array) -> Array:
        a = pose[2] + z[0]
        return np.array([pose[0] + z[1] * np.cos(a), pose[1] + z[1] * np.sin(a)])

    def inverse_jacobians(self, pose: Array, z: Array) -> tuple[Array, Array]:
        c, s = np.cos(pose[2] + z[0]), np.sin(pose[2] + z[0])
        across = z[1] * np.array([-s, c])
        return np.column_stack([np.eye(2), across]), np.column_stack([across, [c, s]])


class PositionAndRange:
    """Three numbers a sighting: the position in robot axes, and the range again."""

    R: ClassVar[Array] = np.diag([0.01, 0.01, 0.04])

    def predict(self, pose: Array, landmark: Array) -> Array:
        b = se2.rotation(pose[2]).T @ (landmark - pose[:2])
        return np.array([*b, np.hypot(*b)])

    def jacobians(self, pose: Array, landmark: Array) -> tuple[Array, Array]:
        d = landmark - pose[:2]
        H_b = np.vstack([np.eye(2), se2.rotation(pose[2]).T @ d / np.hypot(*d)])
        H = H_b @ se2.rotation(pose[2]).T
        return -H @ np.array([[1, 0, -d[1]], [0, 1, d[0]]]), H

    def residual(self, z: Array, z_hat: Array) -> Array:
        return z - z_hat

    def invert(self, pose: Array, z: Array) -> Array:
        return se2.transform(pose, z[:2])

    def inverse_jacobians(self, pose: Array, z: Array) -> tuple[Array, Array]:
        C = se2.rotation(pose[2])
        return np.column_stack([np.eye(2), C @ [-z[1], z[0]]]), np.column_stack([C, np.zeros(2)])


@numba.njit
def numba_predict(pose, landmark, params, out):  # type: ignore[no-untyped-def]
    c, s = np.cos(pose[2] + params[0]), np.sin(pose[2] + params[0])
    dx, dy = landmark[0] - pose[0], landmark[1] - pose[1]
    out[0], out[1] = c * dx + s * dy, c * dy - s * dx


@numba.njit
def numba_jacobians(pose, landmark, params, H_pose, H_landmark):  # type: ignore[no-untyped-def]
    c, s = np.cos(pose[2] + params[0]), np.sin(pose[2] + params[0])
    dx, dy = landmark[0] - pose[0], landmark[1] - pose[1]
    H_landmark[0, 0], H_landmark[0, 1], H_landmark[1, 0], H_landmark[1, 1] = c, s, -s, c
    H_pose[0, 0], H_pose[0, 1], H_pose[1, 0], H_pose[1, 1] = -c, -s, s, -c
    H_pose[0, 2], H_pose[1, 2] = c * dy - s * dx, -c * dx - s * dy


@numba.njit
def numba_residual(z, z_hat, params, out):  # type: ignore[no-untyped-def]
    out[0], out[1] = z[0] - z_hat[0], z[1] - z_hat[1]


@numba.njit
def numba_invert(pose, z, params, out):  # type: ignore[no-untyped-def]
    c, s = np.cos(pose[2] + params[0]), np.sin(pose[2] + params[0])
    out[0], out[1] = pose[0] + c * z[0] - s * z[1], pose[1] + s * z[0] + c * z[1]


@numba.njit
def numba_inverse_jacobians(pose, z, params, G_pose, G_z):  # type: ignore[no-untyped-def]
    c, s = np.cos(pose[2] + params[0]), np.sin(pose[2] + params[0])
    G_z[0, 0], G_z[0, 1], G_z[1, 0], G_z[1, 1] = c, -s, s, c
    G_pose[0, 0], G_pose[0, 1], G_pose[1, 0], G_pose[1, 1] = 1.0, 0.0, 0.0, 1.0
    G_pose[0, 2], G_pose[1, 2] = -s * z[0] - c * z[1], c * z[0] - s * z[1]


class Mounted:
    """Relative position by a sensor that is mounted askew, as plain Numba functions."""

    functions: Any = SensorFunctions(
        numba_predict, numba_jacobians, numba_residual, numba_invert, numba_inverse_jacobians
    )

    def __init__(self) -> None:
        self.R, self.params = 0.01 * np.eye(2), np.array([0.3])

    def _call(self, function: str, *arguments: Any, shapes: tuple[tuple[int, ...], ...]) -> tuple[Array, ...]:
        outs = tuple(np.empty(s) for s in shapes)
        getattr(Mounted.functions, function)(*arguments, self.params, *outs)
        return outs

    def predict(self, pose: Array, landmark: Array) -> Array:
        return self._call("predict", pose, landmark, shapes=((2,),))[0]

    def jacobians(self, pose: Array, landmark: Array) -> tuple[Array, ...]:
        return self._call("jacobians", pose, landmark, shapes=((2, 3), (2, 2)))

    def residual(self, z: Array, z_hat: Array) -> Array:
        return self._call("residual", z, z_hat, shapes=((2,),))[0]

    def invert(self, pose: Array, z: Array) -> Array:
        return self._call("invert", pose, z, shapes=((2,),))[0]

    def inverse_jacobians(self, pose: Array, z: Array) -> tuple[Array, ...]:
        return self._call("inverse_jacobians", pose, z, shapes=((2, 3), (2, 2)))


@numba.njit
def numba_linearise(pose, landmark, z, params, z_hat, y, H_pose, H_landmark):  # type: ignore[no-untyped-def]
    numba_predict(pose, landmark, params, z_hat)
    numba_residual(z, z_hat, params, y)
    numba_jacobians(pose, landmark, params, H_pose, H_landmark)


class Watcher(Mounted):
    """It says at one blow what it sees."""

    functions = Mounted.functions._replace(linearise=numba_linearise)


@numba.njit
def numba_move(pose, u, dt, params, out):  # type: ignore[no-untyped-def]
    out[0] = pose[0] + u[0] * dt * np.cos(pose[2])
    out[1] = pose[1] + u[0] * dt * np.sin(pose[2])
    out[2] = pose[2] + u[1] * dt


@numba.njit
def numba_motion_jacobians(pose, u, dt, params, F, G):  # type: ignore[no-untyped-def]
    c, s = np.cos(pose[2]), np.sin(pose[2])
    F[:, :] = 0.0
    F[0, 0] = F[1, 1] = F[2, 2] = 1.0
    F[0, 2], F[1, 2] = -u[0] * dt * s, u[0] * dt * c
    G[:, :] = 0.0
    G[0, 0], G[1, 0], G[2, 1] = dt * c, dt * s, dt


@numba.njit
def numba_control_noise(u, dt, params, out):  # type: ignore[no-untyped-def]
    out[:, :] = 0.0
    out[0, 0] = out[1, 1] = params[0]


@numba.njit
def numba_pose_noise(pose, u, dt, params, out):  # type: ignore[no-untyped-def]
    out[:, :] = 0.0
    out[0, 0] = out[1, 1] = out[2, 2] = params[1]


@numba.njit
def numba_predict_all(pose, u, dt, params, out, F, G, sigma, noise):  # type: ignore[no-untyped-def]
    numba_move(pose, u, dt, params, out)
    numba_motion_jacobians(pose, u, dt, params, F, G)
    numba_control_noise(u, dt, params, sigma)
    numba_pose_noise(pose, u, dt, params, noise)


class Scooter:
    """Euler unicycle as plain Numba functions."""

    functions: Any = MotionFunctions(numba_move, numba_motion_jacobians, numba_control_noise, numba_pose_noise)
    control_dim = 2

    def __init__(self) -> None:
        self.params = np.array([0.04, 1e-4])

    def move(self, pose: Array, u: Array, dt: float) -> Array:
        out = np.empty(3)
        numba_move(pose, u, dt, self.params, out)
        return out

    def jacobians(self, pose: Array, u: Array, dt: float) -> tuple[Array, Array]:
        F, G = np.empty((3, 3)), np.empty((3, 2))
        numba_motion_jacobians(pose, u, dt, self.params, F, G)
        return F, G

    def control_noise(self, u: Array, dt: float) -> Array:
        return np.diag([float(self.params[0])] * 2)

    def pose_noise(self, pose: Array, u: Array, dt: float) -> Array:
        return np.diag([float(self.params[1])] * 3)


class Driven(Scooter):
    """It says at one blow what it does."""

    functions = Scooter.functions._replace(predict_all=numba_predict_all)


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


# -- models that break one law ----------------------------------------------------------------------------------------


def breaks(law: str, *, alone: bool = True) -> Callable[[type], type]:
    """Note on the class which law it breaks, and whether it keeps all the others."""

    def note(model: type) -> type:
        model.law, model.alone = law, alone  # type: ignore[attr-defined]
        BROKEN.append(model)
        return model

    return note


BROKEN: list[type] = []


@breaks("F is ∂move/∂pose")
class WrongF(Differential):
    def jacobians(self, pose: Array, u: Array, dt: float) -> tuple[Array, Array]:
        F, G = super().jacobians(pose, u, dt)
        F[0, 2] *= -1
        return F, G


@breaks("G is ∂move/∂u")
class SlightlyWrongG(Differential):
    def jacobians(self, pose: Array, u: Array, dt: float) -> tuple[Array, Array]:
        F, G = super().jacobians(pose, u, dt)
        return F, G * (1 + 1e-5)


@breaks("G is ∂move/∂u")
class EulerG(Differential):
    def jacobians(self, pose: Array, u: Array, dt: float) -> tuple[Array, Array]:
        F, G = super().jacobians(pose, u, dt)
        G[:2] = dt / 2 * np.array([[np.cos(pose[2])] * 2, [np.sin(pose[2])] * 2])
        return F, G


@breaks("move is continuous as u goes to zero", alone=False)
class Quotient(Differential):
    def move(self, pose: Array, u: Array, dt: float) -> Array:
        v, omega = u  # a unicycle that divides by its turn rate
        if omega == 0:
            return np.array([pose[0] + v * dt * np.cos(pose[2]), pose[1] + v * dt * np.sin(pose[2]), pose[2]])
        t = pose[2] + omega * dt
        x, y = v / omega * (np.sin(t) - np.sin(pose[2])), v / omega * (np.cos(pose[2]) - np.cos(t))
        return np.array([pose[0] + x, pose[1] + y, t])

    def jacobians(self, pose: Array, u: Array, dt: float) -> tuple[Array, Array]:
        return Unicycle(0, 0).jacobians(pose, u, dt)


@breaks("move is finite", alone=False)
class Division(Quotient):
    def move(self, pose: Array, u: Array, dt: float) -> Array:
        return super().move(pose, u, dt) + 0 / np.float64(u[1])


@breaks("jacobians is finite")
class InfiniteJacobian(Differential):
    def jacobians(self, pose: Array, u: Array, dt: float) -> tuple[Array, Array]:
        F, G = super().jacobians(pose, u, dt)
        return F, G if u.any() else G * np.nan


@breaks("move takes the heading as an angle")
class HeadingAsNumber(Differential):
    def move(self, pose: Array, u: Array, dt: float) -> Array:
        return np.add(super().move(pose, u, dt), [0, 0, 0.01 * pose[2]])

    def jacobians(self, pose: Array, u: Array, dt: float) -> tuple[Array, Array]:
        F, G = super().jacobians(pose, u, dt)
        return F + np.diag([0, 0, 0.01]), G


@breaks("control_noise is symmetric positive semidefinite")
class NegativeNoise(Differential):
    def control_noise(self, u: Array, dt: float) -> Array:
        return np.diag([u[0], 1.0])


@breaks("control_noise is symmetric positive semidefinite")
class AsymmetricNoise(Differential):
    def control_noise(self, u: Array, dt: float) -> Array:
        return np.array([[1.0, 0.1], [0.0, 1.0]])


@breaks("pose_noise is symmetric positive semidefinite")
class NegativePoseNoise(Differential):
    def pose_noise(self, pose: Array, u: Array, dt: float) -> Array:
        return np.diag([0.0, 0.0, -1e-9])


@breaks("pose_noise is finite")
class NotANumberNoise(Differential):
    def pose_noise(self, pose: Array, u: Array, dt: float) -> Array:
        return np.full((3, 3), np.inf)


@breaks("control_noise gives float64 arrays of the right shape")
class NoiseShape(Differential):
    def control_noise(self, u: Array, dt: float) -> Array:
        return np.eye(3)


@breaks("move gives float64 arrays of the right shape", alone=False)
class ColumnPose(Differential):
    def move(self, pose: Array, u: Array, dt: float) -> Array:
        return super().move(pose, u, dt)[:, None]


@breaks("move gives float64 arrays of the right shape")
class SinglePrecision(Differential):
    def move(self, pose: Array, u: Array, dt: float) -> Any:
        return super().move(pose, u, dt).astype(np.float32)


@breaks("jacobians gives float64 arrays of the right shape")
class OnlyF(Differential):
    def jacobians(self, pose: Array, u: Array, dt: float) -> Any:
        return super().jacobians(pose, u, dt)[0]


@breaks("pose_noise raises no error")
class Raises(Differential):
    def pose_noise(self, pose: Array, u: Array, dt: float) -> Array:
        raise RuntimeError("no noise here")


@breaks("move raises no error")
class Limited(Differential):
    def move(self, pose: Array, u: Array, dt: float) -> Array:
        if u.max() > 1.0:
            raise ValueError("too fast")
        return super().move(pose, u, dt)


@breaks("move leaves its arguments alone", alone=False)
class InPlace(Differential):
    def move(self, pose: Array, u: Array, dt: float) -> Array:
        moved = super().move(pose, u, dt)
        pose += 0.1
        return moved


@breaks("move gives new arrays")
class SameArray(Differential):
    def move(self, pose: Array, u: Array, dt: float) -> Array:
        return super().move(pose, u, dt) if u.any() else pose


@breaks("move gives new arrays")
class Buffer(Differential):
    out: ClassVar[Array] = np.empty(3)

    def move(self, pose: Array, u: Array, dt: float) -> Array:
        Buffer.out[:] = super().move(pose, u, dt)
        return Buffer.out


@breaks("control_noise is deterministic", alone=False)
class Dice(Differential):
    def control_noise(self, u: Array, dt: float) -> Array:
        return super().control_noise(u, dt) + np.eye(2) * np.random.default_rng().uniform()


@breaks("survives pickle")
class NoPickle(Differential):
    def __reduce__(self) -> Any:
        raise TypeError("not today")

    def __deepcopy__(self, memo: object) -> Any:
        return self


@breaks("survives deepcopy")
class ForgetfulCopy(Differential):
    def __deepcopy__(self, memo: object) -> Any:
        return ForgetfulCopy(self.width * 2)


@breaks("functions.control_noise agrees with control_noise")
class OtherNoise(Scooter):
    def control_noise(self, u: Array, dt: float) -> Array:
        return 2 * super().control_noise(u, dt)


@breaks("functions holds one function a method")
class HalfCompiled(Scooter):
    functions = (numba_move, numba_motion_jacobians)


@breaks("functions fit into a compiled run")
class NotCompiled(Scooter):
    functions = Scooter.functions._replace(control_noise=numba_control_noise.py_func)


@breaks("functions.pose_noise raises no error", alone=False)
class BadSignature(Scooter):
    functions = Scooter.functions._replace(pose_noise=numba_control_noise)


@breaks("params is a float64 vector")
class IntegerParams(Scooter):
    def __init__(self) -> None:
        self.params = np.array([1, 2])


@breaks("H_pose is ∂predict/∂pose")
class WrongHPose(Polar):
    def jacobians(self, pose: Array, landmark: Array) -> tuple[Array, Array]:
        H_pose, H = super().jacobians(pose, landmark)
        H_pose[0, 2] = 1.0
        return H_pose, H


@breaks("H_landmark is ∂predict/∂landmark")
class WrongHLandmark(Polar):
    def jacobians(self, pose: Array, landmark: Array) -> tuple[Array, Array]:
        H_pose, H = super().jacobians(pose, landmark)
        return H_pose, H[::-1].copy()


@breaks("H_landmark is ∂predict/∂landmark")
class WrongOnlyBehind(Polar):
    def jacobians(self, pose: Array, landmark: Array) -> tuple[Array, Array]:
        H_pose, H = super().jacobians(pose, landmark)
        return H_pose, -H if abs(self.predict(pose, landmark)[0]) > 3.1415 else H


@breaks("G_pose is ∂invert/∂pose")
class WrongGPose(Polar):
    def inverse_jacobians(self, pose: Array, z: Array) -> tuple[Array, Array]:
        G_pose, G_z = super().inverse_jacobians(pose, z)
        G_pose[:, 2] *= 1.0001
        return G_pose, G_z


@breaks("G_z is ∂invert/∂z")
class WrongGZ(Polar):
    def inverse_jacobians(self, pose: Array, z: Array) -> tuple[Array, Array]:
        G_pose, G_z = super().inverse_jacobians(pose, z)
        return G_pose, G_z[:, ::-1].copy()


@breaks("predict undoes invert")
class WrongInverse(Polar):
    def invert(self, pose: Array, z: Array) -> Array:
        return super().invert(pose, z) + 1e-6


@breaks("predict takes the heading as an angle", alone=False)
class PredictHeading(Polar):
    def predict(self, pose: Array, landmark: Array) -> Array:
        return np.add(super().predict(pose, landmark), [0, 0.01 * pose[2]])


@breaks("invert takes the heading as an angle", alone=False)
class InvertHeading(Polar):
    def invert(self, pose: Array, z: Array) -> Array:
        return np.add(super().invert(pose, z), [0.01 * pose[2]])


@breaks("residual wraps angles", alone=False)
class NoWrap(Polar):
    def residual(self, z: Array, z_hat: Array) -> Array:
        return z - z_hat


@breaks("residual wraps angles")
class WrapsOnce(Polar):
    def residual(self, z: Array, z_hat: Array) -> Array:
        d = z - z_hat
        return d - [2 * PI if d[0] >= PI else -2 * PI if d[0] < -PI else 0.0, 0.0]


@breaks("residual is z - z_hat apart from whole turns", alone=False)
class Reversed(Polar):
    def residual(self, z: Array, z_hat: Array) -> Array:
        return super().residual(z_hat, z)


@breaks("residual is z - z_hat apart from whole turns")
class WrapsHalf(Polar):
    def residual(self, z: Array, z_hat: Array) -> Array:
        d = super().residual(z, z_hat)
        return np.array([(d[0] + PI / 2) % PI - PI / 2, d[1]])


@breaks("residual is z - z_hat apart from whole turns", alone=False)
class WrapsToPositive(Polar):
    def residual(self, z: Array, z_hat: Array) -> Array:
        return np.array([(z[0] - z_hat[0]) % (2 * PI), z[1] - z_hat[1]])


@breaks("residual is zero at z = z_hat")
class Offset(Polar):
    def residual(self, z: Array, z_hat: Array) -> Array:
        return super().residual(z, z_hat) + 1e-12


@breaks("predict is finite")
class OnlyAhead(Polar):
    def predict(self, pose: Array, landmark: Array) -> Array:
        z = super().predict(pose, landmark)
        return z if abs(z[0]) < 1.5 else z * np.nan


@breaks("predict is finite")
class InfiniteWhenNear(Polar):
    def predict(self, pose: Array, landmark: Array) -> Array:
        z = super().predict(pose, landmark)
        return np.where(np.isnan(z), np.inf, z)


@breaks("invert gives float64 arrays of the right shape")
class InvertsToPose(Polar):
    def invert(self, pose: Array, z: Array) -> Array:
        return np.append(super().invert(pose, z), 0.0)


@breaks("R is a symmetric positive definite float64 matrix")
class SemidefiniteR(Polar):
    def __init__(self) -> None:
        self.R = np.diag([0.1, 0.0])


@breaks("R is a symmetric positive definite float64 matrix")
class AsymmetricR(Polar):
    def __init__(self) -> None:
        self.R = np.array([[0.1, 0.01], [0.0, 0.1]])


@breaks("R is a symmetric positive definite float64 matrix")
class VectorR(Polar):
    def __init__(self) -> None:
        self.R = np.array([0.1, 0.1])


@breaks("R is finite")
class InfiniteR(Polar):
    def __init__(self) -> None:
        self.R = np.diag([0.1, np.inf])


@breaks("R raises no error")
class RaisingR(Polar):
    def __init__(self) -> None:
        pass

    @property
    def R(self) -> Array:  # type: ignore[override]  # noqa: N802
        raise RuntimeError("no R yet")


@breaks("predict leaves its arguments alone")
class MovesLandmark(Polar):
    def predict(self, pose: Array, landmark: Array) -> Array:
        z = super().predict(pose, landmark)
        landmark -= pose[:2]
        return z


@breaks("residual gives new arrays", alone=False)
class ResidualInPlace(Polar):
    def residual(self, z: Array, z_hat: Array) -> Array:
        z[:] = super().residual(z, z_hat)
        return z


@numba.njit
def numba_still(pose, u, dt, params, out, F, G, sigma, noise):  # type: ignore[no-untyped-def]
    numba_predict_all(pose, u, dt, params, out, F, G, sigma, noise)
    noise[2, 2] = 0.0


@breaks("predict_all is move, jacobians, control_noise and pose_noise")
class Still(Scooter):
    functions = Scooter.functions._replace(predict_all=numba_still)


@numba.njit
def numba_turned(pose, landmark, z, params, z_hat, y, H_pose, H_landmark):  # type: ignore[no-untyped-def]
    numba_linearise(pose, landmark, z, params, z_hat, y, H_pose, H_landmark)
    numba_residual(z_hat, z, params, y)


@breaks("linearise is predict, residual and jacobians")
class Turned(Mounted):
    functions = Mounted.functions._replace(linearise=numba_turned)


@breaks("functions.linearise raises no error", alone=False)
class WrongLinearise(Mounted):
    functions = Mounted.functions._replace(linearise=numba_still)


@numba.njit
def numba_unfinished(pose, z, params, out):  # type: ignore[no-untyped-def]
    c, s = np.cos(pose[2] + params[0]), np.sin(pose[2] + params[0])
    out[0] = pose[0] + c * z[0] - s * z[1]


@breaks("functions.invert agrees with invert")
class Unfinished(Mounted):
    functions = Mounted.functions._replace(invert=numba_unfinished)


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

"""Laws of the rigid motions of the plane."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.linalg import expm, logm

from slamkit import se2
from slamkit.arrays import Array

PI = np.pi

angles = st.floats(-1e4, 1e4) | st.sampled_from(
    [0.0, -0.0, PI, -PI, 2 * PI, -2 * PI, 3 * PI, np.nextafter(PI, 0), np.nextafter(-PI, 0), np.nextafter(-PI, -4)]
)
headings = st.floats(-PI, PI, exclude_max=True) | st.sampled_from([-PI, np.nextafter(PI, 0), 1e-12, -1e-12, 1e-300])
poses = st.builds(lambda x, y, t: np.array([x, y, t]), st.floats(-1e3, 1e3), st.floats(-1e3, 1e3), headings)
# small twists, and twists whose heading is close to ±π
twists = st.builds(
    lambda x, y, t: np.array([x, y, t]), st.floats(-50, 50), st.floats(-50, 50), st.floats(-3.14, 3.14) | headings
)


def same_pose(a: Array, b: Array, tolerance: float = 1e-9) -> None:
    """Equal positions, and headings equal as angles."""
    np.testing.assert_allclose(a[..., :2], b[..., :2], atol=tolerance, rtol=1e-12)
    np.testing.assert_allclose(np.abs(np.exp(1j * a[..., 2]) - np.exp(1j * b[..., 2])), 0, atol=1e-12)


def homogeneous(a: Array) -> Array:
    """The 3 × 3 matrix of a pose, written from the definition."""
    c, s = np.cos(a[2]), np.sin(a[2])
    return np.array([[c, -s, a[0]], [s, c, a[1]], [0, 0, 1]])


@given(angles)
def test_wrapped_angle_lies_in_the_half_open_circle_and_is_the_same_angle(angle: float) -> None:
    wrapped = float(se2.wrap(angle))
    assert -PI <= wrapped < PI
    assert abs(np.exp(1j * wrapped) - np.exp(1j * angle)) <= 1e-15 * (4 + abs(angle))


@given(headings)
def test_an_angle_in_range_is_unchanged(angle: float) -> None:
    assert float(se2.wrap(angle)) == angle
    assert se2.wrap_angle(angle) == angle


@given(angles)
def test_compiled_and_vector_wrap_are_equal(angle: float) -> None:
    assert se2.wrap_angle(angle) == float(se2.wrap(angle))
    assert se2.wrap_angle.plain(angle) == float(se2.wrap(angle))


def test_pi_wraps_to_minus_pi_and_nan_to_nan() -> None:
    assert se2.wrap(PI) == -PI
    assert se2.wrap(np.nextafter(PI, 4)) < 0
    assert se2.wrap(np.nextafter(-PI, -4)) in (-PI, np.nextafter(PI, 0))
    assert np.isnan(se2.wrap(np.nan))
    for angle in (np.nan, np.inf, -np.inf):
        assert np.isnan(se2.wrap_angle(angle))
        assert np.isnan(se2.wrap_angle.plain(angle))


@pytest.mark.parametrize("shape", [(), (0,), (4,), (2, 3)])
def test_wrap_and_rotation_keep_the_shape(shape: tuple[int, ...]) -> None:
    a = np.full(shape, 7.0)
    assert se2.wrap(a).shape == shape
    assert se2.rotation(a).shape == (*shape, 2, 2)


@given(angles, angles)
def test_rotations_are_orthogonal_and_add_their_angles(a: float, b: float) -> None:
    R = se2.rotation(a)
    np.testing.assert_allclose(R @ R.T, np.eye(2), atol=1e-15)
    assert np.linalg.det(R) == pytest.approx(1, abs=1e-15)
    np.testing.assert_allclose(R @ se2.rotation(b), se2.rotation(a + b), atol=1e-11)
    np.testing.assert_allclose(R @ [1, 0], [np.cos(a), np.sin(a)], atol=1e-15)  # counter-clockwise


@given(poses, poses)
def test_composition_is_the_product_of_the_homogeneous_matrices(a: Array, b: Array) -> None:
    ab = se2.compose(a, b)
    np.testing.assert_allclose(homogeneous(ab), homogeneous(a) @ homogeneous(b), atol=1e-10)
    assert -PI <= ab[2] < PI


@given(poses, poses, poses)
def test_poses_form_a_group(a: Array, b: Array, c: Array) -> None:
    same_pose(se2.compose(se2.compose(a, b), c), se2.compose(a, se2.compose(b, c)))
    same_pose(se2.compose(a, np.zeros(3)), a)
    same_pose(se2.compose(np.zeros(3), a), a)
    same_pose(se2.compose(a, se2.inverse(a)), np.zeros(3))
    same_pose(se2.compose(se2.inverse(a), a), np.zeros(3))


@given(poses, poses)
def test_between_leads_from_one_pose_to_the_other(a: Array, b: Array) -> None:
    same_pose(se2.compose(a, se2.between(a, b)), b)
    same_pose(se2.between(a, a), np.zeros(3))


@given(poses, poses, arrays(float, (5, 2), elements=st.floats(-100, 100)))
def test_points_transform_as_poses_compose(a: Array, b: Array, points: Array) -> None:
    moved = se2.transform(a, points)
    np.testing.assert_allclose(moved, se2.compose(a, np.column_stack([points, np.zeros(5)]))[:, :2], atol=1e-10)
    np.testing.assert_allclose(
        se2.transform(a, se2.transform(b, points)), se2.transform(se2.compose(a, b), points), atol=1e-9
    )
    np.testing.assert_allclose(se2.transform(se2.inverse(a), moved), points, atol=1e-9)
    np.testing.assert_allclose(se2.transform(a, points[0]), moved[0], atol=1e-12)


@given(twists)
def test_exp_is_the_matrix_exponential(xi: Array) -> None:
    generator = np.array([[0, -xi[2], xi[0]], [xi[2], 0, xi[1]], [0, 0, 0]])
    np.testing.assert_allclose(homogeneous(se2.exp(xi)), expm(generator), atol=1e-11)


@given(st.floats(-3, 3), st.floats(-5, 5), st.floats(-5, 5))
def test_log_is_the_matrix_logarithm(theta: float, x: float, y: float) -> None:
    pose = np.array([x, y, theta])
    L = np.real(logm(homogeneous(pose)))
    np.testing.assert_allclose(se2.log(pose), [L[0, 2], L[1, 2], L[1, 0]], atol=1e-7)


@given(poses)
def test_exp_undoes_log(a: Array) -> None:
    same_pose(se2.exp(se2.log(a)), a)
    assert -PI <= se2.log(a)[2] < PI


@given(poses, st.integers(-3, 3))
def test_whole_turns_of_the_heading_change_nothing(a: Array, turns: int) -> None:
    turned = np.add(a, [0, 0, 2 * PI * turns])
    inverse, log = se2.inverse(turned), se2.log(turned)
    same_pose(inverse, se2.inverse(a))
    same_pose(se2.exp(log), a)
    assert -PI <= inverse[2] < PI
    assert -PI <= log[2] < PI


def test_the_inverse_of_half_a_turn_is_half_a_turn() -> None:
    np.testing.assert_array_equal(se2.inverse([0, 0, -PI]), [0, 0, -PI])


@given(twists)
def test_log_undoes_exp(xi: Array) -> None:
    np.testing.assert_allclose(se2.log(se2.exp(xi)), xi, atol=1e-11, rtol=1e-12)


@given(twists, st.floats(-2, 2), st.floats(-2, 2))
def test_one_twist_generates_a_one_parameter_group(xi: Array, s: float, t: float) -> None:
    same_pose(se2.compose(se2.exp(s * xi), se2.exp(t * xi)), se2.exp((s + t) * xi))


@pytest.mark.parametrize("theta", [0.0, 1e-300, 1e-16, -1e-12, 1e-8, -1e-5, 1e-3])
def test_exp_is_smooth_through_zero_turn(theta: float) -> None:
    p, across = np.array([1.0, 2.0]), np.array([-2.0, 1.0])
    expected = p + theta / 2 * across - theta**2 / 6 * p
    np.testing.assert_allclose(se2.exp([*p, theta])[:2], expected, rtol=0, atol=abs(theta) ** 3 / 8 + 1e-15)


@given(arrays(float, (4, 1, 3), elements=st.floats(-3, 3)), arrays(float, (5, 3), elements=st.floats(-3, 3)))
def test_functions_broadcast_over_leading_axes(a: Array, b: Array) -> None:
    ab = se2.compose(a, b)
    assert ab.shape == (4, 5, 3)
    for i in range(4):
        for j in range(5):
            same_pose(ab[i, j], se2.compose(a[i, 0], b[j]), 1e-12)
    for f in (se2.inverse, se2.exp, se2.log):
        np.testing.assert_allclose(f(b), [f(row) for row in b], atol=1e-12)
    same_pose(se2.between(a, b)[2, 3], se2.between(a[2, 0], b[3]), 1e-12)


@pytest.mark.parametrize("f", [se2.inverse, se2.exp, se2.log])
def test_lists_of_integers_are_accepted_and_arguments_are_not_modified(f: object) -> None:
    assert callable(f)
    a = np.array([1, 2, 3])
    assert f([1, 2, 3]).dtype == float
    f(a)
    assert a.tolist() == [1, 2, 3]

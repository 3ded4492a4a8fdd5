"""What a filter may never learn: where, and how turned, the whole map lies in the world.

Robot and map, moved together as one rigid body, give the same measurements. These three directions of the state, the
gauge, are unobservable: a consistent filter keeps its uncertainty of them. Letters: state s = (p, θ, l₁ … l_N),
D = 3 + 2N; J = [0 -1; 1 0]; C = R(θ); X the pose as a rigid motion.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Hashable, Iterator, Mapping
from dataclasses import dataclass, replace
from math import pi, sqrt
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import block_diag, cho_factor, cho_solve

from slamkit import se2
from slamkit.arrays import finite_array
from slamkit.compiled import ROWS, WHOLE, Models
from slamkit.errors import DivergenceError, InputError
from slamkit.evaluate.consistency import ATOL, nees
from slamkit.filters.landmark_filter import LandmarkFilter
from slamkit.logs import Log, Truth
from slamkit.models import RelativePosition, Unicycle
from slamkit.protocols import MotionModel, SensorModel
from slamkit.simulate import World

__all__ = [
    "NeesSplit",
    "Nullity",
    "equivariance",
    "gauge_deviation",
    "gauge_deviations",
    "gauge_drop",
    "lower_bound_gap",
    "nees_split",
    "null_directions",
    "nullity",
    "observability_world",
    "relative_map_covariance",
    "stochastic_gauge",
]

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_J = np.array([[0.0, -1.0], [1.0, 0.0]])


@dataclass(frozen=True, eq=False)
class Nullity:
    """How many directions of the state a recorded run left unmeasured."""

    nullity: int  #: number of singular values at or below tolerance · largest
    singular_values: Array  #: (D,) of the whitened local observability matrix, descending
    tolerance: float  #: share of the largest singular value that counts as zero


@dataclass(frozen=True)
class NeesSplit:
    """NEES of the whole state, split into what the gauge and what the relative map contributes."""

    gauge: float  #: of the pose, given the relative map: χ² with `gauge_dof` degrees of freedom if consistent
    gauge_dof: int  #: 3, or less where the claimed covariance is singular
    relative: float  #: of the landmarks as the robot sees them: χ² with `relative_dof` degrees of freedom
    relative_dof: int  #: 2N

    @property
    def total(self) -> float:
        """NEES of the whole state, gauge + relative."""
        return self.gauge + self.relative

    @property
    def relative_per_dof(self) -> float:
        """Relative NEES per degree of freedom, one on the average if consistent; NaN for an empty map."""
        return self.relative / self.relative_dof if self.relative_dof else float("nan")


def null_directions(filter: LandmarkFilter) -> Array:
    """The three directions that no measurement sees, as this estimator sees them.

    Parameters
    ----------
    filter : LandmarkFilter

    Returns
    -------
    ndarray (D, 3)
        N = [I₂ J p; 0 1; I₂ J lᵢ …] in the coordinates of ``filter.x`` and ``filter.P``: translation along x and y
        [m per m], rotation about the world's origin [m and rad per rad].

    Notes
    -----
    p and lᵢ are where the estimator takes its lever arms: the current estimate (standard, iterated), p_{k|k-1} and the
    landmarks' first estimates (first estimates), p_{k|k-1} + Δ and the first estimates (observability-constrained).
    The invariant filter's N is constant in its own error ξ; its covariance is carried along with the mean, so that in
    standard coordinates N is taken at the current estimate. H N = 0 and N_{k+1} = Φ_k N_k hold for every estimator but
    the standard and the iterated one, whose N moves with each correction.
    Huang, Mourikis & Roumeliotis, IJRR 29(5):502-528 (2010); Barrau & Bonnabel, arXiv:1510.06263 (2015).
    """
    filter._settle()
    feet = filter._feet()
    N = np.zeros((len(feet), 3))
    N[:2, :2] = np.eye(2)
    N[3:, :2] = np.tile(np.eye(2), ((len(feet) - 3) // 2, 1))
    N[:, 2] = _turned(feet)
    N[2, 2] = 1.0
    return N


def nullity(filter: LandmarkFilter, log: Log, tolerance: float = 5e-6) -> Nullity:
    """Nullity of the local observability matrix of a recorded run.

    Parameters
    ----------
    filter : LandmarkFilter
        The estimator at the start of the log; it stays as it is, a copy makes the run.
    log : Log
    tolerance : float
        Share of the largest singular value at or below which a singular value counts as zero, in (0, 1). Analytic
        Jacobians leave 1e-16, the regressions of an unscented filter up to 4e-7 (as α²), and a heading that is learnt
        6e-5 or more in 200 steps of the built-in worlds.

    Returns
    -------
    Nullity
        Three for an estimator that leaves the gauge unlearnt, two for the standard EKF, which takes the heading for
        measured; more where the log does not tie its landmarks together.

    Raises
    ------
    InputError
        The tolerance is out of its interval, or the log does not fit the filter.

    Notes
    -----
    The matrix stacks R^(-1/2) H_k Φ_{k-1} … Φ_0 with the Jacobians that the estimator really used in each of its
    updates. A landmark that is new at step k enters as the measurement that its first sighting is:
    H = [-G_x, I] with the noise G_z R G_zᵀ, so that a wrong initialisation shows, too. For the invariant filter Φ
    includes the passage to the new mean, for the robocentric filter the passage to the robot's new frame. The latter's
    three directions are those of the start as the robot sees it, which no measurement of landmarks touches at all. The
    steps run as Python, about a millisecond each. An unscented filter's Jacobians are the matrices of its regressions;
    with sigma points over the whole state, H = P_xzᵀ P_xx⁻¹ has columns for every landmark.
    Huang, Mourikis & Roumeliotis, IJRR 29(5):502-528 (2010), whose matrix takes its landmarks for known to the map.
    """
    if not 0 < tolerance < 1:
        raise InputError(f"tolerance is {tolerance}, expected a share of the largest singular value in (0, 1)")
    f, sightings, corrected = _recording(filter)
    D = f.dim_x + 2 * sum(i not in f.landmarks for i in log.landmark_ids)
    own = f.base - 3  # a belief in a frame of its own begins with the robot there, whose error starts at zero
    Phi, rows = np.eye(own + D)[:, own:], [np.zeros((0, D))]
    for dt in _steps(f, log):
        if dt > 0:
            Phi[:3] = f._belief.state.F @ Phi[:3]
        rows += [H @ Phi[at] for at, H in sightings]
        sightings.clear()
        if corrected:
            f._change_frame(Phi, corrected[-1])
            corrected.clear()
        before = f._feet()
        f._settle()
        Phi[: f.dim_x] += np.outer(_turned(f._feet() - before), Phi[2])
    D = f.dim_x  # ids of the log that were never sighted have no columns
    # Only the triangular factor matters, and padding with zero rows gives every column its singular value.
    stacked = np.concatenate([*rows, np.zeros((D, Phi.shape[1]))])[:, :D]
    values = np.linalg.svd(np.linalg.qr(stacked, mode="r"), compute_uv=False)
    return Nullity(int(np.sum(values <= tolerance * values[0])), values, tolerance)


def observability_world() -> World:
    """Five landmarks, one scan that starts them all and forty further steps: the set-up on which nullity is compared.

    0.5 m/s on a circle of 2.5 m, dt 1 s; the landmarks are 2-4 m around its centre and always in sight; relative
    positions with 0.1 m an axis; σ_v 0.05 m/s, σ_ω 0.05 rad/s; P₀ = diag(0.1² m², 0.1² m², (3°)²).

    Returns
    -------
    World
    """
    angle, distance = 2 * pi * np.arange(5) / 5, np.array([3.6, 2.0, 4.0, 2.8, 3.2])
    places = np.column_stack([distance * np.cos(angle), 2.5 + distance * np.sin(angle)])
    return World(
        name="observability",
        landmarks=dict(enumerate(places)),
        motion=Unicycle(0.05, 0.05),
        sensor=RelativePosition(0.1),
        controls=np.tile([0.5, 0.2], (41, 1)),
        dt=1.0,
        pose=np.zeros(3),
        pose_covariance=np.diag([0.01, 0.01, (pi / 60) ** 2]),
    )


def gauge_deviation(filter: LandmarkFilter) -> float:
    """Standard deviation that the filter claims for the heading of robot and map as one rigid body.

    Parameters
    ----------
    filter : LandmarkFilter

    Returns
    -------
    float
        √[(Nᵀ P⁻¹ N)⁻¹]_θθ [rad]. No prediction and no measurement of landmarks may lower it.

    Raises
    ------
    DivergenceError
        The claimed covariance of the relative map is not positive definite.

    Notes
    -----
    P⁻¹ is not formed: with relative coordinates r, in which N vanishes, the expression equals the deviation of the
    heading given the relative map, √(P_θθ - P_θr P_rr⁻¹ P_rθ). That exists for a singular P, too. **A robot that knows
    exactly how it starts (P₀ = 0) has no gauge deviation that could fall**: then the value is what the motion before
    the first sighting left, and zero to rounding, about 1e-8 of the heading's deviation, where that is nothing; such a
    run says nothing of whether the filter learns its gauge. Start from a positive definite P₀ to find out.
    """
    P = _body_covariance(filter)
    squared, _ = _given_relative(P, np.zeros(len(P)))
    return sqrt(max(float(squared[2, 2]), 0.0))


def gauge_deviations(filter: LandmarkFilter, log: Log) -> Array:
    """Gauge deviation after each step of a log.

    Parameters
    ----------
    filter : LandmarkFilter
        The estimator at the start of the log; it stays as it is, a copy makes the run.
    log : Log

    Returns
    -------
    ndarray (K,)
        :func:`gauge_deviation` [rad] after each of the log's K steps.

    Raises
    ------
    InputError
        The log does not fit the filter.
    DivergenceError
        As :func:`gauge_deviation`.
    """
    f = copy.deepcopy(filter)
    return np.array([gauge_deviation(f) for _ in _steps(f, log)])


def gauge_drop(deviations: ArrayLike) -> float:
    """The largest fall of a gauge deviation below an earlier value: what the filter believes to have learnt.

    Parameters
    ----------
    deviations : array_like (K,)
        Gauge deviations [rad] in the order of time; K may be 0.

    Returns
    -------
    float
        max over j < k of dⱼ - d_k [rad], at least 0.

    Raises
    ------
    InputError
        Not one row of finite numbers.
    """
    d = finite_array("deviations", deviations, (-1,))
    return float(np.max(np.maximum.accumulate(d) - d, initial=0.0))


def stochastic_gauge(
    filter_class: Callable[..., LandmarkFilter],
    motion: MotionModel,
    sensor: SensorModel,
    log: Log,
    pose_covariance: ArrayLike,
    pose: ArrayLike = (0.0, 0.0, 0.0),
    **options: Any,
) -> float:
    """How far an uncertain start changes what the filter says of the map relative to the robot.

    The same data are filtered from an exactly known start and from `pose_covariance`. How uncertain the frame is
    has no bearing on what lies where from the robot: a filter that gives another answer has mixed the two.

    Parameters
    ----------
    filter_class : callable
        The estimator.
    motion : MotionModel
    sensor : SensorModel
    log : Log
    pose_covariance : array_like (3, 3)
        Covariance [m², m·rad, rad²] of the uncertain start.
    pose : array_like (3,)
        Where both start [m, m, rad].
    **options
        Further arguments of `filter_class`.

    Returns
    -------
    float
        Largest difference [m] between the two runs of Cᵀ(l - p), over all steps and landmarks.

    Raises
    ------
    InputError
        An argument does not fit, or the two runs have different maps.

    Notes
    -----
    The test presumes nothing of the estimator. Where H N = 0 with one N for all, P₀ enters P as N Σ Nᵀ only, which no
    gain K = P Hᵀ S⁻¹ sees, so that the two runs agree to rounding. Barrau & Bonnabel, arXiv:1510.06263 (2015).
    """
    known, uncertain = (filter_class(motion, sensor, pose, P, **options) for P in (None, pose_covariance))
    largest = 0.0
    for _ in zip(_steps(known, log), _steps(uncertain, log), strict=True):
        if known.landmark_ids != uncertain.landmark_ids:
            raise InputError("the two runs have different maps: a gate refused a sighting in one of them only")
        difference = _seen_by_robot(known.x) - _seen_by_robot(uncertain.x)
        largest = max(largest, float(np.hypot(difference[:, 0], difference[:, 1]).max(initial=0.0)))
    return largest


def equivariance(
    filter_class: Callable[..., LandmarkFilter],
    motion: MotionModel,
    sensor: SensorModel,
    log: Log,
    T: ArrayLike,
    pose: ArrayLike = (0.0, 0.0, 0.0),
    pose_covariance: ArrayLike | None = None,
    **options: Any,
) -> float:
    """How far an estimate depends on the frame in which it is expressed.

    The same data are filtered from `pose` and from T ∘ `pose`, with P₀ rotated. Every estimate must differ by T:
    pose' = T ∘ pose, l' = T l, P' = A P Aᵀ, A = diag(R(T), 1, R(T) …).

    Parameters
    ----------
    filter_class : callable
        The estimator.
    motion : MotionModel
        Its noise must be equivariant: an additive pose noise that differs between the world's x and y is not.
    sensor : SensorModel
    log : Log
    T : array_like (3,)
        Rigid motion of the initial frame [m, m, rad].
    pose : array_like (3,)
        Where the first run starts [m, m, rad].
    pose_covariance : array_like (3, 3), optional
        With which P₀ [m², m·rad, rad²]; None: exactly known.
    **options
        Further arguments of `filter_class`; a :class:`slamkit.logs.Truth` among them is moved by T, too.

    Returns
    -------
    float
        Largest absolute deviation over all steps and all entries of x [m, rad] and P [m², m·rad, rad²].

    Raises
    ------
    InputError
        An argument does not fit, or the two runs have different maps.

    Notes
    -----
    Deterministic equivariance; Barrau & Bonnabel, arXiv:1510.06263 (2015). The EKF of equivariant models has it.
    """
    t = finite_array("T", T, (3,))
    start = finite_array("pose", pose, (3,))
    P0 = np.zeros((3, 3)) if pose_covariance is None else finite_array("pose_covariance", pose_covariance, (3, 3))
    A = _rotations(t[2], 0)
    a = filter_class(motion, sensor, start, P0, **options)
    moved: dict[str, Any] = {n: _moved(t, v) if isinstance(v, Truth) else v for n, v in options.items()}
    b = filter_class(motion, sensor, se2.compose(t, start), A @ P0 @ A.T, **moved)
    largest = 0.0
    for _ in zip(_steps(a, log), _steps(b, log), strict=True):
        if a.landmark_ids != b.landmark_ids:
            raise InputError("the two runs have different maps: a gate refused a sighting in one of them only")
        x, A = a.x, _rotations(t[2], len(a.landmark_ids))
        expected = np.concatenate([se2.compose(t, x[:3]), se2.transform(t, x[3:].reshape(-1, 2)).ravel()])
        off = b.x - expected
        off[2] = se2.wrap(off[2])
        largest = max(largest, float(np.abs(off).max()), float(np.abs(b.P - A @ a.P @ A.T).max()))
    return largest


def nees_split(filter: LandmarkFilter, truth_pose: ArrayLike, truth_landmarks: Mapping[Any, ArrayLike]) -> NeesSplit:
    """Split the NEES of the whole state into that of the gauge and that of the relative map.

    Parameters
    ----------
    filter : LandmarkFilter
    truth_pose : array_like (3,)
        True pose [m, m, rad].
    truth_landmarks : mapping id → array_like (2,)
        True positions [m] of at least the landmarks in the map.

    Returns
    -------
    NeesSplit

    Raises
    ------
    InputError
        A shape does not fit, a value is not finite, or a landmark of the map has no truth.
    DivergenceError
        The claimed covariance of the relative map is not positive definite, or the error contradicts a gauge that
        the filter claims to know exactly (see :func:`slamkit.evaluate.consistency.nees`).

    Notes
    -----
    Coordinates in the robot's frame: g = log(X̂⁻¹X) (3), which has the NEES of the invariant error log(XX̂⁻¹), and
    r = Cᵀ(l - p) - Ĉᵀ(l̂ - p̂) (2N), free of the gauge. Their covariance is P' = B P Bᵀ with
    B = [Ĉᵀ ĈᵀJ(p̂ - p_lin) 0; 0 1 0; -Ĉᵀ -ĈᵀJ(l_lin - p_lin) Ĉᵀ], with the lever arms where the estimator takes them,
    so that N has no part in r. Then the NEES of (g, r) is exactly
    rᵀP_rr⁻¹r + (g - P_gr P_rr⁻¹ r)ᵀ (P_gg - P_gr P_rr⁻¹ P_rg)⁻¹ (g - P_gr P_rr⁻¹ r).
    The relative part is the same whichever rigid motion is applied to the truth.
    With levers at the current mean, r of an estimator that linearises elsewhere would take over claimed gauge
    uncertainty: its relative part would look smaller and its gauge part lose its meaning.
    A claimed gauge covariance that is singular (P₀ = 0) counts on its eigenspace only: see `gauge_dof`. Directions
    below the rounding of its computation, 1e-8 of the pose's deviation, count as known exactly.
    """
    X = finite_array("truth_pose", truth_pose, (3,))
    missing = [i for i in filter.landmark_ids if i not in truth_landmarks]
    if missing:
        raise InputError(f"truth_landmarks lack {missing[0]!r}, which is in the map, and {len(missing) - 1} more")
    places = [finite_array(f"truth of landmark {i!r}", truth_landmarks[i], (2,)) for i in filter.landmark_ids]
    truth = np.concatenate([X, *places])
    r = (_seen_by_robot(truth) - _seen_by_robot(filter.x)).ravel()
    e = np.concatenate([se2.log(se2.between(filter.pose, X)), r])
    P = _body_covariance(filter)
    C, g = _given_relative(P, e)
    relative = float(r @ cho_solve(cho_factor(P[3:, 3:], lower=True), r)) if len(r) else 0.0
    rounding = sqrt(len(P) * np.finfo(float).eps * float(np.diag(P)[:3].max()))
    gauge = nees(g, C, atol=max(ATOL, rounding))
    return NeesSplit(float(gauge.values), int(gauge.dof), relative, len(r))


def relative_map_covariance(filter: LandmarkFilter) -> Array:
    """The map's covariance without the gauge: how well the landmarks are known among themselves.

    Parameters
    ----------
    filter : LandmarkFilter
        Its map holds at least two landmarks.

    Returns
    -------
    ndarray (2N, 2N)
        Π P_mm Πᵀ [m²], Π = I - N_m (N_mᵀ N_m)⁻¹ N_mᵀ with N_m the landmarks' rows of :func:`null_directions`; of
        rank 2N - 3 at most. It goes to zero as the same map is seen again and again.

    Raises
    ------
    InputError
        Fewer than two landmarks.

    Notes
    -----
    Dissanayake, Newman, Clark, Durrant-Whyte & Csorba, IEEE Trans. Robotics and Automation 17(3) (2001), theorem 2.
    """
    if len(filter.landmark_ids) < 2:
        raise InputError(f"the map holds {len(filter.landmark_ids)} landmarks, expected at least 2")
    N = null_directions(filter)[3:]
    # About the map's centre the three columns are orthogonal, so that a map far from the origin loses no digits.
    N[:, 2] -= N[:, :2] @ (N[:, :2].T @ N[:, 2]) / (len(N) / 2)
    Q, _ = np.linalg.qr(N)
    P = filter.P[3:, 3:]
    P = P - Q @ (Q.T @ P)
    P = P - (P @ Q) @ Q.T
    return np.asarray((P + P.T) / 2)


def lower_bound_gap(filter: LandmarkFilter, pose_covariance: ArrayLike, pose: ArrayLike) -> float:
    """How far the map's covariance stays above its lower bound, the initial uncertainty of the pose.

    Parameters
    ----------
    filter : LandmarkFilter
        After a run; its map holds at least one landmark.
    pose_covariance : array_like (3, 3)
        P₀ [m², m·rad, rad²] with which it started.
    pose : array_like (3,)
        Where it started [m, m, rad] (for a filter that linearises at the truth: where that started).

    Returns
    -------
    float
        Smallest eigenvalue [m²] of P_mm - A₀ P₀ A₀ᵀ with A₀ of rows [I, J(lᵢ - p₀)], lᵢ where the estimator evaluates
        N. Not below zero, but for rounding, unless the filter has learnt its gauge.

    Raises
    ------
    InputError
        A shape does not fit, a value is not finite, or the map is empty.

    Notes
    -----
    Dissanayake, Newman, Clark, Durrant-Whyte & Csorba, IEEE Trans. Robotics and Automation 17(3) (2001), theorem 3,
    for a heading that is uncertain as well.
    """
    P0, start = finite_array("pose_covariance", pose_covariance, (3, 3)), finite_array("pose", pose, (3,))
    if not filter.landmark_ids:
        raise InputError("the map is empty, expected at least one landmark")
    A0 = null_directions(filter)[3:]
    A0[:, 2] -= A0[:, :2] @ _J @ start[:2]
    return float(np.linalg.eigvalsh(filter.P[3:, 3:] - A0 @ P0 @ A0.T)[0])


def _steps(filter: LandmarkFilter, log: Log) -> Iterator[float]:
    """Take a log step by step; yields after each step the duration of its prediction."""
    for step in log:
        if step.u is None:
            filter.observe_scan(step.scan)
        else:
            filter.step(step.u, step.dt, step.scan)
        yield step.dt


def _recording(filter: LandmarkFilter) -> tuple[LandmarkFilter, list[tuple[Indices, Array]], list[Array]]:
    """A copy that runs as Python, and what it leaves in two lists.

    Of each sighting the coordinates (n,) that it depends on and the whitened H (k, n) on them; then the pose (3,) after
    each correction.
    """
    f = copy.deepcopy(filter)
    policy = f._new_policy()
    own = policy.plain
    sightings: list[tuple[Indices, Array]] = []
    corrected: list[Array] = []
    dense: dict[int, tuple[Array, Array]] = {}

    def keep(at: Indices, H: Array, noise: Array) -> None:
        sightings.append((at, np.linalg.solve(np.linalg.cholesky(noise), H)))

    def block(slot: int) -> Indices:
        return np.array([0, 1, 2, slot, slot + 1])

    # A dense H belongs to the belief before the update, a sparse one is still in the state at the end of it.
    def correct(policy: Any, models: Any, state: Any, n: int) -> int:
        dense.clear()
        for slot in state.slots[:n].tolist():
            regression = f._regression(slot)
            if regression is not None:
                dense[slot] = regression
        return int(own.correct(policy, models, state, n))

    # Every update ends in one retraction.
    def retract(state: Any) -> None:
        k = state.noise.shape[1]
        for j, slot in enumerate(state.slots[: state.size[ROWS] // k].tolist()):
            rows = slice(j * k, (j + 1) * k)
            if slot in dense:
                keep(np.arange(state.size[WHOLE]), *dense[slot])
            else:
                H = np.hstack([state.H_pose[rows], state.H_landmark[rows]])
                keep(block(int(state.owner[slot])), H, state.noise[rows])
        own.retract(state)
        corrected.append(state.mean[:3].copy())

    def start(models: Any, state: Any, slot: int, place: int, z: Any) -> None:
        own.start(models, state, slot, place, z)
        keep(block(int(state.size[WHOLE])), np.hstack([-state.G_pose, np.eye(2)]), state.block)

    policy.plain = SimpleNamespace(**{**vars(own), "correct": correct, "retract": retract, "start": start})
    f._policy, f._models = policy, Models(compiled=False, **f._models.fields)
    return f, sightings, corrected


def _turned(points: Array) -> Array:
    """J times every position of a state (D,), and 0 in place of the heading."""
    out = np.zeros_like(points)
    out[0], out[1] = -points[1], points[0]
    out[3::2], out[4::2] = -points[4::2], points[3::2]
    return out


def _seen_by_robot(x: Array) -> Array:
    """Landmarks of a state (D,) in the robot's frame, Cᵀ(l - p): (N, 2) [m]."""
    seen: Array = (x[3:].reshape(-1, 2) - x[:2]) @ se2.rotation(x[2])
    return seen


def _body_covariance(filter: LandmarkFilter) -> Array:
    """B P Bᵀ (D, D), with the B of :func:`nees_split`."""
    P = filter.P  # first: it settles the coordinates
    feet, x = filter._feet(), filter.x
    D, N = len(x), (len(x) - 3) // 2
    levers = feet.copy()
    levers[:2] -= x[:2]
    levers[3:] -= np.tile(feet[:2], N)
    B = np.eye(D)
    B[3:, :2] = -np.tile(np.eye(2), (N, 1))
    B[:, 2] -= _turned(levers)
    B = _rotations(-x[2], N) @ B
    return np.asarray(B @ P @ B.T)


def _given_relative(P: Array, e: Array) -> tuple[Array, Array]:
    """Covariance (3, 3) and error (3,) of the pose given the relative map, of a body covariance and error."""
    if len(P) == 3:
        return P, e
    try:
        factor = cho_factor(P[3:, 3:], lower=True)
    except np.linalg.LinAlgError:
        smallest = np.linalg.eigvalsh(P[3:, 3:])[0]
        raise DivergenceError(
            "the covariance of the map relative to the robot is not positive definite "
            f"(smallest eigenvalue {smallest:.3g} m²), so the gauge cannot be told from it"
        ) from None
    gain = cho_solve(factor, P[3:, :3]).T
    C = P[:3, :3] - gain @ P[3:, :3]
    return (C + C.T) / 2, e[:3] - gain @ e[3:]


def _rotations(angle: float, N: int) -> Array:
    """diag(R, 1, R …) (D, D): a rotation of the frame, as errors of a state with N landmarks see it."""
    R = se2.rotation(angle)
    return np.asarray(block_diag(R, 1.0, np.kron(np.eye(N), R)))


def _moved(t: Array, truth: Truth) -> Truth:
    landmarks: dict[Hashable, Array] = {i: se2.transform(t, p) for i, p in truth.landmarks.items()}
    return replace(truth, poses=se2.compose(t, truth.poses), landmarks=landmarks)

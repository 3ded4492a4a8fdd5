"""The unscented filter: how far to spread its sigma points, in which axes, how many, and when to redraw them."""

# %% [markdown]
# # 09 · The unscented filter
#
# The extended filter replaces a function by its tangent. The unscented filter (UKF) evaluates the function at a few
# *sigma points* around the mean, and computes mean and covariance from the results. It needs no derivatives. In SLAM,
# a textbook UKF has four problems that have nothing to do with derivatives:
#
# - Its points lie √D standard deviations from the mean, and D grows with the map.
# - Its answer depends on the choice of the world's axes.
# - A sighting costs O(D³), although it depends on only five numbers.
# - If the points are not redrawn after an update, the covariance becomes negative.
#
# This tutorial shows each problem in a few lines of NumPy, and how slamkit's `UKFSLAM` solves it.
#
# | symbol | shape | meaning |
# |---|---|---|
# | x, P | (D,), (D, D) | mean and covariance of the pose and N landmarks, D = 3 + 2N |
# | L | (D, D) | a root of the covariance, L Lᵀ = P, with columns L_i |
# | s = α √(n + κ) | scalar | spread: distance of the points from the mean in standard deviations, in n dimensions |
# | W₀, W | scalars | weight of the centre, 1 − n/s², and of every other point, 1/(2 s²) |
# | z, S | (2,), (2, 2) | range [m] and bearing [rad] of a sighting, and covariance of its prediction |
# | R(θ) | (2, 2) | rotation from robot axes to world axes |

# %%
import os
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # one thread for everything whose time is compared

import matplotlib.pyplot as plt
import numpy as np
from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter
from numpy.typing import NDArray
from scipy.linalg import block_diag

from slamkit import EKFSLAM, UKFSLAM, FullUKFSLAM, plots, se2, simulate
from slamkit.evaluate import gauge
from slamkit.models import RangeBearing, Unicycle
from slamkit.simulate import World, random_world

FIGURES = Path(os.environ.get("SLAMKIT_FIGURES") or "figures")
Array = NDArray[np.float64]
Function = Callable[[Array], Array]

# %% [markdown]
# ## The transform
#
# The sigma points of a Gaussian are its mean and two points along each column of a root of P,
#
#     X₀ = x        X_{±i} = x ± s L_i,   i = 1 … n
#
# With the weights of the table, their mean is x and their covariance is P for every s. The function values at the
# points give the mean of f(x), its covariance, and its covariance with x:
#
#     m = Σ W_j f(X_j)        S = Σ W_j (f(X_j) − m)(f(X_j) − m)ᵀ + (1 − α² + β)(f(x) − m)(f(x) − m)ᵀ
#     C = Σ W_j (X_j − x)(f(X_j) − m)ᵀ
#
# With α = 1 and β = 0 this is the transform of Julier and Uhlmann. α and β come from van der Merwe. A small α moves
# the points together. The last term, with β = 2, compensates what S would lose by that if x is Gaussian.
#
# Differences from f(x) use the function's own subtraction, because angles must be subtracted as angles.


# %%
def unscented(
    f: Function, x: Array, L: Array, alpha: float = 1.0, kappa: float = 0.0, beta: float = 0.0,
    subtract: Callable[[Array, Array], Array] = np.subtract,
) -> tuple[Array, Array, Array]:  # fmt: skip
    """Mean m and covariance S of f, and its covariance C with the state, for a state of mean x and covariance L Lᵀ."""
    n = len(x)
    s = alpha * np.sqrt(n + kappa)
    X = np.vstack([x, x + s * L.T, x - s * L.T])
    W = np.append(1 - n / s**2, np.full(2 * n, 0.5 / s**2))
    centre = f(x)
    d = np.array([subtract(f(point), centre) for point in X])
    shift = W @ d
    S = (W * (d - shift).T) @ (d - shift) + (1 - alpha**2 + beta) * np.outer(shift, shift)
    return centre + shift, S, (W * (X - x).T) @ (d - shift)


# %% [markdown]
# Here is what the transform gains. A landmark 10 m ahead is seen with a poor bearing of 0.3 rad. It lies somewhere on
# an arc that bends towards the robot. The tangent does not bend, so an EKF starts the landmark at 10 m.

# %%
poor = RangeBearing(sigma_range=0.1, sigma_bearing=0.3)
z = np.array([10.0, 0.0])
mean, _, _ = unscented(lambda v: poor.invert(np.zeros(3), v), z, np.linalg.cholesky(poor.R), kappa=1)
rng = np.random.default_rng(0)
samples = np.array([poor.invert(np.zeros(3), v) for v in rng.multivariate_normal(z, poor.R, 20_000)])
print(f"mean distance of the landmark, tangent: {poor.invert(np.zeros(3), z)[0]:.2f} m")
print(f"mean distance of the landmark, sigma points: {mean[0]:.2f} m")
print(f"mean distance of the landmark, 20000 samples: {samples[:, 0].mean():.2f} m")

# %% [markdown]
# ## First problem: the spread
#
# With κ = 0 and α = 1, the points lie √n standard deviations from the mean. With a map of 100 landmarks, n is 203. If
# the heading is known to 5°, the function is evaluated at 71°. The usual advice is κ = 3 − n. It gives s = √3 for
# every n, which matches the fourth moments of a Gaussian. Its price is the weight of the centre:

# %%
D = 203
kappa = 3 - D
print(f"spread with kappa = 0 at n = {D}: {np.sqrt(D):.1f} standard deviations")
print(f"centre weight with kappa = 3 - n at n = {D}: {kappa / (D + kappa):.1f}")

# %% [markdown]
# A sum with a weight of −66 does not always give a valid covariance. For example, take |x|², where x has 203
# independent components of variance 1. Its variance is 2 · 203 = 406.

# %%
_, variance, _ = unscented(lambda v: np.array([v @ v]), np.zeros(D), np.eye(D), kappa=kappa)
print(f"variance of |x|² by kappa = 3 - n: {variance[0, 0]:.0f}")

# %% [markdown]
# What does a wide spread do in SLAM? A robot knows its heading to 5°. It maps N landmarks with one scan and predicts
# the range of landmark 0, which is 10 m away. The answer cannot depend on N, because the range is a function of the
# pose and of this one landmark.
#
# But the points depend on N. When the heading moves by s · 5°, the belief moves the landmark along the tangent of its
# circle around the robot. This is right for small angles. At 71° the tangent has left the circle, and the landmark is
# 60 % farther away.

# %%
sensor, motion = RangeBearing(0.1, np.deg2rad(2.0)), Unicycle(0.1, 0.05)
sizes = [1, 3, 10, 30, 100, 300]


def sight(v: Array) -> Array:
    """Predicted sighting of the landmark whose position follows the pose in the state."""
    return sensor.predict(v[:3], v[3:5])


predicted: dict[str, list[float]] = {}
beliefs: list[tuple[Array, Array]] = []
for N in sizes:
    places = np.random.default_rng(3).uniform(-20, 20, (N, 2))
    places[0] = 8.0, 6.0
    f = EKFSLAM(motion, sensor, pose_covariance=np.diag([0.1, 0.1, np.deg2rad(5.0)]) ** 2)
    f.observe_scan({i: sensor.predict(np.zeros(3), p) for i, p in enumerate(places)})
    L = np.linalg.cholesky(f.P)
    for name, (alpha, kappa, beta) in {
        "√D": (1.0, 0.0, 0.0),
        "√3 (κ = 3 − D)": (1.0, 3.0 - f.dim_x, 0.0),
        "√D / 100 (α = 0.01, β = 2)": (0.01, 0.0, 2.0),
    }.items():
        _, S, _ = unscented(sight, f.x, L, alpha, kappa, beta, subtract=sensor.residual)
        predicted.setdefault(name, []).append(float(np.sqrt(S[0, 0])))
    beliefs.append((f.x, f.P))
x, P = beliefs[sizes.index(100)]
columns = np.linalg.cholesky(P)[:5]
draws = x[:5] + rng.standard_normal((20_000, 5)) @ columns[:, :5].T
sampled = np.hypot(draws[:, 3] - draws[:, 0], draws[:, 4] - draws[:, 1]).std()
print(f"sd of the predicted range, 20000 samples: {sampled:.3f} m")
for name, values in predicted.items():
    print(f"sd of the predicted range at N = 1, spread {name}: {values[0]:.3f} m")
    print(f"sd of the predicted range at N = 300, spread {name}: {values[-1]:.3f} m")

# %% [markdown]
# A filter that claims five times the true uncertainty of the range learns little from a sighting. The larger its map,
# the less it learns. slamkit uses α = 0.01. The points stay close to the mean, where the tangent is as good as the
# circle. They are then almost a derivative, plus the second-order terms of mean and covariance.
#
# ## Second problem: the axes
#
# The robot does not know where north is. If we turn the world by 1.1 rad, including robot and map, every estimate must
# turn with it and nothing else may change. This is true for an EKF. The points of a UKF lie along the columns of a
# root of P, and a root is not unique. A Cholesky root is triangular *in the axes in which P is written*, so in other
# axes the points are different. The remedy is to compute the root in axes that turn with the robot, and to rotate it
# back:
#
#     L = T chol(Tᵀ P T),        T = diag(R(θ), 1, R(θ), R(θ) …)
#
# Here is a complete UKF-SLAM with sigma points over the whole state and the noise. The root is an argument.

# %%
Root = Callable[[Array, float], Array]


def world_root(P: Array, heading: float) -> Array:
    """Cholesky root in the axes of the world."""
    return np.linalg.cholesky(P)


def body_root(P: Array, heading: float) -> Array:
    """Cholesky root in the axes of the robot."""
    C = se2.rotation(heading)
    T = block_diag(C, 1.0, *[C] * ((len(P) - 3) // 2))
    return np.asarray(T @ np.linalg.cholesky(T.T @ P @ T))


def turned(a: Array, b: Array) -> Array:
    """a − b for poses."""
    return np.array([a[0] - b[0], a[1] - b[1], se2.wrap(a[2] - b[2])])


class WholeUKF:
    """UKF-SLAM with sigma points over the whole state and the noise."""

    def __init__(self, world: World, pose: Array, P: Array, root: Root) -> None:
        self.motion, self.sensor, self.root = world.motion, world.sensor, root
        self.x, self.P = pose, P
        self.slots: dict[object, int] = {}

    def joint(self, v: Array, V: Array) -> tuple[Array, Array]:
        """The state followed by a noisy input of mean v and covariance V, and the root of their covariance."""
        return np.append(self.x, v), block_diag(self.root(self.P, self.x[2]), np.linalg.cholesky(V))

    def predict(self, u: Array, dt: float) -> None:
        D, move = len(self.x), self.motion.move
        both, L = self.joint(u, self.motion.control_noise(u, dt))
        m, S, C = unscented(lambda v: move(v[:3], v[D:], dt), both, L, subtract=turned)
        self.x = np.concatenate([[m[0], m[1], se2.wrap(m[2])], self.x[3:]])
        self.P = np.block([[S, C[3:D].T], [C[3:D], self.P[3:, 3:]]])

    def observe(self, landmark: object, z: Array) -> None:
        D = len(self.x)
        if landmark not in self.slots:
            both, L = self.joint(z, self.sensor.R)
            m, S, C = unscented(lambda v: self.sensor.invert(v[:3], v[D:]), both, L)
            self.slots[landmark] = D
            self.x, self.P = np.append(self.x, m), np.block([[self.P, C[:D]], [C[:D].T, S]])
            return
        a = self.slots[landmark]
        L = self.root(self.P, self.x[2])  # redrawn for every sighting
        residual = self.sensor.residual
        m, S, C = unscented(lambda v: self.sensor.predict(v[:3], v[a : a + 2]), self.x, L, subtract=residual)
        S = S + self.sensor.R
        K = np.linalg.solve(S, C.T).T
        self.x = self.x + K @ residual(z, m)
        self.x[2] = se2.wrap(self.x[2])
        self.P = self.P - K @ S @ K.T


rng = np.random.default_rng(2)
world = random_world(rng, 6, steps=60, max_range=np.inf)
world = replace(world, pose_covariance=np.diag([0.1, 0.1, np.deg2rad(5.0)]) ** 2)
log = simulate(world, rng)
turn = np.array([0.0, 0.0, 1.1])
A = block_diag(se2.rotation(turn[2]), 1.0)
apart: dict[str, list[float]] = {}
for name, root in (("world axes", world_root), ("body axes", body_root)):
    here = WholeUKF(world, world.pose, world.pose_covariance, root)
    there = WholeUKF(world, se2.compose(turn, world.pose), A @ world.pose_covariance @ A.T, root)
    apart[name] = []
    for step in log:
        assert step.u is not None
        for ukf in (here, there):
            ukf.predict(step.u, step.dt)
            for i, z in zip(step.scan.ids, np.asarray(step.scan.z), strict=True):
                ukf.observe(i, z)
        pose = turned(se2.compose(turn, here.x[:3]), there.x[:3])
        places = se2.transform(turn, here.x[3:].reshape(-1, 2)) - there.x[3:].reshape(-1, 2)
        apart[name].append(float(max(np.abs(pose).max(), np.abs(places).max())))
    print(f"largest change by turning the frame, root in {name}: {max(apart[name]):.1e} m or rad")
for kind in (UKFSLAM, FullUKFSLAM):
    largest = gauge.equivariance(kind, world.motion, world.sensor, log, turn, world.pose, world.pose_covariance)
    print(f"largest change by turning the frame, {kind.__name__}: {largest:.1e}")

# %% [markdown]
# With the root in world axes, the estimate changes by centimetres when north changes. The root in body axes removes
# this effect up to rounding.
#
# ## Third problem: the cost, and the partial transform
#
# A root of P costs O(D³), and there are 2D + 1 points, although a sighting depends only on the pose and one landmark.
# Let a be these five numbers and b the rest of the state, with a first. A Cholesky root is triangular,
#
#     L = [L_aa 0; L_ba L_bb]
#
# so the points along the columns of L_bb do not change a. The sighting there is the same as at the centre. Only the
# points along L_aa matter, and the covariance with the whole state is C = P_xa P_aa⁻¹ C_a. The sigma points of the
# five numbers alone give the same result *exactly* if they have the same spread. In `sight`, a comes first.


# %%
def whole_update(x: Array, P: Array) -> Array:
    """P after a sighting, by sigma points of the whole state."""
    _, S, C = unscented(sight, x, np.linalg.cholesky(P), subtract=sensor.residual)
    return P - C @ np.linalg.solve(S + sensor.R, C.T)


def partial_update(x: Array, P: Array) -> Array:
    """P after a sighting, by sigma points of the pose and the landmark."""
    P_aa = P[:5, :5]
    _, S, C = unscented(sight, x[:5], np.linalg.cholesky(P_aa), kappa=len(x) - 5.0, subtract=sensor.residual)
    C = P[:, :5] @ np.linalg.solve(P_aa, C)
    return P - C @ np.linalg.solve(S + sensor.R, C.T)


times: dict[str, list[float]] = {"ukf": [], "ukf-full": []}
largest = 0.0
for x, P in beliefs:
    largest = max(largest, float(np.abs(whole_update(x, P) - partial_update(x, P)).max()))
    for name, function in (("ukf", partial_update), ("ukf-full", whole_update)):
        spent = []
        for _ in range(9):
            before = time.perf_counter()
            function(x, P)
            spent.append(time.perf_counter() - before)
        times[name].append(1e6 * float(np.median(spent)))
print(f"sigma points of the whole state at N = {sizes[-1]}: {2 * len(x) + 1}")
print(f"sigma points of the pose and one landmark: {2 * 5 + 1}")
print(f"largest difference between whole and partial update, same spread: {largest:.1e} m² or rad²")
print(f"whole over partial update at N = {sizes[-1]}: {times['ukf-full'][-1] / times['ukf'][-1]:.0f} times")

# %% [markdown]
# This is the *partial transform*. The regression H̄ = C_aᵀ P_aa⁻¹ takes the place of the Jacobian in the sparse update
# of the EKF. The part of z that is not linear in a is added to the noise.
#
# slamkit's `UKFSLAM` works like this. `FullUKFSLAM` uses points over the whole state, as a reference. Each uses the
# spread for its own dimension, and the full filter keeps the landmarks in their order. So the two differ only through
# spread and order. For a small α there is no difference. Both filters run over the same logs, with every landmark in
# sight.

# %%
for N in (5, 20, 50):
    rng = np.random.default_rng(0)
    scene = random_world(rng, N, steps=1 + 250 // N, max_range=np.inf)
    scene = replace(scene, pose_covariance=np.diag([0.1, 0.1, np.deg2rad(3.0)]) ** 2)
    record = simulate(scene, rng)
    for alpha in (1.0, 1e-3):
        models = scene.motion, scene.sensor, scene.pose, scene.pose_covariance
        partial, full = UKFSLAM(*models, alpha=alpha), FullUKFSLAM(*models, alpha=alpha)
        largest = 0.0
        for step in record:
            assert step.u is not None
            for f in (partial, full):
                f.step(step.u, step.dt, step.scan)
            difference = partial.x - full.x
            difference[2] = se2.wrap(difference[2])
            largest = max(largest, float((np.abs(difference) / np.sqrt(np.diag(full.P))).max()))
        print(f"N = {N}, alpha = {alpha:g}, partial from full: {largest:.1e} standard deviations")

# %% [markdown]
# ## Fourth problem: points that are not redrawn
#
# filterpy's UKF draws its points in `predict` and uses them for every `update` until the next prediction. The second
# sighting of a scan is then compared with points that ignore the first. Here is one number with P = 1, measured three
# times with R = 1. The right variances are 1/2, 1/3 and 1/4.

# %%
stale = UnscentedKalmanFilter(
    1, 1, 1.0, hx=lambda v: v, fx=lambda v, dt: v, points=MerweScaledSigmaPoints(1, alpha=1, beta=2, kappa=2)
)
stale.x, stale.P, stale.R, stale.Q = np.zeros(1), np.eye(1), np.eye(1), np.zeros((1, 1))
stale.predict()
ours = UKFSLAM(motion, sensor, pose_covariance=np.eye(3))
for n in (1, 2, 3):
    stale.update(np.zeros(1))
    ours.update(np.zeros(1), np.eye(1), hx=lambda v: v[:1])
    print(f"variance after {n} updates, points of the prediction: {stale.P[0, 0]:.3f}")
    print(f"variance after {n} updates, drawn anew: {ours.P[0, 0]:.3f}")

# %% [markdown]
# Each update subtracts the same amount as the first, and the third leaves a negative variance. filterpy expects one
# measurement after each prediction. In SLAM a scan has many sightings, and each one must be compared with the current
# belief.
#
# ## What sigma points do not cure
#
# The standard EKF is inconsistent because it claims to learn its heading. The UKF has the same fault: its regressions
# do not belong to one linear system either. The world below has five landmarks that are always in sight, and a heading
# that is known to 3°. Nothing in this world measures the heading.

# %%
small = gauge.observability_world()
seen = simulate(small, np.random.default_rng(1))
for kind in (EKFSLAM, UKFSLAM):
    f = kind(small.motion, small.sensor, small.pose, small.pose_covariance)
    drop = gauge.gauge_drop(gauge.gauge_deviations(f, seen))
    print(f"{kind.__name__}, deviation of the heading claimed away: {np.degrees(drop):.2f} deg")

# %% [markdown]
# ## The figure
#
# Top left: landmark 0 as the robot sees it, in a map of 100 landmarks, with samples of the belief and the sigma
# points. The two outermost crosses are the points of the heading. They have left the arc of the samples. Top right:
# the effect on a prediction. Bottom: the change of the estimates when the frame is turned, and the time of an update.

# %%
figure = plt.figure(figsize=(11, 7.6), layout="constrained")
(cloud, spread), (axes, cost) = figure.subplots(2, 2)


x, P = beliefs[sizes.index(100)]
mean, columns = x[:5], np.linalg.cholesky(P)[:5]


def seen_by_robot(states: Array) -> Array:
    """Landmark 0 in robot axes, (n, 2), of states (n, 5)."""
    return np.array([se2.rotation(v[2]).T @ (v[3:5] - v[:2]) for v in states])


cloud.plot(*seen_by_robot(draws[:4000]).T, ".", color="0.7", markersize=2, label="samples of the belief")
for s, marker, color, label in (
    (np.sqrt(D), "x", "black", "sigma points, s = √D"),
    (np.sqrt(3), "o", plots.style("ukf").color, "sigma points, s = √3"),
):
    points = np.vstack([mean + s * columns.T, mean - s * columns.T])
    face = color if marker == "x" else "none"
    cloud.plot(*seen_by_robot(points).T, marker, color=color, markersize=6, markerfacecolor=face, label=label)
cloud.set(xlabel="ahead of the robot [m]", ylabel="to its left [m]", title="landmark 0, N = 100")
cloud.set_aspect("equal", adjustable="datalim")
cloud.legend(loc="lower left", frameon=False, fontsize="small")

looks = [("black", "-", "x"), (plots.style("ukf").color, "--", "o"), ("0.5", ":", "s")]
spread.axhline(sampled, color="0.75", linewidth=5, label="samples", zorder=1)
for (name, values), (color, line, marker) in zip(predicted.items(), looks, strict=True):
    spread.plot(sizes, values, color=color, linestyle=line, marker=marker, markersize=5, label=f"s = {name}")
spread.set(xscale="log", ylim=(0, None), xlabel="landmarks N", ylabel="sd of the predicted range [m]")
spread.set_xticks(sizes, [str(n) for n in sizes])
spread.minorticks_off()
spread.legend(loc="upper left", frameon=False, fontsize="small")

elapsed = world.dt * np.arange(1, len(log) + 1)
axes.semilogy(elapsed, apart["world axes"], color="black", label="root in world axes")
axes.semilogy(elapsed, apart["body axes"], color=plots.style("ukf").color, linestyle="--", label="root in body axes")
axes.set(xlabel="time [s]", ylabel="change by turning\nthe frame [m or rad]")
axes.legend(loc="center right", frameon=False, fontsize="small")

for name, label in (("ukf-full", "whole state"), ("ukf", "pose and landmark")):
    look = plots.style(name)
    cost.loglog(sizes, times[name], color=look.color, linestyle=look.linestyle, marker=look.marker, label=label)
cost.set(xlabel="landmarks N", ylabel="time of an update, NumPy [µs]")
cost.set_xticks(sizes, [str(n) for n in sizes])
cost.minorticks_off()
cost.legend(loc="upper left", frameon=False, fontsize="small")

FIGURES.mkdir(parents=True, exist_ok=True)
print("figure:", plots.save(figure, FIGURES / "09_the_ukf.png", dpi=150))

# %% [markdown]
# ## Key points
#
# - Sigma points with a spread of √D leave the region in which the belief is meaningful. κ = 3 − n keeps them close but
#   needs a large negative weight. A small α keeps them close without it.
# - A Cholesky root depends on the axes of the world. Compute it in the axes of the robot.
# - A function of five numbers needs the sigma points of five numbers. The answer is the same, without the O(D³) cost.
# - Redraw the points before every update.
# - A UKF needs no derivatives. It does not cure inconsistency: it claims to learn its heading, as the EKF does.

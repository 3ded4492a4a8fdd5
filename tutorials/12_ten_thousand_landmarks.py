"""Ten thousand landmarks: what a step costs on a small and on a large map, and why the fast method is exact."""

# %% [markdown]
# # 12 · Ten thousand landmarks
#
# A sighting changes everything that is correlated with the landmark, which is everything (tutorial 02). So a plain
# EKF-SLAM pays for the whole map at every sighting, and a map of ten thousand landmarks is considered too large for
# it. But you rarely need the whole map after every sighting. A filter can update landmarks that are out of sight
# later, if it keeps enough information to do this exactly (Guivant & Nebot, IEEE TRA 17(3), 2001).
#
# This tutorial shows which information the filter keeps, that the result is the same up to rounding, and which costs
# still grow with the map.
#
# | symbol | shape | meaning |
# |---|---|---|
# | x, P | (D,), (D, D), D = 3 + 2N | mean and covariance of the pose and N landmarks |
# | A | indices | the active entries: the pose, and the landmarks sighted since the last flush |
# | A₀, b | indices | the part of A that was in the map at the flush; the resting entries: all others |
# | x⁰, P⁰ | (D,), (D, D) | mean and covariance after the last flush |
# | M = P⁰[A₀, b] | (A₀, b) | covariance of active and resting entries at the last flush |
# | Φ | (A, A₀) | how this covariance has changed since: P_Ab = Φ M |
# | Ψ, ϑ | (A₀, A₀), (A₀,) | pending corrections of the covariance and the mean of the resting entries |
# | H, S = L Lᵀ, y | (2, A), (2, 2), (2,) | Jacobian, innovation covariance and innovation of a sighting |
# | w, g, t | (2, A), (2, A₀), (2,) | L⁻¹ H P_AA, L⁻¹ H Φ and L⁻¹ y |

# %%
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # one thread for everything whose time is compared

import time
from collections.abc import Hashable
from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray

from slamkit import EKFSLAM, Storage, World, plots, simulate
from slamkit.models import RangeBearing, Unicycle
from slamkit.se2 import wrap
from slamkit.simulate import random_world

FIGURES = Path(os.environ.get("SLAMKIT_FIGURES") or "figures")
Array = NDArray[np.float64]
AT_ONCE, PLAIN = Storage(), Storage(compress_above=10**6)  # the default, and a filter that defers nothing

# %% [markdown]
# ## One field, maps of several sizes
#
# There are ten thousand landmarks, one per ten square metres. A map of N landmarks is the square in the middle that
# contains N of them. First comes a quick survey: the robot jumps from stop to stop on a spiral inwards, sights
# landmarks up to 25 m away, and keeps the first sighting of each. Then it drives from one random place to the next,
# 0.1 m a step, and sights landmarks up to 5 m away, eight on average. On maps of 1000 landmarks and more it drives the
# same path.

# %%
motion, sensor = Unicycle(sigma_v=0.05, sigma_omega=0.005), RangeBearing(0.1, np.deg2rad(0.5))
field = random_world(np.random.default_rng(1), 10_000, steps=1).landmarks
places = sorted(field.values(), key=lambda place: float(np.abs(place).max()))


def drive(n: int, steps: int) -> World:
    """The map of n landmarks and a path through it that begins in the middle."""
    way = random_world(np.random.default_rng(2), min(n, 1000), steps=steps)
    return replace(way, landmarks=dict(enumerate(places[:n])), motion=motion, sensor=sensor)


def surveyed(n: int, storage: Storage) -> EKFSLAM:
    """A filter that has mapped n landmarks and stands in the middle."""
    world, stride = drive(n, 1), 33.0  # a square of 33 m lies within 25 m of its middle
    half = max(0.0, np.ceil(float(np.abs(places[n - 1]).max()) / stride - 0.5))
    at = stride * np.arange(-half, half + 1)
    stops = np.array([(x, y) for x in at for y in at])
    stops = stops[np.lexsort((np.arctan2(stops[:, 1], stops[:, 0]), -np.abs(stops).max(axis=1)))]
    leaps = np.diff(stops, axis=0)
    headings = np.append(np.arctan2(leaps[:, 1], leaps[:, 0]), 0.0)
    controls = np.zeros((2 * len(leaps) + 1, 2))  # stand, leap, turn, leap, turn, …
    controls[1::2, 0] = np.hypot(*leaps.T) / world.dt
    controls[2::2, 1] = wrap(np.diff(headings)) / world.dt

    start = np.array([*stops[0], headings[0]])
    log = simulate(replace(world, controls=controls, pose=start, max_range=25.0), np.random.default_rng(3))
    first = np.sort(np.unique(log.observation_ids, return_index=True)[1])
    parts = {k: getattr(log, k)[first] for k in ("observation_times", "observation_ids", "observations")}
    f = EKFSLAM(motion, sensor, start, storage=storage)
    f.run(replace(log, **parts))
    f.flush()
    return f


# %% [markdown]
# ## What a sighting touches
#
# Start just after a flush, when P⁰ is complete. Split the state into A, which contains the pose and all landmarks that
# will be sighted for a while, and the rest b. Motion changes the pose. A sighting involves the pose and one landmark.
# So every Jacobian is zero in b: [H 0]. With w_b = L⁻¹ H P_Ab, the update P ← P − wᵀw splits into
#
#     P_AA ← P_AA − wᵀw         P_Ab ← P_Ab − wᵀ w_b         P_bb ← P_bb − w_bᵀ w_b         x_b ← x_b + w_bᵀ t
#
# H P_AA, S and y need nothing of b. **The filter in A works as if b did not exist.** None of its numbers depends on
# whether b is up to date. For b, write P_Ab = Φ M with Φ = I at the flush. Then w_b = L⁻¹ H Φ M = g M, and M can stay
# outside:
#
#     Φ ← Φ − wᵀg               Ψ ← Ψ + gᵀg                  ϑ ← ϑ + gᵀt
#
# A motion multiplies the pose's rows of Φ by F. None of these matrices is larger than A. At any time, the complete
# state is exactly
#
#     P_Ab = Φ M                P_bb = P⁰_bb − Mᵀ Ψ M        x_b = x⁰_b + Mᵀ ϑ
#
# Computing it is the flush. Here it is in NumPy, for 40 steps on a map of 200 landmarks. A filter that defers nothing
# runs beside it and provides the linearisation points:

# %%
plain = surveyed(200, PLAIN)
steps = list(simulate(drive(200, 40), np.random.default_rng(4)))
x0, P0 = plain.x, plain.P


def rows(landmark: Hashable) -> list[int]:
    """Indices of a landmark in the state."""
    slot = 3 + 2 * plain.landmark_ids.index(landmark)
    return [slot, slot + 1]


sighted = {i for step in steps for i in step.scan.ids}
A = np.array([0, 1, 2, *sorted(row for i in sighted for row in rows(i))])
b = np.setdiff1d(np.arange(len(x0)), A)
Phi, Psi, theta = np.eye(len(A)), np.zeros((len(A), len(A))), np.zeros(len(A))
for step in steps:
    assert step.u is not None
    F, _ = motion.jacobians(plain.pose, step.u, step.dt)
    plain.predict(step.u, step.dt)
    Phi[:3] = F @ Phi[:3]
    for i, z in zip(step.scan.ids, np.asarray(step.scan.z), strict=True):
        here = plain.landmarks[i]
        H = np.zeros((2, len(A)))
        H[:, :3], H[:, np.searchsorted(A, rows(i))] = sensor.jacobians(plain.pose, here)
        P_AA = plain.P[np.ix_(A, A)]
        L = np.linalg.cholesky(H @ P_AA @ H.T + sensor.R)
        w, g = np.linalg.solve(L, H @ P_AA), np.linalg.solve(L, H @ Phi)
        t = np.linalg.solve(L, sensor.residual(z, sensor.predict(plain.pose, here)))
        Phi, Psi, theta = Phi - w.T @ g, Psi + g.T @ g, theta + g.T @ t
        plain.observe(i, z)
M = P0[np.ix_(A, b)]
sd = np.sqrt(np.diag(plain.P))
moved = np.abs(plain.x - x0)[b] / sd[b]
P_Ab, P_bb, x_b = Phi @ M, P0[np.ix_(b, b)] - M.T @ Psi @ M, x0[b] + M.T @ theta
errors = (
    (P_Ab - plain.P[np.ix_(A, b)]) / np.outer(sd[A], sd[b]),
    (P_bb - plain.P[np.ix_(b, b)]) / np.outer(sd[b], sd[b]),
    x_b - plain.x[b],
)
print(f"by hand, sightings: {sum(len(step.scan.ids) for step in steps)}")
print(f"by hand, active of {len(x0)}: {len(A)}")
print(f"by hand, largest move of a landmark that was not in sight, in standard deviations: {moved.max():.2f}")
print(f"by hand, largest difference from the plain filter: {max(np.abs(e).max() for e in errors):.1e}")

# %% [markdown]
# (Here and below, differences of x are in metres and radians. Differences of P_ij are in units of √(P_ii P_jj).)
#
# ## The active set grows
#
# The filter does not know in advance which landmarks it will sight. When it sights a resting landmark j, it computes
# the rows of j from the equations above, with c = P⁰[A₀, j]: P_jA = cᵀΦᵀ, P_jj = P⁰_jj − cᵀΨc, x_j = x⁰_j + cᵀϑ. This
# costs O(A²), and j is then in A. A new landmark gets its rows of Φ from those of the pose. So A grows as the robot
# drives, and a step costs O(A²). From time to time the filter flushes and starts again with the pose alone. Is the
# result still the same after many regions and many flushes?
#
# The size of A changes no result, so it is not part of the public interface. This tutorial reads it from the inside of
# the filter.


# %%
def active(f: EKFSLAM) -> int:
    """Dimension of A; from inside, and no part of the interface."""
    return int(vars(f)["_belief"].active)


def difference(one: EKFSLAM, other: EKFSLAM) -> tuple[float, float]:
    """Largest difference of x [m, rad] and of P_ij [√(P_ii P_jj)]."""
    P = one.P
    sd = np.sqrt(np.diag(P))
    return float(np.abs(one.x - other.x).max()), float(np.max(np.abs(P - other.P) / np.outer(sd, sd)))


pair = surveyed(200, AT_ONCE), surveyed(200, PLAIN)
driven = simulate(drive(200, 3000), np.random.default_rng(4))
dims = []
for step in driven:
    for f in pair:
        f.step(step.u if step.u is not None else (), step.dt, step.scan)
    dims.append(active(pair[0]))
print(f"200 landmarks, 3000 steps, flushes: {np.sum(np.diff(dims) < 0)}")
print(f"200 landmarks, 3000 steps, sighted: {len(driven.landmark_ids)}")
dx, dp = difference(*pair)
print(f"200 landmarks, 3000 steps, largest difference of x: {dx:.1e}")
print(f"200 landmarks, 3000 steps, largest difference of P: {dp:.1e}")

# %% [markdown]
# The method is not an approximation. It computes the same sums in a different order.
#
# ## From 10 to 10,000
#
# Now we run four maps and time every step of the drive. At the end comes a flush, whose time also counts, so that no
# work is left undone. The plain filter runs beside it up to N = 1000. Its 8 sightings are 8 rank-2 changes of a
# triangle of D²/2 numbers, or 8 D² multiply-adds. So 100 times the landmarks take 10,000 times the time.
#
# Memory cannot be deferred: one triangle is D (D + 1)/2 numbers of 8 bytes. (While a map grows, the old triangle and a
# larger one sometimes exist at the same time.)

# %%
SIZES, STEPS = (10, 100, 1000, 10_000), 400


def timed(f: EKFSLAM, n: int, steps: int) -> tuple[Array, Array]:
    """Seconds of every step of the drive (steps,), and the dimension of A after it (steps,)."""
    spent, dims = [], []
    for step in simulate(drive(n, steps), np.random.default_rng(4)):
        u = step.u if step.u is not None else ()
        before = time.perf_counter()
        f.step(u, step.dt, step.scan)
        spent.append(time.perf_counter() - before)
        dims.append(active(f))
    return np.array(spent), np.array(dims)


held, usual, average, plain_times = [], [], [], []
growth, spent_at = {}, {}
print(
    "time of a step [µs], its median and its average with all flushes; of the last flush [ms]; of a plain filter's step"
)
print("     N     P [MB]     median    average      flush      plain")
for n in SIZES:
    f = surveyed(n, AT_ONCE)
    spent, growth[n] = timed(f, n, STEPS)
    spent_at[n] = spent
    before = time.perf_counter()
    f.flush()
    flush = time.perf_counter() - before
    D = 3 + 2 * n
    held.append(8 * D * (D + 1) / 2)
    usual.append(1e6 * np.median(spent))
    average.append(1e6 * (spent.sum() + flush) / STEPS)
    beside = "–"
    if n <= 1000:
        plain_times.append(1e6 * np.median(timed(surveyed(n, PLAIN), n, 50)[0]))
        beside = f"{plain_times[-1]:.0f}"
    print(f"{n:6d} {held[-1] / 1e6:10.3f} {usual[-1]:10.0f} {average[-1]:10.0f} {1e3 * flush:10.1f} {beside:>10}")
print(f"P at N = 10000, one triangle: {held[-1] / 1e9:.3f} GB")
print(f"P at N = 10000, a full matrix: {8 * D**2 / 1e9:.3f} GB")
print(f"P at N = 10000, one triangle over that at N = 1000: {held[-1] / held[-2]:.1f}")
small, large = growth[1000], growth[10_000]
same = int(np.argmax(small != large)) if np.any(small != large) else STEPS
print(f"steps in which A is the same at N = 1000 and at N = 10000: {same}")
print(f"dimension of A at N = 1000, largest of these: {small[:same].max()}")
print(f"dimension of A at N = 10000, largest of these: {large[:same].max()}")
print(f"median of these steps at N = 1000: {1e6 * np.median(spent_at[1000][:same]):.0f} µs")
print(f"median of these steps at N = 10000: {1e6 * np.median(spent_at[10_000][:same]):.0f} µs")
print(f"dimension of A at N = 10000, after {STEPS} steps: {large[-1]} of {D}")
del f  # frees gigabytes

# %% [markdown]
# The robot drives the same path through 1000 landmarks and through 10,000, and sights the same landmarks. So A is the
# same at every step, and a step between flushes costs about the same: it does not touch the rest of the map. The two
# differ only after the filter with the smaller map finds that a flush pays off.
#
# ## What a flush costs
#
# The cost of a flush grows with the map. Mᵀ Ψ M over one triangle is about A D²/2 multiply-adds, against 8 D² for one
# step of the plain filter. But a flush pays for a landmark once, when it has *come* into sight, and not at every
# sighting. The robot meets about one new landmark per metre, which is ten steps and eighty sightings. A flush is also
# one large matrix product, which a processor computes much faster than eighty changes of rank two. Its cost is still ∝
# D², so the average cost for a travelling robot grows with the map, from a much lower level.
#
# A flush pays off once the extra cost of a large A since the last flush exceeds the cost of a flush. So the filter
# flushes less often on a larger map, and A grows larger in between. A robot that stays in one region does not need to
# flush at all.
#
# The slowest step matters too. `Storage(flush_work=…)` spreads a flush over several steps. It sets the number of
# multiply-adds that one step may spend on the flush. The filter continues meanwhile. A landmark that comes into sight
# before the flush has reached it is updated individually. Here is a map of 2000 landmarks:

# %%
MANY, LONG = 2000, 1500
filters = {"at once": surveyed(MANY, AT_ONCE), "spread": surveyed(MANY, Storage(flush_work=1e8))}
times = {}
for name, f in filters.items():
    times[name], reach = timed(f, MANY, LONG)
    print(f"N = {MANY}, {name}, flushes: {np.sum(np.diff(reach) < 0)}")
    print(f"N = {MANY}, {name}, largest dimension of A: {reach.max()}")
    print(f"N = {MANY}, {name}, median step: {1e3 * np.median(times[name]):.3f} ms")
    print(f"N = {MANY}, {name}, average step: {1e3 * times[name].mean():.3f} ms")
    print(f"N = {MANY}, {name}, worst step: {1e3 * times[name].max():.1f} ms")
dx, dp = difference(filters["at once"], filters["spread"])
print(f"N = {MANY}, at once and spread, largest difference of x: {dx:.1e}")
print(f"N = {MANY}, at once and spread, largest difference of P: {dp:.1e}")

# %% [markdown]
# The time of the slowest step is bounded. The price is a larger average: A must stay small so that even the first part
# of a flush stays within the bound, so there are more flushes. The result is the same.
#
# ## The figure
#
# Top left: the time of a step. The plain filter is measured up to N = 1000 and extrapolated by D². Top right: the
# dimension of A during the drive. Bottom left: every step of the two filters on the map of 2000. A single step of some
# milliseconds is not a flush: the machine was busy with something else. Bottom right: memory.

# %%
figure = plt.figure(figsize=(11, 7.6), layout="constrained")
(cost, reached), (worst, memory) = figure.subplots(2, 2)
ekf, grey = plots.style("ekf").color, "0.45"
line = plain_times[-1] * ((3 + 2 * np.array([1000, 10_000])) / 2003) ** 2
cost.loglog(SIZES[:3], plain_times, color=grey, linestyle="--", marker="^", markersize=5, label="defers nothing")
cost.loglog((1000, 10_000), line, color=grey, linestyle=":", label="∝ D², not measured")
cost.loglog(SIZES, average, color=ekf, marker="o", markersize=5, label="slamkit, average with flushes")
cost.loglog(SIZES, usual, color=ekf, linewidth=0.9, marker="s", markersize=4, label="slamkit, median step")
cost.set(xlabel="landmarks N", ylabel="one step [µs]")
memory.loglog(
    SIZES, [8e-6 * (3 + 2 * n) ** 2 for n in SIZES], color=grey, linestyle="--", marker="^", label="full matrix"
)
memory.loglog(SIZES, np.array(held) / 1e6, color=ekf, marker="o", markersize=5, label="slamkit, one triangle")
memory.set(xlabel="landmarks N", ylabel="memory of P [MB]")
for ax in (cost, memory):
    ax.set_xticks(SIZES, [f"{n:,}" for n in SIZES])
    ax.minorticks_off()
    ax.grid(color="0.9")

at = np.arange(1, STEPS + 1)
for n, width, dashes, above in ((100, 1.2, ":", 3), (1000, 1.0, "--", 3), (10_000, 2.6, "-", 2)):
    color = {100: grey, 1000: "black", 10_000: ekf}[n]
    reached.plot(at, growth[n], color=color, linewidth=width, linestyle=dashes, zorder=above, label=f"map of {n:,}")
reached.set(xlabel="steps since the survey", ylabel="dimension of A", xlim=(0, STEPS), ylim=(0, None))

for name, color, marker in (("at once", ekf, "o"), ("spread", "black", ".")):
    worst.semilogy(
        np.arange(1, LONG + 1), 1e3 * times[name], color=color, linestyle="none", marker=marker,
        markersize=5 if marker == "o" else 3, markerfacecolor="none" if marker == "o" else color,
        label=f"flush {name}",
    )  # fmt: skip
top = 1e3 * max(spent.max() for spent in times.values())
worst.set_ylim(top=8 * top)
worst.set(xlabel=f"steps since the survey, N = {MANY}", ylabel="time of the step [ms]", xlim=(0, LONG))
for ax in (cost, reached, worst, memory):
    ax.legend(loc="best", frameon=False, fontsize="small")

FIGURES.mkdir(parents=True, exist_ok=True)
print("figure:", plots.save(figure, FIGURES / "12_ten_thousand_landmarks.png", dpi=150))

# %% [markdown]
# ## Key points
#
# - A sighting measures the pose and landmarks in sight. The filter in A needs nothing of the rest. The pending
#   corrections of the rest fit into Φ, Ψ and ϑ, which are no larger than A. The result is that of the plain filter.
# - A step between flushes costs O(A²), where A contains what was in sight since the last flush. It does not depend on
#   N.
# - Two costs grow with N: memory, D²/2 numbers, and the flush, A D²/2 multiply-adds. A flush is paid once for the
#   landmarks that came into sight, not for every sighting.
# - Reading `P` flushes. `pose`, `pose_covariance`, `landmarks` and `marginal` do not.
# - `Storage(flush_work=…)` bounds the slowest step and raises the average.

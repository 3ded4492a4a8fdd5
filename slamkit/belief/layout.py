"""The one list of a belief's fields: what each is, its shape, and what becomes of it in a copy, a file, an undo.

Everything that has to know all fields derives from this list: the tables of compiled code, the arrays and their growth
(:mod:`slamkit.belief.room`), saving and loading (:mod:`slamkit.belief.files`), and the undo of a refused step.
"""

from __future__ import annotations

from dataclasses import dataclass

from slamkit.compiled import Table

BASE, BLOCK = 3, 2  #: entries of the base that a transition moves, and of one block
#: Rows of L⁻¹ H Φ that are kept as they come: a root of Ψ for a caller that reads P after every few steps.
ROOT_ROWS = 32


@dataclass(frozen=True)
class Field:
    """One field of the state.

    Dimensions are named: ``capacity`` (room for active coordinates), ``columns`` (room for those of Φ), ``rows`` (of
    an update), ``sightings`` (of a scan), ``map`` (room for coordinates of the map), ``k`` (rows of a sighting), ``m``
    (of a control), ``own`` (the estimator's own numbers), ``saved`` (of a small belief). In a file they are as long as
    what they hold: ``active``, ``dim``, ``update`` (rows of the last update), ``resting`` (length of the store's
    vectors) and ``store``.
    """

    kind: str  #: as in :class:`slamkit.compiled.Table`
    shape: tuple[str | int, ...] = ()  #: of an array; empty: it is not allocated with the others
    kept: bool = False  #: whether its content survives a change of capacity
    file: tuple[str | int, ...] | None = None  #: shape in a file; None: it is in none
    undone: bool = True  #: whether undoing a step needs it
    fill: int = 0  #: value of entries that hold nothing


def _number(kind: str = "index", *, file: bool = False) -> Field:
    return Field(kind, file=() if file else None)


def _scratch(kind: str, *shape: str | int, kept: bool = False, undone: bool = False) -> Field:
    return Field(kind, shape, kept=kept, undone=undone)


#: What the filter believes now. D = `active` is the dimension of the active part.
BELIEF = {
    "active": _number(file=True),
    "dim": _number(file=True),  # of the whole map
    "mean": Field("vector", ("capacity",), True, ("active",)),  # pose, then two numbers a landmark
    "cov": Field("matrix", ("capacity", "capacity"), True, ("active", "active")),  # lower triangle
    # Where the lever arms of the Jacobians are taken, in filters that do not take them at the mean.
    "linearised_at": Field("vector", ("capacity",), True, ("active",)),
    "owner": Field("integers", ("capacity",), True),  # active coordinate → coordinate of the map
    "local": Field("integers", ("map",), True, fill=-1),  # coordinate of the map → active one, -1 where it rests
}
#: What is not active rests, see `slamkit.belief.compressed`. C = `columns`.
RESTING = {
    "columns": _number(file=True),  # columns of Φ; 0 where nothing may rest
    "corrected": _number(),  # first row of the store that a flush has yet to correct
    "row_stride": _number(),  # entries from one row of the store to the next; 0 where it is a packed triangle
    "root_row_count": _number(),  # rows in `root_rows`; -1: there were more
    # What decides when to flush, in multiply-adds, see `slamkit.cycle.upkeep`.
    "debt": _number("real", file=True),
    "price_per_square": _number("real"),
    "fixed_price": _number("real"),
    "spent": _number("real", file=True),
    "spent_plain": _number("real", file=True),
    "most_columns": _number("real", file=True),
    "limit": _number("real"),  # dimension above which a belief is compressed
    "stays": _number("real", file=True),  # steps for which nothing is to rest
    "Phi": Field("matrix", ("capacity", "columns"), True),
    "minus_Psi": Field("matrix", ("columns", "columns"), True),  # lower triangle of -Ψ
    "theta": Field("vector", ("columns",), True),  # ϑ
    "root_rows": Field("matrix", (ROOT_ROWS, "columns"), True),  # L⁻¹ H Φ of updates since the last flush
    "activated": Field("integers", ("columns",), True),  # A₀ as coordinates of the map
    "mean": Field("vector", file=("resting",), undone=False),  # as of the last flush
    "linearised_at": Field("vector", file=("resting",), undone=False),
    "store": Field("vector", file=("store",), undone=False),  # covariance as of the last flush
    "V": Field("matrix", undone=False),  # what a flush under way has yet to subtract is V Vᵀ
}
#: The last prediction and the last update.
LAST = {
    "rows": _number(file=True),
    "active": _number(),  # of the belief then; -1 once that has changed
    "dim": _number(),
    "F": Field("matrix", (BASE, BASE), True, (BASE, BASE)),
    "Q": Field("matrix", (BASE, BASE), True, (BASE, BASE)),
    "z": Field("vector", ("rows",), True, ("update",)),
    "y": Field("vector", ("rows",), True, ("update",)),  # innovation
    "S": Field("matrix", ("rows", "rows"), True, ("update", "update")),
    "L": Field("matrix", ("rows", "rows"), True, ("update", "update")),  # lower Cholesky factor of S
    "t": Field("vector", ("rows",), True, ("update",)),  # L⁻¹ y
    "w": Field("matrix", ("rows", "capacity"), True),  # L⁻¹ H P
    "g": Field("matrix", ("rows", "columns"), True),  # L⁻¹ H Φ
}
#: Room to work in. What stands here is of use during one step only.
SCRATCH = {
    "status": Field("index", undone=False),  # of the last step of a run
    "steps_done": _number(),  # of the run under way
    "failing": Field("index", undone=False),  # place of the sighting for which a step was refused
    "non_finite_sightings": _number(),  # sightings since the step began that gave no finite numbers
    # What a filter is told of a log beside its sightings: rows of steps and of sightings, and those of this step.
    "told_of_steps": Field("matrix", undone=False),
    "told_of_sightings": Field("matrix", undone=False),
    "step_row": Field("index", undone=False),
    "first_row": Field("index", undone=False),
    "careful": Field("flag", undone=False),  # whether the caller undoes a step that fails
    "pose": _scratch("vector", BASE),  # the pose that the step arrives at
    "refused": _scratch("vector", 18),  # F and Q before a prediction that may yet be refused
    "refused_own": _scratch("vector", "own"),
    "G": _scratch("matrix", BASE, "m"),
    "sigma_u": _scratch("matrix", "m", "m"),
    "at": _scratch("vector", "point"),  # the pose and the landmarks at which a scan is linearised
    "slots": _scratch("integers", "sightings", undone=True),  # slots of the sightings that an update uses
    "order": _scratch("integers", "sightings", undone=True),  # their places in the scan
    "innovations": _scratch("matrix", "sightings", "k", undone=True),  # in the scan's order
    "nis": _scratch("vector", "sightings", undone=True),
    "accepted": _scratch("flags", "sightings", undone=True),
    "z_hat": _scratch("vector", "k"),  # one predicted measurement
    "effective": _scratch("vector", "rows"),  # innovation as the linear update wants it
    "H_pose": _scratch("matrix", "rows", BASE),
    "H_landmark": _scratch("matrix", "rows", BLOCK),
    "noise": _scratch("matrix", "rows", "k"),  # the k × k noise of each sighting, one below the other
    "dx": _scratch("vector", "capacity"),  # correction in the filter's error coordinates
    "gathered": _scratch("matrix", BASE + BLOCK, "capacity"),  # rows of the covariance under the sighting at hand
    "G_pose": _scratch("matrix", BLOCK, BASE),
    "G_z": _scratch("matrix", BLOCK, "k"),
    "block": _scratch("matrix", BLOCK, BLOCK),  # noise of a new landmark
    "saved": _scratch("vector", "saved"),  # a small belief before a step
}
FIELDS = {"belief": BELIEF, "resting": RESTING, "last": LAST, "scratch": SCRATCH}

_PARTS = {part: Table(part, **{name: field.kind for name, field in fields.items()}) for part, fields in FIELDS.items()}
#: The state as compiled code sees it. ``own`` (n,) are the estimator's own numbers, see `slamkit.compiled.OwnFields`.
STATE = Table("state", **_PARTS, own="vector")

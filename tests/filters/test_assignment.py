"""Assigning to an attribute of a filter takes effect at once and wholly, or raises."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from family import FILTERS, MOTIONS, PlainSensor, drive
from filter_examples import all_filters, every_filter, every_order, every_storage, grown, made_of, make, same

import slamkit
from slamkit import AssignmentError, InputError, ModelError
from slamkit.models import Odometry, RangeBearing, Unicycle

SIGHTED = {"L0": (3.0, 0.4), "L1": (2.0, -0.8), "fresh": (4.0, 0.1)}
UNSCENTED = [name for name in FILTERS if "ukf" in name]


def as_if_made_with(f: Any, tmp_path: Path, **models: Any) -> Any:
    """The same belief in a filter that was made with other models: through a file, which `load` gives them to."""
    f.save(tmp_path / "f.npz")
    return type(f).load(tmp_path / "f.npz", **models)


@every_filter
@every_order
@every_storage
@pytest.mark.parametrize("form", ["compiled", "python"])
def test_another_sensor_is_used_from_the_next_step_on(
    name: str, order: str, storage: Any, form: str, tmp_path: Path
) -> None:
    f = grown(name, order=order, storage=storage)
    motion, noisy = made_of(form, f.motion, RangeBearing(10.0, 1.0))
    twin = as_if_made_with(f, tmp_path, motion=motion, sensor=noisy)
    f.motion, f.sensor = motion, noisy
    assert f.sensor is noisy
    assert np.array_equal(f.R, np.diag([100.0, 1.0]))
    for g in (f, twin):
        g.step((1.0, 0.1), 0.3, SIGHTED)
    assert same(f, twin)
    assert f.S[0, 0] >= 100.0, "S uses the new R"
    for g in (copy.deepcopy(f), as_if_made_with(f, tmp_path, motion=motion, sensor=noisy)):
        g.observe("L0", (3.1, 0.4))
        h = copy.deepcopy(f)
        h.observe("L0", (3.1, 0.4))
        assert same(g, h), "a copy and a file continue with it"


@every_filter
@every_storage
def test_another_motion_is_used_from_the_next_step_on(name: str, storage: Any, tmp_path: Path) -> None:
    f = grown(name, storage=storage)
    wild = Unicycle(3.0, 2.0)
    twin = as_if_made_with(f, tmp_path, motion=wild)
    calm = copy.deepcopy(f)
    f.motion = wild
    for g in (f, twin, calm):
        g.step((1.0, 0.1), 0.3, SIGHTED)
    assert same(f, twin)
    assert f.Q[0, 0] > 100 * calm.Q[0, 0]


@every_filter
def test_a_motion_may_take_controls_of_another_length(name: str) -> None:
    f = grown(name)
    f.motion = Odometry(0.1, 0.1, 0.1, 0.1)
    assert f.dim_u == 3
    with pytest.raises(InputError, match=r"u has shape \(2,\)"):
        f.predict((1.0, 0.1), 0.5)
    f.step((0.1, 0.3, 0.1), 0.3, SIGHTED)
    f.motion = Unicycle(0.1, 0.1)
    f.step((1.0, 0.1), 0.3, SIGHTED)
    assert np.linalg.eigvalsh(f.P)[0] > 0


@every_filter
@every_storage
def test_another_order_is_used_from_the_next_scan_on(name: str, storage: Any) -> None:
    f, twin = grown(name, storage=storage), grown(name, storage=storage)
    f.order = "batch"
    f.observe_scan(SIGHTED)
    assert f.K.shape[1] == 4, "two known landmarks in one stacked update"
    f.order = "sequential"
    f.observe_scan(SIGHTED)
    assert f.K.shape[1] == 2
    with pytest.raises(InputError, match="order is 'random'"):
        f.order = "random"
    assert f.order == "sequential"
    twin.order = "batch"
    twin.observe_scan(SIGHTED)
    twin.order = "sequential"
    twin.observe_scan(SIGHTED)
    assert same(f, twin)


@all_filters
def test_models_that_do_not_fit_are_refused_and_change_nothing(name: str) -> None:
    f = make(name)
    motion, sensor = f.motion, f.sensor

    class Range(PlainSensor):
        R = np.array([[0.01]])

    with pytest.raises(AssignmentError, match="1 numbers, this filter is laid out for 2"):
        f.sensor = Range(sensor)
    for bad in (None, 3, RangeBearing, MOTIONS["unicycle"]):
        with pytest.raises(ModelError):
            f.sensor = bad
    for bad in (None, 3, Unicycle, RangeBearing(0.1, 0.1)):
        with pytest.raises(ModelError):
            f.motion = bad
    assert f.motion is motion and f.sensor is sensor


@all_filters
def test_what_cannot_be_assigned_raises(name: str) -> None:
    f = make(name)
    public = [n for n in dir(f) if not n.startswith("_")]
    for attribute in (
        "dim_x",
        "R",
        "pose",
        "pose_covariance",
        "landmarks",
        "landmark_ids",
        "K",
        "S",
        "y",
        "z",
        "F",
        "Q",
    ):
        assert attribute in public
        with pytest.raises(AssignmentError, match=f"{attribute} of a .* is read-only"):
            setattr(f, attribute, np.eye(3))
    for attribute in ("snapshots", "storage", "name", "functions", "iterations", "dim_z", "dim_u", "B", "compresses"):
        with pytest.raises(AssignmentError, match=f"{attribute} of a .* is chosen when it is made"):
            setattr(f, attribute, getattr(f, attribute))
    for attribute in ("predict", "observe", "run", "save"):
        with pytest.raises(AssignmentError, match="no attribute"):
            setattr(f, attribute, None)
    with pytest.raises(AssignmentError, match=r"'gates'.*did you mean gate"):
        f.gates = 3
    with pytest.raises(AttributeError):
        f.noise = 1.0


@pytest.mark.parametrize("name", UNSCENTED)
@pytest.mark.parametrize("attribute", ["alpha", "beta", "kappa"])
def test_the_scaling_of_sigma_points_can_be_set_later(name: str, attribute: str) -> None:
    value = {"alpha": 0.7, "beta": 1.0, "kappa": 2.0}[attribute]
    late, early = make(name), make(name, **{attribute: value})
    setattr(late, attribute, value)
    for f in (late, early):
        assert getattr(f, attribute) == value
        f.run(drive(f.motion, f.sensor))
    assert same(late, early)
    for bad in (np.nan, "a", -2.0, None):
        if attribute != "beta" or bad != -2.0:
            with pytest.raises(InputError, match=attribute):
                setattr(late, attribute, bad)
    assert getattr(late, attribute) == value
    with pytest.raises(AssignmentError, match="sigma_points"):
        late.sigma_points = "full"


@every_filter
def test_a_subclass_may_have_attributes_of_its_own(name: str) -> None:
    class Mine(FILTERS[name]):  # type: ignore[misc]
        threshold = 3.0

        def __init__(self, *arguments: Any, **options: Any) -> None:
            self.before = 1
            super().__init__(*arguments, **options)
            self.seen: list[str] = []

    f = Mine(MOTIONS["unicycle"], RangeBearing(0.1, 0.1))
    f.before, f.seen, f.threshold, f._hidden = 2, ["a"], 4.0, 5
    for g in (f, copy.deepcopy(f)):
        assert (g.before, g.seen, g.threshold, g._hidden) == (2, ["a"], 4.0, 5)
        with pytest.raises(AssignmentError, match=r"'treshold'.*did you mean threshold"):
            g.treshold = 5.0


def test_every_error_is_public() -> None:
    from slamkit import errors

    for name, kind in vars(errors).items():
        if isinstance(kind, type) and issubclass(kind, errors.SlamkitError):
            assert name in slamkit.__all__ and getattr(slamkit, name) is kind

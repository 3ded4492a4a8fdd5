"""What a filter takes from outside: any array of real numbers, and nothing else; a refusal changes nothing."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from family import drive
from filter_examples import all_filters, every_filter, every_storage, grown, made_of, make, same, untouched

from slamkit import InputError, Log, Scan
from slamkit.filters import FILTERS


def read_only(a: Any) -> Any:
    a = np.array(a, dtype=float)
    a.flags.writeable = False
    return a


def unaligned(a: Any) -> Any:
    a = np.array(a, dtype=float)
    view = np.zeros(a.nbytes + 1, np.uint8)[1:].view(float).reshape(a.shape)
    view[...] = a
    return view


class Subclass(np.ndarray):
    pass


FORMS: dict[str, Callable[[Any], Any]] = {
    "a list": lambda a: np.array(a).tolist(),
    "read-only": read_only,
    "unaligned": unaligned,
    "from bytes": lambda a: np.frombuffer(np.array(a, dtype=float).tobytes()).reshape(np.shape(a)),
    "big-endian": lambda a: np.array(a, dtype=">f8"),
    "Fortran order": lambda a: np.asfortranarray(np.array(a, dtype=float)),
    "strided": lambda a: np.repeat(np.array(a, dtype=float), 2, axis=-1)[..., ::2],
    "a subclass": lambda a: np.array(a, dtype=float).view(Subclass),
    "objects": lambda a: np.array(a, dtype=object),
    "nothing masked": lambda a: np.ma.array(a, dtype=float),
}
REFUSED: dict[str, Callable[[Any], Any]] = {
    "complex": lambda a: np.array(a, dtype=complex) + 1j,
    "masked": lambda a: np.ma.array(a, dtype=float, mask=np.ones(np.shape(a))),
    "text": lambda a: np.array(a).astype(str),
    "bytes": lambda a: np.array(a).astype("S8"),
    "time": lambda a: np.array(a).astype("m8[s]"),
    "date": lambda a: np.array(a).astype("M8[s]"),
    "None": lambda a: np.full(np.shape(a), None),
    "ragged": lambda a: [[1.0], [1.0, 2.0]],
    "huge integers": lambda a: [10**400] * len(a),
    "nothing": lambda a: None,
    "a set": lambda a: {1.0, 2.0},
}


@every_filter
@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("models", ["compiled", "python"])
def test_arrays_may_be_of_any_form(name: str, form: str, models: str) -> None:
    """The same numbers give the same filter, whatever array holds them; the caller's array stays as it was."""
    shape, motion_and_sensor = FORMS[form], made_of(models, *(getattr(make(name), n) for n in ("motion", "sensor")))
    a, b = make(name, *motion_and_sensor), make(name, *motion_and_sensor)
    u, z = (1.0, 0.25), [(3.0, 0.5), (2.0, -0.5)]
    given_u, given_z = shape(u), shape(z)
    for f, control, sightings in ((a, u, np.array(z)), (b, given_u, given_z)):
        f.predict(control, 0.5)
        f.observe("a", sightings[0])
        f.observe_scan(Scan(("a", "b"), sightings))
        f.step(control, 0.5, dict(zip("ab", sightings, strict=True)))
        f.step(control, np.float32(0.5), Scan(("a", "b"), sightings))
    assert same(a, b)
    assert np.array_equal(np.array(given_u, dtype=float), u) and np.array_equal(np.array(given_z, dtype=float), z)
    b.x, b.P = shape(a.x), shape(a.P)
    made = FILTERS[name](a.motion, a.sensor, shape((0.0, 0.0, 0.0)), shape(np.eye(3)))
    assert np.array_equal(made.P, np.eye(3))


@all_filters
def test_a_log_may_be_frozen(name: str) -> None:
    a, b = make(name), make(name)
    log = drive(a.motion, a.sensor)
    expected = a.run(log)
    frozen = drive(a.motion, a.sensor)
    for array in (frozen.control_times, frozen.controls, frozen.observation_times, frozen.observation_ids,
                  frozen.observations):  # fmt: skip
        array.flags.writeable = False
    assert np.array_equal(b.run(frozen).poses, expected.poses)


@every_filter
@pytest.mark.parametrize("kind", REFUSED)
def test_what_is_not_a_real_number_is_refused(name: str, kind: str) -> None:
    f, bad = make(name), REFUSED[kind]
    f.observe("a", (3.0, 0.5))
    f.step((1.0, 0.25), 0.5, {"a": (2.5, 0.6)})
    untouched(f, lambda: f.predict(bad((1.0, 2.0)), 0.5))
    untouched(f, lambda: f.step(bad((1.0, 2.0)), 0.5, {}))
    untouched(f, lambda: f.step((1.0, 0.2), 0.5, {"a": bad((1.0, 2.0))}))
    untouched(f, lambda: f.observe("a", bad((1.0, 2.0))))
    untouched(f, lambda: f.observe("new", bad((1.0, 2.0))))
    untouched(f, lambda: f.observe_scan({"new": (1.0, 2.0), "a": bad((1.0, 2.0))}))
    untouched(f, lambda: f.observe_scan(Scan(("a",), bad([(1.0, 2.0)]))))
    untouched(f, lambda: setattr(f, "x", bad(f.x)))
    untouched(f, lambda: setattr(f, "P", bad(np.diag(f.P))))
    with pytest.raises(InputError, match="pose"):
        FILTERS[name](f.motion, f.sensor, bad((0.0, 0.0, 0.0)))


@every_filter
@every_storage
def test_options_and_durations_of_the_wrong_kind_are_refused(name: str, storage: Any) -> None:
    f = grown(name, storage=storage)
    arguments = f.motion, f.sensor
    for gate in ("a", True, False, 0.0, -1.0, np.nan, [3.0], 1j, 10**400, object()):
        with pytest.raises(InputError, match="gate is"):
            FILTERS[name](*arguments, gate=gate)
        untouched(f, lambda gate=gate: setattr(f, "gate", gate))
    for options in ({"order": "x"}, {"order": None}, {"snapshots": "no"}, {"snapshots": 1}, {"storage": 3}):
        with pytest.raises(InputError, match=next(iter(options))):
            FILTERS[name](*arguments, **options)
    for dt in (
        10**400,
        -(10**400),
        "1",
        True,
        None,
        1j,
        [0.5],
        np.array([0.5, 0.5]),
        np.nan,
        0,
        np.timedelta64(1, "s"),
    ):
        untouched(f, lambda dt=dt: f.predict((1.0, 0.1), dt))
        untouched(f, lambda dt=dt: f.step((1.0, 0.1), dt, {}))
    f.predict(np.array([1.0, 0.1]), np.array(0.5))


@every_filter
def test_scans_of_the_wrong_kind_are_refused(name: str) -> None:
    f = grown(name)
    scans: list[Any] = [None, 3, "ab", [("L0", (1.0, 0.1))], {("L0", 1.0)}, object(), [], Scan]
    for scan in scans:
        untouched(f, lambda scan=scan: f.observe_scan(scan))
        untouched(f, lambda scan=scan: f.step((1.0, 0.1), 0.5, scan))
    for ids, z in ((None, [(1.0, 0.1)]), (3, [(1.0, 0.1)]), (("L0",), None), (([],), [(1.0, 0.1)])):
        untouched(f, lambda ids=ids, z=z: f.observe_scan(Scan(ids, z)))


@every_filter
def test_a_log_of_other_columns_is_refused(name: str) -> None:
    f = grown(name)
    untouched(f, lambda: f.run(Log([0.0], [(1.0, 0.0)], [1.0], [0], [(1.0,)], (1,))))
    untouched(f, lambda: f.run(None))

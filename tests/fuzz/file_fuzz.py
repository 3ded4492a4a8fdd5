"""Damaged files of every kind that slamkit reads: they are refused, quickly, or what they give can be used.

Damage is of two kinds: to the bytes of a file, and to the content of an archive, which then is well formed and wrong.
"""

from __future__ import annotations

import json
import resource
import shutil
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from child import Trace, arguments
from family import PlainMotion, PlainSensor
from log_examples import small_history, small_log

from slamkit import History, Log, Scan, Storage, Truth, World
from slamkit.cli.models_file import read_models, write_models
from slamkit.datasets import mrclam
from slamkit.errors import InputError, LogFileError, SlamkitError
from slamkit.filters import FILTERS
from slamkit.logs import read_archive, read_table, write_archive
from slamkit.models import RangeBearing, Unicycle
from slamkit.study import Study, compare

SLOWEST = 1.0  #: [s] of CPU that reading a file may take
MOST_MEMORY = 200e6  #: [bytes] by which reading any file may raise the peak
#: Smallest eigenvalue of P that is rounding, over the largest variance since the file was read.
ROUNDING = 1e-8
TRUTH = Truth([0.0, 0.1, 0.2, 0.3, 100.0], np.ones((5, 3)), {i: (3.0 + i, 2.0 - i) for i in range(40)})
MODELS = Unicycle(0.1, 0.05), RangeBearing(0.1, 0.03)


@dataclass(frozen=True)
class Kind:
    """One kind of file."""

    make: Callable[[Path], Any]  #: writes a sound file, or the files of a folder, at a path
    read: Callable[[Path], Any]
    use: Callable[[Any], Any]
    archive: str = ""  #: the kind of archive that it is; empty for one that is none


# -- kinds of files ---------------------------------------------------------------------------------------------------


def make_filter(name: str, landmarks: int, **options: Any) -> Callable[[Path], None]:
    def make(path: Path) -> None:
        extra = {"truth": TRUTH} if name == "ideal" else {}
        f = FILTERS[name](*MODELS, [0.1, 0.2, 0.3], np.eye(3) * 0.1, **extra, **options)
        for i in range(landmarks):
            f.observe(i, (3 + 0.1 * i, 0.3 * i))
        f.step((1.0, 0.1), 0.1, {0: (2.9, 0.0), 1: (3.0, 0.3)})
        f.save(path)

    return make


def use_filter(f: Any) -> None:
    """A series of operations, after each of which P is finite and positive semidefinite."""
    sound(f, 0.0)
    largest = float(np.diag(f.P).max())
    known = f.landmark_ids[:2]
    u = np.ones(max(f.dim_u, 1)) * 0.1
    acts: list[Callable[[], Any]] = [
        lambda: f.step(u, 0.1, Scan(known, np.array([(3.0, 0.1), (3.1, 0.4)][: len(known)]).reshape(-1, 2))),
        lambda: f.observe_scan({("new", n): (3.0 + 0.1 * n, 0.1 * n) for n in range(9)}),
        lambda: f.observe_scan(dict.fromkeys(range(30, 36), (4.0, 0.2))),
        lambda: f.predict(u, 0.1),
        lambda: f.flush(),
        lambda: f.remove(next(iter(f.landmark_ids), "none")),
        lambda: f.observe(next(iter(f.landmark_ids), "new"), (3.0, 0.1)),
        lambda: (f.x, f.K, f.y, f.S, f.F, f.Q, f.likelihood, f.pose, f.pose_covariance, f.landmarks, repr(f)),
        lambda: setattr(f, "P", np.array(f.P) * 2),
        lambda: f.marginal(f.landmark_ids[:3], pose=True),
    ]
    for act in acts:
        with suppress(SlamkitError):
            act()
        largest = sound(f, largest)


def sound(f: Any, largest: float) -> float:
    x, P = np.array(f.x), np.array(f.P)
    assert np.isfinite(x).all() and np.isfinite(P).all(), "not finite"
    assert len(x) == 3 + 2 * len(f.landmark_ids) == len(P)
    largest = max(largest, float(np.diag(P).max()))
    if largest > 0:
        smallest = np.linalg.eigvalsh(P / largest)[0]
        assert smallest >= -ROUNDING, f"smallest eigenvalue {smallest} of the largest variance"
    return largest


def use_log(log: Log) -> None:
    _ = log.schedule, len(log), repr(log), log._repr_html_(), log.head(1)
    if log.controls.shape[1] == 2 and log.observations.shape[1] in (0, 2):
        with suppress(SlamkitError):
            FILTERS["ekf"](*MODELS).run(log)


def use_history(h: History) -> None:
    _ = repr(h), h._repr_html_(), h.dof, h.rejected


WORLD = World(
    name="small",
    landmarks={f"L{i}": (4 * np.cos(i), 4 * np.sin(i)) for i in range(5)},
    motion=MODELS[0],
    sensor=MODELS[1],
    controls=np.tile([0.5, 0.25], (8, 1)),
    dt=1.0,
    pose=np.array([0.0, -2.0, 0.0]),
    pose_covariance=np.diag([0.01, 0.01, 0.02**2]),
)


def make_study(folder: Path) -> None:
    compare(("ekf", "invariant"), WORLD, runs=2, seed=1, jobs=1, gauge_steps=4, folder=folder)


def use_study(study: Study) -> None:
    _ = repr(study), study.table(), study.report()


def make_csv(folder: Path) -> None:
    small_log().write_csv(folder)


MRCLAM = {
    "Barcodes.dat": "# subject barcode\n1 5\n6 72\n7 27\n",
    "Landmark_Groundtruth.dat": "6 5.5 4.9 0.0001 0.0002\n7 -1.25 5.5 0.0001 0.0002\n",
    "Robot1_Odometry.dat": "1248272272.841 0.1 0.0\n1248272272.852 0.1 0.2\n1248272273.841 0.0 -0.3\n",
    "Robot1_Measurement.dat": "1248272272.871 72 2.5 0.1\n1248272273.141 27 3.5 -0.4\n",
    "Robot1_Groundtruth.dat": "1248272272.841 1.0 2.0 0.5\n1248272273.841 1.5 2.5 0.6\n",
}


def make_mrclam(folder: Path) -> None:
    folder.mkdir()
    for name, text in MRCLAM.items():
        (folder / name).write_text(text)


def make_table(path: Path) -> None:
    path.write_text('t,id,x # what\n0.5,"a, b",1e3\n\n1.5,c,-2\n')


def read_plain(path: Path) -> Any:
    content, known = path.read_bytes(), (lambda names: names == ("t", "id", "x"), "t,id,x")
    return read_table(path, content, header=known, text_column="id")


KINDS: dict[str, Kind] = {
    **{
        f"{name} of {n}{' compressed' if options else ''}": Kind(
            make_filter(name, n, **options), FILTERS[name].load, use_filter, "filter"
        )
        for name in FILTERS
        for n, options in ((5, {}), (8, {"storage": Storage(compress_above=3)}))
    },
    "plain models": Kind(
        make_filter("ekf", 4),
        lambda path: FILTERS["ekf"].load(path, PlainMotion(MODELS[0]), PlainSensor(MODELS[1])),
        use_filter,
        "filter",
    ),
    "log": Kind(small_log().save, Log.load, use_log, "Log"),
    "history": Kind(small_history().save, History.load, use_history, "History"),
    "study": Kind(make_study, Study.load, use_study),
    "CSV folder": Kind(make_csv, Log.read_csv, use_log),
    "MRCLAM folder": Kind(make_mrclam, lambda path: mrclam.load(path, 1), lambda given: None),
    "table": Kind(make_table, read_plain, lambda table: table.line(0) if table.texts else None),
    "models.json": Kind(lambda path: write_models(path, WORLD), read_models, repr),
}

# -- damage -----------------------------------------------------------------------------------------------------------


def damage_bytes(rng: Any, content: bytes) -> bytes:
    b = bytearray(content)
    n = len(b)
    at = int(rng.integers(0, max(n, 1)))
    length = int(rng.integers(1, 40))
    match rng.integers(0, 7):
        case 0:
            for _ in range(rng.integers(1, 9)):
                if n:
                    b[rng.integers(0, n)] ^= 1 << rng.integers(0, 8)
        case 1:
            del b[at:]
        case 2:
            del b[at : at + length]
        case 3:
            b[at:at] = rng.bytes(length)
        case 4:
            b[at : at + length] = bytes(len(b[at : at + length]))
        case 5:
            b[at:at] = b[at : at + length]
        case 6:
            b[at : at + length] = rng.choice([b"nan", b"inf", b"1e999", b"-1", b",", b"\n", b'"', b"9" * 400, b"\xff"])
    return bytes(b)


VALUES: tuple[Any, ...] = (
    None, True, False, -1, 0, 1, 2, 3, 5, 64, 1000, 20_000, 2**31, 2**40, 2**63, 10**30, 0.5, -0.5, 1e18, -1e18, 1e308,
    "x", "", [], [1], {}, {"a": 1}, "ekf", "batch", [[[]]], float("nan"), float("inf"),
)  # fmt: skip


def damage_facts(rng: Any, value: Any) -> Any:
    """A value of JSON with one part, somewhere in it, replaced, removed or doubled."""
    if isinstance(value, dict) and value and rng.random() < 0.9:
        name = list(value)[rng.integers(0, len(value))]
        if rng.random() < 0.1:
            return {n: v for n, v in value.items() if n != name} if rng.random() < 0.5 else value | {name + "x": 1}
        return value | {name: damage_facts(rng, value[name])}
    if isinstance(value, list) and value and rng.random() < 0.8:
        at = int(rng.integers(0, len(value)))
        if rng.random() < 0.3:
            return [*value, value[at]] if rng.random() < 0.5 else value[:at] + value[at + 1 :]
        return [*value[:at], damage_facts(rng, value[at]), *value[at + 1 :]]
    return VALUES[rng.integers(0, len(VALUES))]


def damage_array(rng: Any, a: Any) -> Any:
    if a.dtype.kind not in "fiub":
        return np.array(0.0)
    if a.shape == () and rng.random() < 0.8:
        number = VALUES[rng.integers(3, 21)]
        with np.errstate(over="ignore"):
            return np.array(min(number, 2**62)).astype(a.dtype) if a.dtype.kind == "i" else np.array(float(number))
    match rng.integers(0, 12):
        case 0:
            return a[:-1] if a.ndim else a[None]
        case 1:
            return np.concatenate([a, a[-1:]]) if a.ndim else a[None]
        case 2:
            return a[..., :1] if a.ndim else a[None]
        case 3:
            shape = [int(rng.choice([0, 1, n, n + 1, 2 * n, 64, 65, 128])) for n in a.shape]
            return np.full(shape, rng.choice([0.0, 1.0, -1.0, 1e9])).astype(a.dtype)
        case 4:
            return a.astype(rng.choice([np.float32, np.int64, np.int32, np.float64, np.bool_, np.complex128]))
        case 5:
            return a * rng.choice([0, -1, 2, 10**9])
        case 6:
            return a.astype(float) * rng.choice([1e-300, 1e150, 1e300, np.nan, np.inf])
        case 7:
            return a.T
        case 8:
            return np.flip(a)
        case 9:
            return a.astype(">f8") if a.dtype.kind == "f" else a + 1
        case _:
            b = np.array(a)
            if b.size and b.dtype.kind in "fi":
                for _ in range(rng.integers(1, 4)):
                    v = rng.choice([0, -1, 1, 2, 5, 1e3, 1e9, -1e9, 1e18, rng.normal(), np.nan, np.inf])
                    b.flat[rng.integers(0, b.size)] = v if b.dtype.kind == "f" else int(np.nan_to_num(v, posinf=1e18))
            return b


def damage_archive(rng: Any, facts: Any, arrays: dict[str, Any]) -> tuple[Any, dict[str, Any]]:
    arrays = dict(arrays)
    covariances = [n for n, a in arrays.items() if n.endswith(("cov", "store")) and a.size and a.dtype.kind == "f"]
    if covariances and rng.random() < 0.3:  # nothing but a number is wrong
        name = covariances[rng.integers(0, len(covariances))]
        a = arrays[name] = np.array(arrays[name])
        a.flat[rng.integers(0, a.size)] *= rng.choice([-1.0, 0.0, 1e3, 1e6])
        return facts, arrays
    for _ in range(rng.integers(1, 4)):
        names = list(arrays)
        name, other = names[rng.integers(0, len(names))], names[rng.integers(0, len(names))]
        match rng.integers(0, 12):
            case 0 | 1 | 2:
                facts = damage_facts(rng, facts)
            case 3:
                arrays[name], arrays[other] = arrays[other], arrays[name]
            case 4:
                del arrays[name]
            case 5:
                arrays[name + "x"] = arrays[name]
            case 6 | 7:
                facts, arrays = resize(rng, facts, arrays)
            case _:
                arrays[name] = damage_array(rng, arrays[name])
    return facts, arrays


def resize(rng: Any, facts: Any, arrays: dict[str, Any]) -> tuple[Any, dict[str, Any]]:
    """All that has one length gets another one, as consistently as anyone can who does not know what it means."""
    lengths = sorted({n for a in arrays.values() for n in a.shape})
    if not lengths:
        return facts, arrays
    old, new = lengths[rng.integers(0, len(lengths))], int(rng.choice([0, 1, 2, 3, 5, 13, 19, 64, 128, 192]))

    def fit(a: Any) -> Any:
        for axis, n in enumerate(a.shape):
            if n == old:
                a = np.take(a, np.arange(new) % max(n, 1), axis) if n else np.zeros([*a.shape[:axis], new])
        if a.shape == () and a.dtype.kind == "i" and a == old and rng.random() < 0.8:
            return np.array(new)
        return a

    if isinstance(facts, dict) and isinstance(facts.get("ids"), list) and rng.random() < 0.7:
        facts = facts | {"ids": list(range(max(0, (new - 3) // 2)))}
    return facts, {n: fit(a) for n, a in arrays.items()}


# -- the fuzz ---------------------------------------------------------------------------------------------------------


class Fuzz:
    def __init__(self, folder: Path, trace: Trace) -> None:
        self.folder, self.trace = folder, trace
        self.sound, self.loaded, self.slowest = folder / "sound", 0, 0.0
        self.sound.mkdir(exist_ok=True)
        for n, kind in enumerate(KINDS.values()):
            path = self.sound / str(n)
            if path.is_dir():
                shutil.rmtree(path)
            kind.make(path)
            kind.use(kind.read(path))  # whatever is to be compiled or imported is, now
        self.memory = peak()

    def once(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        n = int(rng.integers(0, len(KINDS)))
        name, kind = list(KINDS.items())[n]
        path = self.folder / f"damaged {n}"
        if path.is_dir():
            shutil.rmtree(path)
        source = self.sound / str(n)
        if source.is_dir():
            shutil.copytree(source, path)
            files = sorted(path.iterdir())
            file = files[rng.integers(0, len(files))]
        else:
            shutil.copyfile(source, path)
            files, file = [path], path
        self.trace.operation(f"{name} {file.name} seed {seed}")
        self.damage(rng, kind, files, file)
        began = time.process_time()
        thing: Any = None
        with suppress(LogFileError, InputError):
            thing = kind.read(path)
        seconds = time.process_time() - began
        self.slowest = max(self.slowest, seconds)
        assert seconds < SLOWEST, f"reading took {seconds:.1f} s"
        grown = peak() - self.memory
        assert grown < MOST_MEMORY, f"the peak of memory has grown by {grown / 1e6:.0f} MB"
        if thing is not None:
            self.loaded += 1
            self.trace.write("   read")
            kind.use(thing)

    def damage(self, rng: Any, kind: Kind, files: list[Path], file: Path) -> None:
        content = file.read_bytes()
        if len(files) > 1 and rng.random() < 0.1:
            other = files[rng.integers(0, len(files))]
            file.write_bytes(other.read_bytes())
        elif content[:2] == b"PK" and rng.random() < 0.8:
            what = json.loads(str(np.load(file)["slamkit"]))["slamkit"]
            facts, arrays = damage_archive(rng, *read_archive(file, what))
            try:
                write_archive(file, what, facts if isinstance(facts, dict) else {}, arrays)
            except (TypeError, ValueError):
                file.write_bytes(damage_bytes(rng, content))
        elif content[:1] == b"{" and rng.random() < 0.6:
            file.write_text(json.dumps(damage_facts(rng, json.loads(content))))
        else:
            file.write_bytes(damage_bytes(rng, content))


def peak() -> float:
    """Largest memory of the process so far [bytes]."""
    unit = 1 if sys.platform == "darwin" else 1024
    return float(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss) * unit


def main() -> None:
    """Damage and read as many files as the command line asks for."""
    given = arguments()
    with open(given.folder / "trace", "w") as file, np.errstate(all="ignore"):
        fuzz = Fuzz(given.folder, Trace(file))
        for n in range(given.count):
            if n % 1000 == 0:
                fuzz.trace.begin(f"files from {n} on")
            fuzz.once(given.seed * 10**6 + n)
    print(f"{given.count} files, {fuzz.loaded} of them read, the slowest in {fuzz.slowest:.2f} s")


if __name__ == "__main__":
    main()

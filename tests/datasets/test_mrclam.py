"""Laws of the MRCLAM reader, on small sets that the test writes and on the real ones where they are present."""

from __future__ import annotations

import os
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cache
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slamkit import EKFSLAM
from slamkit.datasets import mrclam
from slamkit.errors import InputError, LogFileError
from slamkit.evaluate import dead_reckoning, evaluate
from slamkit.logs import Log

START = 1248272272.841  # a Unix time: its milliseconds are near the last digits of a double

BARCODES = {1: 5, 2: 14, 3: 41, 4: 32, 5: 23, 6: 72, 7: 27, 11: 18, 17: 61}
LANDMARKS = {6: (5.5, 4.9), 7: (-1.25, 5.5), 11: (0.5, 2.5), 17: (1.0, -2.0)}
PUBLISHED_SET_1 = {**LANDMARKS, 11: (3.15071999, 2.38294871), 17: (0.03596156, -2.84396626)}


@dataclass(frozen=True)
class SmallSet:
    """The rows of a set with two robots, robot 2 with a sparse truth; stamps count from START."""

    odometry: list[tuple[float, float, float]] = field(
        default_factory=lambda: [(0.0, 0.1, 0.0), (0.011, 0.1, 0.2), (0.062, 0.0, -0.3), (1.25, 0.05, 0.0), (1.3, 0, 0)]
    )
    measurement: list[tuple[float, float, float, float]] = field(
        default_factory=lambda: [(0.03, 72, 2.5, 0.1), (0.03, 27, 3.5, -0.4), (0.5, 14, 1.0, 0), (1.4, 18, 2, -0.5)]
    )
    truth: list[tuple[float, float, float, float]] = field(
        default_factory=lambda: [(-5, 0, 0, 0), (0.02, 1, 2, 3.5), (1.3, 1.5, 2.5, -0.25), (99, 0, 0, 0)]
    )
    barcodes: dict[int, int] = field(default_factory=lambda: dict(BARCODES))
    landmarks: dict[int, tuple[float, float]] = field(default_factory=lambda: dict(LANDMARKS))
    start: float = START

    def rows(self) -> dict[str, list[list[str]]]:
        """File → rows of fields."""

        def stamped(rows: list[tuple[float, ...]]) -> list[list[str]]:
            return [[f"{self.start + t:.3f}", *(f"{value:.8g}" for value in row)] for t, *row in rows]

        files = {
            "Barcodes.dat": [[str(subject), str(barcode)] for subject, barcode in self.barcodes.items()],
            "Landmark_Groundtruth.dat": [
                [str(subject), f"{x:.8f}", f"{y:.8f}", "0.0001", "0.0002"] for subject, (x, y) in self.landmarks.items()
            ],
        }
        for robot, kind in ((1, ""), (2, "_sparse")):
            files[f"Robot{robot}_Odometry.dat"] = stamped(list(self.odometry))
            files[f"Robot{robot}_Measurement.dat"] = stamped(list(self.measurement))
            files[f"Robot{robot}_Groundtruth{kind}.dat"] = stamped(list(self.truth))
        return files

    def texts(self) -> dict[str, bytes]:
        return {name: render(rows) for name, rows in self.rows().items()}


def render(rows: list[list[str]], gap: str = " \t ", tail: str = " ", newline: str = "\n", comments: int = 2) -> bytes:
    lines = ["# UTIAS data # with a comment in it"] * comments + [f" {gap.join(row)}{tail}" for row in rows]
    return newline.join([*lines, ""]).encode()


def write_folder(files: dict[str, bytes], folder: Path) -> Path:
    folder.mkdir(parents=True)
    for name, text in files.items():
        (folder / name).write_bytes(text)
    return folder


def write_zip(files: dict[str, bytes], path: Path, inner: str = "MRSLAM_Dataset4/") -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, text in files.items():
            archive.writestr(inner + name, text)
    return path


def assert_same(a: Log, b: Log) -> None:
    for name in ("control_times", "controls", "observation_times", "observation_ids", "observations"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)
    assert (a.landmark_ids, a.end_time) == (b.landmark_ids, b.end_time)
    assert a.truth is not None and b.truth is not None
    np.testing.assert_array_equal(a.truth.times, b.truth.times)
    np.testing.assert_array_equal(a.truth.poses, b.truth.poses)
    assert a.truth.landmarks.keys() == b.truth.landmarks.keys()
    for i, position in a.truth.landmarks.items():
        np.testing.assert_array_equal(position, b.truth.landmarks[i])


@pytest.fixture
def place() -> Iterator[Path]:
    with TemporaryDirectory() as folder:
        yield Path(folder)


# ---- what is read ----


def test_every_number_arrives(place: Path) -> None:
    got = mrclam.read(write_folder(SmallSet().texts(), place / "MRCLAM_Dataset7"), 1, delay=0.0, range_scale=1.0)
    log = got.log
    np.testing.assert_array_equal(log.control_times, [0.0, 0.011, 0.062, 1.25, 1.3])
    np.testing.assert_array_equal(log.controls, [row[1:] for row in SmallSet().odometry])
    np.testing.assert_array_equal(log.observation_times, [0.03, 0.03, 1.4])
    assert [log.landmark_ids[i] for i in log.observation_ids] == [6, 7, 11]
    assert all(type(i) is int for i in log.landmark_ids)
    np.testing.assert_array_equal(log.observations, [[2.5, 0.1], [3.5, -0.4], [2, -0.5]])
    assert log.end_time == 1.4
    assert log.truth is not None
    np.testing.assert_array_equal(log.truth.times, [0.02, 1.3])
    np.testing.assert_allclose(log.truth.poses, [[1, 2, 3.5 - 2 * np.pi], [1.5, 2.5, -0.25]], rtol=0, atol=1e-15)
    assert {i: tuple(p) for i, p in log.truth.landmarks.items()} == LANDMARKS
    assert (got.robot, got.set_number, got.time_offset, got.truth_kind) == (1, 7, START, "full")
    assert (got.robot_sightings, got.unknown_barcodes, got.repeated_stamps, got.backward_stamps) == (1, 0, 0, 0)
    np.testing.assert_array_equal(got.gaps, [[0.062, 1.25]])
    assert_same(mrclam.load(place / "MRCLAM_Dataset7", 1, delay=0.0, range_scale=1.0), log)


def test_sparse_truth_is_read_and_named(place: Path) -> None:
    folder = write_folder(SmallSet().texts(), place / "a")
    full, sparse = mrclam.read(folder, 1), mrclam.read(folder, 2)
    assert (full.truth_kind, sparse.truth_kind) == ("full", "sparse")
    assert_same(full.log, sparse.log)


def test_full_truth_goes_before_sparse(place: Path) -> None:
    files = SmallSet().texts()
    files["Robot2_Groundtruth.dat"] = render([[f"{START + 1:.3f}", "7", "8", "0.5"]])
    got = mrclam.read(write_folder(files, place / "a"), 2)
    assert got.truth_kind == "full" and got.log.truth is not None
    np.testing.assert_array_equal(got.log.truth.poses, [[7, 8, 0.5]])


def test_truth_may_be_absent(place: Path) -> None:
    files = SmallSet().texts()
    del files["Robot1_Groundtruth.dat"]
    got = mrclam.read(write_folder(files, place / "a"), 1)
    assert got.truth_kind == "none" and got.log.truth is not None
    assert len(got.log.truth.times) == 0 and got.log.truth.landmarks.keys() == LANDMARKS.keys()
    del files["Landmark_Groundtruth.dat"]
    assert mrclam.load(write_folder(files, place / "b"), 1).truth is None


@settings(max_examples=60, deadline=None)
@given(
    gap=st.sampled_from([" ", "\t", "  \t ", "\t\t"]),
    tail=st.sampled_from(["", " ", "\t", " # note"]),
    newline=st.sampled_from(["\n", "\r\n", "\r"]),
    comments=st.integers(0, 4),
    head=st.sampled_from([b"", b"\xef\xbb\xbf"]),
    foot=st.sampled_from([b"", b"# end", b"\n \n", b"\r\n"]),
    inner=st.sampled_from([None, "", "MRSLAM_Dataset4/", "a/b/", "b c/MRCLAM 9/"]),
    robot=st.sampled_from([1, 2]),
)
def test_form_does_not_matter(
    gap: str, tail: str, newline: str, comments: int, head: bytes, foot: bytes, inner: str | None, robot: int
) -> None:
    with TemporaryDirectory() as scratch:
        plain = mrclam.load(write_folder(SmallSet().texts(), Path(scratch, "plain")), robot)
        files = {
            name: head + render(rows, gap, tail, newline, comments) + foot for name, rows in SmallSet().rows().items()
        }
        if inner is None:
            other = write_folder(files, Path(scratch, "outer", "inner")).parent
        else:
            files["__MACOSX/._Barcodes.dat"] = b"\x00\x05"
            other = write_zip(files, Path(scratch, "set.zip"), inner)
        assert_same(mrclam.load(other, robot), plain)


@pytest.mark.parametrize(
    ("outer", "inner", "number"),
    [
        ("x.zip", "MRSLAM_Dataset4/", 4),
        ("MRCLAM8.zip", "", 8),
        ("mrclam8.zip", "files/", 8),
        ("MRCLAM2024.zip", "", None),
    ],
)
def test_set_number_is_in_a_name(place: Path, outer: str, inner: str, number: int | None) -> None:
    assert mrclam.read(write_zip(SmallSet().texts(), place / outer, inner), 1).set_number == number


# ---- times ----


@settings(max_examples=50, deadline=None)
@given(shift=st.integers(0, 2_000_000_000), delay=st.floats(0, 10), scale=st.floats(0.1, 2))
def test_clock_delay_and_scale(shift: int, delay: float, scale: float) -> None:
    with TemporaryDirectory() as scratch:
        base = mrclam.read(write_folder(SmallSet(start=0.841).texts(), Path(scratch, "a")), 1, delay=0.0)
        other = write_folder(SmallSet(start=shift + 0.841).texts(), Path(scratch, "b"))
        moved = mrclam.read(other, 1, delay=0.0)
        assert_same(moved.log, base.log)
        assert moved.time_offset == pytest.approx(base.time_offset + shift, abs=1e-6)
        late = mrclam.read(other, 1, delay=delay, speed_scale=scale, range_scale=2 * mrclam.RANGE_SCALE)
        np.testing.assert_array_equal(late.log.observations, base.log.observations * (2, 1))
        np.testing.assert_allclose(late.log.control_times, base.log.control_times + delay, rtol=0, atol=1e-12)
        np.testing.assert_allclose(late.gaps, base.gaps + delay, rtol=0, atol=1e-12)
        np.testing.assert_array_equal(late.log.observation_times, base.log.observation_times)
        np.testing.assert_array_equal(late.log.controls, base.log.controls * (scale, 1))
        assert late.log.end_time == max(late.log.control_times[-1], base.log.observation_times[-1])


def test_default_delay_is_the_stated_one(place: Path) -> None:
    folder = write_folder(SmallSet().texts(), place / "a")
    assert_same(mrclam.load(folder, 1), mrclam.load(folder, 1, delay=mrclam.COMMAND_DELAY))
    assert mrclam.load(folder, 1).control_times[0] == mrclam.COMMAND_DELAY
    assert_same(mrclam.load(folder, 1, delay=np.float32(0.5)), mrclam.load(folder, 1, delay=0.5))


@settings(max_examples=60, deadline=None)
@given(
    milliseconds=st.lists(st.integers(0, 3000), min_size=1, max_size=30),
    sightings=st.lists(st.tuples(st.integers(-500, 3000), st.sampled_from([72, 27, 5, 14, 99])), max_size=20),
)
def test_events_are_sorted_and_counted(milliseconds: list[int], sightings: list[tuple[int, int]]) -> None:
    speeds = [row * 0.37 % 1 for row in range(len(milliseconds))]  # neither rising nor falling
    odometry = [(ms / 1000, speeds[row], 0.0) for row, ms in enumerate(milliseconds)]
    measurement = [(ms / 1000, barcode, 1 + row, 0.0) for row, (ms, barcode) in enumerate(sightings)]
    with TemporaryDirectory() as scratch:
        files = SmallSet(odometry=odometry, measurement=measurement).texts()
        got = mrclam.read(write_folder(files, Path(scratch, "a")), 1, delay=0.0, range_scale=1.0)
    kept = [(ms, barcode, 1 + row) for row, (ms, barcode) in enumerate(sightings) if barcode in (72, 27)]
    first = min([*milliseconds, *(ms for ms, *_ in kept)])
    commands = sorted({ms: row for row, ms in enumerate(milliseconds)}.items())
    np.testing.assert_array_equal(got.log.control_times, [(ms - first) / 1000 for ms, _ in commands])
    np.testing.assert_allclose(got.log.controls[:, 0], [speeds[row] for _, row in commands])
    seen = {
        (time, got.log.landmark_ids[i], z[0])
        for time, i, z in zip(got.log.observation_times, got.log.observation_ids, got.log.observations, strict=True)
    }
    assert seen == {((ms - first) / 1000, {72: 6, 27: 7}[barcode], z) for ms, barcode, z in kept}
    assert len(got.log.observations) == len(kept)
    assert got.repeated_stamps == len(milliseconds) - len(set(milliseconds))
    assert got.backward_stamps == sum(b < a for a, b in pairwise(milliseconds))
    assert got.robot_sightings == sum(barcode in (5, 14) for _, barcode in sightings)
    assert got.unknown_barcodes == sum(barcode == 99 for _, barcode in sightings)
    ordered = sorted(set(milliseconds))
    wide = [(a - first, b - first) for a, b in pairwise(ordered) if b - a > 500]
    np.testing.assert_array_equal(got.gaps, np.reshape(wide, (-1, 2)) / 1000)


# ---- the exchanged landmarks of set 1 ----


@pytest.mark.parametrize("name", ["MRCLAM_Dataset1", "renamed", "MRCLAM_Dataset5"])
def test_set_1_is_corrected_whatever_its_name(place: Path, name: str) -> None:
    files = SmallSet(landmarks=PUBLISHED_SET_1).texts()
    for path in (write_folder(files, place / name), write_zip(files, place / f"{name}.zip", f"{name}/")):
        got, raw = mrclam.read(path, 1), mrclam.read(path, 1, correct_landmarks=False)
        assert (got.set_number, got.landmarks_corrected, raw.landmarks_corrected) == (1, True, False)
        assert got.log.truth is not None and raw.log.truth is not None
        assert {i: tuple(p) for i, p in raw.log.truth.landmarks.items()} == PUBLISHED_SET_1
        expected = {**PUBLISHED_SET_1, 11: PUBLISHED_SET_1[17], 17: PUBLISHED_SET_1[11]}
        assert {i: tuple(p) for i, p in got.log.truth.landmarks.items()} == expected
        assert got.log.landmark_ids == raw.log.landmark_ids


@pytest.mark.parametrize(
    "other",
    [
        SmallSet(),
        SmallSet(landmarks={**PUBLISHED_SET_1, 11: PUBLISHED_SET_1[17], 17: PUBLISHED_SET_1[11]}),
        SmallSet(landmarks=PUBLISHED_SET_1, barcodes={**BARCODES, 11: 61, 17: 18}),
        SmallSet(landmarks={i: p for i, p in PUBLISHED_SET_1.items() if i != 17}),
        SmallSet(landmarks={**PUBLISHED_SET_1, 17: (0.1, -2.84396626)}),
    ],
    ids=["another set", "corrected positions", "corrected barcodes", "only one of the two", "one elsewhere"],
)
def test_nothing_else_is_corrected(place: Path, other: SmallSet) -> None:
    got = mrclam.read(write_folder(other.texts(), place / "MRCLAM_Dataset1"), 1)
    assert not got.landmarks_corrected and got.log.truth is not None
    assert {i: tuple(p) for i, p in got.log.truth.landmarks.items()} == other.landmarks


# ---- what is refused ----


def corrupt(name: str, old: bytes, new: bytes) -> Callable[[dict[str, bytes]], None]:
    def change(files: dict[str, bytes]) -> None:
        assert files[name].count(old) == 1
        files[name] = files[name].replace(old, new)

    return change


@pytest.mark.parametrize(
    ("name", "old", "new", "line", "expected"),
    [
        ("Robot1_Odometry.dat", b"0.1 \t 0.2", b"0.1", 4, "expected 3: time"),
        ("Robot1_Odometry.dat", b"0.1 \t 0.2", b"0.1 0.2 0.3", 4, "expected 3: time"),
        (
            "Robot1_Odometry.dat",
            b"0.1 \t 0.2",
            b"0.1 nan",
            4,
            "nan is not finite, expected angular velocity [rad/s] in column 3",
        ),
        (
            "Robot1_Odometry.dat",
            b"0.1 \t 0.2",
            b"0.1 inf",
            4,
            "inf is not finite, expected angular velocity [rad/s] in column 3",
        ),
        (
            "Robot1_Odometry.dat",
            b"0.1 \t 0.2",
            b"0.1 fast",
            4,
            "'fast' is not a number, expected angular velocity [rad/s] in column 3",
        ),
        ("Robot1_Odometry.dat", b"0.1 \t 0.2", b"0.1 \xff\x00", 4, "byte 0xff, expected UTF-8 text"),
        ("Robot1_Odometry.dat", b"1248272272.852", b"-1248272272.852", 4, "within a day of the file's median 12482722"),
        ("Robot1_Odometry.dat", b"1248272272.852", b"9248272272.852", 4, "within a day of the file's median 12482722"),
        ("Robot1_Odometry.dat", b"1248272272.852", b"1248272272852", 4, "seconds on a clock"),
        ("Robot1_Measurement.dat", b"27 \t 3.5", b"27 \t -3.5", 4, "range > 0"),
        ("Robot1_Measurement.dat", b"27 \t 3.5", b"27 \t 0", 4, "range > 0"),
        ("Robot1_Measurement.dat", b"27 \t 3.5", b"27.5 \t 3.5", 4, "an integer as barcode"),
        ("Robot1_Measurement.dat", b"27 \t 3.5", b"27 3.5 3.5", 4, "expected 4: time"),
        ("Robot1_Groundtruth.dat", b"1 \t 2 \t 3.5", b"1 \t 2", 4, "expected 4: time"),
        ("Robot1_Groundtruth.dat", b"1248272272.861", b"1e300", 4, "seconds on a clock"),
        ("Landmark_Groundtruth.dat", b"7 \t -1.25", b"7.5 \t -1.25", 4, "subject an integer from 6"),
        ("Landmark_Groundtruth.dat", b"7 \t -1.25", b"5 \t -1.25", 4, "subject an integer from 6"),
        ("Landmark_Groundtruth.dat", b"7 \t -1.25", b"6 \t -1.25", 4, "each subject once"),
        ("Landmark_Groundtruth.dat", b"7 \t -1.25", b"-1.25", 4, "expected 5: subject"),
        ("Barcodes.dat", b"2 \t 14", b"2 \t 14.5", 4, "two integers"),
        ("Barcodes.dat", b"2 \t 14", b"0 \t 14", 4, "two integers"),
        ("Barcodes.dat", b"2 \t 14", b"2 \t 5", 4, "each barcode once"),
        ("Barcodes.dat", b"2 \t 14", b"1 \t 14", 4, "each subject and each barcode once"),
        ("Barcodes.dat", b"2 \t 14", b"2", 4, "expected 2: subject"),
    ],
)
def test_broken_row_is_named(place: Path, name: str, old: bytes, new: bytes, line: int, expected: str) -> None:
    files = SmallSet().texts()
    corrupt(name, old, new)(files)
    for path in (write_folder(files, place / "a"), write_zip(files, place / "a.zip")):
        with pytest.raises(LogFileError) as caught:
            mrclam.load(path, 1)
        message = str(caught.value)
        assert f"{name}:{line}: " in message and expected in message and str(path) in message


def test_row_that_only_python_can_read_is_refused(place: Path) -> None:
    files = SmallSet().texts()
    corrupt("Robot1_Odometry.dat", b"0.1 \t 0.2", b"0.1 \t 0_2")(files)
    with pytest.raises(LogFileError, match=r"Robot1_Odometry\.dat:4: '0_2' is not a number, expected angular velocity"):
        mrclam.load(write_folder(files, place / "a"), 1)


def test_every_row_with_a_column_too_many(place: Path) -> None:
    files = SmallSet().texts()
    files["Robot1_Odometry.dat"] = render([["1", "2", "3", "4"], ["2", "2", "3", "4"]])
    with pytest.raises(LogFileError, match=r"Robot1_Odometry\.dat:3: .*expected 3: time"):
        mrclam.load(write_folder(files, place / "a"), 1)


@pytest.mark.parametrize("name", ["Robot1_Odometry.dat", "Barcodes.dat"])
@pytest.mark.parametrize("text", [b"", b"# only\r\n# comments\r\n \r\n"])
def test_file_without_rows(place: Path, name: str, text: bytes) -> None:
    with pytest.raises(LogFileError, match=f"{name} holds no row, expected"):
        mrclam.load(write_folder({**SmallSet().texts(), name: text}, place / "a"), 1)


def test_robot_that_saw_nothing_has_a_log(place: Path) -> None:
    files = {**SmallSet().texts(), "Robot1_Measurement.dat": b"# nothing\n"}
    log = mrclam.load(write_folder(files, place / "a"), 1)
    assert len(log.controls) == 5 and log.observations.shape == (0, 2) and log.landmark_ids == ()


@pytest.mark.parametrize("missing", ["Robot1_Odometry.dat", "Robot1_Measurement.dat"])
def test_missing_file_is_named(place: Path, missing: str) -> None:
    files = SmallSet().texts()
    del files[missing]
    for path in (write_folder(files, place / "a"), write_zip(files, place / "a.zip")):
        assert mrclam.robots(path) == (2,)
        with pytest.raises(LogFileError, match=f"{missing} is missing: robot 1 cannot be read; robots that can: 2"):
            mrclam.load(path, 1)


@pytest.mark.parametrize("robot", [0, 6, -1, 1.0, "1", None, True])
def test_no_such_robot(place: Path, robot: object) -> None:
    with pytest.raises(InputError, match="expected an integer from 1 to 5"):
        mrclam.load(write_folder(SmallSet().texts(), place / "a"), robot)  # type: ignore[arg-type]


@pytest.mark.parametrize("name", ["delay", "speed_scale", "range_scale"])
@pytest.mark.parametrize("value", [-0.1, float("nan"), float("inf"), 1e4, "fast", None])
def test_options_out_of_range(place: Path, name: str, value: object) -> None:
    with pytest.raises(InputError, match=f"{name} is .*expected"):
        mrclam.load(write_folder(SmallSet().texts(), place / "a"), 1, **{name: value})  # type: ignore[arg-type]


def test_no_set_there(place: Path) -> None:
    files = SmallSet().texts()
    with pytest.raises(LogFileError, match="nowhere does not exist"):
        mrclam.load(place / "nowhere", 1)
    (place / "empty").mkdir()
    with pytest.raises(LogFileError, match=r"empty holds no Barcodes\.dat"):
        mrclam.load(place / "empty", 1)
    write_zip(files, place / "empty" / "MRCLAM1.zip")
    with pytest.raises(LogFileError, match=r"give one of its zips: MRCLAM1\.zip"):
        mrclam.load(place / "empty", 1)
    both = {f"{inner}/{name}": text for inner in ("first", "second") for name, text in files.items()}
    with pytest.raises(LogFileError, match="holds 2 sets, give one of them: first, second"):
        mrclam.load(write_zip(both, place / "two.zip", ""), 1)


@settings(max_examples=60, deadline=None)
@given(share=st.floats(0, 1, exclude_max=True))
def test_truncated_zip(share: float) -> None:
    with TemporaryDirectory() as scratch:
        path = write_zip(SmallSet().texts(), Path(scratch, "MRCLAM1.zip"))
        mrclam.check_zip(path)
        whole = path.read_bytes()
        path.write_bytes(whole[: int(share * len(whole))])
        for reader in (lambda: mrclam.load(path, 1), lambda: mrclam.robots(path), lambda: mrclam.check_zip(path)):
            with pytest.raises(LogFileError, match=r"MRCLAM1\.zip is not a whole zip"):
                reader()


@settings(max_examples=150, deadline=None)
@given(data=st.data())
def test_a_flipped_byte_of_a_zip_changes_nothing_or_is_refused(data: st.DataObject) -> None:
    with TemporaryDirectory() as scratch:
        path = write_zip(SmallSet().texts(), Path(scratch, "MRCLAM1.zip"))
        before = mrclam.load(path, 1)
        bytes_ = bytearray(path.read_bytes())
        bytes_[data.draw(st.integers(0, len(bytes_) - 1))] ^= data.draw(st.integers(1, 255))
        path.write_bytes(bytes_)
        message, after = "", before
        try:
            after = mrclam.load(path, 1)
        except LogFileError as error:
            message = str(error)
        assert not message or str(path) in message
        # No checksum covers the names in a zip: a file may vanish under another one, but never change.
        if after.truth is not None and len(after.truth.times) and after.truth.landmarks:
            assert_same(after, before)


@settings(max_examples=200, deadline=None)
@given(
    name=st.sampled_from(sorted(SmallSet().texts())),
    at=st.floats(0, 1, exclude_max=True),
    cut=st.integers(0, 5),
    new=st.binary(max_size=4),
)
def test_garbled_text_is_read_or_refused_with_its_name(name: str, at: float, cut: int, new: bytes) -> None:
    files = SmallSet().texts()
    i = int(at * len(files[name]))
    files[name] = files[name][:i] + new + files[name][i + cut :]
    with TemporaryDirectory() as scratch:
        folder = write_folder(files, Path(scratch, "a"))
        message = name
        try:
            mrclam.load(folder, 2 if "Robot2" in name else 1)
        except LogFileError as error:
            message = str(error)
        assert name in message


def test_checked_zip_must_hold_a_set(place: Path) -> None:
    files = SmallSet().texts()
    with pytest.raises(LogFileError, match="is a folder, expected a zip"):
        mrclam.check_zip(write_folder(files, place / "a"))
    few = {name: text for name, text in files.items() if "Landmark" not in name}
    with pytest.raises(LogFileError, match=r"Landmark_Groundtruth\.dat is missing"):
        mrclam.check_zip(write_zip(few, place / "b.zip"))
    few = {name: text for name, text in files.items() if "Odometry" not in name}
    with pytest.raises(LogFileError, match="holds no robot with both"):
        mrclam.check_zip(write_zip(few, place / "c.zip"))


def test_checked_zip_must_fit_its_checksums(place: Path) -> None:
    path = place / "stored.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED) as archive:
        for name, text in SmallSet().texts().items():
            archive.writestr(name, text)
    mrclam.check_zip(path)
    path.write_bytes(path.read_bytes().replace(b"5.50000000", b"5.60000000", 1))
    with pytest.raises(LogFileError, match=r"the checksum of Landmark_Groundtruth\.dat does not fit"):
        mrclam.check_zip(path)
    with pytest.raises(LogFileError, match=r"Landmark_Groundtruth\.dat is not a whole zip: Bad CRC"):
        mrclam.load(path, 1)


# ---- the real sets ----

DATA = Path(os.environ.get("SLAMKIT_DATA", Path(__file__).parents[3] / "shared" / "data")) / "mrclam"
REAL = [
    pytest.param(
        DATA / f"MRCLAM_Dataset{number}.zip",
        number,
        id=f"set{number}",
        marks=pytest.mark.skipif(
            not (DATA / f"MRCLAM_Dataset{number}.zip").is_file(),
            reason=f"MRCLAM set {number} is not there: SLAMKIT_DATA names the folder that holds mrclam/",
        ),
    )
    for number in (1, 2, 3, 6)
]


def raw_rows(archive: zipfile.ZipFile, ending: str, columns: int) -> np.ndarray:
    (name,) = [name for name in archive.namelist() if name.endswith(ending)]
    lines = [line for line in archive.read(name).decode().splitlines() if not line.startswith("#")]
    return np.fromstring(" ".join(lines), sep=" ").reshape(-1, columns)


# The slowest part of these tests is reading: each log once.
read = cache(mrclam.read)


@pytest.mark.parametrize(("path", "number"), REAL)
def test_real_counts(path: Path, number: int) -> None:
    mrclam.check_zip(path)
    robots = mrclam.robots(path)
    assert robots == ((1, 2, 3, 5) if number == 3 else (1, 2, 3, 4, 5))
    with zipfile.ZipFile(path) as archive:
        subject_of = {barcode: subject for subject, barcode in raw_rows(archive, "/Barcodes.dat", 2).tolist()}
        for robot in robots:
            got = read(path, robot)
            commands = raw_rows(archive, f"Robot{robot}_Odometry.dat", 3)
            stamps, from_the_end = np.unique(commands[::-1, 0], return_index=True)
            barcodes = raw_rows(archive, f"Robot{robot}_Measurement.dat", 4)[:, 1]
            subjects = [subject_of.get(barcode, 0) for barcode in barcodes.tolist()]
            assert got.set_number == number and got.landmarks_corrected == (number == 1)
            np.testing.assert_array_equal(got.log.controls, commands[::-1][from_the_end, 1:])
            assert len(got.log.observations) == sum(subject >= 6 for subject in subjects)
            assert got.robot_sightings == sum(1 <= subject <= 5 for subject in subjects)
            assert got.unknown_barcodes == subjects.count(0)
            assert got.repeated_stamps == len(commands) - len(stamps)
            assert got.backward_stamps == np.sum(commands[1:, 0] < commands[:-1, 0])
            assert len(got.gaps) == np.sum(np.diff(stamps) > mrclam.LONGEST_INTERVAL)
            assert set(got.log.landmark_ids) == {int(subject) for subject in subjects if subject >= 6}
            assert got.truth_kind == ("full" if number in (1, 6) else "sparse")
            assert abs(got.time_offset - stamps[0]) < 1e-6 and got.log.observation_times[0] >= 0


def residuals(log: Log, landmark: int) -> np.ndarray:
    """Range and bearing (n, 2) minus what the truth gives, where a true pose is within 0.05 s of the sighting."""
    assert log.truth is not None
    times = log.truth.times
    rows = log.observation_ids == log.landmark_ids.index(landmark)
    at = log.observation_times[rows]
    after = np.clip(np.searchsorted(times, at), 1, len(times) - 1)
    near = after - (at - times[after - 1] < times[after] - at)
    close = np.abs(times[near] - at) < 0.05
    poses, z = log.truth.poses[near[close]], log.observations[rows][close]
    offset = log.truth.landmarks[landmark] - poses[:, :2]
    bearing = np.arctan2(offset[:, 1], offset[:, 0]) - poses[:, 2]
    return z - np.column_stack([np.hypot(*offset.T), z[:, 1] - (z[:, 1] - bearing + np.pi) % (2 * np.pi) + np.pi])


@pytest.mark.parametrize(("path", "number"), REAL)
def test_real_sightings_fit_the_truth(path: Path, number: int) -> None:
    """Clock, barcodes, landmarks and truth belong together: every landmark's sightings agree with its position."""
    checked = 0
    for robot in mrclam.robots(path):
        log = read(path, robot).log
        for landmark in log.landmark_ids:
            difference = residuals(log, landmark)
            if len(difference) >= 5:
                checked += 1
                assert np.all(np.median(np.abs(difference), axis=0) < (0.4, 0.06)), (robot, landmark)
    assert checked > 40


@pytest.mark.parametrize(("path", "number"), REAL[:1])
def test_real_set_1_is_wrong_as_published(path: Path, number: int) -> None:
    for robot in mrclam.robots(path):
        log = mrclam.load(path, robot, correct_landmarks=False)
        for landmark in (11, 17):
            assert np.all(np.median(np.abs(residuals(log, landmark)), axis=0) > (1.0, 1.0))


@pytest.mark.parametrize(("path", "number"), REAL[:1])
def test_real_motion_lags_the_commands(path: Path, number: int) -> None:
    """The true turn over half a second fits the delayed commands much better than the commands as stamped."""
    for robot in mrclam.robots(path):
        spread = []
        for log in (mrclam.load(path, robot, delay=0.0), read(path, robot).log):
            assert log.truth is not None and log.end_time is not None
            turned = np.cumsum(np.diff(log.control_times, append=log.end_time) * log.controls[:, 1])
            true = np.unwrap(log.truth.poses[:, 2])
            ends = np.arange(20, log.truth.times[-1] - 20, 0.5)

            def turn(times: np.ndarray, angles: np.ndarray, ends: np.ndarray = ends) -> np.ndarray:
                return np.diff(np.interp(ends, times, angles))

            commanded = turn(np.append(log.control_times[1:], log.end_time), turned)
            wrong = turn(log.truth.times, true) - commanded
            spread.append(np.std(wrong[np.abs(wrong) < 0.5]))
        assert spread[1] < 0.75 * spread[0], (robot, spread)


@pytest.mark.parametrize(("path", "number"), REAL[:1])
def test_real_set_1_becomes_a_map(path: Path, number: int) -> None:
    """One set of parameters for all five robots: trajectory within 0.30 m, landmarks within 0.12 m."""
    motion, sensor = mrclam.models()
    ates, dead = [], []
    for robot in mrclam.robots(path):
        log = read(path, robot).log
        f = EKFSLAM(motion, sensor, gate=mrclam.GATE)
        history = f.run(log)
        got = evaluate(history.times, history.poses, log.truth, f.landmarks)
        drift = evaluate(*dead_reckoning(log, motion), log.truth)
        assert got.ate_m is not None and got.landmark_rmse_m is not None and drift.ate_m is not None
        assert got.ate_m <= 0.30, robot
        assert got.landmark_rmse_m <= 0.12, robot
        assert history.rejected < 0.01 * len(history.nis)
        ates.append(got.ate_m)
        dead.append(drift.ate_m)
    assert np.mean(dead) >= 4 * np.mean(ates)

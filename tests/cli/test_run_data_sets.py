"""Laws of `slamkit run mrclam` and `slamkit fetch`."""

from __future__ import annotations

import zipfile
from collections.abc import Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from typing import Any

import numpy as np
import pytest
from commands import KEYS, contents, fails, is_png, strict_json, succeeds

from slamkit import EKFSLAM
from slamkit.datasets import mrclam
from slamkit.evaluate import run_report

# ---- mrclam ----


@pytest.fixture(scope="module")
def small_set(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """MRCLAM7.zip, named as it is published: a robot on an arc among three landmarks, by the arc's equations."""
    rng = np.random.default_rng(7)
    start, v, omega, seconds = 1248272272.0, 0.2, 0.2, 30.0
    landmarks = {6: (2.0, 0.5), 7: (0.0, 2.0), 8: (-1.5, 0.0)}
    barcodes = {1: 5, 6: 72, 7: 27, 8: 54}

    def pose(t: float) -> tuple[float, float, float]:
        driven = max(t - mrclam.COMMAND_DELAY, 0.0)
        theta = omega * driven
        return v / omega * np.sin(theta), v / omega * (1 - np.cos(theta)), theta

    odometry = [f"{start + t:.3f} {v} {omega}" for t in np.arange(0, seconds, 0.05)]
    truth = [f"{start + t:.3f} " + " ".join(f"{x:.9f}" for x in pose(t)) for t in np.arange(0, seconds, 0.05)]
    measurement = []
    for t in np.arange(0.5, seconds, 0.5):
        x, y, theta = pose(t)
        for subject, (a, b) in landmarks.items():
            r, bearing = np.hypot(a - x, b - y), np.arctan2(b - y, a - x) - theta
            # Two outliers: one that the gate lets pass, one that it must refuse.
            r += {(10.0, 6): 0.8, (20.0, 7): 8.0}.get((t, subject), rng.normal(0, 0.02))
            noisy = f"{r:.6f} {np.angle(np.exp(1j * bearing)) + rng.normal(0, 0.01):.6f}"
            measurement.append(f"{start + t:.3f} {barcodes[subject]} {noisy}")
    measurement.append(f"{start + 1:.3f} 5 1.0 0.0")
    measurement.append(f"{start + 1:.3f} 99 1.0 0.0")
    files = {
        "Barcodes.dat": [f"{subject} {code}" for subject, code in barcodes.items()],
        "Landmark_Groundtruth.dat": [f"{subject} {x} {y} 0.001 0.001" for subject, (x, y) in landmarks.items()],
        "Robot1_Odometry.dat": odometry,
        "Robot1_Measurement.dat": measurement,
        "Robot1_Groundtruth.dat": truth,
    }
    path = tmp_path_factory.mktemp("mrclam") / "MRCLAM7.zip"
    with zipfile.ZipFile(path, "w") as archive:
        for name, rows in files.items():
            archive.writestr(f"MRCLAM_Dataset7/{name}", "\n".join(["# a comment", *rows, ""]))
    return path


def test_run_mrclam(small_set: Path, tmp_path: Path) -> None:
    text = succeeds(
        "run", "mrclam", small_set, "--robot", 1, "--json", tmp_path / "run.json", "--out", tmp_path / "out"
    )
    assert "MRCLAM set 7, robot 1" in text
    assert "1 sightings of robots, 1 of unknown barcodes" in text
    got = strict_json(tmp_path / "run.json")
    assert {name: type(value) for name, value in got.items()} == KEYS
    assert (got["landmarks"], got["observations"], got["rejected"]) == (3, 177, 1)
    assert got["ate_m"] < 0.1
    assert is_png(tmp_path / "out" / "overview.png")
    log, (motion, sensor) = mrclam.load(small_set, 1), mrclam.models()
    history = EKFSLAM(motion, sensor, gate=mrclam.GATE).run(log)
    assert got == run_report.summarise(history, log, motion) | {"seconds": got["seconds"]}


def test_run_mrclam_refuses_a_robot_that_the_set_has_not_got(small_set: Path) -> None:
    assert "Robot2_Odometry.dat is missing" in fails("run", "mrclam", small_set, "--robot", 2)


def test_run_mrclam_on_the_real_set(data_folder: Path, tmp_path: Path) -> None:
    path = data_folder / "mrclam" / "MRCLAM_Dataset1.zip"
    if not path.exists():
        pytest.skip(f"{path} does not exist")
    succeeds("run", "mrclam", path, "--robot", 1, "--json", tmp_path / "run.json", "--max-steps", 20000)
    got = strict_json(tmp_path / "run.json")
    assert {name: type(value) for name, value in got.items()} == KEYS
    assert got["steps"] == 20000
    assert got["ate_m"] < got["dead_reckoning_ate_m"]


# ---- fetch ----


@pytest.fixture
def server(small_set: Path) -> Iterator[str]:
    class Quiet(SimpleHTTPRequestHandler):
        def log_message(self, *_: Any) -> None:
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(small_set.parent))) as http:
        thread = Thread(target=http.serve_forever)
        thread.start()
        try:
            yield f"http://127.0.0.1:{http.server_port}"
        finally:
            http.shutdown()
            thread.join()


def test_fetch_prints_where_the_set_is(server: str, small_set: Path, tmp_path: Path) -> None:
    for quiet in ((), ("--quiet",)):
        text = succeeds("fetch", "mrclam", 7, "--folder", tmp_path / "data", "--base-url", server, *quiet)
        assert text == f"{tmp_path / 'data' / 'MRCLAM7.zip'}\n"
        assert Path(text.strip()).read_bytes() == small_set.read_bytes()


def test_fetch_of_a_set_that_is_not_there(server: str, tmp_path: Path) -> None:
    assert "MRCLAM8.zip" in fails("fetch", "mrclam", 8, "--folder", tmp_path / "data", "--base-url", server, code=1)
    assert contents(tmp_path) == {}

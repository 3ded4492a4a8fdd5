"""Downloads, against servers on this machine only."""

from __future__ import annotations

import io
import socket
import threading
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from socketserver import StreamRequestHandler, ThreadingTCPServer

import pytest

from slamkit.datasets import mrclam
from slamkit.datasets.fetch import fetch
from slamkit.errors import InputError, LogFileError


def small_zip(leave_out: str = "nothing", filler: int = 200_000) -> bytes:
    """A set with one robot that stands still, and as many bytes of filler, uncompressed."""
    files = {
        "Barcodes.dat": "# subject barcode\n1 5\n6 72\n",
        "Landmark_Groundtruth.dat": "6 1.0 2.0 0.001 0.001\n",
        "Robot1_Odometry.dat": "100.0 0.0 0.0\n101.0 0.0 0.0\n",
        "Robot1_Measurement.dat": "100.5 72 2.0 0.5\n",
        "filler": "x" * filler,
    }
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_STORED) as archive:
        for name, text in files.items():
            if leave_out not in name:
                # A ZipInfo of its own has a fixed date: two archives of the same files are the same bytes.
                archive.writestr(zipfile.ZipInfo(f"MRCLAM_Dataset1/{name}"), text)
    return stream.getvalue()


@dataclass
class Shelf:
    """What a server has, and how it behaves."""

    files: dict[str, bytes] = field(default_factory=dict)
    asked: list[str] = field(default_factory=list)
    stop_after: int | None = None  # bytes, then the connection ends
    announce: bool = True  # the length, in HTTP
    report_failure: bool = True  # of an interrupted transfer, in FTP
    base_url: str = ""


def http_server(shelf: Shelf) -> ThreadingTCPServer:
    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            shelf.asked.append(self.path)
            if self.path not in shelf.files:
                self.send_error(404)
                return
            content = shelf.files[self.path]
            self.send_response(200)
            if shelf.announce:
                self.send_header("Content-Length", str(len(content)))
            self.end_headers()
            self.wfile.write(content[: shelf.stop_after])
            self.close_connection = True

        def log_message(self, format: str, *args: object) -> None:
            pass

    return ThreadingHTTPServer(("127.0.0.1", 0), Handler)


def ftp_server(shelf: Shelf) -> ThreadingTCPServer:
    class Handler(StreamRequestHandler):
        def say(self, line: str) -> None:
            self.wfile.write(f"{line}\r\n".encode())

        def handle(self) -> None:
            self.say("220 ready")
            with socket.create_server(("127.0.0.1", 0)) as data:
                for line in self.rfile:
                    command, _, argument = line.decode().strip().partition(" ")
                    if command == "PASV":
                        port = data.getsockname()[1]
                        self.say(f"227 entering passive mode (127,0,0,1,{port // 256},{port % 256})")
                    elif command == "EPSV":
                        self.say(f"229 entering extended passive mode (|||{data.getsockname()[1]}|)")
                    elif command == "RETR":
                        shelf.asked.append(argument)
                        if argument not in shelf.files:
                            self.say("550 no such file")
                            continue
                        self.say("150 here it comes")
                        with data.accept()[0] as connection:
                            connection.sendall(shelf.files[argument][: shelf.stop_after])
                        failed = shelf.stop_after is not None and shelf.report_failure
                        self.say("426 transfer aborted" if failed else "226 done")
                    elif command == "QUIT":
                        self.say("221 bye")
                        return
                    else:
                        self.say({"USER": "331 password", "PASS": "230 in"}.get(command, "200 fine"))

    return ThreadingTCPServer(("127.0.0.1", 0), Handler)


@contextmanager
def serving(protocol: str) -> Iterator[Shelf]:
    shelf = Shelf()
    server = {"http": http_server, "ftp": ftp_server}[protocol](shelf)
    server.daemon_threads = True
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01}, daemon=True)
    thread.start()
    shelf.base_url = f"{protocol}://127.0.0.1:{server.server_address[1]}/MRCLAM"
    try:
        yield shelf
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


@pytest.fixture(params=["http", "ftp"])
def shelf(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[Shelf]:
    monkeypatch.setenv("NO_PROXY", "*")
    monkeypatch.setenv("no_proxy", "*")
    with serving(request.param) as served:
        yield served


def test_a_set_is_fetched_once_and_can_be_read(shelf: Shelf, tmp_path: Path) -> None:
    shelf.files["/MRCLAM/MRCLAM3.zip"] = small_zip()
    folder = tmp_path / "new" / "folder"
    received: list[int] = []
    path = fetch("mrclam", 3, folder, base_url=shelf.base_url, progress=received.append)
    assert path == folder / "MRCLAM3.zip" and path.read_bytes() == small_zip()
    assert len(received) > 1 and received == sorted(received) and received[-1] == len(small_zip())
    assert mrclam.load(path, 1).landmark_ids == (6,)
    del shelf.files["/MRCLAM/MRCLAM3.zip"]
    assert fetch("mrclam", 3, str(folder), base_url=shelf.base_url + "/") == path
    assert shelf.asked == ["/MRCLAM/MRCLAM3.zip"]
    assert list(folder.iterdir()) == [path]


def test_a_missing_file(shelf: Shelf, tmp_path: Path) -> None:
    with pytest.raises(LogFileError, match=r"/MRCLAM/MRCLAM9\.zip cannot be fetched to .*(404|550)"):
        fetch("mrclam", 9, tmp_path, base_url=shelf.base_url)
    assert shelf.asked == ["/MRCLAM/MRCLAM9.zip"]
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("honest", [True, False])
@pytest.mark.parametrize("share", [0.0, 0.4, 0.999])
def test_an_interrupted_transfer(shelf: Shelf, tmp_path: Path, honest: bool, share: float) -> None:
    """Whether or not the protocol tells, no broken file stays, and the next call fetches the whole one."""
    whole = small_zip()
    shelf.files["/MRCLAM/MRCLAM1.zip"] = whole
    shelf.stop_after, shelf.announce, shelf.report_failure = int(share * len(whole)), honest, honest
    expected = "cannot be fetched to" if honest else r"sent is not the set: MRCLAM1\.zip is not a whole zip"
    with pytest.raises(LogFileError, match=rf"MRCLAM1\.zip {expected}"):
        fetch("mrclam", 1, tmp_path, base_url=shelf.base_url)
    assert list(tmp_path.iterdir()) == []
    shelf.stop_after = None
    assert fetch("mrclam", 1, tmp_path, base_url=shelf.base_url).read_bytes() == whole


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"<html>It works!</html>", "is not a whole zip"),
        (small_zip("Barcodes"), r"holds no Barcodes\.dat"),
        (small_zip("Landmark"), r"Landmark_Groundtruth\.dat is missing"),
        (small_zip("Odometry"), "holds no robot"),
        (small_zip().replace(b"xxxx", b"xyxx", 1), "the checksum of MRCLAM_Dataset1/filler does not fit"),
    ],
    ids=["page", "no barcodes", "no landmarks", "no odometry", "one bit"],
)
def test_what_is_not_the_set_is_not_kept(shelf: Shelf, tmp_path: Path, content: bytes, expected: str) -> None:
    shelf.files["/MRCLAM/MRCLAM1.zip"] = content
    with pytest.raises(LogFileError, match=f"sent is not the set: .*{expected}") as caught:
        fetch("mrclam", 1, tmp_path, base_url=shelf.base_url)
    assert str(tmp_path) not in str(caught.value)
    assert list(tmp_path.iterdir()) == []


def test_a_broken_file_that_is_there_is_replaced(shelf: Shelf, tmp_path: Path) -> None:
    shelf.files["/MRCLAM/MRCLAM1.zip"] = small_zip()
    (tmp_path / "MRCLAM1.zip").write_bytes(small_zip()[:1000])
    assert fetch("mrclam", 1, tmp_path, base_url=shelf.base_url).read_bytes() == small_zip()


def test_a_failed_attempt_leaves_the_old_file(shelf: Shelf, tmp_path: Path) -> None:
    (tmp_path / "MRCLAM1.zip").write_bytes(b"old")
    with pytest.raises(LogFileError):
        fetch("mrclam", 1, tmp_path, base_url=shelf.base_url)
    assert (tmp_path / "MRCLAM1.zip").read_bytes() == b"old"


def test_no_server(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as unheard:
        port = unheard.getsockname()[1]
    with pytest.raises(LogFileError, match="cannot be fetched to"):
        fetch("mrclam", 1, tmp_path, base_url=f"ftp://127.0.0.1:{port}")
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_cannot_be_made(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(LogFileError, match="cannot be fetched to"):
        fetch("mrclam", 1, tmp_path / "file", base_url="ftp://127.0.0.1:9")


def test_the_default_folder_is_the_users_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import pooch

    monkeypatch.setattr(pooch, "os_cache", lambda project: tmp_path / project)
    (tmp_path / "slamkit" / "mrclam").mkdir(parents=True)
    there = tmp_path / "slamkit" / "mrclam" / "MRCLAM2.zip"
    there.write_bytes(small_zip())
    assert fetch("mrclam", 2) == there


def test_a_tilde_is_the_home_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("USERPROFILE", str(tmp_path))
    (tmp_path / "MRCLAM2.zip").write_bytes(small_zip())
    assert fetch("mrclam", 2, "~") == tmp_path / "MRCLAM2.zip"


@pytest.mark.parametrize(
    ("name", "number", "base_url", "expected"),
    [
        ("victoria", 1, None, "data set is 'victoria', expected one of: mrclam"),
        ("mrclam", 0, None, "set is 0, mrclam has the sets 1 to 9"),
        ("mrclam", 10, None, "set is 10, mrclam has the sets 1 to 9"),
        ("mrclam", 1.0, None, r"set is 1\.0"),
        ("mrclam", True, None, "set is True"),
        ("mrclam", 1, "file:///etc", "expected an address such as ftp://"),
        ("mrclam", 1, "ftp://", "expected an address"),
        ("mrclam", 1, "http://host:port", "expected an address"),
        ("mrclam", 1, "", "expected an address"),
    ],
)
def test_what_cannot_be_asked_for(tmp_path: Path, name: str, number: int, base_url: str | None, expected: str) -> None:
    with pytest.raises(InputError, match=expected):
        fetch(name, number, tmp_path, base_url=base_url)
    assert list(tmp_path.iterdir()) == []

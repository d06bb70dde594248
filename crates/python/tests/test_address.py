"""Scenes behind addresses."""

from __future__ import annotations

import contextlib
import gc
import tempfile
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
import pytest
import tcgs
from conftest import TESTDATA

FILE = TESTDATA / "bitstream/v1/room_default.tcgs"


class Answers(BaseHTTPRequestHandler):
    """A scene, what is no scene, a scene that ends early, and nothing."""

    def do_GET(self) -> None:
        body = FILE.read_bytes()
        if self.path.startswith("/garbage"):
            self.wfile.write(b"scene\r\n\r\n")
            return
        if self.path.startswith("/missing"):
            self.send_error(404)
            return
        self.send_response(200)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body[:-100] if self.path == "/short.tcgs" else b"\0" * len(body) if self.path == "/no.tcgs" else body)

    def log_message(self, format: str, *args: object) -> None:
        pass


@pytest.fixture
def address() -> Iterator[str]:
    server = ThreadingHTTPServer(("127.0.0.1", 0), Answers)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    with contextlib.closing(server.socket):
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()


def test_a_scene_is_downloaded_and_kept_as_long_as_it_is_needed(
    address: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    scene = tcgs.open(f"{address}/a%20room.tcgs?version=3")
    assert np.array_equal(scene.at(3).means, tcgs.open(FILE).at(3).means)
    assert scene.path.name == "a room.tcgs" and scene.path.is_relative_to(tmp_path)
    del scene
    gc.collect()
    assert list(tmp_path.iterdir()) == []


def test_what_cannot_be_fetched_is_named_and_leaves_nothing(
    address: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with pytest.raises(OSError, match=r"/missing.tcgs: the server answers 404 Not Found, expected a scene"):
        tcgs.open(f"{address}/missing.tcgs")
    with pytest.raises(OSError, match=r"/short.tcgs: ended after \d+ bytes, expected \d+"):
        tcgs.open(f"{address}/short.tcgs")
    with pytest.raises(ValueError, match=r"no.tcgs: "):
        tcgs.open(f"{address}/no.tcgs")
    with pytest.raises(OSError, match="expected a server"):
        tcgs.open("http://127.0.0.1:9/scene.tcgs")
    with pytest.raises(OSError, match="/garbage.tcgs: BadStatusLine, expected an answer of HTTP"):
        tcgs.open(f"{address}/garbage.tcgs")
    for wrong in ("http://[scene.tcgs", "http://127.0.0.1:9/a scene.tcgs", f"{address}/%00"):
        with pytest.raises(ValueError, match=r"^http.*, expected an address"):
            tcgs.open(wrong)
    assert list(tmp_path.iterdir()) == []

"""The player, as Jupyter and a browser see it."""

from __future__ import annotations

import os
from pathlib import Path
from urllib.request import Request, urlopen

import pytest
import tcgs
from conftest import TESTDATA


def shown(scene: tcgs.Scene) -> tcgs.Player:
    try:
        return scene.show(height=300)
    except RuntimeError as error:
        assert "REQUIRE_PLAYER" not in os.environ, error
        pytest.skip(str(error))


def test_a_file_is_served_to_the_page() -> None:
    path = TESTDATA / "bitstream/v1/room_default.tcgs"
    player = shown(tcgs.open(path))
    assert f'<iframe src="{player.address}"' in player._repr_html_() and "height: 300px" in player._repr_html_()
    with urlopen(player.address) as page:
        assert b'<meta name="tcgs-src" content="/scene.tcgs">' in page.read()
        assert "http://localhost:*" in page.headers["Content-Security-Policy"]
    with urlopen(Request(player.address + "scene.tcgs", headers={"Range": "bytes=5-99"})) as part:
        assert part.status == 206 and part.read() == path.read_bytes()[5:100]
    assert shown(tcgs.open(path)).address == player.address, "one server a file"


def test_a_run_is_compressed_to_be_shown(run: Path) -> None:
    scene = tcgs.open(run)
    player = shown(scene)
    with urlopen(player.address + "scene.tcgs") as file:
        assert file.read(4) == b"TCGS"
    assert shown(scene).address == player.address

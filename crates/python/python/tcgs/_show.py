"""The player in a cell of a notebook."""

from __future__ import annotations

import atexit
import html
import tempfile
import weakref
from pathlib import Path

from tcgs._tcgs import Scene, compress, serve

_files: weakref.WeakKeyDictionary[Scene, Path] = weakref.WeakKeyDictionary()


class Player:
    """What `Scene.show` returns: Jupyter shows it as the player. `address` opens in any browser of this machine."""

    def __init__(self, address: str, height: int) -> None:
        self.address = address
        self._height = height

    def _repr_html_(self) -> str:
        style = f"width: 100%; height: {self._height}px; border: 0"
        return f'<iframe src="{html.escape(self.address)}" allow="fullscreen; autoplay" style="{style}"></iframe>'

    def __repr__(self) -> str:
        return f"Player({self.address})"


def show(scene: Scene, height: int) -> Player:
    """The player of a scene, which is compressed for it if need be."""
    return Player(serve(_file_of(scene)), height)


def _file_of(scene: Scene) -> Path:
    if scene.kind == "compressed file" and scene.path.is_file():
        return scene.path
    if scene not in _files:
        folder = tempfile.TemporaryDirectory(prefix="tcgs-")
        atexit.register(folder.cleanup)
        _files[scene] = compress(scene, Path(folder.name) / "scene.tcgs", backend="cpu").path
    return _files[scene]

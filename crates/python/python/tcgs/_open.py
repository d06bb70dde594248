"""Scenes of this machine, and those behind addresses."""

from __future__ import annotations

import http.client
import os
import shutil
import tempfile
import urllib.error
import urllib.parse
import urllib.request
import weakref
from collections.abc import Sequence
from pathlib import Path, PurePosixPath

from tcgs import _tcgs
from tcgs._tcgs import Scene


def open(
    path: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    *,
    drop_sh: bool = False,
    axes: str | None = None,
    recover: bool = False,
    no_limits: bool = False,
    fps: float | None = None,
    segment_length: int | None = None,
) -> Scene:
    """Opens a scene: a .tcgs file, a run folder, a params.npz of Dynamic 3D Gaussians, a .4dgs file, a file of Gaussians
    (PLY, SPZ, glTF, SOG, .splat, .ksplat), or a folder with a file of Gaussians for each frame.

    - path: str or os.PathLike; or the address of a file (http, https), which is downloaded whole and kept as long as the
      Scene is; or run folders that are chapters of one scene (`tcgs.train`, `start_from`), in any order
    - drop_sh: of other programs' files, leave out spherical harmonics above degree 0
    - axes: of other programs' files, as three letters: right or left, up or down, forward or back, such as "rub"; by default
      those that the file declares, else "luf" of glTF and "rdf" of all others. Scenes are in "rdf"
    - recover: of a .tcgs file that was cut, read what is whole
    - no_limits: of other programs' files, read those that claim more memory than their length warrants, or more than 65,536
      timesteps; for files of a known source
    - fps: timesteps a second, where the source says none or another
    - segment_length: of chapters, timesteps between the places at which they are joined; `tcgs.compress` makes segments of
      that length, 50 by default and fewer of more than 60,000 Gaussians

    Raises OSError if the file cannot be read or fetched, ValueError if it is no scene or damaged.
    """
    if not isinstance(path, str) or not path.startswith(("http://", "https://")):
        return _tcgs.open(
            path,
            drop_sh=drop_sh,
            axes=axes,
            recover=recover,
            no_limits=no_limits,
            fps=fps,
            segment_length=segment_length,
        )
    folder = tempfile.TemporaryDirectory(prefix="tcgs-", ignore_cleanup_errors=True)
    try:
        file = _download(path, Path(folder.name))
        scene = _tcgs.open(file, drop_sh=drop_sh, axes=axes, recover=recover, no_limits=no_limits, fps=fps)
    except BaseException:
        folder.cleanup()
        raise
    weakref.finalize(scene, folder.cleanup)
    return scene


def _download(address: str, folder: Path) -> Path:
    try:
        name = PurePosixPath(urllib.parse.unquote(urllib.parse.urlsplit(address).path)).name
        file = folder / (name or "scene.tcgs")
        with urllib.request.urlopen(address) as answer, file.open("xb") as out:
            shutil.copyfileobj(answer, out)
            expected = answer.headers["Content-Length"]
    except urllib.error.HTTPError as error:
        raise OSError(f"{address}: the server answers {error.code} {error.reason}, expected a scene") from None
    except urllib.error.URLError as error:
        raise OSError(f"{address}: {error.reason}, expected a server") from None
    except (ValueError, http.client.InvalidURL) as error:
        raise ValueError(f"{address}: {error}, expected an address") from None
    except http.client.HTTPException as error:
        raise OSError(f"{address}: {type(error).__name__}, expected an answer of HTTP") from None
    found = file.stat().st_size
    if expected is not None and found != int(expected):
        raise OSError(f"{address}: ended after {found} bytes, expected {expected}")
    return file

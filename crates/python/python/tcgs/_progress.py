"""One line of progress on standard error, in terminals and notebooks; nothing elsewhere."""

from __future__ import annotations

import sys
from collections.abc import Callable

from tcgs._tcgs import Progress


def bar() -> Callable[[Progress], None] | None:
    """A callback that shows progress, or None where nobody sees it."""
    if sys.stderr.isatty() or "ipykernel" in sys.modules:
        return _Bar()
    return None


class _Bar:
    """Writes over its own line until a part of the work is done."""

    def __init__(self) -> None:
        self._length = 0

    def __call__(self, progress: Progress) -> None:
        if progress.message is not None:
            self._write(progress.message, "\n")
            if not progress.total:
                return
        parts = [f"{progress.work} {progress.done}/{progress.total}"] if progress.total else ["trying settings"]
        for name, value in [
            ("timestep", progress.timestep),
            ("frame", progress.frame),
            ("Gaussians", progress.num_gaussians),
            ("bytes", progress.bytes),
        ]:
            if value is not None:
                parts.append(f"{name} {value}")
        if progress.loss is not None:
            parts.append(f"loss {progress.loss:.4f}")
        if progress.psnr is not None:
            parts.append(f"{progress.psnr:.2f} dB")
        is_done = progress.total > 0 and progress.done >= progress.total
        self._write(", ".join(parts), "\n" if is_done else "")

    def _write(self, line: str, end: str) -> None:
        print("\r" + line.ljust(self._length), end=end, file=sys.stderr, flush=True)
        self._length = 0 if end else len(line)

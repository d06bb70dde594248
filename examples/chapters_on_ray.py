"""Trains the chapters of a long capture on the machines of a Ray cluster, and joins them into one file.

    python chapters_on_ray.py CAPTURE OUT --chapters 4

CAPTURE and OUT lie on storage that all machines share, and each machine has the packages `tcgs` and `ray`. Run this on a
machine of the cluster (`ray start`); without a cluster all chapters run on this machine. If a worker dies, its chapter goes
on from the last checkpoint, on any machine. The same command goes on after an interruption.
"""

import argparse
from pathlib import Path

import ray
import tcgs

CATCH_UP = 10  # frames in which a chapter catches up with the motion since the first frame
SEGMENT = 50  # timesteps of a segment: chapters that meet at its multiples cost no bytes


@ray.remote(max_retries=-1)
def train_chapter(capture: Path, out: Path, base: Path, frames: tuple[int, int]) -> Path:
    settings = {"config": base / "config.toml", "start_from": (base, 0), "frames": frames}
    tcgs.train(capture, out, resume=True, progress=False, **settings)
    return out


def cut(num_frames: int, chapters: int) -> list[tuple[int, int]]:
    """The frames of each chapter, from A up to but not including B."""
    step = -(-num_frames // chapters)
    if step > SEGMENT:
        step = -(-step // SEGMENT) * SEGMENT
    return [(max(begin - CATCH_UP, 0), min(begin + step, num_frames)) for begin in range(0, num_frames, step)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("capture", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--chapters", type=int, default=4)
    parser.add_argument("--preset", default="fast")
    parser.add_argument("--iterations", type=int, nargs=2, help="of the first timestep, and of each later one")
    parser.add_argument("--cpus", type=int, default=1, help="of a machine's cores, those of a chapter")
    arguments = parser.parse_args()
    capture, out = arguments.capture.resolve(), arguments.out.resolve()

    # Points become Gaussians, which all chapters share.
    iterations = arguments.iterations and tuple(arguments.iterations)
    tcgs.train(capture, out / "base", preset=arguments.preset, iterations=iterations, frames=(0, 1), resume=True)
    ray.init(runtime_env={"env_vars": {"RAYON_NUM_THREADS": str(arguments.cpus)}})
    train = train_chapter.options(num_cpus=arguments.cpus)
    frames = cut(len(tcgs.Capture(capture)), arguments.chapters)
    tasks = [train.remote(capture, out / f"chapter{i}", out / "base", frames[i]) for i in range(len(frames))]
    scene = tcgs.compress(tcgs.open(ray.get(tasks)), out / "scene.tcgs", overwrite=True)
    print(f"{out / 'scene.tcgs'}: {len(scene)} timesteps")


if __name__ == "__main__":
    main()

#!/usr/bin/env python3
"""Shows a scene from all around on one picture, to look at what no figure tells.

    lab/scripts/sheet.py SCENE.tcgs SHEET.png [--timestep 0] [--poses 12] [--beside BEFORE.tcgs]

The poses lie evenly on the orbit of `tcgs render`, which leads from camera to camera around the subject, three in a row.
With --beside the rows of the other scene stand to the left, from the same poses. Needs the Python package, NumPy and Pillow.
"""

import argparse
from pathlib import Path

import numpy as np
import tcgs
from PIL import Image

ACROSS = 3
SIZE = (426, 240)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("scene", type=Path)
    parser.add_argument("sheet", type=Path)
    parser.add_argument("--timestep", type=int, default=0)
    parser.add_argument("--poses", type=int, default=12)
    parser.add_argument("--beside", type=Path, metavar="BEFORE.tcgs")
    args = parser.parse_args()

    scenes = [tcgs.open(path) for path in (args.beside, args.scene) if path]
    poses = scenes[-1].orbit(args.poses, width=SIZE[0], height=SIZE[1])
    sheets = [rows([tcgs.render(scene, pose, args.timestep) for pose in poses]) for scene in scenes]
    sheet = np.concatenate(sheets, axis=1)
    Image.fromarray((sheet.clip(0, 1) * 255 + 0.5).astype(np.uint8)).save(args.sheet)


def rows(pictures):
    """[H, W, 3] pictures in rows of ACROSS; the last row is filled up with black."""
    pictures += [np.zeros_like(pictures[0])] * (-len(pictures) % ACROSS)
    return np.concatenate([np.concatenate(pictures[i : i + ACROSS], axis=1) for i in range(0, len(pictures), ACROSS)])


if __name__ == "__main__":
    main()

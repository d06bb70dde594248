#!/usr/bin/env python3
"""Makes a capture that has every N-th frame of another, as if its cameras were slower: what moves goes N times as far.

    lab/scripts/every_nth_frame.py CAPTURE N OUT

CAPTURE and OUT are folders of the layout of Panoptic Sports (train_meta.json, test_meta.json, ims, seg, init_pt_cld.npz),
which `tcgs demo` writes, too. OUT has links to the images of CAPTURE. Needs Python 3.8, and no packages.
"""

import json
import pathlib
import sys


def main():
    if len(sys.argv) != 4 or not sys.argv[2].isdigit() or int(sys.argv[2]) < 1:
        sys.exit(f"{sys.argv[0]}: found {' '.join(sys.argv[1:])!r}, expected CAPTURE N OUT")
    capture, every, out = pathlib.Path(sys.argv[1]).resolve(), int(sys.argv[2]), pathlib.Path(sys.argv[3])
    metas = {}
    for name in ["train_meta.json", "test_meta.json"]:
        try:
            meta = json.loads((capture / name).read_text())
        except OSError as error:
            sys.exit(f"{capture / name}: {error.strerror}, expected a capture of the layout of Panoptic Sports")
        except ValueError as error:
            sys.exit(f"{capture / name}: {error}, expected JSON")
        # Lists have an entry a frame.
        metas[name] = {key: value[::every] if isinstance(value, list) else value for key, value in meta.items()}
    try:
        out.mkdir(parents=True)
    except FileExistsError:
        sys.exit(f"{out}: exists, expected a new folder")
    for name, meta in metas.items():
        (out / name).write_text(json.dumps(meta))
    for name in ["ims", "seg", "init_pt_cld.npz"]:
        if (capture / name).exists():
            (out / name).symlink_to(capture / name)
    print(f"{out}: {len(metas['train_meta.json']['fn'])} frames")


main()

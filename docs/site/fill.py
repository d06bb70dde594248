#!/usr/bin/env python3
"""Writes the page: index.html with the numbers of scenes.json and the sizes of what a visitor loads.

    docs/site/fill.py OUT        OUT holds the player already, in OUT/player, and OUT/SCENE.html
"""

import gzip
import html
import json
import re
import sys
from pathlib import Path
from string import Template

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
# Bytes of all scenes together, which are committed.
MAX_SCENES_BYTES = 2_000_000
TITLES = {"toss": "Toss", "kitchen": "Kitchen", "demo": "Demo"}


def size(count):
    """Bytes with three digits, such as 162 kB; a kB is 1000 bytes."""
    for unit in ("B", "kB", "MB", "GB"):
        if count < 999.5 or unit == "GB":
            break
        count /= 1000
    digits = 0 if unit == "B" or count >= 99.95 else 1 if count >= 9.995 else 2
    return f"{count:.{digits}f} {unit}"


def repository():
    """The address that Cargo.toml gives; none if it gives none."""
    found = re.search(r'^repository = "(https://[^"]+)"', (ROOT / "Cargo.toml").read_text(), re.MULTILINE)
    return found and found[1].rstrip("/").removesuffix(".git")


def document(path):
    """A document's name, with a link where the repository has an address."""
    if not (ROOT / path).is_file():
        sys.exit(f"fill.py: {path}: is missing, expected a document that the page names")
    name = f"<code>{path}</code>"
    home = repository()
    return f'<a href="{html.escape(home)}/blob/main/{path}">{name}</a>' if home else name


def table(scenes):
    """A body of the table for each scene: three formats, with bars of one scale within the scene."""
    bodies = []
    for name, scene in scenes.items():
        frames, ply = scene["timesteps"], scene["ply_bytes"]
        rows = [
            (f"PLY, {frames} files", ply, scene["ply_psnr"], ""),
            (".4dgs", scene["fourdgs_bytes"], scene["fourdgs_psnr"], ""),
            (".tcgs", scene["tcgs_bytes"], scene["tcgs_psnr"], ' class="ours"'),
        ]
        smaller = f"<em>{ply / scene['tcgs_bytes']:.0f} times smaller than PLY</em>"
        about = f"{frames} frames, {scene['gaussians']:,} Gaussians {smaller}"
        head = f'<th scope="rowgroup" colspan="3">{TITLES[name]} <span>{about}</span></th>'
        lines = [f'        <tbody>\n          <tr class="scene">{head}</tr>']
        for kind, count, psnr, ours in rows:
            width = max(0.4, 100 * count / ply)
            bar = f'<svg aria-hidden="true" width="{width:.2f}%" height="8"><rect width="100%" height="8" rx="2"/></svg>'
            cells = f'<td>{size(count).replace(" ", "&nbsp;")}</td><td>{psnr:.2f}&nbsp;dB</td>'
            lines.append(f'          <tr{ours}><th scope="row">{kind}{bar}</th>{cells}</tr>')
        bodies.append("\n".join(lines) + "\n        </tbody>")
    return "\n".join(bodies)


def main():
    out = Path(sys.argv[1])
    scenes = json.loads((HERE / "scenes.json").read_text())
    missing = [name for name in TITLES if name not in scenes]
    if missing:
        sys.exit(f"fill.py: scenes.json: lacks {', '.join(missing)}, expected what scenes.py writes")
    for name in TITLES:
        found, told = (HERE / f"scenes/{name}.tcgs").stat().st_size, scenes[name]["tcgs_bytes"]
        if found != told:
            sys.exit(f"fill.py: scenes/{name}.tcgs: {found} bytes, expected the {told} that scenes.json measured (run scenes.py)")
    together = sum(scene["tcgs_bytes"] for scene in scenes.values())
    if together > MAX_SCENES_BYTES:
        sys.exit(f"fill.py: scenes: {together} bytes together, expected at most {MAX_SCENES_BYTES}")
    player = sum(len(gzip.compress(file.read_bytes(), 9)) for file in (out / "player").rglob("*") if file.is_file())
    values = {
        "player_size": size(player),
        "table": table(scenes),
        "results": document("docs/RESULTS.md"),
        "paper": document("docs/PAPER.md"),
        "format": document("docs/FORMAT.md"),
        "source_link": f'\n      <a href="{html.escape(repository())}">Source</a>' if repository() else "",
        "kitchen_size": " × ".join(str(side // scenes["kitchen"]["downscale"]) for side in (676, 508)),
    }
    for name, scene in scenes.items():
        values[f"{name}_line"] = f"{scene['timesteps']} frames, {size(scene['tcgs_bytes'])}"
        values[f"{name}_single"] = size((out / f"{name}.html").stat().st_size)
        values[f"{name}_load"] = size(player + scene["tcgs_bytes"])
    page = Template((HERE / "index.html").read_text()).substitute(values)
    (out / "index.html").write_text(page)


main()

#!/usr/bin/env python3
"""Fails if files of a crate depend on each other in a circle.

A room is a file or a folder directly in a crate's src; inside one folder files may know each other. An arrow is a path
that starts with `crate::`, also by way of a name that lib.rs re-exports. Tests do not count.
"""

import re
import sys
from pathlib import Path


def rooms_of_names(source, rooms):
    """Which room each name that lib.rs re-exports comes from."""
    names = {}
    for path in ("lib.rs", "main.rs"):
        text = (source / path).read_text() if (source / path).exists() else ""
        for room, listed in re.findall(r"pub(?:\(crate\))? use (?:self::|crate::)?(\w+)(?:::\w+)*::(\{[^}]*\}|\w+);", text):
            names.update({name: room for name in re.findall(r"\w+", listed) if room in rooms})
    return names


def arrows_of(source):
    """From each room the rooms that its files name."""
    rooms = {path.stem for path in source.iterdir()}
    names = rooms_of_names(source, rooms)
    arrows = {room: set() for room in rooms}
    for path in source.rglob("*.rs"):
        room = path.relative_to(source).parts[0].removesuffix(".rs")
        if room in ("lib", "main") or path.stem in ("tests", "testing"):
            continue
        text = re.sub(r"//.*", "", path.read_text().split("#[cfg(test)]\nmod tests {")[0])
        for used in re.findall(r"crate::(\{[^;]*?\};|\w+)", text):
            found = re.findall(r"[{,]\s*(\w+)", used) if used.startswith("{") else [used]
            arrows[room] |= {names.get(name, name) for name in found} & rooms - {room}
    return arrows


def circle(arrows):
    """The rooms of one circle, in order; none if there is none."""
    done = set()

    def visit(room, path):
        if room in path:
            return path[path.index(room):] + [room]
        if room in done:
            return None
        found = next(filter(None, (visit(other, path + [room]) for other in sorted(arrows[room]))), None)
        done.add(room)
        return found

    return next(filter(None, (visit(room, []) for room in sorted(arrows))), None)


failed = False
root = Path(__file__).resolve().parent.parent
for source in [*sorted(root.glob("crates/*/src")), root / "lab/src"]:
    if found := circle(arrows_of(source)):
        failed = True
        print(f"{source.parent.name}: {' -> '.join(found)}: files in a circle, expected arrows one way", file=sys.stderr)
sys.exit(failed)

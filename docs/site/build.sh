#!/usr/bin/env bash
# Builds the page that shows tcgs: static files in docs/site/dist, or in a folder that is named and does not exist. Takes the
# player from web/dist, and builds it first if it is not there. TCGS=FILE names the program; without it cargo builds it.
# Scenes and pictures are committed; scenes.py makes them, and with them the README's first picture.
set -euo pipefail
out=$(realpath -m "${1:-$(dirname "${BASH_SOURCE[0]}")/dist}")
cd "$(dirname "${BASH_SOURCE[0]}")"

if (($# > 1)) || { (($# == 1)) && [[ -e $out ]]; }; then
    echo "usage: docs/site/build.sh [NEW FOLDER]" >&2
    exit 2
fi
[[ -e ../../web/dist/element.js ]] || ../../web/build.sh
made=$(mktemp -d)
trap 'rm -rf "$made"' EXIT
chmod 755 "$made"
cp -r ../../web/dist "$made/player"
# What this page does not use.
rm -rf "$made"/player/{decoder,decoder.js,decoder.d.ts,element.d.ts,tcgs-player.d.ts,example.html}
cp -r style.css page.js scenes pictures "$made"
tcgs=${TCGS:-}
if [[ -z $tcgs ]]; then
    cargo build --manifest-path ../../Cargo.toml --release --locked
    tcgs=${CARGO_TARGET_DIR:-../../target}/release/tcgs
fi
for scene in scenes/*.tcgs; do
    "$tcgs" export "$scene" --to "$made/$(basename "$scene" .tcgs).html"
done
./fill.py "$made"
rm -rf "$out"
mkdir -p "$(dirname "$out")"
cp -r "$made" "$out"
echo "$out: $(du -sb "$out" | cut -f 1) bytes"

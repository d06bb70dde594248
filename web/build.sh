#!/usr/bin/env bash
# Builds the player's page: static files in web/dist, which any host can serve and which a later build of `tcgs`
# includes for `tcgs view`. Needs Rust alone; scripts/build_wasm.sh gets the other tools.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")"

# Limit for all files that a browser loads, compressed.
MAX_BYTES=3000000

made=$(mktemp -d)
trap 'rm -rf "$made"' EXIT
chmod 755 "$made"
cp src/* "$made"
../scripts/build_wasm.sh "$made/engine" play webgpu
../scripts/build_wasm.sh "$made/engine-webgl2" play webgl2
../scripts/build_wasm.sh "$made/decoder" js
# Types are for programmers of the page alone.
rm -f "$made"/engine*/*.d.ts

total=0
while IFS= read -r -d '' file; do
    total=$((total + $(gzip -9c "$file" | wc -c)))
done < <(find "$made" -type f -print0)
echo "web/dist: $total bytes compressed, at most $MAX_BYTES"
# What a browser loads before the first picture, beside the scene: the page and one engine.
for engine in engine engine-webgl2; do
    first=0
    for file in "$made"/*.{html,css,svg,js} "$made/$engine"/*; do
        case $(basename "$file") in
        example.html | element.js | tcgs-player.js | decoder.js | headset.js) continue ;;
        worker.js) [[ $engine == engine-webgl2 ]] || continue ;;
        esac
        first=$((first + $(gzip -9c "$file" | wc -c)))
    done
    echo "web/dist: $first bytes compressed before the first picture with $engine"
done
if ((total > MAX_BYTES)); then
    echo "web/build.sh: the page is too large" >&2
    exit 1
fi
rm -rf dist
cp -r "$made" dist

#!/usr/bin/env bash
# Builds a crate's WebAssembly: OUTDIR/tcgs_CRATE.js, tcgs_CRATE_bg.wasm and their TypeScript declarations; CRATE is play (the
# player) or js (the decoder alone). FEATURES, in place of the crate's default ones, choose the player's renderer: webgpu or
# webgl2.
# Needs rustup or the target wasm32-unknown-unknown.
# Makes the module smaller with wasm-opt where that is on the PATH.
set -euo pipefail

if (($# < 1 || $# > 3)); then
    echo "usage: scripts/build_wasm.sh OUTDIR [CRATE [FEATURES]]" >&2
    exit 2
fi
out=$(realpath -m "$1")
crate=${2:-play}
features=()
(($# < 3)) || features=(--no-default-features --features "$3")
cd "$(dirname "${BASH_SOURCE[0]}")/.."
target=${CARGO_TARGET_DIR:-$PWD/target}

if ! [[ -d $(rustc --print sysroot)/lib/rustlib/wasm32-unknown-unknown ]]; then
    rustup target add wasm32-unknown-unknown
fi

# Compiled without optimisation it takes less than a second for the player.
cargo build --locked --manifest-path web/bindgen/Cargo.toml --target-dir "$target/tools"
cargo build --locked -p "tcgs-$crate" --lib "${features[@]}" --target wasm32-unknown-unknown --profile web
"$target/tools/debug/bindgen" "$target/wasm32-unknown-unknown/web/tcgs_$crate.wasm" "$out"
if command -v wasm-opt >/dev/null; then
    wasm-opt -O --all-features "$out/tcgs_${crate}_bg.wasm" -o "$out/tcgs_${crate}_bg.wasm.smaller"
    mv "$out/tcgs_${crate}_bg.wasm.smaller" "$out/tcgs_${crate}_bg.wasm"
fi
echo "$out: $(stat -c %s "$out/tcgs_${crate}_bg.wasm") bytes, $(gzip -9c "$out/tcgs_${crate}_bg.wasm" | wc -c) compressed"

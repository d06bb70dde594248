#!/usr/bin/env bash
# Builds a crate's WebAssembly: OUTDIR/tcgs_CRATE.js, tcgs_CRATE_bg.wasm and their TypeScript declarations; CRATE is play (the
# player) or js (the decoder alone).
# Needs rustup or the target wasm32-unknown-unknown; installs the matching wasm-bindgen below the target folder.
# Makes the module smaller with wasm-opt where that is on the PATH.
set -euo pipefail

if (($# < 1 || $# > 2)); then
    echo "usage: scripts/build_wasm.sh OUTDIR [CRATE]" >&2
    exit 2
fi
out=$(realpath -m "$1")
crate=${2:-play}
cd "$(dirname "${BASH_SOURCE[0]}")/.."
target=${CARGO_TARGET_DIR:-$PWD/target}

if ! [[ -d $(rustc --print sysroot)/lib/rustlib/wasm32-unknown-unknown ]]; then
    rustup target add wasm32-unknown-unknown
fi

# The program must be of the very version that the crate is.
version=$(awk '/^name = "wasm-bindgen"$/ { getline; gsub(/"/, "", $3); print $3 }' Cargo.lock)
bindgen=$target/tools/bin/wasm-bindgen
if [[ $("$bindgen" --version 2>/dev/null) != "wasm-bindgen $version" ]]; then
    # Not with --locked: a mirror may lack one of the very newest versions that its lock file names.
    cargo install wasm-bindgen-cli --version "$version" --bin wasm-bindgen --root "$target/tools" \
        --target-dir "$target/tools/build"
fi

cargo build --locked -p "tcgs-$crate" --lib --target wasm32-unknown-unknown --profile web
"$bindgen" --target web --remove-name-section --remove-producers-section --out-dir "$out" "$target/wasm32-unknown-unknown/web/tcgs_$crate.wasm"
if command -v wasm-opt >/dev/null; then
    wasm-opt -O --all-features "$out/tcgs_${crate}_bg.wasm" -o "$out/tcgs_${crate}_bg.wasm.smaller"
    mv "$out/tcgs_${crate}_bg.wasm.smaller" "$out/tcgs_${crate}_bg.wasm"
fi
echo "$out: $(stat -c %s "$out/tcgs_${crate}_bg.wasm") bytes, $(gzip -9c "$out/tcgs_${crate}_bg.wasm" | wc -c) compressed"

#!/usr/bin/env bash
# Publishes the crates, each after those that it depends on; tcgs-serve with the player's page in it.
#
#   scripts/publish.sh             packs all of them, builds each from its package, uploads nothing
#   scripts/publish.sh --upload    uploads them; takes an account of crates.io (cargo login)
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

case ${1-} in
'') upload=(--dry-run) ;;
--upload) upload=() ;;
*)
    echo "usage: scripts/publish.sh [--upload]" >&2
    exit 2
    ;;
esac

if [[ -n $(git status --porcelain) ]]; then
    echo "scripts/publish.sh: the checkout has changes, expected what is committed" >&2
    exit 1
fi
version=$(sed -n '/^\[workspace.package\]/,/^\[/ s/^version = "\(.*\)"$/\1/p' Cargo.toml)
for place in "web/package.json \"version\": \"$version\"" "CITATION.cff version: $version" "CHANGELOG.md ## [$version]"; do
    grep -qF -- "${place#* }" "${place%% *}" ||
        { echo "scripts/publish.sh: ${place%% *} has no '${place#* }', which Cargo.toml has" >&2; exit 1; }
done

web/build.sh
trap 'rm -rf crates/serve/page' EXIT
cp -r web/dist crates/serve/page
# The page is not committed.
cargo publish --workspace --locked --allow-dirty "${upload[@]}"

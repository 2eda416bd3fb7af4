#!/bin/sh
# Serves with an installed meshmend of this version, or else builds one. BUILD=1 always builds.
set -eu

cd "$(dirname "$0")/.."
version=$(sed -n 's/^version = "\(.*\)"/\1/p' Cargo.toml | head -n 1)

if [ -z "${BUILD:-}" ] && [ "$(meshmend --version 2>/dev/null)" = "meshmend $version" ]; then
    printf "serve: the installed %s has this version; run make serve BUILD=1 to build the sources instead\n" "$(command -v meshmend)" >&2
    exec meshmend serve
fi
sh scripts/install-tools.sh
cargo build --release --locked --features service
exec "${CARGO_TARGET_DIR:-target}/release/meshmend" serve

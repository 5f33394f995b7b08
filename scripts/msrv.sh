#!/usr/bin/env bash
# Compiles with the oldest compiler that Cargo.toml promises, which rustup fetches where it is missing; minutes.
#
#   scripts/msrv.sh [VERSION]      another version than that of Cargo.toml
set -euo pipefail
cd "$(dirname "$0")/.."
version=${1:-$(sed -n 's/^rust-version = "\(.*\)"/\1/p' Cargo.toml)}
rustup toolchain install "$version" --profile minimal --no-self-update
# A folder of its own: the compiler of every day would compile everything anew otherwise.
CARGO_TARGET_DIR=${CARGO_TARGET_DIR:-target/msrv} cargo "+$version" check --locked --lib --bins
echo "compiles with Rust $version"

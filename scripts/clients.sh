#!/usr/bin/env bash
# Writes the fixture's walk in every format that holds a whole take, opens the files in real clients, and compares vertices with the PC2.
#
#   scripts/clients.sh [FOLDER]      keep outputs and clients in FOLDER (1.5 GB), else in a folder under TMPDIR that goes away
#
# Needs a python3 that Blender's module has a wheel for (3.11; PYTHON names another), its venv, and the network for the first run.
set -euo pipefail
cd "$(dirname "$0")/.."
root=$PWD
python=${PYTHON:-python3}

if [ $# -gt 0 ]; then
  folder=$1
  mkdir -p "$folder"
else
  folder=$(mktemp -d "${TMPDIR:-/tmp}/retarget-clients.XXXXXX")
  trap 'rm -rf "$folder"' EXIT
fi
folder=$(cd "$folder" && pwd)

if [ ! -x "$folder/venv/bin/python" ]; then
  "$python" -m venv "$folder/venv"
fi
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check 'bpy==5.0.1' 'usd-core==26.11'

cargo build --release --quiet --bin retarget
program=${CARGO_TARGET_DIR:-$root/target}/release/retarget
(cd "$folder" && "$program" "$root/fixtures/scan.obj" "$root/fixtures/walk.c3d" --frames 5..124 --force \
  -o a.glb -o a.pc2 -o a.mdd -o a.usdc -o a.usda -o a.abc -o 'f_####.obj')
"$folder/venv/bin/python" scripts/clients.py "$folder" "${FRAMES:-7}"

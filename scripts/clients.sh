#!/usr/bin/env bash
# Writes the fixture's walk in every format that holds a whole take, and a thing of rigid parts as GLB, opens the files in real clients, and compares
# vertices with the PC2, for GLB half a frame between keys too.
#
#   scripts/clients.sh [FOLDER]      keep outputs and clients in FOLDER (1.5 GB), else in a folder under TMPDIR that goes away
#   PROGRAM=FILE                     a retarget that is built already
#
# Needs a python3 that Blender's module has a wheel for (3.11; PYTHON names another), its venv, and the network for the first run; where node and npm
# are there, the Khronos validator and three.js (in Chromium, or what CHROMIUM names) look at the GLBs.
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

program=${PROGRAM:-}
if [ -z "$program" ]; then
  cargo build --release --quiet --bin retarget
  program=${CARGO_TARGET_DIR:-$root/target}/release/retarget
fi
pair=("$root/fixtures/scan.obj" "$root/fixtures/walk.c3d" --frames 5..124 --force --quiet)
(cd "$folder" && "$program" "${pair[@]}" --source-index -o a.glb -o a.pc2 -o a.mdd -o a.usdc -o a.usda -o a.usdz -o a.abc -o 'f_####.obj')
(cd "$folder" && "$program" "${pair[@]}" --source-index --encode morph -o m.glb)
# So near that joints alone do not do.
(cd "$folder" && "$program" "${pair[@]}" --source-index --tolerance "${TIGHT:-0.02}" -o c.glb)
# Rigid parts: a node each.
"$folder/venv/bin/python" scripts/parts.py "$folder"
holds=(--hold-exact stand=group:stand --hold-exact left=group:left --hold-exact right=group:right)
(cd "$folder" && "$program" parts.obj parts.csv "${holds[@]}" --source-index --force --quiet -o p.glb -o p.pc2)
failed=0
"$folder/venv/bin/python" scripts/clients.py "$folder" "${FRAMES:-7}" || failed=1

if command -v npm >/dev/null; then
  npm install --silent --no-fund --no-audit --prefix "$folder/node" gltf-validator three puppeteer-core >/dev/null
  export NODE_PATH=$folder/node/node_modules
  for glb in a m c p; do node scripts/validate_gltf.js "$folder/$glb.glb" || failed=1; done
  chromium=${CHROMIUM:-$(command -v chromium || command -v google-chrome || true)}
  if [ -n "$chromium" ]; then
    node scripts/viewer.js "$chromium" "$folder" "${FRAMES:-7}" a.glb c.glb m.glb p.glb || failed=1
  else
    echo "three.js: skipped, there is no Chromium"
  fi
else
  echo "validator and three.js: skipped, npm is not here"
fi
exit $failed

#!/usr/bin/env bash
# Runs real captures on real scans and prints one table of all that is demanded of them; minutes.
#
#   scripts/measure.sh [FOLDER]      keep the outputs in FOLDER (about 2.5 GB), else in a folder under TMPDIR that goes away
#
# Needs the folder of real data (RETARGET_SHARED, else ../shared). Where node and npm are there, the Khronos validator reads every GLB; where
# python3 with numpy and scipy is (PYTHON names another), the readers of bench/ compare every GLB with the exact frames.
set -euo pipefail
cd "$(dirname "$0")/.."
root=$PWD
export RETARGET_SHARED=${RETARGET_SHARED:-$root/../shared}
[ -d "$RETARGET_SHARED/data" ] || { echo "no real data at $RETARGET_SHARED: set RETARGET_SHARED" >&2; exit 1; }

scratch=$(mktemp -d "${TMPDIR:-/tmp}/retarget-measure.XXXXXX")
trap 'rm -rf "$scratch"' EXIT
export RETARGET_KEEP=${1:-$scratch/takes}
mkdir -p "$RETARGET_KEEP"
RETARGET_KEEP=$(cd "$RETARGET_KEEP" && pwd)
failed=0

cargo test --release --test real_takes -- --include-ignored --nocapture --test-threads 1 >"$scratch/log" 2>&1 || failed=1
# The heading once, then the rows.
grep -m 1 '^ *take  ' "$scratch/log" || true
sed -n 's/^table //p' "$scratch/log"
echo
grep -E '^(done|warning  )|panicked at|^[a-z].*(bound|volume of the proxy|an edge is|edges are below|skin error)' "$scratch/log" || true
grep -E '^test result|^test .* (FAILED|failed)|^failures' "$scratch/log" || true

echo
if command -v npm >/dev/null; then
  (cd "$scratch" && npm install --silent --no-fund --no-audit --prefix "$scratch/node" gltf-validator >/dev/null)
  for glb in "$RETARGET_KEEP"/*.glb; do
    NODE_PATH=$scratch/node/node_modules node "$root/scripts/validate_gltf.js" "$glb" || failed=1
  done
else
  echo "validator: skipped, npm is not here"
fi

echo
python=${PYTHON:-python3}
if "$python" -c 'import numpy, scipy' 2>/dev/null; then
  for glb in "$RETARGET_KEEP"/*.glb; do
    printf '%-12s' "$(basename "$glb" .glb)"
    "$python" "$RETARGET_SHARED/bench/meshio.py" compare "$glb" "${glb%.glb}.pc2" --stride "${STRIDE:-1}" | tail -n 1
  done
else
  echo "second reader: skipped, $python has no numpy and scipy"
fi
exit $failed

#!/usr/bin/env bash
# Time of one iteration of the solver against libigl's ARAP (ARAP_ENERGY_TYPE_ELEMENTS) on the same tetrahedra, handles and count of
# iterations, one thread each, turn by turn in one run; prints a table.
#
#   scripts/libigl.sh [CASE.npz …]      else: bars made here, the proxy of fixtures/scan.obj, and the cases under RETARGET_SHARED
#
# Needs python3 with venv, and the package index for numpy and libigl, which go into a virtual environment under TMPDIR that goes away
# (RETARGET_VENV names one to keep). tests/common/cases.rs says what a case holds.
set -euo pipefail
here=$(cd "$(dirname "$0")/.." && pwd)
scratch=$(mktemp -d "${TMPDIR:-/tmp}/retarget-libigl.XXXXXX")
trap 'rm -rf "$scratch"' EXIT
venv=${RETARGET_VENV:-$scratch/venv}
[ -x "$venv/bin/python" ] || python3 -m venv "$venv"
"$venv/bin/python" -c 'import igl, numpy' 2>/dev/null || "$venv/bin/pip" install --quiet numpy libigl

cases=()
for case in "$@"; do cases+=("$(realpath "$case")"); done
cd "$here"
if [ $# -eq 0 ] && [ -d "${RETARGET_SHARED:-$here/../shared}/bench/cases" ]; then
  for case in "${RETARGET_SHARED:-$here/../shared}"/bench/cases/*.npz; do cases+=("$(realpath "$case")"); done
fi
cargo build --release --quiet
cargo run --release --quiet -- fixtures/scan.obj fixtures/walk.c3d --frames 1..1 --save-proxy "$scratch/scan.mesh" -o "$scratch/scan.pc2" --quiet
bench=$(cargo bench --bench solver --no-run 2>&1 | sed -n 's/.*Executable .*(\(.*\))$/\1/p')
OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 IGL_NUM_THREADS=1 \
  "$venv/bin/python" scripts/libigl.py "$bench" "$scratch" "${cases[@]}"

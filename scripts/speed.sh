#!/usr/bin/env bash
# Tables of speed and accuracy: what each quality gives and costs, the surface map, growth with size, whole runs of a dense scan; half an hour.
#
#   scripts/speed.sh [accuracy|map|growth|takes]…      else all four
#
# Real scans and takes where RETARGET_SHARED names their folder (else ../shared), else those of fixtures/ only. scripts/libigl.sh compares with libigl.
set -euo pipefail
cd "$(dirname "$0")/.."
export RETARGET_SHARED=${RETARGET_SHARED:-$PWD/../shared}
cargo build --release --quiet
sections=("$@")
[ $# -gt 0 ] || sections=(map growth accuracy takes)
for section in "${sections[@]}"; do
  printf '\n## %s\n\n' "$section"
  cargo bench --quiet --bench solver -- "$section"
done

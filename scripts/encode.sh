#!/usr/bin/env bash
# How six real takes leave as GLB: joints, morph targets, error, size, and the seconds that encoding took; minutes.
#
#   scripts/encode.sh [OPTION …]     options of retarget, such as --tolerance 0.1 or --encode morph
#
# Needs the folder of real data (RETARGET_SHARED, else ../shared); first: cargo build --release.
set -euo pipefail
cd "$(dirname "$0")/.."
data=${RETARGET_SHARED:-../shared}/data
[ -d "$data" ] || { echo "no real data at $data: set RETARGET_SHARED" >&2; exit 1; }
program=${PROGRAM:-target/release/retarget}
scratch=$(mktemp -d "${TMPDIR:-/tmp}/retarget-encode.XXXXXX")
trap 'rm -rf "$scratch"' EXIT
failed=0

body=$data/meshes/bodies/makehuman_male_body
arena=$data/motion/c3d/mocap36.c3d
walk=("$data/motion/c3d/pig_antom_walk.c3d" --ref-file "$data/motion/c3d/pig_antom_static.c3d")
dense=$data/meshes/scans/synthetic_scan_male_apose_mm_zup.ply.gz

echo "| take | frames | as | rms / worst % | MB | encoded in |"
echo "|---|---|---|---|---|---|"
row() {
  local take=$1 done frames
  shift
  if ! "$program" "$@" "${options[@]}" --verbose --report "$scratch/$take.json" -o "$scratch/$take.glb" 2>"$scratch/log"; then
    echo "| $take | $(grep -m 1 '^error' "$scratch/log") |"
    failed=1
    return
  fi
  done=$(grep '^done' "$scratch/log")
  frames=$(grep -c '"iterations"' "$scratch/$take.json")
  echo "| $take | $frames | $(sed -E 's/.*\((.*), rms ([0-9.e-]+) %, worst vertex ([0-9.e-]+) %.*/\1 | \2 \/ \3/' <<<"$done") | $(
    stat -c %s "$scratch/$take.glb" | awk '{ printf "%.2f", $1 / 1e6 }') | $(sed -nE 's/.*outputs completed in (.*) · peak.*/\1/p' "$scratch/log") |"
}
options=("$@")
row a "${body}_tpose_quads_cm.obj.gz" "$arena"
row b "${body}_apose_quads.obj.gz" "${walk[@]}"
row c "$dense" "$data/motion/c3d/pycgm_rom_static.c3d"
row d "$dense" "${walk[@]}"
row e "$data/meshes/bodies/nbs_maynard_tpose.obj.gz" "$arena" --frames 1..600
row f "${body}_tpose_quads_cm.obj.gz" "$data/motion/bvh/mixamo_thriller_part_2.bvh.gz"
exit $failed

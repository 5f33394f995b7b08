#!/usr/bin/env bash
# Draws the pictures of the guide anew, with the program itself, from fixtures; a minute.
#
#   scripts/pictures.sh [FOLDER]      into docs/pictures without a word
#
# PROGRAM names another than target/release/retarget; needs python3 (PYTHON names another) with Pillow for one of them. None may be larger than 150 kB, the animation of the README than 400 kB.
set -euo pipefail
cd "$(dirname "$0")/.."
program=$(realpath "${PROGRAM:-target/release/retarget}")
mkdir -p "${1:-docs/pictures}"
folder=$(cd "${1:-docs/pictures}" && pwd)
scratch=$(mktemp -d "${TMPDIR:-/tmp}/retarget-pictures.XXXXXX")
trap 'rm -rf "$scratch"' EXIT

draw() { "$program" "$@" --force --quiet; }
body=fixtures/scan.obj
# One step of the walk after the other: it ends as it began.
draw $body fixtures/walk.c3d --frames 61..174 --fps 10 -o "$scratch/walk.apng"
# Shown as a picture by every browser and page of code under this name.
mv "$scratch/walk.apng" "$folder/walk.png"
draw $body fixtures/walk.c3d --frames 1..1 --picture "$scratch/bind.png" -o "$scratch/bind.pc2"
# The two views on the left, in 128 colours: the whole has 550 kB.
"${PYTHON:-python3}" - "$scratch/bind.png" "$folder/bind.png" <<'END'
import sys
from PIL import Image
picture = Image.open(sys.argv[1]).convert("RGB")
picture.crop((0, 70, picture.width // 2 - 20, picture.height)).quantize(128, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE).save(sys.argv[2], optimize=True)
END
draw $body fixtures/walk.c3d --fps 1.6 -o "$folder/squat.png"
draw $body fixtures/tall.c3d --fps 5 -o "$folder/tall.png"
draw $body fixtures/steps.bvh --fps 2.5 -o "$folder/skeleton.png"
draw fixtures/trunk.obj fixtures/trunk.csv --examples fixtures/trunk_bent.obj --fps 5 -o "$folder/trunk.png"
draw blend fixtures/trunk.obj fixtures/trunk_bent.obj --at -0.3 --at 0 --at 0.5 --at 1 --at 1.3 -o "$folder/blend.png"
"$program" joints fixtures/lamp.obj -o "$scratch/lamp.toml" --picture "$folder/joints.png" --force 2>/dev/null
draw fixtures/lamp.obj fixtures/lamp.csv --rig "$scratch/lamp.toml" --fps 5 -o "$folder/lamp.png"

failed=0
for picture in "$folder"/*; do
  most=150000
  case $picture in */walk.png) most=400000 ;; esac
  size=$(wc -c <"$picture")
  echo "$size $(basename "$picture")"
  [ "$size" -le $most ] || { echo "$picture is larger than $most bytes" >&2; failed=1; }
done
exit $failed

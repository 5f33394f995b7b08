#!/usr/bin/env bash
# Every figure of the volumetric engine, from the tests that judge them: twists, rigid parts under few markers, the papers' figures, touching limbs,
# the way back from worthless poses, the laws, the agreement with an independent implementation, folds of a squat. Ten minutes once it is built.
#
#   scripts/engine.sh [FOLDER]      keep pictures and outputs in FOLDER
#
# What needs the real data (RETARGET_SHARED, else ../shared) says that it is skipped without them.
set -uo pipefail
cd "$(dirname "$0")/.."
export RETARGET_SHARED=${RETARGET_SHARED:-$PWD/../shared}
data=yes
[ -d "$RETARGET_SHARED/data" ] || data=no
if [ $# -gt 0 ]; then
  mkdir -p "$1"
  RETARGET_KEEP=$(cd "$1" && pwd)
  export RETARGET_KEEP
fi
log=$(mktemp "${TMPDIR:-/tmp}/retarget-engine.XXXXXX")
trap 'rm -f "$log"' EXIT
failed=0

# part TITLE PATTERN ARGUMENTS OF cargo test -- ARGUMENTS OF THE TESTS: the lines that match, and how it ended.
part() {
  local title=$1 pattern=$2
  shift 2
  printf '\n%s\n' "$title"
  RUST_BACKTRACE=0 cargo test --release "$@" --nocapture --test-threads 1 >"$log" 2>&1 || failed=1
  # A test's name stands before the first line that it prints.
  sed -E 's/^test [^ ]+ \.\.\. //' "$log" | grep -E "$pattern" | sed 's/^table //' || true
  grep -E '^test .* FAILED$|panicked at|^error' "$log" || true
  grep -hE '^skipped' "$log" | sort -u || true
  grep -E '^test result' "$log" | sed -E 's/; 0 measured.*//' || true
}

needs_data() {
  [ $data = yes ] && return
  printf '\n%s\nskipped: no real data at %s\n' "$1" "$RETARGET_SHARED"
  return 1
}

part "Twists by the library, of the length of the bar" 'degrees|°' --lib -- deform::volumetric::oriented_laws
part "Twists and turning handles by the program, of the length of the bar" 'degrees|radii|off the handle' --test handles --
part "22 markers on a cartwheel, per cent of the height" 'without:|default:' --test few_markers --
part "The papers' figures" ' · |uneven|iterations' --test paper_figures --
part "Touching limbs: poses of our own making, and a heavy body with its arms down" '^[^ ].*: torn|^skin' --lib -- touch
part "The way back from random poses" 'come|within' --lib -- deform::volumetric::recovery --include-ignored
part "Laws: combinations of deformer, mesh and take, and the worst figure" 'combinations|diagonal|height' --test laws --
part "Agreement with an independent implementation" 'diagonals|mm' --lib -- deform::volumetric::stored_poses five_iterations
needs_data "Folds of a squat" && part "Folds of a squat" '^table squat' --test real_takes -- a_squat --include-ignored
exit $failed

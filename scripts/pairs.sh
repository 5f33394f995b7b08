#!/usr/bin/env bash
# Every real body with every real take of a whole person: the joints found on bodies with known joints, then a table of how each pair is
# placed, bound and moved, and a table of takes and scans as others would deliver them; about half an hour on two cores.
# RETARGET_PAIRS=WORD: only the pairs with this word in their names.
#
# Needs the folder of real data (RETARGET_SHARED, else ../shared).
set -euo pipefail
cd "$(dirname "$0")/.."
export RETARGET_SHARED=${RETARGET_SHARED:-$PWD/../shared}
[ -d "$RETARGET_SHARED/data" ] || { echo "no real data at $RETARGET_SHARED: set RETARGET_SHARED" >&2; exit 1; }
cargo test --release --lib binding::landmarks -- --nocapture --test-threads 1 2>&1 | grep -E '% of stature|%' || true
log=$(mktemp "${TMPDIR:-/tmp}/retarget-pairs.XXXXXX")
trap 'rm -f "$log"' EXIT
failed=0
cargo test --release --test corpus -- --ignored --nocapture --test-threads 1 pairs:: variations:: >"$log" 2>&1 || failed=1
grep -E '^\||panicked' "$log" || true
# Last, how many rows are right, refused, wrong and warned, and wrong and not warned: the last must be 0.
grep -E '^(pairs|variations):' "$log"
exit $failed

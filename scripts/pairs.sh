#!/usr/bin/env bash
# Every real body with every real take of a whole person: the joints found on bodies with known joints, then a table of how each pair is
# placed, bound and moved; about half an hour on two cores.
#
# Needs the folder of real data (RETARGET_SHARED, else ../shared).
set -euo pipefail
cd "$(dirname "$0")/.."
export RETARGET_SHARED=${RETARGET_SHARED:-$PWD/../shared}
[ -d "$RETARGET_SHARED/data" ] || { echo "no real data at $RETARGET_SHARED: set RETARGET_SHARED" >&2; exit 1; }
cargo test --release --lib binding::landmarks -- --nocapture --test-threads 1 2>&1 | grep -E '% of stature|%' || true
cargo test --release --test corpus -- --ignored --nocapture pairs 2>&1 | grep -E '^(\||pairs|test result)|panicked'

#!/usr/bin/env bash
# Reads every real file, and animates every real body, and compares with the tables of tests/corpus; minutes.
#
#   scripts/corpus.sh [files|values|jobs]      all three without a word
#
# Needs the folder of real data (RETARGET_SHARED, else ../shared).
set -euo pipefail
cd "$(dirname "$0")/.."
export RETARGET_SHARED=${RETARGET_SHARED:-$PWD/../shared}
[ -d "$RETARGET_SHARED/data" ] || { echo "no real data at $RETARGET_SHARED: set RETARGET_SHARED" >&2; exit 1; }
case ${1:-all} in
  files) filter=every_file ;;
  values) filter=positions ;;
  jobs) filter=every_body ;;
  *) filter= ;;
esac
cargo test --release --test corpus -- --ignored --nocapture --test-threads 1 $filter 2>&1 |
  grep -E '^(wrong|files|values|jobs|.* \+ |test result|not in)|panicked|unlisted' 

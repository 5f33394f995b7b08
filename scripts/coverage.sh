#!/usr/bin/env bash
# Which lines of src/ the tests run: a line per file, the least covered first, and all; a build with instruments and all tests, an hour.
#
#   scripts/coverage.sh [ARGUMENTS OF cargo llvm-cov …]     --lib: the unit tests only, half of the time; --ignore-run-fail: a report whatever fails
#
# Needs cargo-llvm-cov (`cargo install cargo-llvm-cov`) and the compiler's llvm-tools (`rustup component add llvm-tools`). Tests on real data run where
# RETARGET_SHARED names their folder. A page of all lines goes to target/coverage/html. Unit tests within a file
# count as its lines: without them all is a point lower.
set -euo pipefail
cd "$(dirname "$0")/.."
command -v cargo-llvm-cov >/dev/null || { echo "cargo-llvm-cov is not here: cargo install cargo-llvm-cov" >&2; exit 1; }
export CARGO_INCREMENTAL=0 CARGO_TARGET_DIR=${CARGO_TARGET_DIR:-target/coverage}
ignore='(/tests?/|/tests?\.rs|/tests_of_|_tests\.rs|laws\.rs|mutants\.rs|corpus\.rs|fuzz)'
cargo llvm-cov --release --locked --html --output-dir target/coverage --ignore-filename-regex "$ignore" "$@"
cargo llvm-cov report --release --json --summary-only --ignore-filename-regex "$ignore" >target/coverage/summary.json
python3 - <<'END'
import json, os
data = json.load(open("target/coverage/summary.json"))["data"][0]
rows = sorted((f["summary"]["lines"]["percent"], f["summary"]["lines"]["count"], os.path.relpath(f["filename"])) for f in data["files"])
for percent, count, name in rows:
    print(f"{percent:6.1f} %  {count:6}  {name}")
total = data["totals"]["lines"]
print(f"{total['percent']:6.1f} %  {total['count']:6}  all")
END

#!/usr/bin/env bash
# Runs libFuzzer over the parsers and prints, per body: executions, coverage, and what was found.
#
#   scripts/fuzz.sh [-t SECONDS] [BODY…]      SECONDS per body (60); all bodies where none is named
#
# Needs a C++ compiler; the first build takes minutes. RUSTC_BOOTSTRAP lets the stable compiler instrument the code. Corpora and what was
# found are kept in FUZZ_FOLDER (target/fuzz); seeds are the samples of the unit tests.
set -euo pipefail
cd "$(dirname "$0")/.."
seconds=60
while getopts t: option; do
  case $option in t) seconds=$OPTARG ;; *) exit 2 ;; esac
done
shift $((OPTIND - 1))
bodies=("$@")
[ ${#bodies[@]} -gt 0 ] || mapfile -t bodies < <(sed -n 's/^    ("\([a-z0-9_]*\)".*/\1/p' src/fuzz.rs)

folder=${FUZZ_FOLDER:-target/fuzz}
mkdir -p "$folder"
folder=$(cd "$folder" && pwd)
triple=$(rustc -vV | sed -n 's/^host: //p')

# What `cargo fuzz build` does without a sanitizer of memory: there is no unsafe code in the parsers. --target keeps the flags from build scripts.
coverage="--cfg fuzzing -Cpasses=sancov-module -Cllvm-args=-sanitizer-coverage-level=4 -Cllvm-args=-sanitizer-coverage-inline-8bit-counters \
-Cllvm-args=-sanitizer-coverage-pc-table -Cllvm-args=-sanitizer-coverage-trace-compares -Ccodegen-units=1"
RUSTC_BOOTSTRAP=1 RUSTFLAGS="$coverage" CARGO_INCREMENTAL=0 \
  cargo build --quiet --release --manifest-path fuzz/Cargo.toml --target "$triple" --target-dir "$folder/build"
program=$folder/build/$triple/release/body

RETARGET_FUZZ_SEEDS=$folder/seeds cargo test --quiet --release --lib -- seeds_of_the_fuzzer >/dev/null

failed=0
printf '%-14s %12s %8s %8s  %s\n' body executions edges corpus found
for body in "${bodies[@]}"; do
  mkdir -p "$folder/corpus/$body" "$folder/seeds/$body" "$folder/found/$body"
  BODY=$body "$program" -max_total_time="$seconds" -timeout=10 -rss_limit_mb=1024 -max_len=65536 -print_final_stats=1 \
    -artifact_prefix="$folder/found/$body/" "$folder/corpus/$body" "$folder/seeds/$body" >"$folder/$body.log" 2>&1 || failed=1
  executions=$(sed -n 's/^stat::number_of_executed_units: *//p' "$folder/$body.log")
  edges=$(sed -n 's/.* cov: \([0-9]*\) .*/\1/p' "$folder/$body.log" | tail -n 1)
  printf '%-14s %12s %8s %8s  %s\n' "$body" "${executions:--}" "${edges:--}" "$(find "$folder/corpus/$body" -type f | wc -l)" \
    "$(find "$folder/found/$body" -type f | wc -l) in $folder/found/$body"
done
exit $failed

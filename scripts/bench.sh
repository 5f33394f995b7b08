#!/usr/bin/env bash
# Runs the benches that need nothing but fixtures/ and appends what they print to benches/history.tsv: ten minutes on a machine that does nothing else.
#
#   scripts/bench.sh            map, growth, accuracy, the readers of BVH and C3D
#   scripts/bench.sh map bvh    some of them
#
# A row is a line of a bench: date, commit (with + where sources were changed since), machine, bench, line. One line over all commits:
#   grep 'fixture walk     default' benches/history.tsv
# RETARGET_MACHINE names the machine, else its cores and processor do.
set -euo pipefail
cd "$(dirname "$0")/.."
benches=("$@")
[ $# -gt 0 ] || benches=(map growth accuracy bvh c3d)
# With real data the rows of a bench would depend on who runs it.
unset RETARGET_SHARED
commit=$(git rev-parse --short=12 HEAD)$(git diff --quiet HEAD -- src benches build.rs Cargo.toml Cargo.lock || echo +)
processor=$(sed -n 's/^model name[[:space:]]*: //p' /proc/cpuinfo 2>/dev/null | head -n 1)
machine=${RETARGET_MACHINE:-"$(getconf _NPROCESSORS_ONLN) cores, ${processor:-$(uname -m)}, $(uname -s)"}
history=benches/history.tsv
cargo build --release --locked --quiet --benches
[ -f "$history" ] || printf 'date\tcommit\tmachine\tbench\tline\n' >"$history"
for bench in "${benches[@]}"; do
  case $bench in
    bvh | c3d) command=(--bench "$bench") ;;
    *) command=(--bench solver -- "$bench") ;;
  esac
  # Whole or absent: a bench that fails adds no rows.
  printed=$(cargo bench --locked --quiet "${command[@]}")
  printf '%s\n' "$printed" | sed '/^[[:space:]]*$/d' | while IFS= read -r line; do
    printf '%s\t%s\t%s\t%s\t%s\n' "$(date -u +%F)" "$commit" "$machine" "$bench" "$line"
  done | tee -a "$history" | cut -f 4-
done

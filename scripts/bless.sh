#!/usr/bin/env bash
# Makes the golden frames anew and prints what moved.
set -euo pipefail
cd "$(dirname "$0")/.."
RETARGET_BLESS=1 cargo test --release --test golden -- --nocapture
RETARGET_BLESS=1 cargo test --release --test joints golden -- --nocapture
git --no-pager diff --stat -- tests/golden tests/joints/golden

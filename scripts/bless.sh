#!/usr/bin/env bash
# Makes the golden frames and what the pages of the guide show anew, and prints what moved; a minute once it is built.
set -euo pipefail
cd "$(dirname "$0")/.."
RETARGET_BLESS=1 cargo test --release --test golden -- --nocapture
RETARGET_BLESS=1 cargo test --release --test joints golden -- --nocapture
RETARGET_BLESS=1 cargo test --release --test guide -- commands_print
git --no-pager diff --stat -- tests/golden tests/joints/golden docs

#!/usr/bin/env bash
# Prints Table 2 of Xu et al. 2009 for our models, and what joints do over a real take. RETARGET_SHARED names the folder of real data.
set -euo pipefail
cd "$(dirname "$0")/.."
cargo test --release --test joints -- --nocapture --test-threads 1 table_2 joints_hold_over_a_real_take joints_follow_what_they_can_reach

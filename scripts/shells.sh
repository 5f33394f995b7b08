#!/usr/bin/env bash
# The figures and tables of Fröhlich and Botsch 2011 beside what comes out here; with RETARGET_KEEP=FOLDER also pictures.
set -euo pipefail
cd "$(dirname "$0")/.."
cargo test --release --test shell_figures -- --nocapture --test-threads 1 2>&1 | grep -E '^(Fig|Table)|^test result|panicked'

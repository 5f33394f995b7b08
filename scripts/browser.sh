#!/usr/bin/env bash
# Opens the page that -o FILE.html writes in the browsers that are here, clicks through it and looks that it plays; seconds.
#
#   scripts/browser.sh [FILE.html …]    without files: makes one of the fixtures (first: cargo build --release)
#
# Needs node and npm, and Chromium or Firefox (Debian: chromium, firefox-esr with xvfb, libgl1 and libegl1); CHROMIUM and FIREFOX name others. What drives
# them, puppeteer-core, is installed into a folder under TMPDIR that goes away. Screenshots are left beside each page.
set -euo pipefail
cd "$(dirname "$0")/.."
scratch=$(mktemp -d "${TMPDIR:-/tmp}/retarget-browser.XXXXXX")
trap 'rm -rf "$scratch"' EXIT

files=()
for file in "$@"; do files+=("$(realpath "$file")"); done
if [ ${#files[@]} -eq 0 ]; then
  mkdir -p target/browser
  target/release/retarget fixtures/scan.obj fixtures/walk.c3d --force -o target/browser/walk.html
  files=("$PWD/target/browser/walk.html")
fi

npm install --silent --no-fund --no-audit --prefix "$scratch/node" puppeteer-core >/dev/null
export NODE_PATH=$scratch/node/node_modules
tried=0
failed=0
first() { for name in "$@"; do command -v "$name" 2>/dev/null && return; done; true; }

chromium=${CHROMIUM:-$(first chromium chromium-browser google-chrome)}
if [ -n "$chromium" ]; then
  tried=1
  node scripts/browser.js chromium "$chromium" "${files[@]}" || failed=1
else
  echo "chromium: skipped, it is not here"
fi
firefox=${FIREFOX:-$(first firefox firefox-esr)}
if [ -n "$firefox" ] && { [ -n "${DISPLAY:-}" ] || command -v xvfb-run >/dev/null; }; then
  tried=1
  display=()
  [ -n "${DISPLAY:-}" ] || display=(xvfb-run -a)
  "${display[@]}" node scripts/browser.js firefox "$firefox" "${files[@]}" || failed=1
else
  echo "firefox: skipped, it or a display (xvfb-run) is not here"
fi
[ $tried = 1 ] || { echo "no browser: set CHROMIUM or FIREFOX" >&2; exit 1; }
exit $failed

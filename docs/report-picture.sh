#!/usr/bin/env bash
# Makes docs/report.png, the README's picture, from a real run: docs/report-picture.sh RUN_FOLDER
# RUN_FOLDER is what `bodycheck run --out RUN_FOLDER` left; chromium is needed.
set -euo pipefail
report=$(realpath "$1")/report.html
picture=$(realpath "$(dirname "$0")")/report.png
profile=$(mktemp -d)
trap 'rm -rf "$profile"' EXIT
chromium --headless --no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking \
    --disable-component-update --disable-sync --user-data-dir="$profile" --hide-scrollbars \
    --window-size=1440,2950 --virtual-time-budget=10000 --screenshot="$picture" "file://$report"
echo "$picture"

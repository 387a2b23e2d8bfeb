#!/usr/bin/env bash
# A nightly run from cron: scripts/nightly.sh HISTORY [SCENARIO ...]; the status is that of `bodycheck nightly`.
# Its output is appended to HISTORY.log, and printed only if the status is not 0, because cron mails what is printed.
set -uo pipefail

history=${1:?"usage: nightly.sh HISTORY [SCENARIO ...]"}
history=${history%/} # the log is next to the folder
shift
bodycheck=${BODYCHECK:-$(dirname "$0")/../.venv/bin/bodycheck}
output=$(mktemp)
trap 'rm -f "$output"' EXIT

"$bodycheck" nightly "$@" --quiet --history "$history" > "$output" 2>&1
status=$?
{ date --utc --iso-8601=seconds && cat "$output"; } >> "$history.log"
if [ "$status" != 0 ]; then
    cat "$output"
fi
exit "$status"

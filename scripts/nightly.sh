#!/usr/bin/env bash
# One night from cron: scripts/nightly.sh HISTORY [SCENARIO ...]; the status is that of `bodycheck nightly`.
# What it says goes to HISTORY.log; cron mails what is printed, so that only what needs a look is: not a quiet night.
set -uo pipefail

history=${1:?"usage: nightly.sh HISTORY [SCENARIO ...]"}
history=${history%/} # the log stands beside the folder
shift
bodycheck=${BODYCHECK:-$(dirname "$0")/../.venv/bin/bodycheck}
told=$(mktemp)
trap 'rm -f "$told"' EXIT

"$bodycheck" nightly "$@" --history "$history" > "$told" 2>&1
status=$?
{ date --utc --iso-8601=seconds && cat "$told"; } >> "$history.log"
if [ "$status" != 0 ]; then
    cat "$told"
fi
exit "$status"

#!/usr/bin/env bash
# The lines of bodycheck/ that tests run, of all its statements: those that worker processes run too, and kernels.
#
#     bash tests/long/coverage.sh                   # the tests of a push; or what is told to pytest:
#     bash tests/long/coverage.sh -m "not slow"
#
# A compiled kernel cannot be watched: laws of the mathematics that are quick without a compiler run again as plain
# Python. Prints the files that are not covered whole; the status is 1 below 95 %.
set -euo pipefail
cd "$(dirname "$0")/../.."

plain=(batch closed_forms double_double dynamics elliptic free_rotation integrators lasting rotations taylor wrench)
export COVERAGE_FILE="${TMPDIR:-/tmp}/bodycheck-coverage/of"
rm -rf "${COVERAGE_FILE%/*}" && mkdir -p "${COVERAGE_FILE%/*}"

python -m coverage run -m pytest "$@"
NUMBA_DISABLE_JIT=1 python -m coverage run -m pytest -m "not slow" \
    "${plain[@]/#/tests/reference_impl/test_}"
python -m coverage combine --quiet
python -m coverage report --show-missing --skip-covered --fail-under=95

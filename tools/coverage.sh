#!/usr/bin/env bash
# The lines of bodycheck/ that tests run, of all its statements: those that worker processes run too, and kernels.
# Adapters of engines on request are left out: their tests, `pytest -m engines`, run them in environments of the engines.
#
#     bash tools/coverage.sh                   # the tests of a push, or those that the arguments select:
#     bash tools/coverage.sh tests/reports/gates
#
# A compiled kernel cannot be watched: tests of the mathematics that are quick without a compiler run again as plain
# Python, where numpy warns of a NaN or an overflow; compiled kernels do not. Tests of processor time and of the memory
# of compiled kernels are left out: tracing takes longer. Prints the files that are not covered completely; the status
# is 1 below 95 %, or if a test fails.
set -euo pipefail
cd "$(dirname "$0")/.."

plain=(batch callback_motion closed_forms double_double dynamics elliptic free_batch free_rotation integrators
    load_formulas magnetic_dipole recorded_loads rotations small_vectors unknown_loads wrench)
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
export COVERAGE_FILE=$folder/of

failed=0
compiled=tests/reference_impl/test_load_formulas.py::test_order_under_a_continuous_load
memory=tests/scenarios/mass_properties/test_mesh_check.py::test_check_takes_at_most_150_bytes_per_triangle
light=tests/reports/test_page_safety.py::test_a_large_run_stays_light
signals=tests/test_command_endings.py::test_signal # SIGTERM is handled by coverage here, which stores its lines
python -m coverage run -m pytest -p tests.helpers.counted_workers --deselect "$light" \
    --deselect "${signals}_within_exec_keeps_its_status" --deselect "${signals}_ends_a_command_like_an_interrupt" "${@:--m slow or not slow}" || failed=1
python -m coverage run -m pytest -m nightly tests/reference_impl/test_taylor{,_motion}.py || failed=1 # start plain Python
NUMBA_DISABLE_JIT=1 python -m coverage run -m pytest -m "not slow" \
    -W "ignore:invalid value:RuntimeWarning" -W "ignore:overflow encountered:RuntimeWarning" \
    --deselect "$compiled" --deselect "$memory" \
    $(printf 'tests/reference_impl/test_%s.py ' "${plain[@]}") tests/scenarios/mass_properties || failed=1
python -m coverage combine --quiet
cp "$COVERAGE_FILE" .coverage # with the tests of each line
python -m coverage report --show-missing --skip-covered --precision=1 --fail-under=95 --omit "bodycheck/adapters/optional/*"
exit $failed

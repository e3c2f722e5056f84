#!/usr/bin/env bash
# Set up the workspace and run every check and test: graph tests and unit tests, each ending in pytest's summary line.
set -euo pipefail

usage() {
    cat <<'TEXT'
Usage: ./test.sh [--help] [--faults [ARGUMENT ...]] [ARGUMENT ...]

Sets up the workspace for developing, then runs the linters, the unit tests and the tests on a real ROS graph.
The status is 0 only when all pass. Benchmarks are not run.

  ARGUMENT  goes to pytest: -k EXPRESSION chooses tests by name, a file or folder is all that is run
  --faults  run the campaign of faults instead, about an hour and a half; ./test.sh --faults --help has its options
  --help    print this

example: ./test.sh tests/unit/workspace
TEXT
}

case "${1-}" in
    -h | --help) usage; exit ;;
esac
cd "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")"

./setup.sh --for developing
# Whatever ROS the caller's shell has sourced stays out of it.
unset CMAKE_PREFIX_PATH ROS_PACKAGE_PATH PYTHONPATH PYTHONHOME
unset PYTHONDONTWRITEBYTECODE # or each of some hundred processes compiles what it imports anew
set +u # catkin's file reads variables that may be unset
ros() { . devel/setup.bash; } # in a function: catkin's file would take --help and others for its own
ros
set -u
# Some of Debian's ROS tools start with `env python3`, which another Python in PATH would answer.
export PATH=$PWD/.venv/bin:$PATH

if [[ ${1-} == --faults ]]; then
    exec .venv/bin/python tests/faults/campaign.py "${@:2}"
fi
.venv/bin/python -m ruff check --quiet .
catkin_lint --quiet --offline src

# A graph test that cannot run is a failure here, not a skip (tests/integration/conftest.py).
export ARAS_REQUIRE_GRAPH=1
for argument in "$@"; do
    # Arguments that name files or folders themselves are all that is run.
    [[ -e ${argument%%::*} ]] && exec .venv/bin/python -m pytest "$@"
done

# Unit tests share nothing. Nor do graphs, each with a master of its own: a file of them has one process at a
# time; more of them than cores, or than four, would only wait for each other. Graph tests wait for time to go by
# a part of the while, so the unit tests run beside them, on what they leave.
# What a graph does hangs on how the machine shares its time among a dozen processes: a graph test that
# fails has a second try, and the summary names it (R).
units=$(nproc) graphs=$(nproc)
((graphs <= 4)) || graphs=4
interrupted=2 no_test=5 unit=0 graph=0
log=build/unit_tests.log
: >"$log"
set -m # a process group of its own, in which Ctrl-C is not ignored
nice -n 10 .venv/bin/python -m pytest -n "$units" --dist worksteal tests/unit "$@" >"$log" 2>&1 </dev/null &
beside=$!
set +m
# By Ctrl-C, too: then they end what they have begun themselves.
trap 'kill -INT -- "-$beside" 2>/dev/null && wait "$beside" || true' EXIT
.venv/bin/python -m pytest -n "$graphs" --dist loadfile --no-loadscope-reorder --reruns 1 -r fER tests/integration "$@" || graph=$?
((graph != interrupted)) || exit "$graph"
tail -n +1 -f --pid="$beside" "$log"
wait "$beside" || unit=$?
trap - EXIT
# -k may choose tests of one suite alone.
[[ $unit == "$no_test" ]] && exit "$graph"
[[ $graph == "$no_test" || $graph == 0 ]] && exit "$unit"
exit "$graph"

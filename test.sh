#!/usr/bin/env bash
# Set up the workspace and run the linters, the unit tests and the tests on a ROS graph.
set -euo pipefail

usage() {
    cat <<'TEXT'
Usage: ./test.sh [--help] [--faults [ARGUMENT ...]] [ARGUMENT ...]

Set up the workspace for development, then run the linters, the unit tests and the tests on a ROS graph.
The exit status is 0 only if all pass. Benchmarks are not run.

  ARGUMENT  argument of pytest: -k EXPRESSION selects tests by name; with a file or folder only its tests are run
  --faults  run the fault campaign instead (about 90 minutes); for its options see ./test.sh --faults --help
  --help    print this help

example: ./test.sh tests/unit/workspace
TEXT
}

case "${1-}" in
    -h | --help) usage; exit ;;
esac
cd "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")"

./setup.sh --for developing
# Remove the ROS environment of the caller's shell.
unset CMAKE_PREFIX_PATH ROS_PACKAGE_PATH PYTHONPATH PYTHONHOME
unset PYTHONDONTWRITEBYTECODE # without bytecode files, each of some hundred processes would compile its imports
set +u # catkin's file reads variables that may be unset
ros() { . devel/setup.bash; } # in a function, because catkin's file would interpret --help and other arguments
ros
set -u
# Some of Debian's ROS tools start with `env python3`, which must not find another Python in PATH.
export PATH=$PWD/.venv/bin:$PATH

if [[ ${1-} == --faults ]]; then
    exec .venv/bin/python tests/faults/campaign.py "${@:2}"
fi
.venv/bin/python -m ruff check --quiet .
catkin_lint --quiet --offline src

# A graph test that cannot run is a failure here, not a skip (tests/integration/conftest.py).
export ARAS_REQUIRE_GRAPH=1
for argument in "$@"; do
    # With files or folders as arguments, run only these.
    [[ -e ${argument%%::*} ]] && exec .venv/bin/python -m pytest "$@"
done

# Unit tests are independent. Graph tests are independent, too, because each graph has its own ROS master. The
# tests of one file share a process. More graphs than cores, or more than four, only slow each other down. Graph
# tests are idle part of the time, so the unit tests run at the same time with low priority.
# A graph has about a dozen processes, whose timing depends on the load of the machine. A graph test that fails is
# therefore repeated once, and the summary marks it with R.
units=$(nproc) graphs=$(nproc)
((graphs <= 4)) || graphs=4
interrupted=2 no_test=5 unit=0 graph=0
log=build/unit_tests.log
: >"$log"
set -m # a separate process group, in which Ctrl-C is not ignored
nice -n 10 .venv/bin/python -m pytest -n "$units" --dist worksteal tests/unit "$@" >"$log" 2>&1 </dev/null &
unit_tests=$!
set +m
# Interrupt the unit tests on exit, so that they stop the processes that they have started.
trap 'kill -INT -- "-$unit_tests" 2>/dev/null && wait "$unit_tests" || true' EXIT
.venv/bin/python -m pytest -n "$graphs" --dist loadfile --no-loadscope-reorder --reruns 1 -r fER tests/integration "$@" || graph=$?
((graph != interrupted)) || exit "$graph"
tail -n +1 -f --pid="$unit_tests" "$log"
wait "$unit_tests" || unit=$?
trap - EXIT
# -k may select tests of only one of the two suites.
[[ $unit == "$no_test" ]] && exit "$graph"
[[ $graph == "$no_test" || $graph == 0 ]] && exit "$unit"
exit "$graph"

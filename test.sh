#!/usr/bin/env bash
# Set up the workspace and run every check and test; ends with pytest's summary line.
# Arguments go to pytest: ./test.sh -k moments, ./test.sh tests/unit/workspace. Benchmarks are not run.
set -euo pipefail
cd "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")"

./setup.sh --for developing
# Whatever ROS the caller's shell has sourced stays out of it.
unset CMAKE_PREFIX_PATH ROS_PACKAGE_PATH PYTHONPATH PYTHONHOME
set +u # catkin's file reads variables that may be unset
. devel/setup.bash
set -u
# Some of Debian's ROS tools start with `env python3`, which another Python in PATH would answer.
export PATH=$PWD/.venv/bin:$PATH

.venv/bin/python -m ruff check --quiet .
catkin_lint --quiet --offline src

# The two suites, unless the arguments name files or folders themselves.
suites=(tests/unit tests/integration)
for argument in "$@"; do
    [[ -e ${argument%%::*} ]] && suites=()
done
# A graph test that cannot run is a failure here, not a skip (tests/integration/conftest.py).
export ARAS_REQUIRE_GRAPH=1
exec .venv/bin/python -m pytest "${suites[@]}" "$@"

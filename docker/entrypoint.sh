#!/usr/bin/env bash
# Source the workspace, then become the command.
set -e
. /workspace/devel/setup.bash
# Some of Debian's ROS tools start with `env python3`, which must be the one that has our packages.
export PATH=/workspace/.venv/bin:$PATH
exec "$@"

#!/usr/bin/env bash
# Source the workspace, then become the command.
set -e
# The compiled loops: Numba uses them only where it could keep new ones as well, and the image may be read-only
# and the user any number.
if [[ -z ${NUMBA_CACHE_DIR-} ]]; then
    export NUMBA_CACHE_DIR=/tmp/loops-$UID
    [[ -e $NUMBA_CACHE_DIR ]] || cp -r /workspace/loops "$NUMBA_CACHE_DIR"
fi
. /workspace/devel/setup.bash
# Some of Debian's ROS tools start with `env python3`, which must be the one that has our packages.
export PATH=/workspace/.venv/bin:$PATH
exec "$@"

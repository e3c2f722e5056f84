#!/usr/bin/env bash
# Source the workspace, then become the command.
set -e
workspace=$(dirname "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")")
# The compiled loops: Numba uses them only where it could keep new ones as well, and the image may be read-only
# and the user any number. They come to their name when they are whole: a start may be cut short.
if [[ -z ${NUMBA_CACHE_DIR-} ]]; then
    temporary=${TMPDIR:-/tmp}
    export NUMBA_CACHE_DIR=$temporary/loops-$UID
    if [[ ! -e $NUMBA_CACHE_DIR ]]; then
        { copy=$(mktemp -d "$temporary/loops.XXXXXX") && cp -r "$workspace/loops/." "$copy"; } 2>/dev/null || {
            rm -rf "${copy-}"
            echo "entrypoint.sh: the compiled loops cannot be written to $temporary: give the container room there" \
                "(--tmpfs /tmp)" >&2
            exit 1
        }
        mv -T "$copy" "$NUMBA_CACHE_DIR" 2>/dev/null || rm -rf "$copy" # another start was quicker
    fi
fi
ros() { . "$workspace/devel/setup.bash"; } # in a function: catkin's file would take --help and others for its own
ros
# Some of Debian's ROS tools start with `env python3`, which must be the one that has our packages.
export PATH=$workspace/.venv/bin:$PATH
exec "$@"

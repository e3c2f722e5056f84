#!/usr/bin/env bash
# Source the workspace, then execute the command.
set -e
workspace=$(dirname "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")")
# Numba uses compiled loops only from a writable folder. The image may be read-only and may belong to another
# user, so the loops are copied. The copy is renamed when it is complete, because a start may be interrupted.
if [[ -z ${NUMBA_CACHE_DIR-} ]]; then
    temporary=${TMPDIR:-/tmp}
    export NUMBA_CACHE_DIR=$temporary/loops-$UID
    if [[ ! -e $NUMBA_CACHE_DIR ]]; then
        { copy=$(mktemp -d "$temporary/loops.XXXXXX") && cp -r "$workspace/loops/." "$copy"; } 2>/dev/null || {
            rm -rf "${copy-}"
            echo "entrypoint.sh: cannot write the compiled loops to $temporary: provide a writable folder" \
                "(--tmpfs /tmp)" >&2
            exit 1
        }
        mv -T "$copy" "$NUMBA_CACHE_DIR" 2>/dev/null || rm -rf "$copy" # another container start was faster
    fi
fi
ros() { . "$workspace/devel/setup.bash"; } # in a function, because catkin's file would interpret --help and other arguments
ros
# Some of Debian's ROS tools start with `env python3`, which must find the Python with our packages.
export PATH=$workspace/.venv/bin:$PATH
exec "$@"

#!/usr/bin/env bash
# Make this workspace ready to run: Debian packages, a virtual environment, catkin_make, compiled loops.
# Does only what is missing or has changed; with nothing to do it needs neither network nor root.
set -euo pipefail

usage() {
    cat <<'TEXT'
Usage: ./setup.sh [--packages | --help]

Prepares a Debian 12 machine for this workspace, in four steps, each left out when it is done already:
  1. installs the Debian packages it needs (as root or through sudo),
  2. makes the virtual environment .venv from /usr/bin/python3 with the versions of requirements.txt,
  3. builds the workspace with catkin_make and that interpreter,
  4. compiles the renderer's loops (Numba), which the first start would wait for otherwise.

  --packages   print the Debian packages, one a line, and do nothing
  --help       print this
TEXT
}

# What the workspace needs of Debian, without recommendations.
packages=(
    # building: catkin, a compiler (CMake insists on one), and the messages ours are made of; their
    # definitions (ros-*-msgs) and their CMake files (lib*-dev) are packages of their own
    catkin cmake g++ make python3-venv ros-message-generation
    ros-actionlib-msgs ros-geometry-msgs ros-rosgraph-msgs ros-sensor-msgs ros-std-msgs ros-std-srvs
    ros-tf2-msgs ros-trajectory-msgs
    libactionlib-msgs-dev libgeometry-msgs-dev libsensor-msgs-dev libstd-msgs-dev libtrajectory-msgs-dev
    # running: the ROS tools, and the Python side of the messages and libraries that the nodes import
    ros-base rosbash python3-rospy python3-rosbag python3-actionlib python3-angles python3-dynamic-reconfigure
    python3-rosgraph-msgs python3-sensor-msgs python3-std-srvs python3-trajectory-msgs
    python3-tf python3-tf2-ros ros-robot-state-publisher rviz
    # the messages that dynamic_reconfigure's Python side loads are in its development package
    libdynamic-reconfigure-config-init-mutex-dev
    # rendering without a screen: EGL and Mesa's software rasteriser
    libegl1 libgl1-mesa-dri
    # checks
    catkin-lint liburdfdom-tools
)

fail() {
    printf 'setup.sh: %s\n' "$@" >&2
    exit 1
}

# step TEXT COMMAND...: run a command quietly; its output goes to the log, whose end is shown when it fails.
step() {
    local text=$1 start=$SECONDS
    shift
    printf '%s ... ' "$text"
    if "$@" >>"$log" 2>&1; then
        printf 'done (%d s)\n' "$((SECONDS - start))"
    else
        printf 'failed\n'
        tail -n 20 "$log" >&2
        fail "this step failed: $text" "the whole output is in $log"
    fi
}

case "${1-}" in
    "") ;;
    --packages) printf '%s\n' "${packages[@]}"; exit ;;
    -h | --help) usage; exit ;;
    *) usage >&2; fail "unknown option $1" ;;
esac

cd "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")"
root=$PWD
log=$root/build/setup.log

# Only Debian's own tools and ROS count here: a pyenv, a conda or another sourced ROS workspace in the
# caller's shell must not end up in the build (CMake looks for packages beside the folders of PATH too).
export PATH=/usr/local/sbin:/usr/sbin:/sbin:/usr/bin:/bin
unset CMAKE_PREFIX_PATH ROS_PACKAGE_PATH ROS_ROOT ROS_ETC_DIR PYTHONPATH PYTHONHOME VIRTUAL_ENV

[[ $root != *[[:space:]]* ]] ||
    fail "the interpreter's path stands in the first line of every node, which cannot carry a space:" \
        "  $root" "Move the workspace to a folder without spaces in its path."
system=$(. /etc/os-release && printf '%s %s' "${ID:-unknown}" "${VERSION_ID:-}")
[[ $system == "debian 12" ]] ||
    fail "this workspace is made for Debian 12 (bookworm), which ships ROS 1; this is '$system'." \
        "Use a Debian 12 machine, or the container in docker/."

# One set-up at a time: demo.sh and test.sh may be started together.
exec 9<"$root/setup.sh"
flock 9

# 1. Debian packages
missing=()
declare -A installed=()
while read -r status name; do
    [[ $status == installed ]] && installed[$name]=yes
done < <(dpkg-query -W -f='${db:Status-Status} ${Package}\n' "${packages[@]}" 2>/dev/null || true)
for name in "${packages[@]}"; do
    [[ -n ${installed[$name]-} ]] || missing+=("$name")
done
if ((${#missing[@]})); then
    as_root=()
    if ((EUID != 0)); then
        as_root=(sudo)
        # With a terminal sudo may ask for the password; without one only a password-free sudo helps.
        if ! command -v sudo >/dev/null || ! { sudo -n true 2>/dev/null || { [[ -t 0 ]] && sudo -v; }; }; then
            fail "these Debian packages are missing, and installing them needs root:" "  ${missing[*]}" \
                "As root, run:  apt-get update && apt-get install --no-install-recommends ${missing[*]}" \
                "then start again."
        fi
    fi
    mkdir -p build
    echo "Installing Debian packages: ${missing[*]}"
    step "  apt-get update" "${as_root[@]}" apt-get update
    step "  apt-get install (this may take some minutes)" "${as_root[@]}" env DEBIAN_FRONTEND=noninteractive \
        apt-get install -y --no-install-recommends "${missing[@]}"
fi

# digest FILE...: one hash of the files' names and contents, and of the text on standard input.
digest() {
    { cat; sha256sum -- "$@"; } | sha256sum | cut -d ' ' -f 1
}

# 2. virtual environment; its scripts know where they stand, so a moved workspace gets a new one
stamp=$(printf '%s\n' "$root" "$(/usr/bin/python3 -V)" | digest requirements.txt)
if [[ $(cat .venv/setup.stamp 2>/dev/null) != "$stamp" ]]; then
    mkdir -p build
    step "Making the virtual environment .venv" \
        /usr/bin/python3 -m venv --clear --system-site-packages .venv
    step "Installing the Python packages of requirements.txt" \
        .venv/bin/python -m pip install --disable-pip-version-check --no-input -r requirements.txt
    printf '%s\n' "$stamp" >.venv/setup.stamp
fi

# 3. workspace. Python files are not in the stamp: the devel space refers to them where they stand.
mapfile -d '' sources < <(find src -type f \( -name package.xml -o -name CMakeLists.txt -o -name '*.cmake' \
    -o -name setup.py -o -path '*/msg/*.msg' -o -path '*/srv/*.srv' -o -path '*/action/*.action' \) -print0 |
    sort -z)
# Our upstream_msgs step aside for installed ones, so their coming and going is a change too.
others=$(ls -d /usr/share/{control_msgs,controller_manager_msgs,gazebo_msgs}/cmake/*Config.cmake 2>/dev/null || true)
stamp=$(printf '%s\n' "$root" "$others" | digest "${sources[@]}")
if [[ $(cat devel/setup.stamp 2>/dev/null) != "$stamp" ]]; then
    # CMake refuses a build folder that was configured elsewhere.
    if [[ -e build/CMakeCache.txt ]] && ! grep -qxF "CMAKE_HOME_DIRECTORY:INTERNAL=$root/src" build/CMakeCache.txt; then
        rm -rf build devel
    fi
    mkdir -p build
    rm -f devel/setup.stamp src/upstream_msgs/*/CATKIN_IGNORE
    # Without --force-cmake a package that has come or gone in /usr would not be noticed.
    # Python and C++ messages are enough; the Lisp ones would take a third of the build.
    step "Building the workspace" env ROS_LANG_DISABLE=genlisp \
        catkin_make --force-cmake -DPYTHON_EXECUTABLE="$root/.venv/bin/python"
    printf '%s\n' "$stamp" >devel/setup.stamp
fi

# 4. loops; kept beside their sources, and compiled anew when those are newer
rendering=src/aras_sim_bridge/src/aras_sim_bridge/rendering
if [[ ! -e devel/loops.stamp || -n $(find "$rendering" -name '*.py' -newer devel/loops.stamp -print -quit) ]]; then
    touch devel/loops.begun
    step "Compiling the renderer's loops" env PYTHONPATH="${rendering%/*/*}" \
        .venv/bin/python -c "import aras_sim_bridge.rendering.opengl"
    mv devel/loops.begun devel/loops.stamp
fi

#!/usr/bin/env bash
# Make this workspace ready to run: Debian packages, a virtual environment, catkin_make, compiled loops.
# Does only what is missing or has changed; with nothing to do it needs neither network nor root.
set -euo pipefail

usage() {
    cat <<'TEXT'
Usage: ./setup.sh [--for running|bench|developing] [--packages] [--help]

Prepares a Debian 12 or 13 machine for this workspace, in four steps, each left out when it is done already:
  1. installs the Debian packages it needs (as root or through sudo),
  2. makes the virtual environment .venv from /usr/bin/python3 with the versions in requirements/,
  3. builds the workspace with catkin_make and that interpreter,
  4. compiles loops (Numba), which the first start would wait for otherwise.

  --for TIER   how much is installed: `running` is the simulator with its nodes, `bench` (default) also
               experiments without ROS, the demo and its plots, `developing` also linters and tests;
               what is there already stays
  --packages   print the Debian packages of that tier, one a line, and do nothing
  --help       print this
TEXT
}

fail() {
    printf 'setup.sh: %s\n' "$@" >&2
    exit 1
}

tiers=(running bench developing)
tier=bench list=""
while (($#)); do
    case "$1" in
        --for=*) set -- --for "${1#*=}" "${@:2}" ;;
    esac
    case "$1" in
        --for)
            [[ " ${tiers[*]} " == *" ${2-} "* && -n ${2-} ]] || fail "--for takes one of: ${tiers[*]}"
            tier=$2
            shift 2
            ;;
        --packages) list=yes; shift ;;
        -h | --help) usage; exit ;;
        *) usage >&2; fail "unknown option $1" ;;
    esac
done

# --- What differs between systems, all of it -----------------------------------------------------
system=$(. /etc/os-release && printf '%s %s' "${ID:-unknown}" "${VERSION_ID:-}")
of_this_system=() # more Debian packages
pybullet_wheel=yes # whether PyPI has PyBullet built for this system's Python
case "$system" in
    "debian 12") ;;
    "debian 13")
        of_this_system=(python3-dev ros-environment) # building PyBullet; setting ROS_PACKAGE_PATH
        pybullet_wheel=""
        ;;
    ubuntu*)
        unsupported="Ubuntu has no ROS 1 of its own, and ROS One's packages (/opt/ros/one) go by other names: install \
ros-one-desktop, catkin and python3-venv, then build by hand as the README's section 'The ROS way' says; untested."
        ;;
    *) unsupported="Use Debian 12 or 13, which ship ROS 1, or the container in docker/." ;;
esac
[[ -z ${CONDA_PREFIX-} ]] ||
    conda="A conda shell is active; RoboStack's ROS is not used: its Python could not see Debian's rospy."
# -------------------------------------------------------------------------------------------------

# What the workspace needs of Debian, without recommendations.
packages=(
    # building: catkin, a compiler (CMake insists on one), and the messages ours are made of; their
    # definitions (ros-*-msgs) and their CMake files (lib*-dev) are packages of their own
    catkin cmake g++ make python3-venv ros-message-generation
    ros-actionlib-msgs ros-geometry-msgs ros-rosgraph-msgs ros-sensor-msgs ros-std-msgs ros-std-srvs
    ros-tf2-msgs ros-trajectory-msgs
    libactionlib-msgs-dev libgeometry-msgs-dev libsensor-msgs-dev libstd-msgs-dev libtrajectory-msgs-dev
    # running: the ROS tools, and the Python side of the messages and libraries that the nodes import
    ros-base rosbash python3-rospy python3-rosbag python3-actionlib python3-dynamic-reconfigure
    python3-rosgraph-msgs python3-sensor-msgs python3-std-srvs python3-trajectory-msgs
    python3-tf python3-tf2-ros python3-visualization-msgs ros-robot-state-publisher rviz
    # the messages that dynamic_reconfigure's Python side loads are in its development package
    libdynamic-reconfigure-config-init-mutex-dev
    "${of_this_system[@]}"
)
# Linters; EGL with Mesa's rasteriser and ROS's angles to compare with; a browser without a window for the live page.
[[ $tier != developing ]] || packages+=(
    catkin-lint liburdfdom-tools libegl1 libgl1-mesa-dri python3-angles chromium-headless-shell
)
if [[ -n $list ]]; then
    printf '%s\n' "${packages[@]}"
    exit
fi

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
        local why=""
        [[ "$*" != *apt-get* && "$*" != *pip* ]] || why=" (is there a network?)"
        (($(df --output=avail -k . | tail -n 1) > 100000)) || why=" (the disk is full)"
        fail "this step failed: $text$why" "the whole output is in $log; start again when it is mended"
    fi
}

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
[[ -z ${unsupported-} ]] || fail "this is '$system'. $unsupported" ${conda:+"$conda"}
[[ $(uname -m) == x86_64 ]] ||
    fail "this machine is $(uname -m): PyPI has PyBullet and Pinocchio built for x86_64 alone. Use an x86_64 machine."

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

# 2. virtual environment; its scripts know where they stand, so a moved workspace gets a new one. A tier holds
# those before it: what was asked for once stays, and asking for more adds to it.
pip() {
    .venv/bin/python -m pip --disable-pip-version-check --no-input "$@"
}

# PyBullet from its sources where PyPI has no wheel. NumPy has to be there while it is built, or its pictures
# come as tuples. The wheel is kept: it takes minutes. Newer GCCs take one of its conversions for an error.
pybullet_from_source() {
    local wheels=${XDG_CACHE_HOME:-$HOME/.cache}/aras-visual-servo/$(.venv/bin/python -c \
        'import sys; print("cp%d%d" % sys.version_info[:2])')
    pip install -r requirements/building.txt
    mkdir -p "$wheels"
    [[ -e $(ls "$wheels/${1/==/-}"-*.whl 2>/dev/null | head -n 1) ]] ||
        CFLAGS="-O1 -g0 -w -Wno-error=incompatible-pointer-types" pip wheel --no-build-isolation --no-deps -w "$wheels" "$1"
    pip install --no-deps --no-index --find-links "$wheels" "$1"
}

base=$(printf '%s\n' "$root" "$(/usr/bin/python3 -V)" | digest requirements/*.txt)
stamped="" having=""
[[ ! -e .venv/setup.stamp ]] || read -r stamped having <.venv/setup.stamp || true
if [[ $stamped != "$base" ]]; then
    having=""
    mkdir -p build
    rm -rf .venv/setup.stamp
    step "Making the virtual environment .venv" \
        /usr/bin/python3 -m venv --clear --system-site-packages .venv
    if [[ -z $pybullet_wheel ]]; then
        step "Building PyBullet for this Python (once, some three minutes)" \
            pybullet_from_source "$(grep -hx 'pybullet==.*' requirements/running.txt)"
    fi
fi
if [[ " ${tiers[*]} " != *" $tier "*"${having:-none} "* ]]; then
    step "Installing the Python packages for $tier (requirements/$tier.txt)" pip install -r "requirements/$tier.txt"
    printf '%s %s\n' "$base" "$tier" >.venv/setup.stamp
fi

# 3. workspace. Python files are not in the stamp: the devel space refers to them where they stand.
mapfile -d '' sources < <(find src -type f \( -name package.xml -o -name CMakeLists.txt -o -name '*.cmake' \
    -o -name setup.py -o -path '*/msg/*.msg' -o -path '*/srv/*.srv' -o -path '*/action/*.action' \) -print0 |
    sort -z)
# Our upstream_msgs step aside for installed ones, so their coming and going is a change too.
others=$(ls -d /usr/share/{control_msgs,controller_manager_msgs,gazebo_msgs}/cmake/*Config.cmake 2>/dev/null || true)
# Older catkin asks for the one name of the interpreter, CMake's own module for the other.
arguments=(-DPYTHON_EXECUTABLE="$root/.venv/bin/python" -DPython_EXECUTABLE="$root/.venv/bin/python")
stamp=$(printf '%s\n' "${arguments[@]}" "$others" | digest "${sources[@]}")
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
        catkin_make --force-cmake "${arguments[@]}"
    printf '%s\n' "$stamp" >devel/setup.stamp
fi

# 4. loops; kept beside their sources, and compiled anew when those are newer
mapfile -t loops < <(grep -rlE '^from .*compiled import' --include='*.py' src/*/src)
if [[ ! -e devel/loops.stamp || -n $(find "${loops[@]}" -newer devel/loops.stamp -print -quit) ]]; then
    touch devel/loops.begun
    modules=("${loops[@]#src/*/src/}")
    modules=("${modules[@]%.py}")
    libraries=(src/*/src)
    # the packages side by side, each in a process of its own
    step "Compiling loops" env PYTHONPATH="$(IFS=:; echo "${libraries[*]}")" .venv/bin/python - "${modules[@]}" <<'PYTHON'
import subprocess, sys
packages = {}
for path in sys.argv[1:]:
    packages.setdefault(path.split("/")[0], []).append(path.replace("/", "."))
code = "import importlib, sys; [importlib.import_module(name) for name in sys.argv[1:]]"
processes = [subprocess.Popen([sys.executable, "-c", code, *names]) for names in packages.values()]
sys.exit(max([process.wait() for process in processes]))
PYTHON
    mv devel/loops.begun devel/loops.stamp
fi

#!/usr/bin/env bash
# Set up this workspace: Debian packages, virtual environment, catkin_make, compiled loops.
# Performs only steps that are missing or out of date; if there are none, it needs neither network nor root.
set -euo pipefail

usage() {
    cat <<'TEXT'
Usage: ./setup.sh [--for running|demo|bench|developing] [--packages | --packages-to-run] [--help]

Set up this workspace on Debian 12 or 13. Steps that are up to date are skipped:
  1. install Debian packages (as root or with sudo),
  2. create the virtual environment .venv from /usr/bin/python3 with the versions in requirements/,
  3. build the workspace with catkin_make and this interpreter,
  4. compile loops (Numba), which would delay the first start. Steps 3 and 4 run at the same time.

  --for TIER         tier to install: `running` is the simulator with its nodes, `demo` adds the plots of
                     ./demo.sh, `bench` (default) adds experiments without ROS and studies, `developing` adds
                     linters and tests; installed packages of other tiers are not removed
  --packages         print the Debian packages of the tier, one per line, and exit
  --packages-to-run  print them without packages that only the build needs, for a machine or container image to
                     which a finished workspace is copied (to the same path)
  --help             print this help

example: ./setup.sh --for developing
TEXT
}

fail() {
    printf 'setup.sh: %s\n' "$@" >&2
    exit 1
}

trap 'exit 130' INT # otherwise Bash ignores an interrupt during a command that then ends normally

tiers=(running demo bench developing)
tier=bench list=""
while (($#)); do
    case "$1" in
        --for=*) set -- --for "${1#*=}" "${@:2}" ;;
    esac
    case "$1" in
        --for)
            [[ " ${tiers[*]} " == *" ${2-} "* && -n ${2-} ]] || fail "--for must be one of: ${tiers[*]}"
            tier=$2
            shift 2
            ;;
        --packages) list=all; shift ;;
        --packages-to-run) list=running; shift ;;
        -h | --help) usage; exit ;;
        *) usage >&2; fail "unknown option $1" ;;
    esac
done

# --- Differences between systems -----------------------------------------------------
system=$(. /etc/os-release && printf '%s %s' "${ID:-unknown}" "${VERSION_ID:-}")
for_building=() for_running=() # additional Debian packages
for_environment=(python3-venv) # packages that creating .venv needs
pybullet_wheel=yes # yes if PyPI has a PyBullet wheel for this system's Python
python=""
case "$system" in
    "debian 12") python=3.11 ;;
    "debian 13")
        python=3.13
        pybullet_wheel=""
        for_building=(python3-dev)    # for PyBullet
        for_environment+=(g++ python3-dev)
        for_running=(ros-environment) # sets ROS_PACKAGE_PATH
        ;;
    ubuntu*)
        unsupported="Ubuntu does not provide ROS 1. Use the container in docker/, or install ROS One manually: \
see docs/installing.md, 'Other systems'."
        ;;
    *) unsupported="Use Debian 12 or 13, which provide ROS 1, or the container in docker/." ;;
esac
[[ -z ${CONDA_PREFIX-} ]] ||
    conda="A conda shell is active; RoboStack's ROS is not used (docs/installing.md, 'Other systems')."
# -------------------------------------------------------------------------------------------------

# Debian packages of the workspace, without recommended packages. The build needs catkin, a compiler (required by
# CMake), and the messages that our messages contain: their definitions (ros-*-msgs) and their CMake files
# (lib*-dev) are separate packages.
building=(
    catkin cmake g++ make python3-venv ros-base ros-message-generation
    ros-actionlib-msgs ros-geometry-msgs ros-nav-msgs ros-rosgraph-msgs ros-sensor-msgs ros-std-msgs
    ros-std-srvs ros-tf2-msgs ros-trajectory-msgs
    libactionlib-msgs-dev libgeometry-msgs-dev libsensor-msgs-dev libstd-msgs-dev libtrajectory-msgs-dev
    "${for_building[@]}"
)
# The nodes need the ROS tools, and the Python modules of messages and libraries.
running=(
    rosbash rosout python3-roslaunch python3-rosmaster python3-rosmsg python3-rosnode python3-rosparam
    python3-rosservice python3-rostopic
    python3-rospy python3-rosbag python3-actionlib python3-dynamic-reconfigure
    python3-nav-msgs python3-rosgraph-msgs python3-sensor-msgs python3-std-srvs python3-trajectory-msgs
    python3-tf python3-tf2-ros python3-visualization-msgs ros-robot-state-publisher rviz
    joint-state-publisher # started by launch files of many descriptions
    # this development package contains the messages that dynamic_reconfigure loads in Python
    libdynamic-reconfigure-config-init-mutex-dev
    "${for_running[@]}"
)
# Linters; EGL with Mesa's rasteriser and ROS's angles to compare with; a browser without a window for the live page;
# KaTeX for the formulas of the documentation site.
[[ $tier != developing ]] || running+=(
    catkin-lint liburdfdom-tools libegl1 libgl1-mesa-dri python3-angles chromium-headless-shell
    libjs-katex
)
packages=("${building[@]}" "${running[@]}")
if [[ -n $list ]]; then
    [[ $list == all ]] || packages=("${running[@]}")
    printf '%s\n' "${packages[@]}"
    exit
fi

# free_space FOLDER: print the free space of its disk, MB.
free_space() {
    df --output=avail --block-size=1M "$1" | tail -n 1
}

# open_log: create the log file, or fail with the reason.
open_log() {
    [[ -z ${log_is_open-} ]] || return 0
    { mkdir -p build && : >"$log"; } 2>/dev/null ||
        fail "cannot write to $root/build: it belongs to another user, is read-only, or the disk is full ($(free_space "$root") MB left)"
    log_is_open=yes
}

# step TEXT COMMAND...: run a command with its output in the log; print the end of the log if it fails.
step() {
    local text=$1 start=$SECONDS why=""
    shift
    open_log
    printf '%s ... ' "$text"
    if "$@" >>"$log" 2>&1; then
        printf 'done (%d s)\n' "$((SECONDS - start))"
        return
    fi
    printf 'failed\n'
    if grep -qE 'Temporary failure resolving|Could not resolve|Failed to establish a new connection|NameResolutionError|Network is unreachable|Unable to locate package' "$log"; then
        why="; there seems to be no network (or a proxy must be set: http_proxy, https_proxy)"
    fi
    # pip deletes its files when it fails, so the disk may have free space again
    ! grep -q 'No space left on device' "$log" || why="; a disk was full: free some space"
    for folder in "$root" /usr /var "${TMPDIR:-/tmp}"; do
        (($(free_space "$folder") > 100)) || why="; the disk of $folder is full: free some space"
    done
    [[ -n $why ]] || tail -n 20 "$log" >&2
    fail "this step failed: $text$why" "the complete output is in $log; fix the cause and start setup.sh again (finished steps are skipped)"
}

declare -A background=() # process groups of functions that run in the background, by name

# start_in_background FUNCTION...: run functions at the same time, because none of them uses all cores. If this script
# ends first, it stops them and waits for their end, because they hold its lock. While they run, this script does
# not use $(...), because Bash ignores an interrupt that arrives while such a command ends.
start_in_background() {
    local name
    open_log
    set -m # each gets a separate process group
    trap stop_background EXIT
    for name in "$@"; do
        "$name" </dev/null >"build/setup.$name.log" 2>&1 &
        background[$name]=$!
    done
    set +m
}

stop_background() {
    local turn signal
    for turn in {0..99}; do
        signal=0 # only tests whether the processes exist
        ((turn % 20)) || signal=TERM # every second, because a command that Bash has just started may miss a signal
        # the last process may not be in `background` yet
        kill -s "$signal" -- "${background[@]/#/-}" "-$!" 2>/dev/null || return 0
        sleep 0.05
    done
}

# wait_for FUNCTION...: wait for functions in the background, then print their outputs, failed ones last.
wait_for() {
    local name failed=()
    for name in "$@"; do
        wait "${background[$name]}" && cat "build/setup.$name.log" || failed+=("$name")
        unset "background[$name]"
    done
    ((${#background[@]})) || trap - EXIT
    for name in "${failed[@]}"; do
        cat "build/setup.$name.log"
    done
    ((${#failed[@]} == 0))
}

cd "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")"
root=$PWD
log=$root/build/setup.log

# Use only Debian's own tools and ROS. A pyenv, a conda or another ROS workspace in the caller's shell must not
# affect the build (CMake also searches for packages next to the folders of PATH), and pip must install into
# .venv regardless of the user's settings.
export PATH=/usr/local/sbin:/usr/sbin:/sbin:/usr/bin:/bin
unset CMAKE_PREFIX_PATH ROS_PACKAGE_PATH ROS_ROOT ROS_ETC_DIR PYTHONPATH PYTHONHOME VIRTUAL_ENV
unset CC CXX CFLAGS CXXFLAGS LDFLAGS PIP_TARGET PIP_PREFIX PIP_REQUIRE_VIRTUALENV
export PIP_USER=0

# Check for conditions that prevent the set-up.
[[ $root != *[[:space:]]* ]] ||
    fail "the first line of every node contains the path of the interpreter, which must not contain a space:" \
        "  $root" "Move the workspace to a folder without spaces in its path."
[[ $root != *[\;:\$\&\(\)\<\>\|\*\?\'\"\\\`\#\%\!\{\}\[\]=]* ]] ||
    fail "this path contains a character that search paths or CMake do not support: $root" \
        "Move the workspace to a folder whose path has only letters, digits, and _ - . + , @ ~."
((${#root} <= 200)) || fail "this path is too long for the first line of a node: $root" \
    "Move the workspace to a folder with a path of at most 200 letters."
[[ ! -L .venv ]] || fail ".venv is a link to $(readlink .venv), whose contents would be replaced: rm .venv, then start setup.sh again"
[[ -z ${unsupported-} ]] || fail "this is '$system'. $unsupported" ${conda:+"$conda"}
[[ $(uname -m) == x86_64 ]] ||
    fail "this machine is $(uname -m), but PyPI has PyBullet only for x86_64. Use an x86_64 machine."
if [[ -e /usr/bin/python3 ]]; then
    found=$(/usr/bin/python3 -c 'import sys; print("%d.%d" % sys.version_info[:2])' 2>&1 || true)
    [[ $found == "$python" ]] ||
        fail "/usr/bin/python3 is Python ${found:-?}, but this system's ROS needs Python $python." \
            "Restore the link: ln -sf python$python /usr/bin/python3  (as root)"
fi

# Only one set-up may run at a time; demo.sh and test.sh may be started together.
exec 9<"$root/setup.sh"
flock -n 9 || { echo "Another set-up of this workspace is running; waiting until it ends."; flock 9; }

# require_space FOLDER MB: fail if a disk has too little free space.
require_space() {
    (($(free_space "$1") >= $2)) ||
        fail "this needs about $2 MB below $1, where $(free_space "$1") MB are left: free some space and start setup.sh again"
}

# 1. Debian packages
missing=() early=()
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
        # Without a terminal, sudo works only if it needs no password.
        if ! command -v sudo >/dev/null || ! { sudo -n true 2>/dev/null || { [[ -t 0 ]] && sudo -v; }; }; then
            fail "these Debian packages are missing, and their installation needs root:" "  ${missing[*]}" \
                "As root, run:  apt-get update && apt-get install --no-install-recommends ${missing[*]}" \
                "then start setup.sh again."
        fi
    fi
    install() {
        "${as_root[@]}" env DEBIAN_FRONTEND=noninteractive \
            apt-get -o DPkg::Lock::Timeout=600 install -y --no-install-recommends "$@"
    }
    ((${#missing[@]} < 20)) || require_space /usr 2000
    echo "Installing Debian packages: ${missing[*]}"
    # Complete an interrupted installation first; apt-get waits for one that another process runs.
    [[ -z $(ls /var/lib/dpkg/updates 2>/dev/null; dpkg --audit 2>/dev/null) ]] ||
        step "  dpkg --configure -a (an earlier installation was interrupted)" "${as_root[@]}" \
            env DEBIAN_FRONTEND=noninteractive dpkg --configure -a
    step "  apt-get update" "${as_root[@]}" apt-get -o DPkg::Lock::Timeout=600 update
    for name in "${for_environment[@]}"; do
        [[ -n ${installed[$name]-} ]] || early+=("$name")
    done
    ((${#early[@]} == 0)) || step "  apt-get install ${early[*]}" install "${early[@]}"
fi

# digest FILE...: print one hash of the names and contents of files, and of the text on standard input.
digest() {
    { cat; sha256sum -- "$@"; } | sha256sum | cut -d ' ' -f 1
}

# 2. Virtual environment. Its scripts contain its path, so a workspace that was moved gets a new one. Each tier
# includes the previous ones; a tier that is installed is not removed.
pip() {
    .venv/bin/python -m pip --disable-pip-version-check --no-input "$@"
}

# pybullet_from_source REQUIREMENT: build PyBullet if PyPI has no wheel. NumPy must be installed during the build,
# otherwise PyBullet returns images as tuples. The wheel is cached, because the build takes minutes. One of its
# conversions is an error for newer GCCs.
pybullet_from_source() {
    local wheels=${XDG_CACHE_HOME:-$HOME/.cache}/aras-visual-servo/$(.venv/bin/python -c \
        'import sys; print("cp%d%d" % sys.version_info[:2])')
    pip install -r requirements/building.txt && mkdir -p "$wheels" || return
    if [[ ! -e $(ls "$wheels/${1/==/-}"-*.whl 2>/dev/null | head -n 1) ]]; then
        # Compile the physics (src/) with the optimisation of PyPI's wheels, the other files faster, with -O1.
        printf '%s\n' '#!/bin/sh' 'case " $* " in *" -c src/"*) exec g++ "$@" ;; esac' 'exec g++ "$@" -O1' >.venv/bin/c++ &&
            chmod +x .venv/bin/c++ &&
            CXX=$root/.venv/bin/c++ CXXFLAGS="-O2 -g0 -w" CFLAGS="-O1 -g0 -w -Wno-error=incompatible-pointer-types" \
                pip wheel --no-build-isolation --no-deps -w "$wheels" "$1" || return
    fi
    pip install --no-deps --no-index --find-links "$wheels" "$1"
}

base=$(printf '%s\n' "$root" "$(/usr/bin/python3 -V)" | digest requirements/*.txt)
stamped="" installed_tier=""
[[ ! -e .venv/setup.stamp ]] || read -r stamped installed_tier <.venv/setup.stamp || true
including_tiers=" ${tiers[*]} " # the tiers that include this one, which is the first of them
including_tiers=" $tier ${including_tiers#* "$tier" }"
making=""
if [[ $stamped != "$base" ]]; then
    installed_tier=""
    require_space "$root" 2500
    making="Making the virtual environment .venv"
    [[ -n $pybullet_wheel ]] || making+=", building PyBullet for this Python (once, about two minutes)"
    making+=", installing the Python packages for $tier (requirements/$tier.txt)"
elif [[ $including_tiers != *" ${installed_tier:-none} "* ]]; then
    making="Installing the Python packages for $tier (requirements/$tier.txt)"
fi
environment() {
    if [[ $stamped != "$base" ]]; then
        # Hide Debian's packages until pip has finished: some may be only partly installed, and pip would use them.
        # The stamp makes an interrupted installation continue after this block.
        rm -f .venv/setup.stamp &&
            /usr/bin/python3 -m venv --clear .venv &&
            { [[ -n $pybullet_wheel ]] ||
                pybullet_from_source "$(grep -hx 'pybullet==.*' requirements/running.txt)"; } &&
            printf '%s\n' "$base" >.venv/setup.stamp || return
    fi
    touch .venv/bytecode.due &&
        pip install --no-compile -r "requirements/$tier.txt" &&
        sed -i 's/^include-system-site-packages = .*/include-system-site-packages = true/' .venv/pyvenv.cfg &&
        printf '%s %s\n' "$base" "$tier" >.venv/setup.stamp
}
[[ -z $making ]] || start_in_background environment
# At the same time, install the other Debian packages.
((${#missing[@]} == ${#early[@]})) || step "  apt-get install (this may take some minutes)" install "${missing[@]}"

# 3. Workspace. Its stamp does not include Python files, because the devel space refers to the originals.
mapfile -d '' sources < <(find src -type f \( -name package.xml -o -name CMakeLists.txt -o -name '*.cmake' \
    -o -name setup.py -o -path '*/msg/*.msg' -o -path '*/srv/*.srv' -o -path '*/action/*.action' \) -print0 |
    sort -z)
# Packages with upstream's names are not built if the originals are installed, so these are part of the stamp.
shopt -s nullglob
others=()
for name in src/upstream_*/*/package.xml; do
    name=${name%/package.xml}
    others+=(/usr/share/"${name##*/}"/cmake/*Config.cmake)
done
shopt -u nullglob
# Older catkin reads the first of these variables, CMake's own module the second.
arguments=(-DPYTHON_EXECUTABLE="$root/.venv/bin/python" -DPython_EXECUTABLE="$root/.venv/bin/python")
read -r stamp < <(printf '%s\n' "${arguments[@]}" "${others[@]}" | digest "${sources[@]}")
due=() descriptions=() built=""
[[ ! -e devel/setup.stamp ]] || read -r built <devel/setup.stamp || true
if [[ $built != "$stamp" ]]; then
    due+=(build)
    descriptions+=("building the workspace")
fi
build() {
    # Use the interpreter of the environment, which exists before pip runs, and Debian's packages.
    local made=""
    until { read -r made _ <.venv/setup.stamp; } 2>/dev/null && [[ $made == "$base" ]]; do sleep 0.1; done
    # CMake refuses a build folder that was configured for another path.
    if [[ -e build/CMakeCache.txt ]] && ! grep -qxF "CMAKE_HOME_DIRECTORY:INTERNAL=$root/src" build/CMakeCache.txt; then
        find build -mindepth 1 -maxdepth 1 ! -name 'setup*.log' -exec rm -rf {} + && rm -rf devel
    fi
    # --force-cmake detects packages that were installed in or removed from /usr. Lisp messages are not generated,
    # because they would take a third of the build time.
    rm -f devel/setup.stamp src/upstream_*/*/CATKIN_IGNORE &&
        PYTHONPATH=/usr/lib/python3/dist-packages ROS_LANG_DISABLE=genlisp catkin_make --force-cmake "${arguments[@]}" &&
        printf '%s\n' "$stamp" >devel/setup.stamp
}
if [[ -n $making ]]; then # pip uses only one core
    ((${#due[@]} == 0)) || start_in_background "${due[@]}"
    step "$making" wait_for environment
fi
rm -f .venv/bin/xacro # PyPI's xacro does not find ROS 1 packages; use that of the workspace, in devel/bin

# 4. Compiled loops, stored next to their sources and compiled again when these change.
mapfile -t loops < <(grep -rlE '^from .*compiled import' --include='*.py' src/*/src)
for file in "${loops[@]}"; do
    if [[ $file -nt .venv/loops.stamp ]]; then
        due+=(compile_loops)
        descriptions+=("compiling loops")
        break
    fi
done
compile_loops() {
    local libraries=(src/*/src) packages=("${loops[@]#src/*/src/}")
    mapfile -t packages < <(printf '%s\n' "${packages[@]%%/*}" | sort -u)
    touch .venv/loops.started &&
        PYTHONPATH=$(IFS=:; echo "${libraries[*]}") \
            .venv/bin/python -m aras_visual_servo_base.compile_packages "${packages[@]}" &&
        mv .venv/loops.started .venv/loops.stamp
}

# Compile the installed Python packages to bytecode on all cores; pip would use only one.
[[ ! -e .venv/bytecode.due ]] || due+=(bytecode)
bytecode() {
    # Skip tests of packages, and packages that only training, tables and tests import. These are two thirds of all files;
    # Python compiles them when they are imported.
    local rare='/(tests?|pip|setuptools|pkg_resources|pybullet_envs|pandas|sklearn|fontTools|pygments|sphinx|docutils'
    rare+='|snowballstemmer|babel|mujoco|hypothesis)/'
    # Parallel compilation needs semaphores, which some containers lack. Some packages contain templates that are not
    # valid Python, so the status is ignored.
    .venv/bin/python -m compileall -q -q -j 0 -x "$rare" .venv/lib || .venv/bin/python -m compileall -q -q -x "$rare" .venv/lib || true
    rm .venv/bytecode.due
}

if ((${#due[@]})); then
    printf -v text '%s, ' "${descriptions[@]-byte-compiling the Python packages}"
    text=${text%, }
    for name in "${due[@]}"; do
        [[ -n ${background[$name]-} ]] || start_in_background "$name"
    done
    step "${text^}" wait_for "${due[@]}"
fi

#!/usr/bin/env bash
# Make this workspace ready to run: Debian packages, a virtual environment, catkin_make, compiled loops.
# Does only what is missing or has changed; with nothing to do it needs neither network nor root.
set -euo pipefail

usage() {
    cat <<'TEXT'
Usage: ./setup.sh [--for running|demo|bench|developing] [--packages | --packages-to-run] [--help]

Prepares a Debian 12 or 13 machine for this workspace, in four steps, each left out when it is done already:
  1. installs the Debian packages it needs (as root or through sudo),
  2. makes the virtual environment .venv from /usr/bin/python3 with the versions in requirements/,
  3. builds the workspace with catkin_make and that interpreter,
  4. compiles loops (Numba), which the first start would wait for otherwise. The third runs beside the others.

  --for TIER         how much is installed: `running` is the simulator with its nodes, `demo` also what ./demo.sh
                     draws its plots with, `bench` (default) also experiments without ROS and studies,
                     `developing` also linters and tests; what is there already stays
  --packages         print the Debian packages of that tier, one a line, and do nothing
  --packages-to-run  the same, without those that only building needs: for a machine (an image, say) to which
                     a workspace is copied that was made elsewhere, to the same path
  --help             print this

example: ./setup.sh --for developing
TEXT
}

fail() {
    printf 'setup.sh: %s\n' "$@" >&2
    exit 1
}

trap 'exit 130' INT # or Bash forgets an interrupt while a command runs that then ends as usual

tiers=(running demo bench developing)
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
        --packages) list=all; shift ;;
        --packages-to-run) list=running; shift ;;
        -h | --help) usage; exit ;;
        *) usage >&2; fail "unknown option $1" ;;
    esac
done

# --- What differs between systems, all of it -----------------------------------------------------
system=$(. /etc/os-release && printf '%s %s' "${ID:-unknown}" "${VERSION_ID:-}")
for_building=() for_running=() # more Debian packages
for_environment=(python3-venv) # what .venv is made with
pybullet_wheel=yes # whether PyPI has PyBullet built for this system's Python
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
        unsupported="Ubuntu has no ROS 1 of its own. Use the container in docker/, or ROS One by hand: \
what is missing for that is in docs/installing.md, 'Other systems'."
        ;;
    *) unsupported="Use Debian 12 or 13, which ship ROS 1, or the container in docker/." ;;
esac
[[ -z ${CONDA_PREFIX-} ]] ||
    conda="A conda shell is active; RoboStack's ROS is not used (docs/installing.md, 'Other systems')."
# -------------------------------------------------------------------------------------------------

# What the workspace needs of Debian, without recommendations. To build: catkin, a compiler (CMake insists on
# one), and the messages ours are made of; their definitions (ros-*-msgs) and their CMake files (lib*-dev) are
# packages of their own.
building=(
    catkin cmake g++ make python3-venv ros-base ros-message-generation
    ros-actionlib-msgs ros-geometry-msgs ros-nav-msgs ros-rosgraph-msgs ros-sensor-msgs ros-std-msgs
    ros-std-srvs ros-tf2-msgs ros-trajectory-msgs
    libactionlib-msgs-dev libgeometry-msgs-dev libsensor-msgs-dev libstd-msgs-dev libtrajectory-msgs-dev
    "${for_building[@]}"
)
# To run: the ROS tools, and the Python side of the messages and libraries that the nodes import.
running=(
    rosbash rosout python3-roslaunch python3-rosmaster python3-rosmsg python3-rosnode python3-rosparam
    python3-rosservice python3-rostopic
    python3-rospy python3-rosbag python3-actionlib python3-dynamic-reconfigure
    python3-nav-msgs python3-rosgraph-msgs python3-sensor-msgs python3-std-srvs python3-trajectory-msgs
    python3-tf python3-tf2-ros python3-visualization-msgs ros-robot-state-publisher rviz
    joint-state-publisher # which many descriptions start
    # the messages that dynamic_reconfigure's Python side loads are in its development package
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

# free FOLDER: MB that can be written there.
free() {
    df --output=avail --block-size=1M "$1" | tail -n 1
}

# begin: have a place for logs, or say why there is none.
begin() {
    [[ -z ${begun-} ]] || return 0
    { mkdir -p build && : >"$log"; } 2>/dev/null ||
        fail "cannot write to $root/build: is it another user's, or read-only, or the disk full ($(free "$root") MB left)?"
    begun=yes
}

# step TEXT COMMAND...: run a command quietly; its output goes to the log, whose end is shown when it fails.
step() {
    local text=$1 start=$SECONDS why=""
    shift
    begin
    printf '%s ... ' "$text"
    if "$@" >>"$log" 2>&1; then
        printf 'done (%d s)\n' "$((SECONDS - start))"
        return
    fi
    printf 'failed\n'
    if grep -qE 'Temporary failure resolving|Could not resolve|Failed to establish a new connection|NameResolutionError|Network is unreachable|Unable to locate package' "$log"; then
        why="; there seems to be no network (or a proxy is to be set: http_proxy, https_proxy)"
    fi
    # pip tidies up when it fails, so there may be room again by now
    ! grep -q 'No space left on device' "$log" || why="; a disk was full: make room"
    for folder in "$root" /usr /var "${TMPDIR:-/tmp}"; do
        (($(free "$folder") > 100)) || why="; the disk of $folder is full: make room"
    done
    [[ -n $why ]] || tail -n 20 "$log" >&2
    fail "this step failed: $text$why" "the whole output is in $log; start again when it is corrected: what is done stays done"
}

declare -A beside=() # process groups of functions that run beside this script, by their names

# aside FUNCTION...: run them beside what follows, for none of them fills a machine's cores by itself; when this
# script ends before them they end too, and it waits for that: they hold its lock. Beside them no $(...) is used:
# Bash forgets an interrupt that comes while one of those ends.
aside() {
    local name
    begin
    set -m # each is a process group of its own
    trap end_beside EXIT
    for name in "$@"; do
        "$name" </dev/null >"build/setup.$name.log" 2>&1 &
        beside[$name]=$!
    done
    set +m
}

end_beside() {
    local turn signal
    for turn in {0..99}; do
        signal=0 # asks whether they are there
        ((turn % 20)) || signal=TERM # each second anew: a command that Bash has only just begun may lose one
        # the last one begun may not stand in `beside` yet
        kill -s "$signal" -- "${beside[@]/#/-}" "-$!" 2>/dev/null || return 0
        sleep 0.05
    done
}

# ended FUNCTION...: wait for their end. Each prints in one piece, those that failed last.
ended() {
    local name failed=()
    for name in "$@"; do
        wait "${beside[$name]}" && cat "build/setup.$name.log" || failed+=("$name")
        unset "beside[$name]"
    done
    ((${#beside[@]})) || trap - EXIT
    for name in "${failed[@]}"; do
        cat "build/setup.$name.log"
    done
    ((${#failed[@]} == 0))
}

cd "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")"
root=$PWD
log=$root/build/setup.log

# Only Debian's own tools and ROS count here: a pyenv, a conda or another sourced ROS workspace in the
# caller's shell must not end up in the build (CMake looks for packages beside the folders of PATH too),
# and pip installs into .venv whatever the user's settings say.
export PATH=/usr/local/sbin:/usr/sbin:/sbin:/usr/bin:/bin
unset CMAKE_PREFIX_PATH ROS_PACKAGE_PATH ROS_ROOT ROS_ETC_DIR PYTHONPATH PYTHONHOME VIRTUAL_ENV
unset CC CXX CFLAGS CXXFLAGS LDFLAGS PIP_TARGET PIP_PREFIX PIP_REQUIRE_VIRTUALENV
export PIP_USER=0

# What stands in the way of any set-up, before anything is begun.
[[ $root != *[[:space:]]* ]] ||
    fail "the interpreter's path stands in the first line of every node, which cannot carry a space:" \
        "  $root" "Move the workspace to a folder without spaces in its path."
[[ $root != *[\;:\$\&\(\)\<\>\|\*\?\'\"\\\`\#\%\!\{\}\[\]=]* ]] ||
    fail "search paths and CMake cannot carry a sign of this path: $root" \
        "Move the workspace to a folder with letters, digits, and _ - . + , @ ~ alone in its path."
((${#root} <= 200)) || fail "this path is longer than the first line of a node can carry: $root" \
    "Move the workspace to a folder with a path of at most 200 letters."
[[ ! -L .venv ]] || fail ".venv is a link to $(readlink .venv), which would be made anew for this folder: rm .venv, and start again"
[[ -z ${unsupported-} ]] || fail "this is '$system'. $unsupported" ${conda:+"$conda"}
[[ $(uname -m) == x86_64 ]] ||
    fail "this machine is $(uname -m), tried is x86_64 alone: PyPI has PyBullet built for no other. Use an x86_64 machine."
if [[ -e /usr/bin/python3 ]]; then
    found=$(/usr/bin/python3 -c 'import sys; print("%d.%d" % sys.version_info[:2])' 2>&1 || true)
    [[ $found == "$python" ]] ||
        fail "/usr/bin/python3 is Python ${found:-?}, and this system's ROS is made for its own, $python." \
            "Point it back: ln -sf python$python /usr/bin/python3  (as root)"
fi

# One set-up at a time: demo.sh and test.sh may be started together.
exec 9<"$root/setup.sh"
flock -n 9 || { echo "Another set-up of this workspace is running; waiting for its end."; flock 9; }

# room FOLDER MB: stop before a disk is filled in vain.
room() {
    (($(free "$1") >= $2)) ||
        fail "this needs some $2 MB below $1, where $(free "$1") MB are left: make room and start again"
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
        # With a terminal sudo may ask for the password; without one only a password-free sudo helps.
        if ! command -v sudo >/dev/null || ! { sudo -n true 2>/dev/null || { [[ -t 0 ]] && sudo -v; }; }; then
            fail "these Debian packages are missing, and installing them needs root:" "  ${missing[*]}" \
                "As root, run:  apt-get update && apt-get install --no-install-recommends ${missing[*]}" \
                "then start again."
        fi
    fi
    install() {
        "${as_root[@]}" env DEBIAN_FRONTEND=noninteractive \
            apt-get -o DPkg::Lock::Timeout=600 install -y --no-install-recommends "$@"
    }
    ((${#missing[@]} < 20)) || room /usr 2000
    echo "Installing Debian packages: ${missing[*]}"
    # An installation that was cut short is ended first; one that is under way elsewhere is waited for.
    [[ -z $(ls /var/lib/dpkg/updates 2>/dev/null; dpkg --audit 2>/dev/null) ]] ||
        step "  dpkg --configure -a (an earlier installation was cut short)" "${as_root[@]}" \
            env DEBIAN_FRONTEND=noninteractive dpkg --configure -a
    step "  apt-get update" "${as_root[@]}" apt-get -o DPkg::Lock::Timeout=600 update
    for name in "${for_environment[@]}"; do
        [[ -n ${installed[$name]-} ]] || early+=("$name")
    done
    ((${#early[@]} == 0)) || step "  apt-get install ${early[*]}" install "${early[@]}"
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
    pip install -r requirements/building.txt && mkdir -p "$wheels" || return
    if [[ ! -e $(ls "$wheels/${1/==/-}"-*.whl 2>/dev/null | head -n 1) ]]; then
        # The physics (its src/) as quick as in PyPI's wheels; windows and importers around it in less time.
        printf '%s\n' '#!/bin/sh' 'case " $* " in *" -c src/"*) exec g++ "$@" ;; esac' 'exec g++ "$@" -O1' >.venv/bin/c++ &&
            chmod +x .venv/bin/c++ &&
            CXX=$root/.venv/bin/c++ CXXFLAGS="-O2 -g0 -w" CFLAGS="-O1 -g0 -w -Wno-error=incompatible-pointer-types" \
                pip wheel --no-build-isolation --no-deps -w "$wheels" "$1" || return
    fi
    pip install --no-deps --no-index --find-links "$wheels" "$1"
}

base=$(printf '%s\n' "$root" "$(/usr/bin/python3 -V)" | digest requirements/*.txt)
stamped="" having=""
[[ ! -e .venv/setup.stamp ]] || read -r stamped having <.venv/setup.stamp || true
from_it_on=" ${tiers[*]} " # the tiers that hold this one, itself the first
from_it_on=" $tier ${from_it_on#* "$tier" }"
making=""
if [[ $stamped != "$base" ]]; then
    having=""
    room "$root" 2500
    making="Making the virtual environment .venv"
    [[ -n $pybullet_wheel ]] || making+=", building PyBullet for this Python (once, some two minutes)"
    making+=", installing the Python packages for $tier (requirements/$tier.txt)"
elif [[ $from_it_on != *" ${having:-none} "* ]]; then
    making="Installing the Python packages for $tier (requirements/$tier.txt)"
fi
environment() {
    if [[ $stamped != "$base" ]]; then
        # Debian's packages stay out of sight until pip has done: they may be half installed, and pip would make do
        # with those that are. What is stopped in the middle of the second half goes on there.
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
[[ -z $making ]] || aside environment
# the other Debian packages meanwhile
((${#missing[@]} == ${#early[@]})) || step "  apt-get install (this may take some minutes)" install "${missing[@]}"

# 3. workspace. Python files are not in the stamp: the devel space refers to them where they stand.
mapfile -d '' sources < <(find src -type f \( -name package.xml -o -name CMakeLists.txt -o -name '*.cmake' \
    -o -name setup.py -o -path '*/msg/*.msg' -o -path '*/srv/*.srv' -o -path '*/action/*.action' \) -print0 |
    sort -z)
# Packages under upstream's names step aside for installed ones, so their coming and going is a change too.
shopt -s nullglob
others=()
for name in src/upstream_*/*/package.xml; do
    name=${name%/package.xml}
    others+=(/usr/share/"${name##*/}"/cmake/*Config.cmake)
done
shopt -u nullglob
# Older catkin asks for the one name of the interpreter, CMake's own module for the other.
arguments=(-DPYTHON_EXECUTABLE="$root/.venv/bin/python" -DPython_EXECUTABLE="$root/.venv/bin/python")
read -r stamp < <(printf '%s\n' "${arguments[@]}" "${others[@]}" | digest "${sources[@]}")
due=() telling=() built=""
[[ ! -e devel/setup.stamp ]] || read -r built <devel/setup.stamp || true
if [[ $built != "$stamp" ]]; then
    due+=(build)
    telling+=("building the workspace")
fi
build() {
    # By the environment's interpreter, which is there before pip is at work, and with Debian's packages in sight.
    local made=""
    until { read -r made _ <.venv/setup.stamp; } 2>/dev/null && [[ $made == "$base" ]]; do sleep 0.1; done
    # CMake refuses a build folder that was configured elsewhere.
    if [[ -e build/CMakeCache.txt ]] && ! grep -qxF "CMAKE_HOME_DIRECTORY:INTERNAL=$root/src" build/CMakeCache.txt; then
        find build -mindepth 1 -maxdepth 1 ! -name 'setup*.log' -exec rm -rf {} + && rm -rf devel
    fi
    # Without --force-cmake a package that has come or gone in /usr would not be noticed.
    # Python and C++ messages are enough; the Lisp ones would take a third of the build.
    rm -f devel/setup.stamp src/upstream_*/*/CATKIN_IGNORE &&
        PYTHONPATH=/usr/lib/python3/dist-packages ROS_LANG_DISABLE=genlisp catkin_make --force-cmake "${arguments[@]}" &&
        printf '%s\n' "$stamp" >devel/setup.stamp
}
if [[ -n $making ]]; then # pip takes one core
    ((${#due[@]} == 0)) || aside "${due[@]}"
    step "$making" ended environment
fi
rm -f .venv/bin/xacro # PyPI's finds no ROS 1 packages; the workspace's own does, in devel/bin

# 4. loops; kept beside their sources, and compiled anew when those are newer
mapfile -t loops < <(grep -rlE '^from .*compiled import' --include='*.py' src/*/src)
for file in "${loops[@]}"; do
    if [[ $file -nt .venv/loops.stamp ]]; then
        due+=(compile_loops)
        telling+=("compiling loops")
        break
    fi
done
compile_loops() {
    local libraries=(src/*/src) packages=("${loops[@]#src/*/src/}")
    mapfile -t packages < <(printf '%s\n' "${packages[@]%%/*}" | sort -u)
    touch .venv/loops.begun &&
        PYTHONPATH=$(IFS=:; echo "${libraries[*]}") \
            .venv/bin/python -m aras_visual_servo_base.compile_packages "${packages[@]}" &&
        mv .venv/loops.begun .venv/loops.stamp
}

# What pip has installed is turned into bytecode by all cores; pip itself would take one.
[[ ! -e .venv/bytecode.due ]] || due+=(bytecode)
bytecode() {
    # Not the packages' own tests, nor what only training and testing import: two thirds of all, which Python compiles
    # where they are imported after all.
    local rare='/(tests?|pip|setuptools|pkg_resources|pybullet_envs|pandas|sklearn|fontTools|pygments|sphinx|docutils'
    rare+='|snowballstemmer|babel|mujoco|hypothesis)/'
    # Side by side needs semaphores, which some containers do not have; some packages carry templates that are no Python.
    .venv/bin/python -m compileall -q -q -j 0 -x "$rare" .venv/lib || .venv/bin/python -m compileall -q -q -x "$rare" .venv/lib || true
    rm .venv/bytecode.due
}

if ((${#due[@]})); then
    printf -v text '%s, ' "${telling[@]-byte-compiling the Python packages}"
    text=${text%, }
    for name in "${due[@]}"; do
        [[ -n ${beside[$name]-} ]] || aside "$name"
    done
    step "${text^}" ended "${due[@]}"
fi

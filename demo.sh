#!/usr/bin/env bash
# One command from a clone to a servoed robot: sets up, runs the closed loop headless, writes a report.
set -euo pipefail

usage() {
    cat <<'TEXT'
Usage: ./demo.sh [--scheme NAME] [--start POSE] [--goal NAME] [--law NAME] [--gain NUMBER] [--camera NAME]
                 [--target NAME] [--target-size 'X Y'] [--urdf FILE] [--rviz] [--out DIR] [NAME:=VALUE ...]

Sets up the workspace if need be, simulates the ARAS robot while it servoes its camera to the target,
and ends by itself. The status is 0 only when the robot has converged.

  --scheme NAME   features: moments (default), kernel, points, ...; several joined by +; or your own as
                  package.module:Class, found on PYTHONPATH or in the folder you are in
  --start POSE    initial pose: 2016 (default), 2015, none (where it stands), or gantry (m), J1, J2, J3,
                  J5, J6 (rad), as '0.1 0 0.17 -0.09 -0.09 2.09'
  --goal NAME     2015, 2016, or a goal's YAML file (default: that of the start)
  --law NAME      control law: proportional (default), adaptive, pi, sliding_mode, or package.module:Class
  --gain NUMBER   of the law, 1/s; without it the controller's own
  --camera NAME   camera preset: original (default), calibrated, wide, fisheye, noisy, or a YAML file
  --target NAME   what lies on the table: aras (default), square, l_shape, four_dots, marker, poster, ...,
                  none, or the path of a picture, an SVG outline or a URDF; without a --goal of yours
                  the goal is taught before it
  --target-size S its size along x and y, m, as '0.06 0.06' (default: as it ships)
  --urdf FILE     description of the robot (default: the ARAS robot's)
  --rviz          show the robot and its camera in rviz (needs a display)
  --out DIR       folder for report.html, summary.json, figures and run.bag (default: out/ of this workspace)
  NAME:=VALUE     any other argument of the launch files aras_visual_servo.launch and
                  aras_visual_servo_nodes.launch, as joint_friction:=false
  --help          print this

example: ./demo.sh --scheme points --start 2015 --out out/points
TEXT
}

fail() {
    printf 'demo.sh: %s\n' "$1" >&2
    printf 'Try ./demo.sh --help\n' >&2
    exit 2
}

root=$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")
scheme=moments start=2016 goal= law= gain= camera=original target= size= urdf= out=$root/out rviz=() launch=()
while (($#)); do
    case "$1" in
        --scheme=* | --start=* | --goal=* | --law=* | --gain=* | --camera=* | --target=* | --target-size=* | \
            --urdf=* | --out=*) set -- "${1%%=*}" "${1#*=}" "${@:2}" ;;
    esac
    case "$1" in
        --scheme | --start | --goal | --law | --gain | --camera | --target | --target-size | --urdf | --out)
            [[ -n ${2-} ]] || fail "$1 needs a value"
            option=${1#--}
            declare "${option#target-}=$2"
            shift 2
            ;;
        [A-Za-z_]*:=*) launch+=("$1"); shift ;;
        --rviz) rviz=(--rviz); shift ;;
        -h | --help) usage; exit ;;
        *) fail "unknown argument $1" ;;
    esac
done
number='[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][-+]?[0-9]+)?'
name='[A-Za-z_][A-Za-z0-9_]*'
[[ $scheme =~ ^$name(\+$name)*$ || $scheme =~ ^$name(\.$name)*:$name$ ]] ||
    fail "--scheme is a name, as moments, several joined by +, or package.module:Class, not $scheme"
[[ -z $urdf ]] || { [[ -f $urdf ]] && urdf=$(realpath -- "$urdf"); } || fail "--urdf: there is no file $urdf"
[[ $start == 2015 || $start == 2016 || $start == none || $start =~ ^\ *($number\ +){5}$number\ *$ ||
    -n $urdf && $start =~ ^\ *($number\ *)+$ ]] || # another robot has joints of its own
    fail "--start is 2015, 2016, none or six numbers, not $start"
[[ -z $law || $law =~ ^$name$ || $law =~ ^$name(\.$name)*:$name$ ]] ||
    fail "--law is a name, as proportional, or package.module:Class, not $law"
[[ -z $gain || $gain =~ ^$number$ ]] || fail "--gain is a number above 0, not $gain"
presets=$root/src/aras_visual_servo_gazebo/config/cameras
[[ -f $presets/$camera.yaml ]] || { [[ $camera == *.* && -f $camera ]] && camera=$(realpath -- "$camera"); } ||
    fail "--camera: there is no preset $presets/$camera.yaml, and no file $camera"
[[ -z $goal || $goal == 2015 || $goal == 2016 ]] || { [[ -f $goal ]] && goal=$(realpath -- "$goal"); } ||
    fail "--goal is 2015, 2016 or a goal's YAML file, and there is no file $goal"
targets=$root/src/aras_visual_servo_gazebo/targets
[[ -z $target || $target == none || -f $targets/$target.urdf ]] ||
    { [[ $target == *.* && -f $target ]] && target=$(realpath -- "$target"); } ||
    fail "--target: there is no $targets/$target.urdf, and no file $target"
[[ -z $size || $size =~ ^\ *$number\ +$number\ *$ ]] || fail "--target-size is two numbers, m, not $size"
# Made here, not after a minute of work: a folder that cannot be written is told at once.
mkdir -p -- "$out" && out=$(cd -- "$out" && pwd) && [[ -w $out ]] || fail "--out: cannot write to $out"

[[ -n ${ARAS_PREPARED-} ]] || "$root/setup.sh" --for demo # an image is made ready once for all
# Where classes of one's own are looked for; whatever ROS the caller's shell has sourced stays out of it.
own=$PWD
IFS=: read -ra folders <<<"${PYTHONPATH-}"
for folder in "${folders[@]}"; do
    [[ -z $folder || $folder == */dist-packages || -e $folder/rospy ]] || own=$folder:$own
done
unset CMAKE_PREFIX_PATH ROS_PACKAGE_PATH PYTHONPATH PYTHONHOME
set +u # catkin's file reads variables that may be unset
. "$root/devel/setup.bash"
set -u
# Some of Debian's ROS tools start with `env python3`, which another Python in PATH would answer.
export PATH=$root/.venv/bin:$PATH
[[ $scheme$law != *:* ]] || export PYTHONPATH=$PYTHONPATH:$own
options=()
[[ -z $goal ]] || options+=(--goal "$goal")
[[ -z $law ]] || options+=(--law "$law")
[[ -z $gain ]] || options+=(--gain "$gain")
[[ -z $target ]] || options+=(--target "$target")
[[ -z $size ]] || options+=("--target-size=$size")
[[ -z $urdf ]] || options+=(--urdf "$urdf")
exec rosrun aras_visual_servo_bench demo --scheme "$scheme" "--start=$start" --camera "$camera" \
    --out "$out" "${options[@]}" "${rviz[@]}" "${launch[@]}"

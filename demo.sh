#!/usr/bin/env bash
# One command from a clone to a servoed robot: sets up, runs the closed loop headless, writes a report.
set -euo pipefail

usage() {
    cat <<'TEXT'
Usage: ./demo.sh [--scheme NAME] [--start POSE] [--goal NAME] [--law NAME] [--gain NUMBER] [--camera NAME]
                 [--target NAME] [--target-size 'X Y'] [--urdf FILE] [--rviz] [--out DIR] [NAME:=VALUE ...]

Set up the workspace if need be, simulate the ARAS robot while it servoes its camera to the target, and
write report.html, summary.json, figures and run.bag into DIR (default: out/ of this workspace). The status
is 0 only when the robot has converged. A wrong name is answered with all that there are.

  --scheme NAME   features: moments (default), points, ...; several joined by +; or package.module:Class
  --start POSE    initial pose: 2016 (default), 2015, none, or the six joints
  --goal NAME     2015, 2016, or a goal's YAML file (default: that of the start)
  --law NAME      control law, or package.module:Class (default: proportional)
  --gain NUMBER   gain of the law, 1/s (default: the law's own)
  --camera NAME   camera preset, or the path of a preset or a calibration (default: original)
  --target NAME   target on the table: aras (default), another name, the path of an image, an SVG outline or
                  a URDF, or none
  --target-size S its size along x and y, m, as '0.06 0.06' (default: as it ships)
  --urdf FILE     description of the robot (default: the ARAS robot's)
  --rviz          show the robot and its camera in rviz (needs a display)
  --out DIR       folder of the results
  NAME:=VALUE     any other argument of aras_visual_servo.launch and aras_visual_servo_nodes.launch
  --help          print this

example: ./demo.sh --scheme points --start 2015 --out out/points
TEXT
}

root=$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")
out=(--out "$root/out")
for word in "$@"; do
    case "$word" in
        -h | --help) usage; exit ;;
        --out | --out=*) out=() ;;
    esac
done

[[ -n ${ARAS_PREPARED-} ]] || "$root/setup.sh" --for demo # an image is made ready once for all
# Users' own classes are looked for here; whatever ROS the caller's shell has sourced stays out of it.
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
[[ $* != *:[A-Za-z_]* ]] || export PYTHONPATH=$PYTHONPATH:$own # a class of the user's own is named
exec rosrun aras_visual_servo_bench demo "${out[@]}" "$@"

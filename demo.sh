#!/usr/bin/env bash
# Set up the workspace, run the servo loop headless, and write a report.
set -euo pipefail

usage() {
    cat <<'TEXT'
Usage: ./demo.sh [--scheme NAME] [--start POSE] [--goal NAME] [--law NAME] [--gain NUMBER] [--camera NAME]
                 [--target NAME] [--target-size 'X Y'] [--urdf FILE] [--rviz] [--out DIR] [NAME:=VALUE ...]

Set up the workspace if necessary, simulate the ARAS robot while it servoes its camera to the target, and
write report.html, summary.json, figures and run.bag to DIR (default: out/ of this workspace). The exit
status is 0 only if the robot has converged. The error message for a wrong name lists the valid names.

  --scheme NAME   features: moments (default), points, ...; several are joined by +; or package.module:Class
  --start POSE    initial pose: 2016 (default), 2015, none, or six joint positions
  --goal NAME     2015, 2016, or the YAML file of a goal (default: the goal that belongs to the start)
  --law NAME      control law, or package.module:Class (default: proportional)
  --gain NUMBER   gain of the law, 1/s (default: that of the law)
  --camera NAME   camera preset, or the path of a preset or a calibration (default: original)
  --target NAME   target on the table: aras (default), another name, the path of an image, an SVG outline or
                  a URDF, or none
  --target-size S size of the target along x and y, m, such as '0.06 0.06' (default: that of its file)
  --urdf FILE     description of the robot (default: the ARAS robot)
  --rviz          show the robot and its camera in rviz (needs a display)
  --out DIR       output folder
  NAME:=VALUE     any other argument of aras_visual_servo.launch and aras_visual_servo_nodes.launch
  --help          print this help

example: ./demo.sh --scheme points --start 2015 --out out/points
TEXT
}

root=$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")
out=(--out "$root/out")
for argument in "$@"; do
    case "$argument" in
        -h | --help) usage; exit ;;
        --out | --out=*) out=() ;;
    esac
done

[[ -n ${ARAS_PREPARED-} ]] || "$root/setup.sh" --for demo # container images are already set up
# Folders in which classes of the user are searched, without those of a ROS in the caller's shell.
own=$PWD
IFS=: read -ra folders <<<"${PYTHONPATH-}"
for folder in "${folders[@]}"; do
    [[ -z $folder || $folder == */dist-packages || -e $folder/rospy ]] || own=$folder:$own
done
unset CMAKE_PREFIX_PATH ROS_PACKAGE_PATH PYTHONPATH PYTHONHOME
set +u # catkin's file reads variables that may be unset
. "$root/devel/setup.bash"
set -u
# Some of Debian's ROS tools start with `env python3`, which must not find another Python in PATH.
export PATH=$root/.venv/bin:$PATH
[[ $* != *:[A-Za-z_]* ]] || export PYTHONPATH=$PYTHONPATH:$own # an argument names a class of the user
exec rosrun aras_visual_servo_bench demo "${out[@]}" "$@"

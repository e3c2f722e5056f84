#!/usr/bin/env bash
# by_roslaunch.sh OUT MODE STARTS: runs in a loop of roslaunch, as people make their statistics today.
# STARTS holds a line of joints for each start; OUT becomes a table. MODE: real_time or lockstep.
out=$1 mode=$2 starts=$3
echo "gain,start,phase" >"$out"
for gain in 2.0 5.0; do
  number=0
  while read -r joints; do
    roslaunch aras_visual_servo_gazebo aras_visual_servo.launch "speed_mode:=$mode" output:=log >/dev/null 2>&1 &
    world=$!
    for _ in $(seq 100); do # until it stands, or never does
      timeout 10 rosservice call /aras_visual_servo/controller_manager/list_controllers 2>/dev/null |
        grep -q running && break || sleep 0.2
    done
    roslaunch aras_visual_servo_gazebo aras_visual_servo_nodes.launch "gain:=$gain" "start:=$joints" >/dev/null 2>&1 &
    nodes=$!
    phase=lost
    for _ in $(seq 60); do
      phase=$(timeout 5 rostopic echo -n 1 /aras_visual_servo/controller/state/phase 2>/dev/null | head -1)
      [ "$phase" = '"converged"' ] && break
      sleep 0.2
    done
    echo "$gain,$number,$phase" >>"$out"
    kill -INT $nodes $world
    wait $nodes $world
    number=$((number + 1))
  done <"$starts"
done

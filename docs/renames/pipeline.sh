#!/bin/bash
# pipeline.sh ROOT TYPES: raw rename and wrapping, committed
set -e
cd $1
python3 ./codemod.py $1 $2 ./map3_bench.tsv ./map3_bridge.tsv ./map3_controller.tsv ./map3_extra.tsv --apply > /tmp/codemod-$(basename $1).txt 2>&1
.venv/bin/ruff check --no-cache --select I --fix -q src tests docs || true
python3 ./longlines.py $1 > /tmp/long.txt
python3 ./splitstr.py $1 > /tmp/long2.txt
python3 ./splitcomma.py $1 > /tmp/long3.txt
python3 ./byhand1.py
.venv/bin/ruff check --no-cache --select I --fix -q src tests docs || true
git add -A
git commit -qm "names: rename by the field's vocabulary

Classes, functions, attributes, parameters, files and folders take the
terms of visual servoing, ROS and graphics; a script that knows types
changed them everywhere."
git diff --stat HEAD~1 | tail -1

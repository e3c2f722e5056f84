#!/usr/bin/env python3
"""Longest time that the results browser needs for an answer about 100 000 runs.

    OMP_NUM_THREADS=1 .venv/bin/python tests/benchmarks/browse.py [--runs 100000]

The study is made up (tests/unit/bench/made_study.py), which takes a quarter of a minute. The last
line is JSON; the status is 1 if an answer takes longer than 0.5 s.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path

import checkout  # noqa: F401
from made_study import made_study

from aras_visual_servo_bench.web.access import Access
from aras_visual_servo_bench.web.browse.server import BrowseServer
from aras_visual_servo_bench.web.browse.studies import Studies

WANTED = 0.5  # s
FILTERS = {
    "none": [],
    "a number": [{"column": "gain", "operator": ">", "value": 2.0}],
    "three": [{"column": "gain", "operator": "<", "value": 4.0},
              {"column": "delay", "operator": "≥", "value": 0.1},
              {"column": "success", "operator": "=", "value": 0}],
    "a text": [{"column": "reason", "operator": "contains", "value": "swing"}],
    "what is known": [{"column": "settled", "operator": "is known"}],
}  # fmt: skip
QUESTIONS = {
    "rows, sorted": {"do": "rows", "sort": "settled", "descending": True},
    "rows, by a text": {"do": "rows", "sort": "reason"},
    "map": {"do": "map", "x": "gain", "y": "delay"},
    "map of medians": {"do": "map", "x": "gain", "y": "start.side", "value": "settled"},
    "points": {"do": "points", "x": "start.side", "y": "final_distance", "colour_by": "success"},
    "groups": {"do": "groups", "by": ["gain", "end"], "values": ["settled", "final_distance"]},
    "groups, many": {"do": "groups", "by": ["gain", "delay"], "values": ["settled"]},
}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=100_000)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        made_study(
            Path(folder) / "many", experiment={"plant": "free", "duration": 4.0},
            vary={"gain": {"log": [0.5, 8.0, 20]}, "delay": {"linear": [0.01, 0.3, 20]},
                  "start.side": {"uniform": [0.0, 0.1]}}, samples=max(options.runs // 400, 1),
        )  # fmt: skip
        began = time.process_time()
        server = BrowseServer(Studies([Path(folder)]), Access(), [])
        server.studies.read_snapshot(is_forced=True)
        reading = time.process_time() - began
        print(f"reading: {reading:.2f} s, once")
        worst = 0.0
        for question, asked in QUESTIONS.items():
            for name, filters in FILTERS.items():
                text = json.dumps({**asked, "filters": filters})
                taken = []
                for _ in range(5):
                    began = time.process_time()
                    answer = json.dumps(server.answer_query(text))
                    taken.append(time.process_time() - began)
                worst = max(worst, *taken)
                print(f"{question:<18} filter: {name:<14} {1e3 * max(taken):6.0f} ms, "
                      f"{len(answer) / 1e3:.0f} kB")  # fmt: skip
    print(f"the longest took {worst:.3f} s; wanted: {WANTED} s")
    print(json.dumps({"reading_s": reading, "longest_answer_s": worst}))
    return int(worst > WANTED)


if __name__ == "__main__":
    sys.exit(main())

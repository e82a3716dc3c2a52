"""The side of a benchmarked engine: answers requests on stdin, one line of JSON each, until it is closed.

The answers go to the file descriptor that the first argument names, as engines print on stdout what they like.

An adapter defines `prepare(reference, setup)`, which returns a function of the target image. Only that function is
timed; it gives x, y, u, v (N,) in px: where the points are in the reference and how far they moved, NaN where they
were not found, and may add more arrays, which are passed on. Import, reading and `prepare` are not timed.
"""

from __future__ import annotations

import json
import os
import sys
import time
import traceback
from collections.abc import Callable
from typing import Any

import numpy as np


def serve(prepare: Callable[[np.ndarray, dict[str, Any]], Callable[[np.ndarray], dict[str, np.ndarray]]]) -> None:
    """Answer requests {reference, target, out, setup} with {cpu_s, wall_s} or {error}."""
    answers = os.fdopen(int(sys.argv[1]), "w")
    for line in sys.stdin:
        try:
            answer = _answer(prepare, json.loads(line))
        except Exception as error:
            traceback.print_exc()
            answer = {"error": f"{type(error).__name__}: {error}"}
        print(json.dumps(answer), file=answers, flush=True)


def _answer(prepare: Callable, request: dict[str, Any]) -> dict[str, float]:
    reference, target = np.load(request["reference"]), np.load(request["target"])
    correlate = prepare(reference, request["setup"])
    cpu, wall = _cpu_s(), time.perf_counter()
    result = correlate(target)
    cpu, wall = _cpu_s() - cpu, time.perf_counter() - wall
    np.savez(request["out"], **result)
    return {"cpu_s": cpu, "wall_s": wall}


def _cpu_s() -> float:
    """CPU time of this process, all its threads, and the children that it has ended."""
    times = os.times()
    return time.process_time() + times.children_user + times.children_system

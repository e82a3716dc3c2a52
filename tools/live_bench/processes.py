"""What the processes of a graph cost while it runs, beside the rest of the machine."""

from __future__ import annotations

import math
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from scipy.stats import theilslopes

sys.path.append(str(Path(__file__).parents[1]))
from process_cost import TICKS, own_memory_mb, processor_s

PERIOD_S = 1.0
# Until the nodes have all that they keep: compensation_node ToF frames of 30 s, in which it looks for a delay within
# another 30 s, earlier at full rate; recorder_node the index of one file, 35 s.
SETTLED_S = 50.0
LEAST_S = 20.0  # after that, to tell what grows


class Costs:
    """Samples processes (name -> pid) and the whole machine once a second, from `start` until `stop`."""

    def __init__(self, pids: Mapping[str, int]) -> None:
        self._pids = dict(pids)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._sample, daemon=True)
        self._times: list[float] = []
        self._cpu: dict[str, list[float]] = {name: [] for name in self._pids}
        self._memory: dict[str, list[float]] = {name: [] for name in self._pids}
        self._machine: list[float] = []

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> dict[str, dict[str, float]]:
        """name -> cpu (share of one core), memory each second [MB]; `others`: cpu that other programs took of the
        machine."""
        self._ended.set()
        self._thread.join()
        took_s = self._times[-1] - self._times[0]
        costs = {}
        for name, cpu in self._cpu.items():
            costs[name] = {"cpu": (cpu[-1] - cpu[0]) / took_s, "memory": np.round(self._memory[name], 1).tolist()}
        all_of_ours = sum(cost["cpu"] for cost in costs.values())
        costs["others"] = {"cpu": (self._machine[-1] - self._machine[0]) / took_s - all_of_ours}
        return costs

    def _sample(self) -> None:
        while True:
            self._times.append(time.monotonic())
            for name, pid in self._pids.items():
                self._cpu[name].append(processor_s(pid))
                self._memory[name].append(own_memory_mb(pid))
            self._machine.append(_machine_s())
            if self._ended.wait(PERIOD_S):
                return


def growth_mb_min(memory_mb: Sequence[float]) -> float:
    """By how much the memory of a process grows after SETTLED_S [MB/min], from `Costs`; NaN if that is too short.

    The median of the slopes between any two moments (Theil 1950, Sen 1968): a leak grows all the time, however slowly,
    while a single step is one more block of memory for what takes more now and then.
    """
    settled = np.array(memory_mb)[round(SETTLED_S / PERIOD_S) :]
    if len(settled) < LEAST_S / PERIOD_S:
        return math.nan
    return float(theilslopes(settled, np.arange(len(settled)) * PERIOD_S / 60).slope)


def _machine_s() -> float:
    """Busy time of all cores: user, nice, system, interrupts, and what a hypervisor took."""
    fields = [int(value) for value in Path("/proc/stat").read_text().split("\n", 1)[0].split()[1:9]]
    return (sum(fields) - fields[3] - fields[4]) / TICKS

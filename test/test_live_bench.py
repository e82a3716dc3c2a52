"""What the live benchmark says of memory."""

from __future__ import annotations

import importlib
import math

import numpy as np
import pytest
from system import ROOT


@pytest.fixture
def processes(monkeypatch: pytest.MonkeyPatch):
    """The module tools/live_bench/processes.py."""
    monkeypatch.syspath_prepend(str(ROOT / "tools/live_bench"))
    return importlib.import_module("processes")


def test_a_leak_is_growth_and_warm_up_and_a_single_block_are_not(processes) -> None:
    seconds = np.arange(100)
    warm_up = 80 + 20 * np.minimum(seconds / processes.SETTLED_S, 1)  # [MB]
    block = np.where(seconds > 70, 2.0, 0.0)  # [MB] for what takes more now and then
    assert processes.growth_mb_min(warm_up + block) == 0.0
    leak = np.floor(3.0 * seconds / 60 / 0.25) * 0.25  # 3 MB/min, in blocks of 0.25 MB, which make steps
    assert processes.growth_mb_min(warm_up + leak) == pytest.approx(3.0, abs=0.3)  # a step in 50 s: 0.3 MB/min
    assert processes.growth_mb_min(warm_up + block + leak) > 2.7  # not hidden by the block
    assert math.isnan(processes.growth_mb_min(warm_up[:60]))  # ten seconds after the warm-up tell nothing

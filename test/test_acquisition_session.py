"""`make test-acquisition`, the quick session: three peers through the real protocols, each of which fails once."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from gige_peers import needs_aravis
from system import ROOT, environment


@needs_aravis
@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_session_loses_nothing_but_in_the_faults(tmp_path: Path) -> None:
    """Exit code 0: no frame lost, no stamp wrong, the opening as good as the noise lets it be."""
    pytest.importorskip("harvesters", reason="harvesters is missing: make setup-tof")
    command = [sys.executable, ROOT / "tools/acquisition/run.py", "--quick", "--out", tmp_path]
    done = subprocess.run(command, env={**environment(), "ROS_DOMAIN_ID": "71"}, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    assert all(f"| {peer} |" in done.stdout for peer in ("camera", "ToF camera", "autopilot"))

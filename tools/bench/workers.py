"""Engines run as processes of their own, each on one core and one thread, and asked in turn."""

from __future__ import annotations

import contextlib
import json
import os
import select
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from speckle import Motion

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
BENCH_PYTHON = ROOT / ".venv-bench/bin/python"
ONE_THREAD = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS", "NUMEXPR_NUM_THREADS"), "1"
)
PATIENCE_S = 120.0  # for one answer; the first one may compile
LOST_PX = 0.5  # a point farther from the truth than this was not found


@dataclass(frozen=True)
class Run:
    """What an engine made of one pair."""

    cpu_s: float
    wall_s: float
    arrays: dict[str, NDArray]


@dataclass(frozen=True)
class Errors:
    """How far its points are from the truth.

    points: points it gave. lost: share of them that are NaN or more than half a pixel off. bias_px, std_px: (2,) of
    the rest, along x and y; NaN if there is none.
    """

    points: int
    lost: float
    bias_px: NDArray
    std_px: NDArray


class EngineError(Exception):
    """An engine that cannot be asked, or failed; the message says why."""


class Worker:
    """An engine in its process: `ask` it about pairs; it ends with the `with` block. `core` is the first it may use."""

    def __init__(self, adapter: str, setup: dict[str, Any], folder: Path, threads: int = 1, core: int = 0) -> None:
        ours = adapter == "rgbd_dic"
        python = Path(sys.executable) if ours else BENCH_PYTHON
        if not python.exists():
            raise EngineError("not installed")
        environment = {**os.environ, **({} if threads > 1 else ONE_THREAD)}
        if not ours:
            for name in ("PYTHONPATH", "LD_LIBRARY_PATH", "_ROS_WHEELS_BOOTSTRAP_COMPLETE"):
                environment.pop(name, None)
        cores = sorted(os.sched_getaffinity(0))[core : core + threads]
        self._setup, self._out = setup, folder / f"{adapter}_{id(self)}.npz"
        self._log = tempfile.TemporaryFile("w+")  # noqa: SIM115 (closed when the process has ended)
        reading, writing = os.pipe()
        self._answers = os.fdopen(reading)
        self._process = subprocess.Popen(
            [python, HERE / "peers" / f"with_{adapter}.py", str(writing)],
            stdin=subprocess.PIPE,
            stdout=self._log,
            stderr=self._log,
            text=True,
            cwd=folder,
            env=environment,
            pass_fds=[writing],
            preexec_fn=lambda: os.sched_setaffinity(0, cores),
        )
        os.close(writing)

    def ask(self, reference: Path, target: Path, **setup: Any) -> Run:
        """Correlate a pair of .npy images.

        Raises:
            EngineError: if the engine fails, ends or does not answer in time; nothing more can be asked after the
                latter two.
        """
        request = {
            "reference": str(reference),
            "target": str(target),
            "out": str(self._out),
            "setup": {**self._setup, **setup},
        }
        try:
            self._process.stdin.write(json.dumps(request) + "\n")
            self._process.stdin.flush()
        except BrokenPipeError as error:
            raise EngineError(self._last_words()) from error
        if not select.select([self._answers], [], [], PATIENCE_S)[0]:
            self._process.kill()
            raise EngineError(f"no answer within {PATIENCE_S:.0f} s")
        line = self._answers.readline()
        if not line:
            raise EngineError(self._last_words())
        answer = json.loads(line)
        if "error" in answer:
            raise EngineError(answer["error"].splitlines()[0])
        with np.load(self._out) as arrays:
            return Run(answer["cpu_s"], answer["wall_s"], dict(arrays))

    def _last_words(self) -> str:
        code = self._process.wait()
        self._log.seek(0)
        said = self._log.read().strip().splitlines()
        return f"ended with code {code}" + (f": {said[-1]}" if said else "")

    def __enter__(self) -> Worker:
        return self

    def __exit__(self, kind: type | None, error: BaseException | None, traceback: TracebackType | None) -> None:
        with contextlib.suppress(BrokenPipeError):  # it has ended already
            self._process.stdin.close()
        try:
            self._process.wait(timeout=10)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._answers.close()
        self._log.close()


def errors(run: Run, motion: Motion) -> Errors:
    """A run against the truth."""
    centres = np.column_stack([run.arrays["x"], run.arrays["y"]]).astype(float)
    moved = np.column_stack([run.arrays["u"], run.arrays["v"]]).astype(float)
    error = centres + moved - motion(centres)
    with np.errstate(invalid="ignore"):
        kept = (np.abs(error) < LOST_PX).all(axis=1)
    nothing = np.full(2, np.nan)
    if not kept.any():
        return Errors(len(centres), 1.0, nothing, nothing)
    return Errors(len(centres), float(1 - kept.mean()), error[kept].mean(axis=0), error[kept].std(axis=0))


def version(package: str) -> str:
    """The version of a package in the environment of the peers."""
    code = f"import importlib.metadata as m; print(m.version({package!r}))"
    if not BENCH_PYTHON.exists():
        return "not installed"
    environment = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "LD_LIBRARY_PATH")}
    done = subprocess.run([BENCH_PYTHON, "-c", code], capture_output=True, text=True, env=environment)
    return done.stdout.strip() or "not installed"

"""Runs the tasks of a validation in processes and keeps what each returned: an interrupted run goes on where it was."""

from __future__ import annotations

import json
import multiprocessing
import os
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2

from .digests import digest, digest_of_code

Progress = Callable[[int, int], None]
ONE_THREAD = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")


@dataclass(frozen=True)
class Task:
    """A call `work(folder, **arguments)` of a module-level function; arguments and result are what JSON can write.

    without: modules that the result does not depend on though they are imported (`digest_of_code`).
    """

    work: Callable[..., Any]
    arguments: dict[str, Any] = field(default_factory=dict)
    without: tuple[str, ...] = ()

    def key(self) -> str:
        """Changes with the arguments and with the code that the result depends on."""
        return f"{self.work.__name__}_{digest(self.arguments, digest_of_code(self.work.__module__, self.without))}"


def run_tasks(tasks: Sequence[Task], folder: Path, workers: int, progress: Progress | None = None) -> list[Any]:
    """What each task returns, from the cache in `folder` or made now.

    Args:
        progress: called with (tasks done, tasks in all).
    """
    cache = folder / "cache"
    cache.mkdir(parents=True, exist_ok=True)
    paths = [cache / f"{task.key()}.json" for task in tasks]
    missing = [index for index, path in enumerate(paths) if not path.exists()]
    done = len(tasks) - len(missing)
    if progress is not None:
        progress(done, len(tasks))
    if missing:
        with _pool(workers) as pool:
            waiting: dict[Future, int] = {pool.submit(tasks[i].work, folder, **tasks[i].arguments): i for i in missing}
            while waiting:
                finished, _ = wait(waiting, return_when=FIRST_COMPLETED)
                for future in finished:
                    _write(paths[waiting.pop(future)], json.dumps(future.result()))
                    done += 1
                    if progress is not None:
                        progress(done, len(tasks))
    return [json.loads(path.read_text()) for path in paths]


@contextmanager
def _pool(workers: int) -> Any:
    before = dict(os.environ)
    os.environ.update(ONE_THREAD)
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(workers, context, initializer=cv2.setNumThreads, initargs=(1,))
    try:
        yield pool
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
        os.environ.clear()
        os.environ.update(before)


def _write(path: Path, text: str) -> None:
    unfinished = path.with_suffix(".part")
    unfinished.write_text(text)
    unfinished.replace(path)

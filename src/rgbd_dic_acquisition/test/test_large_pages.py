"""The recorder's memory lies in large pages, and its process and arguments stay what they are."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from pathlib import Path

import pytest

CHOICE = Path("/sys/kernel/mm/transparent_hugepage/enabled")
TUNABLE = "glibc.malloc.hugetlb"
PROGRAM = """
import os, pathlib, sys
from rgbd_dic_acquisition.nodes.large_pages import use_large_pages
use_large_pages()
image = bytes(8 << 20)
flags = [line.split() for line in pathlib.Path("/proc/self/smaps").read_text().splitlines() if "VmFlags" in line]
print(os.getpid(), os.environ["GLIBC_TUNABLES"], any("hg" in words for words in flags), *sys.argv[1:])
"""

pytestmark = pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="only glibc can")


def started(given: str) -> tuple[subprocess.Popen, list[str]]:
    program = subprocess.Popen(
        [sys.executable, "-c", PROGRAM, "-p", "two words"],
        env={**os.environ, "GLIBC_TUNABLES": given},
        stdout=subprocess.PIPE,
        text=True,
    )
    said, _ = program.communicate(timeout=60)
    return program, said.split(maxsplit=3)


@pytest.mark.parametrize("given", ["", "glibc.malloc.perturb=0"])
def test_the_same_process_goes_on_in_large_pages(given: str) -> None:
    program, (pid, tunables, large, arguments) = started(given)
    assert int(pid) == program.pid
    assert tunables == f"{given}:{TUNABLE}=1".lstrip(":"), "what the user has set stays"
    assert arguments.strip() == "-p two words"
    if CHOICE.exists() and "[madvise]" in CHOICE.read_text():
        assert large == "True"


def test_who_has_chosen_is_left_alone() -> None:
    _, (_, tunables, large, _) = started(f"{TUNABLE}=0")
    assert tunables == f"{TUNABLE}=0"
    assert large == "False"

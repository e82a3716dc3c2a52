"""The set-up says what a machine lacks, before it does anything."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from system import ROOT

NEEDED = ("bash", "env", "sed", "sort", "head", "printf", "make", "cmake", "c++")


def attempt(tmp_path: Path, *, without: tuple[str, ...] = (), python: str = sys.executable) -> str:
    """Run the set-up in an empty folder, on a PATH that lacks some programs; what it complains about."""
    programs = tmp_path / "bin"
    programs.mkdir()
    for name in NEEDED:
        if name not in without:
            (programs / name).symlink_to(shutil.which(name))
    (programs / "python3").write_text(f'#!/bin/sh\nexec "{python}" "$@"\n')
    (programs / "python3").chmod(0o755)
    project = tmp_path / "project"
    project.mkdir()
    done = subprocess.run(
        [ROOT / "tools/setup/environment.sh"],
        cwd=project,
        env={"PATH": str(programs), "HOME": str(tmp_path), "_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 1
    assert not (project / ".venv").exists()
    return done.stderr


@pytest.mark.parametrize(
    "missing, said", [("c++", "no C++ compiler"), ("cmake", "cmake is missing"), ("make", "make is missing")]
)
def test_missing_program_is_named_with_its_remedy(tmp_path: Path, missing: str, said: str) -> None:
    message = attempt(tmp_path, without=(missing,))
    assert said in message and "apt install" in message


def test_unsupported_python_is_named(tmp_path: Path) -> None:
    old = tmp_path / "python3.8"
    old.write_text('#!/bin/sh\n[ "$1" = --version ] && echo Python 3.8.10 && exit 0\nexit 1\n')
    old.chmod(0o755)
    message = attempt(tmp_path, python=str(old))
    assert "no Python 3.10 to 3.13 found" in message and "3.8.10" in message

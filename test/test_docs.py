"""What the pages say is what the code does: generated blocks, links, options, examples."""

from __future__ import annotations

import argparse
import dataclasses
import importlib
import os
import pkgutil
import re
import runpy
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from rgbd_dic_acquisition.calibration import load_calibration
from rgbd_dic_acquisition.drivers.aravis_connection import AravisSettings
from rgbd_dic_acquisition.drivers.mavlink import MavlinkSettings
from rgbd_dic_acquisition.drivers.tof_settings import TofSettings
from rgbd_dic_acquisition.nodes.camera_node import CameraNodeSettings
from rgbd_dic_acquisition.nodes.mavlink_node import MavlinkNodeSettings
from rgbd_dic_acquisition.nodes.recorder_node import RecorderSettings
from rgbd_dic_acquisition.nodes.tof_node import TofNodeSettings
from rgbd_dic_acquisition.settings import Settings
from rgbd_dic_acquisition.simulator.flight import FlightSettings
from rgbd_dic_processing.core.displacement_field import DisplacementField
from rgbd_dic_processing.core.regions_file import load_regions
from rgbd_dic_processing.core.settings import load_settings
from system import ROOT

from rgbd_dic_processing import commands

NOT_OURS = {"build", "install", "log", "results"}
PAGES = [
    path
    for path in sorted(ROOT.rglob("*.md"))
    if not any(part in NOT_OURS or part.startswith(".") for part in path.relative_to(ROOT).parts)
]
LOADERS = {"regions.yaml": load_regions, "calibration.yaml": load_calibration, "settings.yaml": load_settings}
CODE = re.compile(r"^```\w*\n(.*?)^```|`([^`\n]+)`", re.MULTILINE | re.DOTALL)


def page_id(path: Path) -> str:
    return str(path.relative_to(ROOT))


def code(path: Path) -> Iterator[str]:
    """Lines of code of a page: those of its blocks, and those within its sentences."""
    for block, inline in CODE.findall(path.read_text()):
        yield from (block.replace("\\\n", " ") or inline).splitlines()


def test_generated_blocks_are_up_to_date() -> None:
    """What docs take from the code is what `make docs` would write now."""
    environment = {name: value for name, value in os.environ.items() if name != "_ROS_WHEELS_BOOTSTRAP_COMPLETE"}
    command = [sys.executable, ROOT / "tools/docs/regenerate.py", "--check"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, env=environment)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "skipped" not in done.stdout


@pytest.mark.parametrize("page", PAGES, ids=page_id)
def test_links(page: Path) -> None:
    """Every relative link points to a file, and, in a page, to a heading of it."""
    for target in re.findall(r"\]\(([^)\s]+)\)", CODE.sub("", page.read_text())):
        if re.match(r"[a-z]+:", target):
            continue
        name, _, heading = target.partition("#")
        path = (page.parent / name).resolve() if name else page
        assert path.exists(), f"{target} does not exist"
        if heading:
            assert heading in headings(path), f"{target}: no such heading"


def headings(page: Path) -> set[str]:
    """The anchors of a page."""
    lines = re.findall(r"^#+ (.+)$", page.read_text(), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", line.lower()).replace(" ", "-") for line in lines}


def sub_commands() -> dict[str, argparse.ArgumentParser]:
    parsers = argparse.ArgumentParser().add_subparsers()
    for entry in pkgutil.iter_modules(commands.__path__):
        module = importlib.import_module(f"{commands.__name__}.{entry.name}")
        if hasattr(module, "add_parser"):
            module.add_parser(parsers)
    return parsers.choices


@pytest.mark.parametrize("page", PAGES, ids=page_id)
def test_options(page: Path) -> None:
    """Every sub-command and option of `rgbd-dic` that a page names exists."""
    known = sub_commands()
    for line in code(page):
        for command, rest in re.findall(r"\brgbd-dic ([a-z]+(?:-[a-z]+)*)\b([^|;&#]*)", line):
            assert command in known, f"{line}: rgbd-dic has no {command}"
            options = set(re.findall(r"(?<!\S)--?[a-z][\w-]*", rest))
            unknown = options - set(known[command]._option_string_actions)
            assert not unknown, f"{line}: rgbd-dic {command} has no {', '.join(unknown)}"


@pytest.mark.parametrize("page", PAGES, ids=page_id)
def test_make_targets(page: Path) -> None:
    known = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    named = {target for line in code(page) for target in re.findall(r"(?:^|\s)make ([a-z][a-z-]*)", line)}
    assert named <= known


@pytest.mark.parametrize("launch_file", ["processing", "replay", "live", "acquisition"])
def test_launch_arguments(launch_file: str) -> None:
    """Every argument that a page gives to a launch file exists."""
    (path,) = ROOT.glob(f"src/*/launch/{launch_file}.launch.py")
    text = path.read_text()
    if "COMMON_ARGUMENTS" in text:
        text += (ROOT / "src/rgbd_dic_processing/rgbd_dic_processing/launching.py").read_text()
    known = set(re.findall(r'DeclareLaunchArgument\(\s*"(\w+)"', text))
    lines = [line for page in PAGES for line in code(page) if f"{launch_file}.launch.py" in line]
    assert lines, f"no page tells how to start {launch_file}.launch.py"
    assert {name for line in lines for name in re.findall(r"(\w+):=", line)} <= known


def examples() -> list[tuple[str, str]]:
    blocks = re.findall(r"^```yaml\n# (\S+)\n(.*?)^```", (ROOT / "docs/files.md").read_text(), re.MULTILINE | re.DOTALL)
    return [(name, text) for name, text in blocks]


@pytest.mark.parametrize("name, text", examples())
def test_example_loads(name: str, text: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_text(text)
    assert LOADERS[name](path)


def test_every_file_has_an_example() -> None:
    assert {name for name, _ in examples()} == set(LOADERS)


def test_every_image_is_shown_and_made_again_by_one_command(monkeypatch: pytest.MonkeyPatch) -> None:
    """`make figures` makes it: by tools/docs/regenerate.py, or by a script that the page which shows it names."""
    monkeypatch.syspath_prepend(ROOT / "tools/docs")
    made = set(runpy.run_path(str(ROOT / "tools/docs/regenerate.py"))["PICTURES"])
    rules = re.findall(r"^(figures|docs|validate):.*\n((?:\t.*\n)+)", (ROOT / "Makefile").read_text(), re.MULTILINE)
    scripts = {script for _, lines in rules for script in re.findall(r"python (tools/\S+\.py)", lines)}
    assert len(rules) == 3 and "tools/docs/regenerate.py" in scripts
    for image in (ROOT / "docs/images").iterdir():
        showing = [page for page in PAGES if f"images/{image.name})" in page.read_text()]
        assert showing, f"no page shows docs/images/{image.name}"
        named = any(script in page.read_text() for page in showing for script in scripts)
        assert image.name in made or named, f"make figures does not make docs/images/{image.name}"


def test_maps_are_described() -> None:
    """The table of displacement_maps.npz has the fields that `Run.save` writes, all those of DisplacementField."""
    section = (ROOT / "docs/files.md").read_text().split("### displacement_maps.npz")[1].split("\n## ")[0]
    named = {
        name for row in re.findall(r"^\| (`.*?) \|", section, re.MULTILINE) for name in re.findall(r"`(\w+)`", row)
    }
    assert named == {field.name for field in dataclasses.fields(DisplacementField)}


ACQUISITION: dict[str, dict[str, type[Settings]]] = {
    "camera_node": {"": CameraNodeSettings, "aravis": AravisSettings, "flight": FlightSettings},
    "tof_node": {"": TofNodeSettings, "tof": TofSettings, "flight": FlightSettings},
    "mavlink_node": {"": MavlinkNodeSettings, "link": MavlinkSettings},
    "recorder_node": {"": RecorderSettings},
}


@pytest.mark.parametrize("node", ACQUISITION)
def test_acquisition_yaml(node: str) -> None:
    """config/acquisition.yaml, written by hand, has the nodes' parameters with their defaults."""
    content = yaml.safe_load((ROOT / "src/rgbd_dic_acquisition/config/acquisition.yaml").read_text())["/**"]
    assert set(content) == set(ACQUISITION)
    parameters = content[node]["ros__parameters"]
    for group, kind in ACQUISITION[node].items():
        values = parameters.pop(group) if group else {k: v for k, v in parameters.items() if not isinstance(v, dict)}
        for name, value, default in pairs(values, kind()):
            assert (type(value), value) == (type(default), default), f"{node}: {group}.{name}"
        parameters = {name: value for name, value in parameters.items() if name not in values}
    assert not parameters, f"{node} has no parameters {', '.join(parameters)}"


def pairs(values: dict[str, Any], defaults: Settings) -> Iterator[tuple[str, Any, Any]]:
    """(name, value of the file, default) of a group of parameters; paths are empty."""
    known = {field.name for field in dataclasses.fields(defaults)}
    for name, value in values.items():
        if name not in known:
            assert name == "calibration", f"{type(defaults).__name__} has no {name}"
            yield name, value, ""
        elif isinstance(value, dict):
            yield from pairs(value, getattr(defaults, name))
        else:
            yield name, value, getattr(defaults, name)


def test_a_block_is_replaced_and_nothing_else() -> None:
    replace_block = runpy.run_path(str(ROOT / "tools/docs/blocks.py"))["replace_block"]
    text = "before\n<!-- begin: a -->\nold\n<!-- end: a -->\nafter\n"
    assert replace_block(text, "a", r"\1") == "before\n<!-- begin: a -->\n\n\\1\n\n<!-- end: a -->\nafter\n"
    assert replace_block(text, "b", "new") is None

"""payload.yaml as ROS reads a parameter file, without ROS."""

from __future__ import annotations

from pathlib import Path

import pytest
from rgbd_dic_acquisition.drivers.aravis_connection import AravisSettings
from rgbd_dic_acquisition.errors import SettingsError
from rgbd_dic_acquisition.payload import Payload, load_payload


def read(tmp_path: Path, text: str) -> Payload:
    path = tmp_path / "payload.yaml"
    path.write_text(text)
    return load_payload(path)


@pytest.mark.parametrize(
    "text",
    [
        "camera_node: {ros__parameters: {source: aravis, aravis: {gain: 3.0}}}",
        "/**: {camera_node: {ros__parameters: {source: aravis, aravis: {gain: 3.0}}}}",
        "/drone/camera_node: {ros__parameters: {source: aravis, aravis: {gain: 3.0}}}",
        "/**: {ros__parameters: {source: aravis, aravis: {gain: 1.0}}}\n"
        "camera_node: {ros__parameters: {aravis: {gain: 3.0}}}",
    ],
)
def test_ways_to_name_a_node(tmp_path: Path, text: str) -> None:
    payload = read(tmp_path, text)
    assert payload.flat("camera_node") == {"source": "aravis", "aravis.gain": 3.0}
    assert payload.settings("camera_node", "aravis", AravisSettings) == AravisSettings(gain=3.0)
    assert payload.source("camera_node") == "aravis" and payload.calibration is None
    assert payload.flat("tof_node") == {}


@pytest.mark.parametrize("text", ["", "- 1", "camera_node: {source: aravis}", "a: [1", "/**: 3"])
def test_what_is_no_parameter_file(tmp_path: Path, text: str) -> None:
    with pytest.raises(SettingsError, match=r"payload\.yaml"):
        read(tmp_path, text)


def test_what_is_missing_or_refused(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match="cannot read"):
        load_payload(tmp_path / "missing.yaml")
    payload = read(tmp_path, "camera_node: {ros__parameters: {aravis: {exposure_s: 99.0}}}")
    with pytest.raises(SettingsError, match="no parameter 'source'"):
        payload.source("camera_node")
    with pytest.raises(SettingsError, match="exposure_s"):
        payload.settings("camera_node", "aravis", AravisSettings)


def test_the_template_can_be_read() -> None:
    """config/acquisition.yaml, with the nodes' defaults."""
    path = Path(__file__).parents[1] / "config" / "acquisition.yaml"
    assert load_payload(path).settings("camera_node", "aravis", AravisSettings) == AravisSettings()

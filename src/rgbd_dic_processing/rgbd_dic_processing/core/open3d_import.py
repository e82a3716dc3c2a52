"""Open3D, imported only where a panel is sought: it takes a second, and libusb, which a computer may not have."""

from __future__ import annotations

import ctypes
from types import ModuleType

from rgbd_dic_acquisition.errors import MeasurementError


def open3d() -> ModuleType:
    """The module `open3d`. Its wheel links to the system's libusb-1.0; the package libusb_package brings one along.

    Raises:
        MeasurementError: if it is not installed.
    """
    try:
        import libusb_package

        ctypes.CDLL(str(libusb_package.get_library_path()), mode=ctypes.RTLD_GLOBAL)
    except (ImportError, OSError):
        pass  # then the system's own will be found, or the next error tells
    try:
        import open3d as module
    except ImportError as error:
        raise MeasurementError(
            f"the panel cannot be sought without Open3D ({error}): pip install open3d-cpu libusb-package, or draw the "
            "panel into regions.yaml (docs/files.md)"
        ) from error
    return module

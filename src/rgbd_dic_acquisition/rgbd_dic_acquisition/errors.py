"""The errors that rgbd_dic raises on purpose. Each names the offending value, the limit and the remedy."""


class RgbdDicError(Exception):
    """Base of all of them: whatever the user can mend; anything else is a bug."""


class SettingsError(RgbdDicError):
    """A setting or parameter is out of range or of the wrong kind."""


class CalibrationError(RgbdDicError):
    """A calibration file or CameraInfo is missing, malformed or uncalibrated."""


class RegionsError(RgbdDicError):
    """A region of regions.yaml is malformed or cannot work with the image."""


class BagError(RgbdDicError):
    """A bag cannot be read or written."""


class ImageError(RgbdDicError):
    """An image or depth frame cannot be used."""


class DeviceError(RgbdDicError):
    """A sensor is not there, refuses a setting, or lacks the software that reads it."""


class MeasurementError(RgbdDicError):
    """A frame cannot be measured; the caller turns it into an invalid row with its reason."""

"""The thesis' validations repeated, a folder a chapter: `rgbd-dic validate chapter3` and `chapter4`."""

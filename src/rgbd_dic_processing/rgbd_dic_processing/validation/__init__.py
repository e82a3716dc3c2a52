"""The thesis' numerical validation (chapter 3), repeated: `rgbd-dic validate chapter3`."""

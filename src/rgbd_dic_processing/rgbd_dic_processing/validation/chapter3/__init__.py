"""The thesis' numerical validation (chapter 3), repeated."""

"""The thesis' experiment (chapter 4), repeated in the simulated laboratory."""

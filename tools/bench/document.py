"""docs/benchmark.md, from the results alone."""

from __future__ import annotations

import textwrap
from typing import Any

from asked import rows
from cells import table
from report_accuracy import accuracy, choice
from report_flight import drift, search
from report_real import real
from report_speed import peers, roofline, speed

COLUMNS = 120


def page(results: dict[str, Any]) -> str:
    """The whole page."""
    sections = [_head, _asked, peers, speed, roofline, search, accuracy, choice, drift, real, _method]
    blocks = "\n\n".join(section(results).strip() for section in sections).split("\n\n")
    return "\n\n".join(_filled(block) for block in blocks) + "\n"


def _filled(block: str) -> str:
    """A paragraph, or the items of a list, broken at the width of the page; titles and tables as they are."""
    if block.startswith(("#", "|")):
        return block
    if block.startswith("- "):
        return "\n".join(_broken(f"- {item}", "  ") for item in block[2:].split("\n- "))
    return _broken(block, "")


def _broken(text: str, indent: str) -> str:
    words = " ".join(text.split())
    return textwrap.fill(words, COLUMNS, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False)


def _head(results: dict[str, Any]) -> str:
    machine, scene = results["machine"], results["scene"]
    return f"""# Benchmark

`make bench` measures all of this anew and writes this page (about a quarter of an hour; `make bench QUICK=1` takes two
minutes and writes to `results/bench/` only). It installs the peers into `.venv-bench`. Times of different runs are not
comparable, ratios within one are: the engines run in turn, each on one core and one thread.

Machine: {machine["cpu"]}, {machine["cores"]} cores; instruction sets of the kernel:
{", ".join(machine["instruction_sets"]) or "one"}.

The common test: Gaussian speckle of sigma 1.5 px given as a formula, evaluated at the pixels of the reference and at
the
inverse-mapped pixels of the target, so the truth is exact; 1000 x 1000 px, 8 bit, no clipping, standard deviation
{scene["contrast"]:.0f} grey levels, mean gradient {scene["mean_gradient"]:.1f} grey levels/px; subsets of 31 x 31 px
every
10 px, 7,744 of them; affine increment. Cramer-Rao bound with quantisation only: {scene["floor_px"]:.5f} px."""


def _asked(results: dict[str, Any]) -> str:
    marks = {True: "met", False: "**not met**", None: "not measured"}
    known = rows(results)
    lines = [(row.what, row.asked, row.measured, marks[row.met], "" if row.met else row.why) for row in known]
    met = sum(row.met is True for row in known)
    return f"""## Asked and measured

{met} of {len(known)} are met.

{table(("what", "asked", "measured", "result", "why not"), lines)}"""


def _method(results: dict[str, Any]) -> str:
    return """## How it is measured

- The speckle, its motion and its noise are seeded; accuracy is the same in each run of one build.
- Each engine is a process of its own (`tools/bench/peers/`), pinned to one core, with one thread for every library.
  It is asked for one pair after another, in turn with the others; the first answer, which compiles and warms up, is
  dropped.
- CPU time is that of the process and its threads around the call; import, reading of images and, for "video", the
  work on the reference are outside.
- An engine that cannot be installed or fails is a row that says so.
- Raw results, each pair of each engine: `results/bench/full.json`."""

"""docs/live.md, from the results alone."""

from __future__ import annotations

import math
import sys
import textwrap
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1] / "docs"))

from blocks import table
from processes import PERIOD_S, SETTLED_S, growth_mb_min

COLUMNS = 120
SURPRISING = 1.5  # error over stated uncertainty that is told
QUIET = 0.05  # share of one core; what other programs may take before the page says so
STEADY_MB_MIN = 2.0  # all processes together; an allocator takes memory in blocks of up to so much
ASKED = {"rate": 60.0, "median": 20.0, "high": 50.0}  # openings a second, latency [ms]
PROCESSES = (
    *("dic_node", "pairing_node", "compensation_node", "crack_opening_node", "composed_nodes"),
    *("plane_node", "recorder_node"),
)


def page(results: dict[str, Any]) -> str:
    """The whole page."""
    parts = (_head, _asked, _cases, _costs, _profile, _slow, _method)
    blocks = "\n\n".join(part(results).strip() for part in parts).split("\n\n")
    return "\n\n".join(_filled(block) for block in blocks if block.strip()) + "\n"


def arrangement(case: dict[str, Any]) -> str:
    """Of the nodes of a case."""
    return {"": "apart", "after_dic": "composed after DIC", "all": "composed"}[case["composed"]]


def _filled(block: str) -> str:
    if block.startswith(("#", "|", "```")):
        return block
    if block.startswith("- "):
        return "\n".join(_broken(f"- {item}", "  ") for item in block[2:].split("\n- "))
    return _broken(block, "")


def _broken(text: str, indent: str) -> str:
    return textwrap.fill(
        " ".join(text.split()), COLUMNS, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    )


def _head(results: dict[str, Any]) -> str:
    machine, worst = results["machine"], max(case["costs"]["others"]["cpu"] for case in results["cases"])
    load = ""
    if worst > QUIET:
        load = (
            f"**Measured under load:** other programs took up to {worst:.0%} of a core meanwhile. On a quiet machine "
            "the rates are higher and the latencies lower."
        )
    return f"""# Measuring live

What the graph does while flying: a camera of 1440 x 1080 px at 60 Hz and a ToF sensor of 640 x 480 px at 20 Hz, the
attitude at 100 Hz, `h_pose`, subsets of 31 x 31 px. `make live-bench` measures all of this anew and writes this page
(twelve minutes; `FULL=1` lets each main case run for ten minutes and takes 37, with 65 GB of room on the disk;
`QUICK=1` takes one minute and leaves the page alone).

Machine: {machine["cpu"]}, {machine["cores"]} cores. All of the graph, and what stands for the sensors, share them.

{load}

For a flight, give the settings that are made for it:

```
tools/run rgbd-dic up ... --settings src/rgbd_dic_processing/config/live.yaml
```

[live.yaml](../src/rgbd_dic_processing/config/live.yaml), which the package installs too, says what it changes and why.
With the default settings an
image waits for its own ToF frame and for its plane, which the offline tool need not mind; with these, `h_pose` takes
the reference plane from the ToF frames up to 0.2 s before the image, and waits for none
([decisions](decisions/content_not_arrival.md)). `--composed` puts the nodes that work on every image into one process,
in which each hands its result on by a call; topics, names and recordings stay the same. Python does one thing at a time
in a process, so `--composed after_dic` leaves dic_node, which takes half of the time, in one of its own
([decisions](decisions/processes.md)). The launch file for a payload has the argument `composed`, which takes the same
words."""


def _asked(results: dict[str, Any]) -> str:
    rows = []
    for case in _main(results):
        latency, memory = case["latency_ms"], sum(growth_mb_min(memory) for memory in _memories(case).values())
        lost = case["sent"] - case["answered"]
        recorded = case["recorded"]["camera/image_raw"]
        how = arrangement(case["case"])
        for what, asked, measured, met in [
            ("openings a second", "60", f"{case['rate_hz']:.1f}", case["rate_hz"] > ASKED["rate"] - 0.1),
            ("images without an opening", "0", f"{lost} of {case['sent']}", lost == 0),
            ("latency, median [ms]", "20", f"{latency['50']:.1f}", latency["50"] <= ASKED["median"]),
            ("latency, 99th percentile [ms]", "50", f"{latency['99']:.1f}", latency["99"] <= ASKED["high"]),
            *(
                [
                    (
                        f"growth of memory after {SETTLED_S:.0f} s [MB/min]",
                        "none",
                        f"{memory:.1f}",
                        memory < STEADY_MB_MIN,
                    )
                ]
                if not math.isnan(memory)  # too short a case to tell
                else []
            ),
            ("images missing in the recording", "0", str(case["published"] - recorded), recorded == case["published"]),
        ]:
            rows.append((what, how, asked, measured, "met" if met else "**not met**"))
    seconds = _main(results)[0]["case"]["duration_s"]
    return f"""## Asked and measured

1,500 subsets, recording, settings of live.yaml, {seconds:.0f} s; each node a process of its own (apart), and
composed in two ways. The latency is from the stamp of the image, taken when it is published, to the arrival of its
opening in another process.

{table(("what", "nodes", "asked", "measured", "result"), rows)}{_ended(results)}"""


def _ended(results: dict[str, Any]) -> str:
    if not any(case.get("recording_ended") for case in results["cases"]):
        return ""
    return """

The images that are missing in a recording are those at its end: the disk was full, and the recorder said so and closed
the bag, as it should. With room for all, none was missing in ten minutes ([decisions](decisions/too_slow.md))."""


def _cases(results: dict[str, Any]) -> str:
    rows = [
        (
            f"{case['case']['subsets']:,}",
            case["case"]["settings"],
            arrangement(case["case"]),
            "yes" if case["case"]["recording"] else "no",
            f"{case['rate_hz']:.1f}",
            f"{case['sent'] - case['answered']} of {case['sent']}",
            case["longest_gap"],
            f"{case['latency_ms']['50']:.0f}",
            f"{case['latency_ms']['99']:.0f}",
            f"{case['latency_ms']['100']:.0f}",
            f"{case['rms_mm']:.4f}",
            f"{case['stated_mm']:.4f}",
        )
        for case in results["cases"]
    ]
    titles = ("subsets", "settings", "nodes", "recording", "openings/s", "left out", "most in a row")
    titles += ("latency, median [ms]", "99 %", "most", "error, RMS [mm]", "stated [mm]")
    beyond = [case for case in results["cases"] if case["rms_mm"] > SURPRISING * case["stated_mm"]]
    surprise = ""
    if beyond:
        surprise = (
            f"In {len(beyond)} of {len(rows)} cases the error is more than {SURPRISING:g} times what is stated. The "
            "same 91 images come again and again, each with the noise that it had, so one unlucky shape of the panel "
            "stays for the whole case; whether that is all of it is not known."
        )
    return f"""## Cases

That speed is not bought with wrong numbers, the last two columns show: the error of the opening against the simulator's
truth, and the standard uncertainty that the graph states.

{surprise}

{table(titles, rows)}"""


def _costs(results: dict[str, Any]) -> str:
    rows = []
    for case in results["cases"]:
        costs = case["costs"]
        rows.append(
            (
                f"{case['case']['subsets']:,}",
                case["case"]["settings"],
                *(f"{costs[name]['cpu']:.0%}" if name in costs else "" for name in PROCESSES),
                f"{costs['source']['cpu']:.0%}",
                f"{costs['others']['cpu']:.0%}",
            )
        )
    settled = round(SETTLED_S / PERIOD_S)
    memories = [
        (
            name,
            *(f"{mb:.0f}" for mb in (memory[0], memory[min(settled, len(memory) - 1)], memory[-1], max(memory))),
            f"{growth_mb_min(memory):.1f}",
        )
        for name, memory in _memories(_main(results)[0]).items()
    ]
    short = [name.removesuffix("_node").removesuffix("_nodes").replace("_", " ") for name in PROCESSES]
    return f"""## Processor and memory

Share of one core, by process, in the order of the cases above. "Sensors" is what stands for camera, ToF sensor and
autopilot.

{table(("subsets", "settings", *short, "sensors", "other programs"), rows)}

Memory of each process by itself (without the segments that the middleware shares) in the main case, and by how much it
grows after {SETTLED_S:.0f} s, as the median of the slopes between any two moments:

{table(("process", "begin [MB]", f"{SETTLED_S:.0f} s", "end", "most", "growth [MB/min]"), memories)}

The first {SETTLED_S:.0f} s are warm-up. compensation_node looks for a delay between the sensors' clocks now and then,
by trying 81 of them on the latest 600 ToF frames: what that takes grows by some 10 MB until it has so many, half a
minute, and stays with the process for the next time. recorder_node keeps some 70 kB a second of index until a file of
the bag is full, after 35 s, and then fills the same memory again; and it keeps the memory of the most that ever waited
for the disk (`buffer_mb` at most). A process that was held up keeps, in the same way, the memory of the images that
then waited for it. With 300,000 small messages in files of 8 MB, as many as twenty minutes bring, recorder_node grew by
0.4 MB."""


def _profile(results: dict[str, Any]) -> str:
    rows = []
    for settings, by_count in results["stages"].items():
        for count, steps in by_count.items():
            each = sum(steps.values()) - steps["plane"] + steps["plane"] / 3
            rows.append((f"{int(count):,}", settings, *(f"{took:.1f}" for took in steps.values()), f"{each:.1f}"))
    names = next(iter(next(iter(results["stages"].values())).values()))
    per_opening = []
    for case in _main(results):
        costs, answered_hz = case["costs"], case["rate_hz"]
        total = sum(cost["cpu"] for name, cost in costs.items() if name != "others")
        how = arrangement(case["case"])
        per_opening.append(f"{total / answered_hz * 1e3:.1f} ms {how}")
    budget = results["machine"]["cores"] / ASKED["rate"] * 1e3
    return f"""## Where the time goes

The steps of the method by themselves, CPU time on one thread without ROS, mean of a frame. A plane is made of every
ToF frame, one for three images, so the last column counts a third of it.

{table(("subsets", "settings", *(f"{name} [ms]" for name in names), "each image [ms]"), rows)}

At 60 Hz, {results["machine"]["cores"]} cores have {budget:.1f} ms for each image. In the main case all processes
together took {" and ".join(per_opening)} for each opening. What is more than the table says does not go with the
openings but with the images, measured or not: the recorder, what stands for the sensors, and the middleware, which
copies each image to dic_node and to the recorder. So the more images are measured, the less each opening costs; and
images that follow closely are found with fewer iterations. An event of rclpy costs about 0.3 ms, whatever it brings:
that is most of what pairing_node takes, which hears 80 a second. The 100 attitudes a second are no events: it takes
those that have come when it pairs an image. Images and depth frames are taken as bytes and read where they lie, so that
one that is left out costs a copy of its bytes. Messages of 1,500 subsets cost 0.1 ms in all; they are made from and
read into NumPy arrays without a loop."""


def _slow(results: dict[str, Any]) -> str:
    worst = min(results["cases"], key=lambda case: case["rate_hz"])
    halves = worst["latency_halves_ms"]
    skipped = ", ".join(
        f"{name} {counters['skipped']}" for name, counters in worst["counters"].items() if counters.get("skipped")
    )
    return f"""## On a machine that is too slow

A live node that is held up for a moment catches up with at most three waiting messages (`keep_up.max_waiting`); when
more wait, all but the newest are left out, until the node has kept up for a second. So a graph that needs twice the
time measures every second image, each as soon as it came, and the counter `skipped` on
[`/diagnostics`](integration.md#diagnostics) says how many were left out, with a warning as long as it goes on. The
recorder takes every image all the same, so the offline tool measures them all afterwards; ten minutes on such a
machine are among the [decisions](decisions/too_slow.md). In a replay nothing is left out.

Nothing makes the latency grow: all that has come is handled before the next image's turn, whatever it is; nothing waits
behind another message of the same topic but for those three; and with a known plane no image waits for a later one,
however late the planes are where other programs want the cores too (`compensation.plane_lag_s`).

What stays uneven is what the system gives: in eight seconds beside programs that took 113 % of a core, every ninth
image was measured, the 99th percentile of the latency was 0.32 s, and at most 18 images in a row were left out,
presumably while dic_node did not get a core.

The slowest case above shows it: {worst["case"]["subsets"]:,} subsets, settings {worst["case"]["settings"]}:
{worst["rate_hz"]:.1f} openings a second, at most {worst["longest_gap"]} images left out in a row, median latency
{halves[0]:.0f} ms in the first half and {halves[1]:.0f} ms in the second
{f"(left out by {skipped}, warm-up included)" if skipped else ""}."""


def _method(results: dict[str, Any]) -> str:
    return """## How it is measured

- The flight is one of the [simulated laboratory](laboratory.md), half of whose panel is rigid: 91 images and 60 depth
  frames, rendered once, played back and forth from memory. Each is stamped with the time of its publishing.
- The nodes are started as `rgbd-dic up` starts them. Three seconds after the first opening the count begins; each image
  that was published from then on must have an opening with its stamp.
- CPU time and memory are those of `/proc`, once a second; "other programs" is what the rest of the machine was busy
  with.
- Truth: the displacement of the very subsets in the two zones, from the simulator.
- Raw results, each case: `results/live_bench/full.json`."""


def _main(results: dict[str, Any]) -> list[dict[str, Any]]:
    """The cases that the numbers are asked for, apart and composed."""
    return [
        case
        for case in results["cases"]
        if case["case"]["subsets"] == 1500 and case["case"]["recording"] and case["case"]["settings"] == "live"
    ]


def _memories(case: dict[str, Any]) -> dict[str, list[float]]:
    """Process of the graph -> its memory each second [MB]."""
    return {name: case["costs"][name]["memory"] for name in PROCESSES if name in case["costs"]}

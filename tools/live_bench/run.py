"""`make live-bench`: the graph before a flight at full size, case by case, and docs/live.md.

--quick: ten seconds a case, three cases, no page. --full: ten minutes for each of the three main cases.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import sys
import time
from pathlib import Path

from case import Case, measure
from document import arrangement, page
from flight import flight
from rgbd_dic_processing.graph import AFTER_DIC, ALL
from stages import stages

ROOT = Path(__file__).parents[2]
RAW = ROOT / "results" / "live_bench"
RECORDED_BYTES_S = 105e6  # and some room: images 93 MB, depth 12 MB
MAIN = Case(1500, recording=True, duration_s=100.0)
CASES = (
    MAIN,
    Case(1500, recording=True, duration_s=100.0, composed=AFTER_DIC),
    Case(1500, recording=True, duration_s=100.0, composed=ALL),
    Case(500, recording=True, duration_s=20.0),
    Case(500, recording=False, duration_s=20.0),
    Case(1500, recording=False, duration_s=20.0),
    Case(5000, recording=True, duration_s=20.0),
    Case(5000, recording=False, duration_s=20.0),
    Case(500, recording=True, duration_s=20.0, composed=AFTER_DIC),
    Case(5000, recording=True, duration_s=20.0, composed=AFTER_DIC),
    Case(1500, recording=True, duration_s=20.0, settings="default"),
)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    length = parser.add_mutually_exclusive_group()
    length.add_argument("--quick", action="store_true", help="three cases of ten seconds; docs/live.md stays as it is")
    length.add_argument("--full", action="store_true", help="ten minutes for each main case, with 65 GB of room")
    options = parser.parse_args()
    os.environ.setdefault("ROS_DOMAIN_ID", "72")
    cases = [_longer(case) for case in CASES] if options.full else list(CASES)
    if options.quick:
        cases = [Case(1500, recording=True, duration_s=10.0, composed=composed) for composed in ("", AFTER_DIC, ALL)]
    played = flight(RAW / "flight")
    room = RECORDED_BYTES_S * max(case.duration_s for case in cases if case.recording)
    if shutil.disk_usage(RAW).free < room:
        parser.error(f"the recording of one case takes {room / 1e9:.0f} GB: make room in {RAW.relative_to(ROOT)}")
    results = []
    for number, case in enumerate(cases):
        folder = RAW / "cases" / str(number)
        shutil.rmtree(folder, ignore_errors=True)
        results.append(measure(case, played, folder))
        print(_line(results[-1]), flush=True)
    subsets = (1500,) if options.quick else (500, 1500, 5000)
    profile = {name: {n: stages(played, n, name) for n in subsets} for name in ("live", "default")}
    name = "quick" if options.quick else "full"
    content = {"date": time.strftime("%Y-%m-%d"), "cases": results, "stages": profile, "machine": _machine()}
    (RAW / f"{name}.json").write_text(json.dumps(content, indent=1))
    document = RAW / "live.md" if options.quick else ROOT / "docs" / "live.md"
    document.write_text(page(json.loads((RAW / f"{name}.json").read_text())))
    print(f"written: {document.relative_to(ROOT)}, {(RAW / f'{name}.json').relative_to(ROOT)}")
    return 0


def _longer(case: Case) -> Case:
    main = case.subsets == MAIN.subsets and case.recording and case.settings == MAIN.settings
    return Case(**{**vars(case), "duration_s": 600.0}) if main else case


def _line(result: dict) -> str:
    case, latency = result["case"], result["latency_ms"]
    return (
        f"{case['subsets']} subsets, {'recording' if case['recording'] else 'not recording'}, "
        f"{arrangement(case)}, settings {case['settings']}: "
        f"{result['rate_hz']:.1f} openings/s, "
        f"{result['sent'] - result['answered']} of {result['sent']} left out, latency {latency['50']:.0f} ms median, "
        f"{latency['99']:.0f} ms at the 99th percentile, error {result['rms_mm']:.4f} mm RMS"
    )


def _machine() -> dict[str, object]:
    lines = Path("/proc/cpuinfo").read_text().splitlines()
    model = next((line.split(":")[1].strip() for line in lines if line.startswith("model name")), "unknown")
    return {"cpu": model, "cores": len(os.sched_getaffinity(0))}


if __name__ == "__main__":
    sys.exit(main())

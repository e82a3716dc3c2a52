"""report.html: one page that needs no other file, for the screen and for paper."""

from __future__ import annotations

import base64
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from datetime import datetime, timezone
from pathlib import Path, PurePath
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from ..calibrating.summary import Row
from ..core.settings import ProcessingSettings
from ..core.status import FrameStatus
from ..history.comparison import MethodComparison
from ..history.zone_sensitivity import Misplacement
from ..runs import Run
from .budget import Budgets, rows_mm
from .drawing import Picture
from .series import STATUS_WORDS, Series
from .summary import failures, summarise

TEMPLATE = "page.html.j2"
MOST_REASONS = 8  # that a table names


def write(
    path: Path,
    run: Run,
    methods: Sequence[Series],
    pictures: Mapping[str, Sequence[Picture]],
    has_truth: bool,
    beside: Sequence[MethodComparison] = (),
    misplaced: Mapping[str, Sequence[Misplacement]] | None = None,
    unplaced: Mapping[str, str] | None = None,
    budgets: Budgets | None = None,
    calibrated: Sequence[Row] = (),
) -> Path:
    """Write the page and return its path.

    Args:
        pictures: section of the page -> its pictures.
        beside: the methods beside a reference.
        misplaced, unplaced: the zones' sensitivity by method, or why it is not known.
        budgets: of the openings of each method.
        calibrated: the numbers of the calibration.
    """
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update(number=_number, share=_share)
    lines = summarise(methods)
    text = environment.get_template(TEMPLATE).render(
        name=path.resolve().parent.name,
        inputs={name: _without_folder(value) for name, value in run.inputs.items()},
        facts=_flat(run.facts),
        settings=_explained(run.settings),
        versions=run.versions,
        extent=_extent(methods),
        has_fields=bool(run.maps),
        compared=any(math.isfinite(line.worst_error_mm) for line in lines),
        has_truth=has_truth,
        summary=lines,
        failures=failures(methods),
        beside=beside,
        misplaced={method: _slopes(found) for method, found in (misplaced or {}).items()},
        unplaced=unplaced or {},
        budget_methods=list(budgets or {}),
        budget_rows=rows_mm(budgets) if budgets else [],
        calibrated=calibrated,
        planes=_planes(run),
        pictures={section: [_embedded(picture) for picture in drawn] for section, drawn in pictures.items()},
    )
    path.write_text(text, encoding="utf-8")
    return path


def _embedded(picture: Picture) -> dict[str, str]:
    data = base64.b64encode(picture.path.read_bytes()).decode("ascii")
    return {"alt": picture.alt, "caption": picture.caption, "data": data}


def _planes(run: Run) -> dict[str, Any]:
    """How many ToF frames there were, and, of those without a plane, how many have which reason."""
    planes = run.frames.planes
    reasons = Counter((plane.status, plane.reason) for plane in planes if plane.status != FrameStatus.OK)
    without = [(STATUS_WORDS[status], reason, count) for (status, reason), count in reasons.most_common(MOST_REASONS)]
    return {"frames": len(planes), "with_plane": len(planes) - reasons.total(), "without": without}


def _extent(methods: Sequence[Series]) -> dict[str, Any]:
    """Images that were measured and the time they span."""
    stamps = {opening.stamp_ns for series in methods for opening in series.openings}
    ordered = sorted(stamps)
    return {
        "frames": len(ordered),
        "first": _clock(ordered[0]) if ordered else "",
        "duration_s": (ordered[-1] - ordered[0]) * 1e-9 if ordered else 0.0,
    }


def _clock(stamp_ns: int) -> str:
    day = datetime.fromtimestamp(stamp_ns // 10**9, timezone.utc)
    return f"{day:%Y-%m-%d %H:%M:%S}.{stamp_ns % 10**9:09d} UTC"


def _slopes(found: Sequence[Misplacement]) -> dict[str, dict[str, float]]:
    """What is moved -> axis -> change of the opening [mm/px]."""
    slopes: dict[str, dict[str, float]] = {}
    for one in found:
        slopes.setdefault(one.moved, {})[one.axis] = one.slope * 1e3
    return slopes


def _explained(settings: Mapping[str, Any]) -> dict[str, list[dict[str, Any]]]:
    """Group -> its settings with unit and sentence, as far as this version knows them."""
    known = ProcessingSettings.__dataclass_fields__
    explained = {}
    for group, values in settings.items():
        fields = getattr(known[group].default_factory, "__dataclass_fields__", {}) if group in known else {}
        rows = values.items() if isinstance(values, Mapping) else [("", values)]
        explained[str(group)] = [
            {
                "name": name,
                "value": value,
                "unit": fields[name].metadata.get("unit", "") if name in fields else "",
                "doc": fields[name].metadata.get("doc", "") if name in fields else "",
            }
            for name, value in rows
        ]
    return explained


def _flat(facts: Mapping[str, Any], prefix: str = "") -> dict[str, str]:
    """Facts by a readable name; nested ones by their path, numbers with as many digits as mean something."""
    flat: dict[str, str] = {}
    for key, value in facts.items():
        name = f"{prefix}{str(key).replace('_', ' ') if not prefix else key}"
        if isinstance(value, Mapping):
            flat.update(_flat(value, f"{name}: "))
        else:
            flat[name] = f"{value:.6g}" if isinstance(value, float) else _without_folder(str(value))
    return flat


def _without_folder(value: str) -> str:
    """An absolute path tells about the computer, not about the measurement: only its last part is shown."""
    path = PurePath(value)
    return path.name if path.is_absolute() else str(value)


def _number(value: float, digits: int) -> str:
    return f"{round(value, digits) + 0.0:.{digits}f}" if math.isfinite(value) else "–"


def _share(value: float) -> str:
    return f"{100 * value:.0f} %" if math.isfinite(value) else "–"

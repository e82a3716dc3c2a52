"""What belongs to one image comes on several topics: put together by its stamp, for those images that are wanted."""

from __future__ import annotations

from collections import OrderedDict
from typing import Any


class SameStamp:
    """Collects the parts of the images whose first part has come; the others are hundreds that nobody asked for.

    Args:
        first: name of the part that tells which images are wanted.
        early: name of each other part -> how many that came before the first are kept.
        late: how many images wait for their parts before the oldest is given up.
    """

    def __init__(self, first: str, early: dict[str, int], late: int = 32):
        self._first, self._early_kept, self._late = first, early, late
        self._early: dict[str, OrderedDict[int, Any]] = {name: OrderedDict() for name in early}
        self._wanted: OrderedDict[int, dict[str, Any]] = OrderedDict()

    def add(self, name: str, stamp_ns: int, part: Any) -> dict[str, Any] | None:
        """All parts of the image of this stamp by name, once they are there."""
        if name == self._first:
            came = {other: parts.pop(stamp_ns) for other, parts in self._early.items() if stamp_ns in parts}
            self._wanted[stamp_ns] = {name: part, **came}
            if len(self._wanted) > self._late:
                self._wanted.popitem(last=False)
        elif stamp_ns in self._wanted:
            self._wanted[stamp_ns][name] = part
        else:
            self._early[name][stamp_ns] = part
            if len(self._early[name]) > self._early_kept[name]:
                self._early[name].popitem(last=False)
        if len(self._wanted.get(stamp_ns, ())) == 1 + len(self._early):
            return self._wanted.pop(stamp_ns)
        return None

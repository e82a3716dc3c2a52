"""What a bag says about how its topics were offered."""

from __future__ import annotations

from pathlib import Path

import yaml
from mcap.exceptions import McapError
from mcap.reader import make_reader

from .errors import BagError

_TRANSIENT_LOCAL = ("transient_local", 1)  # the name, and the number that older bags have


def latched_topics(bag: Path | str) -> set[str]:
    """Topics of a bag (a directory or one .mcap file) whose messages were kept for who came later.

    Raises:
        BagError: a file cannot be read.
    """
    bag = Path(bag)
    latched: set[str] = set()
    for path in sorted(bag.glob("*.mcap")) if bag.is_dir() else [bag]:
        try:
            with path.open("rb") as file:
                summary = make_reader(file).get_summary()
        except (OSError, McapError) as error:
            raise BagError(f"cannot read {path}: {error}") from error
        for channel in summary.channels.values() if summary else ():
            try:
                profiles = yaml.safe_load(channel.metadata.get("offered_qos_profiles", "")) or []
            except yaml.YAMLError:
                profiles = []
            offered = [profile.get("durability") for profile in profiles if isinstance(profile, dict)]
            if offered and all(durability in _TRANSIENT_LOCAL for durability in offered):
                latched.add(channel.topic)
    return latched

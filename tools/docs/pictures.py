"""Figures small enough for the repository."""

from __future__ import annotations

import io
from pathlib import Path

from PIL import Image

LIMIT_BYTES = 300_000
STEP = 0.85


def small_copy(source: Path, target: Path, full_colour: bool = False) -> None:
    """A PNG below the limit, of at most 256 colours unless it is to have all; if it must, with fewer pixels."""
    with Image.open(source) as picture:
        full = picture.convert("RGB")
    scale, data = 1.0, b""
    while not data or len(data) > LIMIT_BYTES:
        size = (round(full.width * scale), round(full.height * scale))
        smaller = full if scale == 1.0 else full.resize(size, Image.Resampling.LANCZOS)
        buffer = io.BytesIO()
        if not full_colour:
            smaller = smaller.quantize(256, method=Image.Quantize.FASTOCTREE)  # keeps colours of small areas
        smaller.save(buffer, "PNG", optimize=True)
        data, scale = buffer.getvalue(), scale * STEP
    target.parent.mkdir(parents=True, exist_ok=True)
    if not target.exists() or target.read_bytes() != data:
        target.write_bytes(data)
        print(f"docs/images/{target.name}: written, {len(data) // 1000} kB")

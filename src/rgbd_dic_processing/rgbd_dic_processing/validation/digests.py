"""Names for results that change with what the results depend on: values, files, code."""

from __future__ import annotations

import ast
import functools
import hashlib
import importlib.util
import json
from collections.abc import Iterator
from pathlib import Path

PROJECT = "rgbd_dic_"  # what the names of its packages start with


def digest(*parts: object) -> str:
    """Short name of anything that JSON can write."""
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()[:16]


@functools.cache
def digest_of_files(*paths: Path) -> str:
    """Of files by content."""
    return digest([hashlib.sha256(path.read_bytes()).hexdigest() for path in sorted(paths)])


@functools.cache
def digest_of_code(module: str, without: tuple[str, ...] = ()) -> str:
    """Of a module of the project and all that it imports of the project, the kernel too.

    Args:
        without: modules that are left out, with what only they import.
    """
    waiting, files = [module], {}
    while waiting:
        name = waiting.pop()
        if name in files or name in without:
            continue
        files[name] = Path(importlib.util.find_spec(name).origin)
        if files[name].suffix == ".py":
            waiting += _imported(name, files[name])
    return digest_of_files(*files.values())


def _imported(name: str, path: Path) -> Iterator[str]:
    """Modules of the project that a module's source imports; `from package import x` may name a module or not."""
    package = name if path.name == "__init__.py" else name.rpartition(".")[0]
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = importlib.util.resolve_name("." * node.level + (node.module or ""), package)
            found = [base, *(f"{base}.{alias.name}" for alias in node.names)]
        else:
            continue
        yield from (one for one in found if one.startswith(PROJECT) and _is_module(one))


def _is_module(name: str) -> bool:
    try:
        return importlib.util.find_spec(name) is not None
    except ModuleNotFoundError:  # its parent is no package
        return False

"""Memory in large pages, for a process that moves many megabytes a second.

An image lies in four hundred small pages of 4 KB, which the processor looks up one after another, and which the kernel
pins for the disk and puts into its requests one by one; of the large ones of 2 MB it fills two at most. glibc takes
memory in them if its environment says so when the process starts (glibc 2.35, tunable glibc.malloc.hugetlb).
"""

from __future__ import annotations

import os
import platform
import sys

_VARIABLE, _TUNABLE = "GLIBC_TUNABLES", "glibc.malloc.hugetlb"


def use_large_pages() -> None:
    """Start this program anew, as the same process, with large pages. To be called before it does anything else.

    Does nothing where that was done, where the user has chosen in GLIBC_TUNABLES, or where the C library is another.
    """
    given = os.environ.get(_VARIABLE, "")
    if _TUNABLE in given or platform.libc_ver()[0] != "glibc":
        return
    os.environ[_VARIABLE] = ":".join(filter(None, (given, f"{_TUNABLE}=1")))
    os.execv(sys.executable, [sys.executable, *sys.orig_argv[1:]])

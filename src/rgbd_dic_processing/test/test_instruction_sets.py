"""One binary runs on every x86-64: instructions that not all of them have are in code that is chosen at run time."""

import platform
import re
import shutil
import subprocess
from collections import Counter

import pytest

from rgbd_dic_processing import _kernel

NEWER = re.compile(
    r"v(?!err|erw)\w+|((shl|sar|shr)x|rorx|mulx|pdep|pext|andn|bextr|bls[ir]|blsmsk|bzhi|lzcnt|movbe)[lqw]?"
)
"""Instructions of AVX, AVX2, AVX-512, FMA, BMI, LZCNT and MOVBE: what x86-64-v3 and -v4 bring."""


@pytest.mark.skipif(platform.machine() != "x86_64", reason="of x86-64")
@pytest.mark.skipif(shutil.which("objdump") is None, reason="needs objdump (binutils)")
def test_newer_instructions_are_only_in_the_loops_compiled_for_them():
    listing = subprocess.run(
        ["objdump", "--disassemble", "--no-show-raw-insn", _kernel.__file__], capture_output=True, text=True, check=True
    ).stdout
    found: Counter[str] = Counter()
    function = ""
    for line in listing.splitlines():
        if heading := re.fullmatch(r"[0-9a-f]+ <(.*)>:", line):
            function = heading[1]
        elif (instruction := re.match(r"\s*[0-9a-f]+:\t(\w+)", line)) and NEWER.fullmatch(instruction[1]):
            loops = re.search(r"8rgbd_dic(?:4avx2|6avx512)", function)  # mangled rgbd_dic::avx2::
            found[loops[0] if loops else function] += 1
    if found.keys() == {".text"}:
        pytest.skip("the symbols are stripped")
    assert found.pop("8rgbd_dic4avx2") > 1000
    assert found.pop("8rgbd_dic6avx512") > 1000
    assert not found

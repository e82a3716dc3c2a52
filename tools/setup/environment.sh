#!/usr/bin/env bash
# Makes the virtual environment .venv from requirements.txt, or says what the machine lacks.
# Called by the Makefile, from the project's root; does nothing that an up-to-date .venv already has.
set -euo pipefail

fail() {
  printf 'rgbd_dic set-up: %s\n' "$@" >&2
  exit 1
}

supported='import sys; raise SystemExit(not ((3, 10) <= sys.version_info[:2] <= (3, 13)))'
python=${PYTHON:-}
if [ -z "$python" ]; then
  for candidate in python3 python3.12 python3.11 python3.13 python3.10; do
    if command -v "$candidate" >/dev/null && "$candidate" -c "$supported" 2>/dev/null; then
      python=$candidate
      break
    fi
  done
fi
[ -n "$python" ] || fail "no Python 3.10 to 3.13 found (python3 is: $(python3 --version 2>&1 || true))." \
  "Install one, or name it: make PYTHON=/path/to/python3.12 ..."
"$python" -c "$supported" || fail "$python is $("$python" --version 2>&1); supported are 3.10 to 3.13."

command -v "${CXX:-c++}" >/dev/null || fail "no C++ compiler (${CXX:-c++}). On Debian or Ubuntu: sudo apt install g++"
command -v cmake >/dev/null || fail "cmake is missing. On Debian or Ubuntu: sudo apt install cmake"
command -v make >/dev/null || fail "make is missing. On Debian or Ubuntu: sudo apt install make"
cmake_version=$(cmake --version | sed -n '1s/[^0-9.]//gp')
[ "$(printf '%s\n' 3.22 "$cmake_version" | sort -V | head -n 1)" = 3.22 ] ||
  fail "cmake is $cmake_version; 3.22 or newer is needed."
header=$("$python" -c 'import sysconfig; print(sysconfig.get_path("include"))')/Python.h
[ -f "$header" ] || fail "the headers of $python are missing (no $header). On Debian or Ubuntu: sudo apt install python3-dev"

if ! .venv/bin/python -c "$supported" 2>/dev/null; then
  echo "making .venv with $("$python" --version)"
  rm -rf .venv
  "$python" -m venv .venv 2>/dev/null || {
    rm -rf .venv
    fail "$python cannot make a virtual environment. On Debian or Ubuntu: sudo apt install python3-venv"
  }
fi
echo "installing requirements.txt into .venv"
if command -v uv >/dev/null; then
  UV_PYTHON_DOWNLOADS=never uv pip sync --quiet --python .venv/bin/python --require-hashes requirements.txt
else
  .venv/bin/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements.txt
fi

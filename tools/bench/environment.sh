#!/usr/bin/env bash
# Makes .venv-bench, in which the peers run, from requirements-bench.txt. Called by the Makefile, from the project's
# root; does nothing that an up-to-date .venv-bench already has.
set -euo pipefail

[ .venv-bench/.installed -nt requirements-bench.txt ] && exit 0
supported='import sys; raise SystemExit(sys.version_info[:2] < (3, 11))' # pyvale needs it
python=
for candidate in "${PYTHON:-python3}" python3.11 python3.12 python3.13; do
  if command -v "$candidate" >/dev/null && "$candidate" -c "$supported" 2>/dev/null; then
    python=$candidate
    break
  fi
done
[ -n "$python" ] || {
  echo "rgbd_dic benchmark: the peers need Python 3.11 or newer; none found" >&2
  exit 1
}
echo "installing the engines that are measured beside this one into .venv-bench (1.7 GB)"
rm -rf .venv-bench
"$python" -m venv .venv-bench
# --no-deps: the lock leaves out what tools/bench/left_out.txt names
if command -v uv >/dev/null; then
  UV_PYTHON_DOWNLOADS=never uv pip sync --quiet --python .venv-bench/bin/python --require-hashes requirements-bench.txt
else
  .venv-bench/bin/python -m pip install --quiet --disable-pip-version-check --no-deps --require-hashes \
    -r requirements-bench.txt
fi
touch .venv-bench/.installed

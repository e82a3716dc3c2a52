#!/usr/bin/env bash
# Builds the three packages with colcon against the ROS 2 wheels in .venv. Called by the Makefile.
set -euo pipefail

root=$(cd "$(dirname "$0")/../.." && pwd)
cd "$root"
unset PYTHONPATH LD_LIBRARY_PATH COLCON_PREFIX_PATH _ROS_WHEELS_BOOTSTRAP_COMPLETE
export PATH="$root/.venv/bin:$PATH"
AMENT_PREFIX_PATH=$root/.venv
export AMENT_PREFIX_PATH CMAKE_PREFIX_PATH="$AMENT_PREFIX_PATH"
.venv/bin/colcon build --executor sequential --event-handlers console_direct- console_cohesion- \
  --cmake-args -DCMAKE_TOOLCHAIN_FILE="$root/tools/setup/toolchain.cmake" \
  -DPython3_EXECUTABLE="$root/.venv/bin/python" -DPython_EXECUTABLE="$root/.venv/bin/python" \
  -DBUILD_TESTING=OFF --no-warn-unused-cli

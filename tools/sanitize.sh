#!/usr/bin/env bash
# The kernel's tests under GCC's sanitizers, in build/sanitize: addresses and undefined behaviour with a long run of
# random calls, then data races. Called by the Makefile; RGBD_DIC_FUZZ_CALLS and RGBD_DIC_FUZZ_SEED set the random calls.
set -euo pipefail
cd "$(dirname "$0")/.."
tests=src/rgbd_dic_processing/test

runtime() {  # path of a library of the compiler
  local path
  path=$("${CXX:-c++}" -print-file-name="$1")
  [ -f "$path" ] || { echo "${CXX:-c++} has no $1: the sanitizers need GCC" >&2; return 1; }
  echo "$path"
}

build() {  # name, flags of the compiler
  local name=$1 folder=build/sanitize/$1
  shift
  echo "building the kernel with $*"
  mkdir -p "$folder/rgbd_dic_processing"
  env -u PYTHONPATH -u LD_LIBRARY_PATH PATH="$PWD/.venv/bin:$PATH" \
    AMENT_PREFIX_PATH="$PWD/.venv" CMAKE_PREFIX_PATH="$PWD/.venv" \
    cmake -S src/rgbd_dic_processing -B "$folder" -Wno-dev --no-warn-unused-cli --log-level=WARNING \
    -DCMAKE_TOOLCHAIN_FILE="$PWD/tools/setup/toolchain.cmake" -DBUILD_TESTING=OFF \
    -DPython3_EXECUTABLE="$PWD/.venv/bin/python" -DPython_EXECUTABLE="$PWD/.venv/bin/python" \
    -DCMAKE_BUILD_TYPE=Debug -DCMAKE_CXX_FLAGS_DEBUG="-O1 -g -fno-omit-frame-pointer -D_GLIBCXX_ASSERTIONS $*" \
    >"$folder/cmake.log"
  cmake --build "$folder" --target _kernel --parallel "$(nproc)" >>"$folder/cmake.log"
  # The Python package with this kernel.
  ln -sf "$PWD"/src/rgbd_dic_processing/rgbd_dic_processing/* "$PWD/$folder"/_kernel.*.so "$folder/rgbd_dic_processing"
}

run() {  # name, library of the sanitizer, arguments of pytest
  local preload fixed=()
  preload="$(runtime "$2") $(runtime libstdc++.so)"  # the second so that the first finds what throws exceptions
  # The thread sanitizer needs the addresses that it expects.
  if setarch -R true 2>/dev/null; then fixed=(setarch -R); fi
  # -s: a sanitizer that ends the process would take what pytest has captured with it.
  KERNEL="build/sanitize/$1" PRELOAD=$preload OPENBLAS_NUM_THREADS=1 \
    ASAN_OPTIONS=detect_leaks=0 UBSAN_OPTIONS=print_stacktrace=1 \
    tools/run "${fixed[@]}" bash -c 'PYTHONPATH="$KERNEL:$PYTHONPATH" LD_PRELOAD=$PRELOAD exec python "$@"' bash \
    -m pytest -s -q -p no:cacheprovider "${@:3}"
}

build address -fsanitize=address,undefined,float-cast-overflow -fno-sanitize-recover=all
RGBD_DIC_FUZZ_CALLS=${RGBD_DIC_FUZZ_CALLS:-30000} run address libasan.so "$tests"/test_kernel*.py

build thread -fsanitize=thread
RGBD_DIC_FUZZ_CALLS=1000 run thread libtsan.so "$tests"/test_kernel*.py -k "threads or random_calls"

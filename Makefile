# `make demo` and `make test` are all that a newcomer needs; each does the set-up that is missing.
SHELL := /bin/bash
.DEFAULT_GOAL := help
.PHONY: help setup setup-camera setup-tof setup-viewers build demo test test-slow test-acquisition sanitize bench
.PHONY: bench-real live-bench validate lint format docs figures page-cost sample lock clean

run := tools/run

help:           ## what there is
	@sed -n 's/^\([a-z-]*\):.*## /  make \1\t/p' $(MAKEFILE_LIST) | expand -t 22

setup: .venv/.installed          ## virtual environment with pinned, hashed requirements
.venv/.installed: requirements.txt tools/setup/environment.sh
	@tools/setup/environment.sh && touch $@

setup-camera: .venv/.camera      ## bindings of Aravis, for real cameras (docs/payload.md)
.venv/.camera: requirements-camera.txt .venv/.installed
	@.venv/bin/python -m pip install --quiet --disable-pip-version-check --require-hashes -r $< && touch $@

setup-tof: .venv/.tof            ## what reads real ToF cameras: harvesters and pypylon (docs/payload.md)
.venv/.tof: requirements-tof.txt .venv/.installed
	@.venv/bin/python -m pip install --quiet --disable-pip-version-check --require-hashes -r $< && touch $@

setup-viewers: .venv/.viewers    ## the websocket for Foxglove (docs/viewers.md)
.venv/.viewers: requirements-viewers.txt .venv/.installed
	@.venv/bin/python -m pip install --quiet --disable-pip-version-check --require-hashes -r $< && touch $@

sources := $(shell find src -type f -not -path '*/__pycache__/*' -not -path '*/test/*')
build: install/.built            ## the three packages, by colcon
install/.built: .venv/.installed $(sources) $(wildcard tools/setup/*)
	@tools/setup/build.sh && touch $@

demo: build                      ## the sample bag through the node graph, with figures and a page
	@rm -rf results/demo
	@$(run) rgbd-dic up bags/sample --method all --as-fast-as-possible --domain 73 --out results/demo
	@$(run) rgbd-dic report results/demo

test: build                      ## all tests but the slow ones
	@OPENBLAS_NUM_THREADS=1 $(run) python -m pytest -m "not slow" $(PYTEST_ARGS)

test-slow: build                 ## the slow tests too
	@OPENBLAS_NUM_THREADS=1 $(run) python -m pytest $(PYTEST_ARGS)

test-acquisition: build         ## a flight through the real protocols, with faults, and its replay; QUICK=1
	@$(run) python tools/acquisition/run.py $(if $(QUICK),--quick) $(ACQUISITION_ARGS)

sanitize: build                  ## the kernel's tests under sanitizers (GCC), with many random calls
	@tools/sanitize.sh

bench: build                     ## this engine beside its peers: docs/benchmark.md; QUICK=1 for a short run
	@tools/bench/environment.sh || echo "peers that cannot be installed are reported as such"
	@$(run) python tools/bench/run.py $(if $(QUICK),--quick)

bench-real: build                ## the regression on real images alone
	@tools/bench/environment.sh
	@$(run) python tools/bench/run.py --real

live-bench: build                ## the graph live at full size: docs/live.md; FULL=1 ten minutes, QUICK=1 a short run
	@OPENBLAS_NUM_THREADS=1 $(run) python tools/live_bench/run.py $(if $(FULL),--full) $(if $(QUICK),--quick)

page-cost: build                 ## what viewers cost the graph: tables of docs/operator.md and docs/viewers.md; five minutes
	@$(run) python tools/bench/page_cost.py
	@$(run) python tools/bench/viewer_cost.py

validate: build                  ## chapters 3 and 4 of the thesis beside ours: docs/validation_chapter*.md
	@$(run) rgbd-dic validate chapter3
	@$(run) rgbd-dic validate chapter4
	@$(run) python tools/docs/regenerate.py

lint: .venv/.installed           ## formatting and lint, as CI checks them
	@.venv/bin/ruff format --check --quiet src test tools || { echo "not formatted: run make format"; exit 1; }
	@.venv/bin/ruff check --quiet src test tools
	@.venv/bin/clang-format --dry-run -Werror src/*/kernel/*.hpp src/*/kernel/*.cpp

format: .venv/.installed         ## format all code
	@.venv/bin/ruff format --quiet src test tools
	@.venv/bin/ruff check --quiet --fix src test tools
	@.venv/bin/clang-format -i src/*/kernel/*.hpp src/*/kernel/*.cpp

docs: demo                       ## tables and figures of README and docs, from what the commands print now
	@$(run) python tools/docs/regenerate.py
	@if [ -x /usr/bin/chromium ]; then $(run) python tools/docs/page_pictures.py; \
	else echo "pictures of the operator's pages are left as they are: no /usr/bin/chromium"; fi

figures: $(if $(QUICK),,validate) docs  ## every figure of the docs, anew; needs Chromium and npm; QUICK=1 all but make validate's
	@rm -rf results/annotated
	@$(run) rgbd-dic annotate results/demo/bag --out results/annotated
	@$(run) python tools/docs/viewer_picture.py results/annotated

sample: build                    ## bags/sample, anew
	@rm -rf bags/sample
	@$(run) rgbd-dic simulate --preset sample --out bags/sample

compile := UV_PYTHON_DOWNLOADS=never uv pip compile --universal --generate-hashes --no-strip-extras --no-emit-index-url \
	  --no-emit-find-links --no-annotate --no-header
lock:                            ## the pinned requirements from requirements*.in (needs uv)
	$(compile) --python-version 3.10 requirements.in -o requirements.txt
	$(compile) --python-version 3.10 requirements-camera.in -o requirements-camera.txt
	$(compile) --python-version 3.10 -c requirements.txt requirements-tof.in -o requirements-tof.txt
	$(compile) --python-version 3.10 -c requirements.txt requirements-viewers.in -o requirements-viewers.txt
	$(compile) --python-version 3.11 --override tools/bench/left_out.txt requirements-bench.in \
	  -o requirements-bench.txt

clean:                           ## all that was built, but not the virtual environment
	rm -rf build install log results

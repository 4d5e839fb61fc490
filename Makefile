PYTHON ?= python3
# Another Python gets an environment of its own: make test PYTHON=python3.13 makes .venv-3.13.
OTHER := $(if $(filter python3,$(PYTHON)),,-$(shell $(PYTHON) -c 'import sys; print("%d.%d" % sys.version_info[:2])'))
VENV := .venv$(OTHER)
BIN := $(VENV)/bin
DEMO := .venv-demo$(OTHER)
PINS := constraints.txt pyproject.toml $(wildcard cpp/*)
# Without bytecode, which takes half of pip's time: Python writes that of a module when it is first
# imported, unless this variable is set.
PIP_OPTIONS := --quiet --disable-pip-version-check --no-compile
# The versions with which pip builds the package: pip has a variable of its own for them since 25.3.
BUILD_PINS := PIP_CONSTRAINT=$(CURDIR)/constraints.txt PIP_BUILD_CONSTRAINT=$(CURDIR)/constraints.txt
unexport PYTHONDONTWRITEBYTECODE

.PHONY: install dev demo-environment demo demo-size plan test demo-physics core-environment test-core lowest-environment test-lowest interpreter-environment test-interpreter test-sanitizer test-mcu ros-environments test-ros wheel rehearsal test-wheel lint docs paper bench figures state-log clean

# What all commands use. `dev` adds what tests, linters and `make wheel` use, in the same environment.
EXTRAS := filters,fleet,live,report,scale,vision
DEV_EXTRAS := $(EXTRAS),dev
# More packages for this environment; the compiled core is in src already.
ADD = HOMEWARD_PURE=1 $(BIN)/python -m pip install $(PIP_OPTIONS) -c constraints.txt

install: $(VENV)/installed
dev: $(VENV)/dev

# $(call environment,FOLDER,PACKAGES)
define environment
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
		|| { echo "homeward needs Python 3.11 or later; make PYTHON=/path/to/it"; exit 1; }
	$(PYTHON) -m venv $(1)
	$(BUILD_PINS) $(1)/bin/python -m pip install $(PIP_OPTIONS) -c constraints.txt $(2)
endef

$(VENV)/installed: $(PINS)
	$(call environment,$(VENV),-e '.[$(EXTRAS)]')
	touch $@

$(VENV)/dev: $(PINS)
	$(call environment,$(VENV),-e '.[$(DEV_EXTRAS)]')
	touch $(VENV)/installed $@

# An environment of its own, for a first look without the packages of the other commands. It has a copy
# of the package: an editable one would write its compiled core into src, beside that of $(VENV).
demo-environment: $(DEMO)/installed
$(DEMO)/installed: $(PINS) $(shell find src -name '*.py')
	$(call environment,$(DEMO),'.[report]')
	touch $@

demo: demo-environment
	$(DEMO)/bin/homeward run sample --out out/demo

# The README gives the size: a new package of the extra report must not make the demo large.
demo-size: demo
	@size=$$(du -sm $(DEMO) | cut -f1); echo "$(DEMO): $$size MB (limit: 450 MB)"; test $$size -lt 450

plan: install
	$(BIN)/homeward plan warehouse --out out/plan

# A robot in a warehouse with physics and rendered images: a film and a report. It renders by EGL,
# without a screen (Debian: libegl1); MUJOCO_GL=osmesa by OSMesa.
demo-physics: install
	$(ADD) -e '.[demo-physics]'
	MUJOCO_GL=$${MUJOCO_GL:-egl} $(BIN)/python -m examples.warehouse.demo --out out/demo-physics
	$(BIN)/homeward run out/demo-physics/drive --out out/demo-physics/run

# MARK='not core': without the tests of test-core, where that has run.
test: dev
	$(BIN)/python -m pytest $(if $(MARK),-m "$(MARK)")

# The tests of the core, in an environment of its own that has neither vision, lab nor studio.
core-environment: wheel
	$(PYTHON) -m venv .venv-core$(OTHER)
	.venv-core$(OTHER)/bin/python -m pip install $(PIP_OPTIONS) -c constraints.txt "$$(echo out/wheel/*.whl)[bags,fleet,live,report]" evo hypothesis pytest pytest-xdist
	cd .venv-core$(OTHER)/lib/python3*/site-packages/homeward && rm -rf lab studio vision

test-core: core-environment
	.venv-core$(OTHER)/bin/python -m pytest -m core

# The oldest supported versions (lowest.txt), of Ubuntu 24.04 or, with PYTHON=python3.11, of Debian 12.
LOWEST = .venv-lowest$(OTHER)
LOWEST_TESTS = io/test_blas_threads.py io/test_files.py localizer/test_gating.py \
	localizer/test_home_fit.py localizer/test_parts.py localizer/test_tails.py odometry \
	test_core_install.py test_track.py
lowest-environment:
	$(PYTHON) -m venv $(LOWEST)
	$(LOWEST)/bin/python -m pip install $(PIP_OPTIONS) -c lowest.txt . hypothesis pytest

test-lowest: lowest-environment
	$(LOWEST)/bin/python -m pytest -o addopts=-q $(addprefix tests/,$(LOWEST_TESTS)) -k 'not which_extra'
	$(LOWEST)/bin/homeward run sample --out out/lowest

# The tests whose result can depend on the Python version, for a second Python (PYTHON=python3.13).
interpreter-environment: install
	$(BIN)/python -m pip install $(PIP_OPTIONS) -c constraints.txt hypothesis pytest pytest-xdist

test-interpreter: interpreter-environment
	$(BIN)/python -m pytest -m interpreter

# The tests that call the compiled core, with the address and undefined-behaviour sanitizers and Eigen's
# assertions. They run with the packages of $(VENV), but PYTHONPATH names a copy of homeward with such a
# core. The sanitizer and libstdc++, whose exceptions it intercepts, must be loaded before Python.
SANITIZED := out/sanitizer$(OTHER)
SANITIZER_TESTS = test_compiled_core.py localizer/test_kernels.py vision/test_vision_compiled.py
test-sanitizer: dev
	@if [ -f "$$($(CXX) -print-file-name=libasan.so 2>/dev/null)" ] \
		&& $(BIN)/python -c 'import os, sysconfig as s; os.stat(s.get_path("include") + "/Python.h")'; \
		then $(MAKE) --no-print-directory sanitizer-tests; \
		else echo "test-sanitizer skipped: no g++ with libasan, or no headers of Python"; fi

.PHONY: sanitizer-tests
sanitizer-tests: $(SANITIZED)/installed
	LD_PRELOAD="$$($(CXX) -print-file-name=libasan.so) $$($(CXX) -print-file-name=libstdc++.so)" \
		ASAN_OPTIONS=detect_leaks=0 UBSAN_OPTIONS=print_stacktrace=1 PYTHONMALLOC=malloc \
		PYTHONPATH=$(CURDIR)/$(SANITIZED) $(BIN)/python -m pytest -o addopts=-v --capture=sys \
		$(addprefix tests/,$(SANITIZER_TESTS)) -k 'not version and not variable'

# A failed build would leave NumPy alone, and the tests would be skipped.
$(SANITIZED)/installed: $(PINS) $(shell find src -name '*.py')
	rm -rf $(SANITIZED)
	$(BUILD_PINS) $(BIN)/python -m pip install $(PIP_OPTIONS) --no-deps --target $(SANITIZED) \
		-C cmake.build-type=Debug -C cmake.define.HOMEWARD_SANITIZE=ON .
	@grep -q __asan_init $(SANITIZED)/homeward/_core*.so \
		|| { echo "no sanitized core was built; add -v to this pip install for the reason"; exit 1; }
	touch $@

# On an emulated Cortex-M4F: gcc-arm-none-eabi, libnewlib-arm-none-eabi and qemu-system-arm of Debian.
test-mcu: dev
	$(BIN)/python -m pytest -n 0 -rs tests/lab/engine/test_export.py -k cortex_m4f

# Real nodes of ROS 2, Jazzy and Kilted, from PyPI's wheels, in environments of their own.
ros-environments: dev
	HOMEWARD_ROS=.venv-ros $(BIN)/python tests/ros/environments.py

# The tests mostly wait for a robot that drives in real time, so two run at once; a test that fails
# on a machine without time for both is repeated alone, and that result counts.
ROS_TESTS = HOMEWARD_ROS=.venv-ros $(BIN)/python -m pytest -rs -s tests/ros
test-ros: ros-environments
	$(ROS_TESTS) -n 2 || $(ROS_TESTS) -n 0 --last-failed --last-failed-no-failures none

# For machines without a compiler, in out/wheel: with the compiled core (pure where this machine has
# no C++ compiler either), for Python 3.11, or with a later PYTHON for all from 3.12.
wheel: dev
	rm -rf out/wheel
	$(BUILD_PINS) $(BIN)/python -m pip wheel --quiet --disable-pip-version-check --no-deps -w out/wheel/built .
	if ls out/wheel/built/*-any.whl 2>/dev/null; then cp out/wheel/built/*.whl out/wheel; \
		else PATH="$(CURDIR)/$(BIN):$$PATH" $(BIN)/auditwheel repair -w out/wheel out/wheel/built/*.whl; fi

# Installation of the source archive, with and without a C++ compiler, and of the wheel on a clean
# Debian 12; needs Debian's mmdebstrap. SYSTEMS=arm64: emulated; SYSTEMS=ubuntu: needs its mirror.
rehearsal: wheel
	$(BIN)/python packaging/rehearsal.py $(SYSTEMS)

# In an environment of its own, with an empty PATH.
test-wheel: wheel
	HOMEWARD_WHEEL=out/wheel $(BIN)/python -m pytest -n 0 -rs -s tests/test_wheel.py

lint: dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

# The site, in out/site: open its index.html. Any error in a page fails the build (but not with
# --quiet, which hides errors from their counter).
docs: install
	$(ADD) -e '.[docs]'
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build

# Needs pandoc, and a LaTeX for the PDF; without LaTeX it is a page.
paper:
	mkdir -p out
	cd paper && pandoc paper.md --citeproc --standalone $(if $(shell command -v pdflatex),-o ../out/paper.pdf,--self-contained -o ../out/paper.html)

# QUICK=1: few runs of each, without the real drives and the hours.
bench: install
	$(ADD) -e '.[bench]'
	$(BIN)/python -m benchmarks.inputs
	$(BIN)/python -m benchmarks.case2 $(if $(QUICK),--seeds 10)
	$(if $(QUICK),,$(BIN)/python -m benchmarks.case2 --limits)
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m benchmarks.engine $(if $(QUICK),--quick)
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m benchmarks.cost $(if $(QUICK),--part steady)
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m benchmarks.consistency --sabotage $(if $(QUICK),--quick)
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m benchmarks.leaderboard $(if $(QUICK),--quick --out /dev/null)
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m benchmarks.vision --part speed
	$(if $(QUICK),,$(BIN)/python -m benchmarks.mrclam)
	$(if $(QUICK),,$(BIN)/python -m benchmarks.mrclam --lag 5)
	$(if $(QUICK),,$(BIN)/python -m benchmarks.mrclam --smooth)
	$(if $(QUICK),,$(BIN)/python -m benchmarks.mrclam --falsify 3 --seeds 5)
	$(if $(QUICK),,$(BIN)/python -m benchmarks.vision)
	$(if $(QUICK),,$(BIN)/python -m benchmarks.render)

# Re-run the cheap commands of docs/figures.json, and report figures of the pages that differ.
figures: install
	$(BIN)/python -m benchmarks.figures

# Renew the states of the localiser that tests compare with; the commit message explains the diff.
state-log: install
	$(BIN)/python tests/localizer/state_log.py

clean:
	rm -rf $(VENV) .venv-demo* .venv-ros-* .venv-core* .venv-lowest* out build dist src/*.egg-info src/homeward/_core.*.so

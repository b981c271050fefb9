# Two commands do everything on a fresh machine: `make sim` and `make test`.
# Both set up .venv with pinned versions; PYTHON=python3.12 chooses the interpreter.
# `make help` lists the targets.

SHELL := /bin/bash
.SHELLFLAGS := -o pipefail -c
VENV := .venv
BIN := $(VENV)/bin
VERSIONS := (3, 11), (3, 12)
PYTHON ?= $(shell for python in python3.12 python3.11 python3; do \
	$$python -c 'import sys; sys.exit(sys.version_info[:2] not in [$(VERSIONS)])' 2>/dev/null \
	&& { command -v $$python; break; }; done)
RUN := run/paper.mcap

# .venv has a ROS of its own: nothing of a sourced one, or of another environment, may leak in.
unexport PYTHONPATH AMENT_PREFIX_PATH PYTHONHOME _ROS_WHEELS_BOOTSTRAP_COMPLETE
# Python keeps compiled modules, even if the shell forbids it.
unexport PYTHONDONTWRITEBYTECODE
ifdef _ROS_WHEELS_BOOTSTRAP_COMPLETE
unexport LD_LIBRARY_PATH
endif
export ROS_AUTOMATIC_DISCOVERY_RANGE ?= LOCALHOST
export ROS_LOG_DIR ?= $(CURDIR)/run/ros_log
PIP := pip install --quiet --no-compile --disable-pip-version-check
METADATA := pyproject.toml setup.py setup.cfg

.PHONY: help sim view test test-lowest test-without-ros browser graphics gallery picture modes pages paper \
	benchmark benchmark-quick benchmark-speed benchmark-speed-quick benchmark-latency benchmark-control \
	benchmark-fit composition observer references real-arm stability stretch stress stress-quick notebooks docs clean

help: ## list the targets
	@sed -n 's/^\([a-z-]*\):.*## /\1\t/p' $(MAKEFILE_LIST) | expand -t 24

sim: $(VENV)/.run ## run the node on the paper's scene for 10 s, log to run/paper.mcap
	@mkdir -p $(dir $(RUN))
	@$(BIN)/sim_node --ros-args --params-file config/paper.yaml \
		-p duration:=10.0 -p record_file:=$(RUN) 2>&1 | sed 's/^\[[A-Z]*\] \[[0-9.]*\] //'
	@echo "next: 'make view' shows the run; README.md shows how to command the node"

view: $(VENV)/.gallery ## show the run of `make sim` in rerun
	@test -n "$(VIEW)$$DISPLAY$$WAYLAND_DISPLAY" -o "$$(uname)" != Linux || { echo "there is no screen \
	(DISPLAY is not set): make view VIEW='--png run.png'" >&2; exit 1; }
	@$(BIN)/timo_sim view $(RUN) $(VIEW)

# The processes of pytest fill the cores; threads of BLAS would only wait for each other.
test test-lowest test-without-ros: export OPENBLAS_NUM_THREADS := 1
# Before, one process emits the code that they share: in each of them functions that many entry
# points call would be emitted again. $(1) is Python.
EMIT := from timo_sim.compiled.machine import intermediate_code as emit; \
	from timo_sim.export.prebuilt import entries; [emit(*each) for each in entries()]
PYTEST = $(1) -c '$(EMIT)' && $(1) -m pytest test --numprocesses 3 --dist worksteal
test: $(VENV)/.test graphics ## pass all tests
	@$(call PYTEST,$(BIN)/python)

browser: $(VENV)/.test ## drive the page of export-web in the browsers that are installed
	@$(BIN)/python -m pytest test/browser

# Options that leave out the test files that import one of the modules $(1) (a pattern of grep).
without = $(addprefix --ignore=,$(shell grep -rlE '^ *(import|from) ($(1))\b' test --include='*.py'))

# The lowest versions that pyproject.toml allows, on Python 3.12. rerun needs NumPy 2.
test-lowest: .venv-lowest/.test ## pass the tests with the lowest versions of dependencies
	@$(call PYTEST,.venv-lowest/bin/python) $(call without,rerun|rerun_cli)

# For Python without ROS, such as 3.13, for which Jazzy has no wheels.
test-without-ros: .venv-without-ros/.test graphics ## pass the tests that need no ROS
	@export PYTHONPATH=test; $(call PYTEST,.venv-without-ros/bin/python) -p no:ros_process -p without_ros

# Pictures of views, in the tests and in the gallery, are drawn without a screen by Mesa's driver.
GRAPHICS := mesa-vulkan-drivers libvulkan1
graphics:
	@test "$$(uname)" != Linux || { ldconfig -p | grep -q libvulkan.so.1 && \
		test -n "$(wildcard /usr/share/vulkan/icd.d/*.json /etc/vulkan/icd.d/*.json)"; } || { \
		sudo=; test "$$(id -u)" = 0 || sudo='sudo -n'; echo "installing $(GRAPHICS)"; \
		$$sudo apt-get -qq update && $$sudo apt-get -qq install -y --no-install-recommends \
		$(GRAPHICS) >/dev/null; } || echo "pictures of views need: apt-get install $(GRAPHICS)"

gallery: $(VENV)/.gallery graphics ## draw the runs of doc/gallery.md
	@$(BIN)/python -m benchmark.figures.gallery

picture: $(VENV)/.plot ## draw the pictures of README.md
	@$(BIN)/python -m benchmark.figures.picture
	@$(BIN)/python -m benchmark.figures.work_precision

modes: $(VENV)/.plot ## draw and fill doc/modes.md
	@$(BIN)/python -m benchmark.figures.modes

paper: $(VENV)/.plot ## fill doc/paper.md
	@$(BIN)/python -m benchmark.figures.paper

pages: $(VENV)/.run ## fill the tables of README.md and doc/
	@$(BIN)/python doc/tables.py

notebooks: $(VENV)/.docs ## run the notebooks and keep their outputs; what is compiled shows in the first run alone
	@$(BIN)/jupyter execute --inplace doc/tutorial/*.ipynb
	@$(BIN)/jupyter execute --inplace doc/tutorial/*.ipynb

docs: $(VENV)/.docs ## make a site of the pages, build/docs
	@$(BIN)/python -m sphinx -EqW --keep-going doc build/docs
	@echo "open build/docs/index.html in a browser"

benchmark: $(VENV)/.benchmark ## measure and fill doc/benchmark.md and README.md, up to 45 minutes
	@$(BIN)/python -m benchmark.accuracy.work_precision

benchmark-quick: $(VENV)/.benchmark ## do a part of make benchmark
	@$(BIN)/python -m benchmark.accuracy.work_precision --quick

references: $(VENV)/.benchmark ## compute the finite-element references again
	@$(BIN)/python -m benchmark.accuracy.generate_references

stability: $(VENV)/.run ## find the largest stable steps
	@$(BIN)/python -m benchmark.accuracy.stability

benchmark-speed: $(VENV)/.benchmark ## fill doc/speed.md
	@$(BIN)/python -m benchmark.speed

benchmark-speed-quick: $(VENV)/.benchmark ## do a part of make benchmark-speed
	@$(BIN)/python -m benchmark.speed --quick

benchmark-control: $(VENV)/.plot ## compare the example controllers
	@$(BIN)/python -m benchmark.figures.control

benchmark-fit: $(VENV)/.run ## fit made records for doc/fit.md, a quarter of an hour
	@$(BIN)/python -m benchmark.accuracy.fits

composition: $(VENV)/.benchmark ## try each effect in each use, and pairs of effects
	@$(BIN)/python -m benchmark.composition

benchmark-latency: $(VENV)/.benchmark ## measure the time from a command to its effect
	@$(BIN)/python -m benchmark.speed.latency

real-arm: $(VENV)/.benchmark ## fill doc/real_arm.md from the records in DATA=folder
	@$(BIN)/python -m benchmark.accuracy.real_arm

observer: $(VENV)/.plot ## fill the tables of doc/observer.md, DATA=folder as of real-arm
	@$(BIN)/python -m benchmark.accuracy.observer

stretch: $(VENV)/.benchmark ## compare arms that stretch with finite elements
	@$(BIN)/python -m benchmark.accuracy.stretch

stress: $(VENV)/.benchmark ## fill doc/stress.md, an hour and a half
	@$(BIN)/python -m benchmark.stress

stress-quick: $(VENV)/.benchmark ## do a part of make stress
	@$(BIN)/python -m benchmark.stress --quick

clean:
	rm -rf $(VENV) .venv-lowest .venv-without-ros run build install log .pytest_cache .mypy_cache \
		*.egg-info timo_sim/compiled/prebuilt doc/api

# A virtual environment that git does not see.
%/.made:
	@test -n "$(PYTHON)" || { echo "timo_sim needs Python 3.11 or 3.12: apt-get install \
	python3 python3-venv, or make PYTHON=..."; exit 1; }
	@$(PYTHON) -c 'import ensurepip' 2>/dev/null || { echo "$(PYTHON) cannot make virtual \
	environments: apt-get install python3-venv"; exit 1; }
	@echo "setting up $* with $$($(PYTHON) --version), this takes up to a minute"
	@rm -rf $* && $(PYTHON) -m venv $* && echo '*' > $*/.gitignore
	@$*/bin/$(PIP) --constraint constraints.txt uv || echo "uv cannot be installed: pip is used"
	@touch $@

# uv is faster than pip, but does not read pip's settings: pip follows where uv fails.
PACKAGE = --constraint $(CONSTRAINTS) --editable '.[$(EXTRAS)]'
define INSTALL
@$(@D)/bin/uv pip install --quiet --python $(@D) $(PACKAGE) || \
	$(@D)/bin/$(PIP) --use-pep517 $(PACKAGE)
@touch $@ $(addprefix $(@D)/,$(ALSO))
endef

# Extras of the package that each kind of target installs, and the kinds whose extras it has ALSO.
CONSTRAINTS := constraints.txt
$(VENV)/.run: EXTRAS := ros
$(VENV)/.plot: EXTRAS := ros,plot
$(VENV)/.gallery: EXTRAS := ros,plot,view
$(VENV)/.benchmark: EXTRAS := ros,benchmark
$(VENV)/.test: EXTRAS := ros,all,test
$(VENV)/.test: ALSO := .run .plot .gallery
$(VENV)/.docs: EXTRAS := docs
$(VENV)/.run $(VENV)/.plot $(VENV)/.gallery $(VENV)/.benchmark $(VENV)/.test $(VENV)/.docs: \
		constraints.txt $(METADATA) | $(VENV)/.made
	$(INSTALL)

.venv-lowest/.test: CONSTRAINTS := constraints-lowest.txt
.venv-lowest/.test: EXTRAS := ros,cluster,control,pandas,plot,rl,sweep,test
.venv-lowest/.test: constraints-lowest.txt $(METADATA) | .venv-lowest/.made
	$(INSTALL)

.venv-without-ros/.test: EXTRAS := all,test
.venv-without-ros/.test: constraints.txt $(METADATA) | .venv-without-ros/.made
	$(INSTALL)

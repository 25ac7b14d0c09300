# make demo    the main job end to end on a recording that is made on the spot
# make test    style, types and tests
# make doctor  checks the installation, the ROS graph and parameters
# Both set up .venv by themselves, from requirements.lock; a second run finds it done.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
DEMO_OUTPUT ?= build/demo
SPACE_OUTPUT ?= build/demo_space

# Processes of tests side by side. A worker that runs out of tests takes some from another, otherwise
# tests keep their order, so that what a module shares is rarely made twice.
WORKERS ?= 2
PYTEST_PARALLEL = $(BIN)/python -m pytest -n $(WORKERS) --dist worksteal

# What compiles the rod's kernels: it is installed first, and compiles while the rest is installed. What
# it has not reached then is compiled by whoever needs it. The lock holds every package, direct or not, so
# that pip resolves nothing (--no-deps): it would stumble over extras of packages of which a newer version
# than the lock's has come out.
COMPILER := numba|llvmlite|numpy|scipy|pyyaml

INSTALLED := $(VENV)/.installed
COMPILED := $(VENV)/.compiled

export PIP_DISABLE_PIP_VERSION_CHECK := 1

# The package asks for one thread itself, but tests import NumPy before it.
export OPENBLAS_NUM_THREADS ?= 1

# Without kept bytecode each of hundreds of processes compiles all libraries that it imports: 3 s each.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: setup doctor docs reference audit demo demo-space real picture examples paper bench challenge field stereo observer fuzz faults soak coverage test test-quick test-slow test-report test-export lint clean lock help

help:
	@sed -n 's/^# //p' Makefile | head -4
	@echo "also: setup, demo-space, docs, reference, real, examples, paper, bench, challenge, field, stereo, observer, fuzz, faults, soak, coverage, audit, test-quick, test-slow, test-report, test-export, lint, picture, lock, clean"

setup: $(COMPILED)

$(INSTALLED): requirements.lock setup.cfg setup.py
	@$(PYTHON) -c 'import sys; v = sys.version_info[:2]; sys.exit(None if (3, 10) <= v <= (3, 13) else f"Python {v[0]}.{v[1]} found; 3.10 to 3.13 is needed: make PYTHON=python3.11 ...")'
	@echo "Creating $(VENV) with the versions of requirements.lock (a minute or two)"
	@$(PYTHON) -m venv --clear $(VENV) || { \
		echo "Python cannot make a virtual environment; on Debian and Ubuntu: apt install python3-venv" >&2; exit 1; }
	@awk '/^[a-z]/ { wanted = /^($(COMPILER))==/ } wanted' requirements.lock > $(VENV)/compiler.lock
	$(BIN)/pip install --quiet --no-compile --no-deps --require-hashes -r $(VENV)/compiler.lock
	@$(BIN)/python -m dlo_ros.compile rod > $(VENV)/compile.log 2>&1 & compiling=$$!; \
	trap 'kill $$compiling 2> /dev/null' EXIT; \
	$(BIN)/pip install --quiet --no-compile --no-deps --require-hashes -r requirements.lock && \
	$(BIN)/pip install --quiet --no-compile --no-deps --no-build-isolation --editable .
	@touch $@

$(COMPILED): $(INSTALLED) $(wildcard dlo_ros/interpolation.py dlo_ros/spline_table.py dlo_ros/kernel_*.py dlo_ros/rod/*.py dlo_ros/rod/*/*.py dlo_ros/vision/*.py dlo_ros/vision/*/*.py dlo_ros/synthesis/*.py)
	$(BIN)/python -m dlo_ros.compile
	@touch $@

# It compiles while the recording is made.
demo: $(INSTALLED)
	$(BIN)/dlo_ros demo --output $(DEMO_OUTPUT) $(if $(BAG),--bag $(BAG)) $(if $(PARAMS),--params $(PARAMS))

# The same in space: two cameras, a rope between two grippers that are frames in /tf.
demo-space: $(INSTALLED)
	$(BIN)/dlo_ros demo --space --output $(SPACE_OUTPUT)

# What is installed, what is heard of running nodes, what does not match, and what to do.
doctor: $(INSTALLED)
	$(BIN)/dlo_ros doctor $(if $(PARAMS),--params $(PARAMS))

# The README's pictures, from the results of both.
picture: demo demo-space real
	cp $(DEMO_OUTPUT)/overview.png docs/demo.png
	cp $(SPACE_OUTPUT)/overview.png docs/demo_space.png
	cp build/real/real_wire.png docs/real_wire.png

# A measured wire: bags of its coordinates, identify, diagnose, the report; build/real.
real: $(COMPILED)
	$(BIN)/python examples/real_wire/real.py --output build/real

# The model against closed forms and boundary value problems; pictures in build/examples.
examples: $(COMPILED)
	@for example in examples/*.py; do $(BIN)/python $$example || exit 1; done

# The paper's tables and figures on simulated recordings, beside what identify finds; build/paper.
paper: $(COMPILED)
	$(BIN)/python -m paper

# Speed against other simulators, which are installed beside ours; build/bench.json.
bench: $(COMPILED)
	$(BIN)/pip install --quiet -r bench/requirements.txt
	$(BIN)/python -m bench

# Hidden effects that `diagnose` must find, COUNT of each kind from seed FIRST; takes a minute each.
# EFFECT="wall connector" hides these alone, COUNT times each; so it does in `make field`.
challenge: $(COMPILED)
	cd test && PYTHONPATH=. ../$(BIN)/python -m challenge.evaluate \
		--first $(or $(FIRST),1000) --count $(or $(COUNT),20) $(EFFECT:%=--effect %)

# The same with all that a real set-up has at once, COUNT cases of 0 to 3 causes each from seed FIRST.
# PICTURES=1 renders them; SPACE=1 moves in space.
field: $(COMPILED)
	cd test && PYTHONPATH=. ../$(BIN)/python -m field.evaluate \
		--first $(or $(FIRST),1000) --count $(or $(COUNT),20) $(if $(PICTURES),--pictures) $(if $(SPACE),--space) \
		$(EFFECT:%=--effect %)

# From two rendered cameras' pictures of a rope in space to E/mu and to a hidden cause, COUNT cases of
# each kind from seed FIRST; one to three minutes of processor time each.
stereo: $(COMPILED)
	cd test && PYTHONPATH=. ../$(BIN)/python -m field.stereo \
		--first $(or $(FIRST),1000) --count $(or $(COUNT),6)

# What the observer finds in rendered pictures, COUNT of each set from seed FIRST.
observer: $(COMPILED)
	$(BIN)/python test/support/vision_ends.py $(or $(COUNT),40) $(or $(FIRST),0)
	$(BIN)/python test/support/vision_space_accuracy.py 4 $(or $(FIRST),0)
	$(BIN)/python test/support/vision_space_accuracy.py 1 $(or $(FIRST),0) --late 8
	$(BIN)/python test/support/vision_space_accuracy.py 2 $(or $(FIRST),0) --depth
	@for set in "issue" "issue --ends none" motion "issue --kind clutter --ends none --hint right" other "other --ends none" "dark --ends start" "cell --ends start" absent; do \
		echo "set $$set"; $(BIN)/python test/support/vision_stress.py $(or $(COUNT),40) $(or $(FIRST),0) --set $$set || exit 1; \
	done

# The documentation as pages, build/docs/index.html; a warning is an error.
docs: $(INSTALLED)
	$(BIN)/python -m sphinx -W --keep-going -q -b html docs build/docs
	@echo "build/docs/index.html"

# The tables of parameters in docs/, from the package's own.
reference: $(INSTALLED)
	$(BIN)/python docs/reference.py

# Hostile messages to the nodes' callbacks, bytes over DDS, and damaged files; docs/reliability.md has
# the figures.
fuzz: $(COMPILED)
	DLO_FUZZ_MESSAGES=$(or $(MESSAGES),100000) DLO_FUZZ_FILES=$(or $(FILES),400) \
		DLO_WIRE_PAYLOADS=$(or $(PAYLOADS),3000) \
		$(BIN)/python -m pytest -s -m "" test/nodes/test_fuzz_nodes.py test/nodes/test_wire.py test/recordings/test_fuzz_files.py

# Live nodes, with messages lost, late, doubled, nodes killed, clocks that jump.
faults: $(COMPILED)
	$(BIN)/python -m pytest -s --durations=0 -m "" test/nodes/test_faults.py

# HOURS of simulated time, at most MINUTES of wall time: memory, lag and queues must not grow.
soak: $(COMPILED)
	$(BIN)/python test/support/soak.py --hours $(or $(HOURS),2) --minutes $(or $(MINUTES),120) \
		--output build/soak.csv

# Lines and branches of the package that the ordinary tests run; build/coverage/index.html.
coverage: $(COMPILED)
	rm -rf build/coverage
	$(BIN)/python -m pytest --cov --cov-branch --cov-report=term \
		--cov-report=html:build/coverage/html --cov-fail-under=90

lint: $(INSTALLED)
	$(BIN)/ruff check . && $(BIN)/ruff format --check . && $(BIN)/mypy

# First what may run side by side, in WORKERS processes; then the live nodes, whose deadlines want a
# machine that does little else, with lint on what they leave of it. Each part also runs where one
# before has failed.
test: $(COMPILED)
	@mkdir -p build; status=0; \
	$(PYTEST_PARALLEL) -m "not slow and not browser and not live" || status=1; \
	nice -n 19 $(MAKE) --no-print-directory lint > build/lint.log 2>&1 & lint=$$!; \
	$(BIN)/python -m pytest -m "live and not slow and not browser" test/nodes || status=1; \
	wait $$lint || status=1; cat build/lint.log; \
	exit $$status

# Every part of the package, without live nodes and long searches.
test-quick: $(COMPILED)
	$(PYTEST_PARALLEL) --durations=5 -m "not slow and not browser and not live and not long"

# Needs chromium or google-chrome on PATH.
test-report: $(COMPILED)
	$(BIN)/python -m pytest -m browser test/report/test_browser.py test/report/test_report.py

# Exported cables in the simulators themselves, which are installed beside ours.
test-export: $(COMPILED)
	$(BIN)/pip install --quiet --no-build-isolation --editable '.[export,parquet]' 'usd-core>=24.8'
	$(BIN)/python -m pytest test/export/test_export.py test/export/test_export_formats.py test/export/test_export_mujoco.py test/recordings/test_import_export.py test/recordings/test_import_points.py

test-slow: $(COMPILED)
	$(BIN)/python -m pytest -m slow

# Needs uv. The lock names no registry, so that it serves a mirror as well.
lock:
	uv pip compile setup.py --extra ros --extra test --extra coverage --extra docs --universal --python-version 3.10 \
		--generate-hashes --no-header --no-annotate --no-emit-index-url --upgrade \
		--output-file requirements.lock
	sed -i '1i # Made by `make lock` from setup.cfg, for Python 3.10 to 3.13.' requirements.lock

# Known vulnerabilities of what the lock names; asks PyPI.
audit: $(INSTALLED)
	$(PYTHON) -m venv build/audit && build/audit/bin/pip install --quiet pip-audit
	build/audit/bin/pip-audit --require-hashes --disable-pip -r requirements.lock

# Compiled kernels lie among the bytecode.
clean:
	rm -rf build install log $(VENV)
	find dlo_ros bench test paper -name __pycache__ -prune -exec rm -rf {} +

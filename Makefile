# Two commands do everything on a fresh machine with Python 3.11+ and make:
#   make train   installs, trains terrain=uplift for a minute or two, evaluates, prints the table
#   make test    sets up and runs the static checks and every test that is not marked as long
#   make install is the first part of train: flipperctl with 3-D and the live pages
#   make setup   adds what tests, documentation and every extra need
#   make ros     runs the tests on real rclpy of two distributions at a time, which it installs
#   make long    runs the tests marked as long, each night; about half an hour
#   make check runs the static checks and the quick tests, for use while one works
#   make gallery  runs the commands of docs/gallery.md, which make its films and figures, in four minutes
#   make docs  builds the documentation in build/docs, without the network; a warning is an error
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
DECISIONS ?= 30000

# Compiled modules are kept, even where the shell says otherwise: the tests start hundreds of processes.
# A module is compiled when it is first used; pip would compile all, 0.2 GB that nobody reads.
export PYTHONDONTWRITEBYTECODE :=

.PHONY: install setup train check test ros long static tests quick-tests gallery docs clean

install: $(VENV)/ready

setup: $(VENV)/complete

$(VENV)/ready: pyproject.toml requirements.txt
	@echo "1 of 3: a virtual environment in $(VENV)"
	$(PYTHON) -m venv $(VENV)
	@echo "2 of 3: the packages of requirements.txt, about 1.5 GB when installed"
	$(BIN)/python -m pip install --no-compile -r requirements.txt
	@echo "3 of 3: flipperctl itself"
	$(BIN)/python -m pip install --quiet --no-deps --editable .
	touch $@

$(VENV)/complete: $(VENV)/ready requirements-dev.txt
	@echo "for developers: the packages of requirements-dev.txt, about 1.1 GB more"
	$(BIN)/python -m pip install --no-compile -r requirements-dev.txt
	touch $@

train: install
	$(BIN)/flipperctl train terrain=uplift train.decisions=$(DECISIONS) \
		--output runs/uplift/make_$$(date +%Y-%m-%d_%H-%M-%S)
	$(BIN)/flipperctl eval "$$(ls -td runs/uplift/make_* | head -n 1)" \
		--episodes 50 --baseline level,geometric
	@echo "To type flipperctl in this shell: . $(VENV)/bin/activate"

# The page is the list of its commands.
gallery: install
	rm -rf build/gallery && mkdir -p build
	grep '^flipperctl ' docs/gallery.md | (cd build && PATH="$(CURDIR)/$(BIN):$$PATH" sh -ex)
	cp build/gallery_*.gif build/gallery_*.png docs/images

# The static checks stand back behind the tests, which run beside them.
check: setup
	$(MAKE) --jobs 2 static quick-tests

test: setup
	$(MAKE) --jobs 2 static tests

static:
	nice $(BIN)/ruff check .
	nice $(BIN)/ruff format --check .
	nice $(BIN)/mypy
	nice $(BIN)/lint-imports
	nice $(BIN)/python -m docs.lint

tests:
	$(BIN)/python -m tests.machine_code
	$(BIN)/pytest -n 2 --dist loadfile --no-loadscope-reorder

ros: setup
	$(MAKE) --jobs 2 ros-jazzy ros-kilted

ros-%:
	$(BIN)/pytest tests/ros -m "ros and not long" -k $*

long: setup
	$(BIN)/python -m tests.machine_code
	$(BIN)/pytest -n 2 --dist loadfile --no-loadscope-reorder -m long

quick-tests:
	$(BIN)/pytest -n 2 --dist loadfile --no-loadscope-reorder --quick

docs: setup
	$(BIN)/sphinx-build --builder html --fail-on-warning --keep-going --quiet docs build/docs

clean:
	rm -rf $(VENV) build dist *.egg-info .mypy_cache .pytest_cache .ruff_cache .import_linter_cache

# make demo    bend a CSG part, check it, write out/demo/ (part.stl, part.png, ...)
# make test    the quick tests; `make test ARGS="-m slow"` for the others
# make lint    style and formatting
# make fuzz    random cases, as many as asked; `make fuzz N=1000`
# make bench   speed, as ratios against the reference back end
# make gallery draw every primitive and operation: docs/gallery.md and its pictures
# make clean   remove outputs and caches (the environment in .venv stays)
#
# Each target first sets up .venv, and does so again only when setup.cfg, pyproject.toml or
# constraints.txt change. On Linux without an NVIDIA GPU the much smaller CPU build of torch
# is enough:
#
#     make demo PIP_EXTRA_INDEX_URL=https://download.pytorch.org/whl/cpu
#
# PYTHON names the interpreter to build the environment with (3.11 to 3.13).

SHELL := /bin/sh
BIN := .venv/bin
READY := .venv/ready
ARGS ?=
N ?= 100

SUPPORTED := import sys; sys.exit(not (3, 11) <= sys.version_info < (3, 14))
# Expanded only when the environment is built; `python3` first, because it is the user's choice.
PYTHON ?= $(shell for p in python3 python3.13 python3.12 python3.11; do \
	$$p -c '$(SUPPORTED)' 2>/dev/null && { command -v $$p; break; }; done)

.PHONY: help demo test lint fuzz bench gallery clean

help:
	@sed -n 's/^# \(make .*\)/\1/p' Makefile

demo: $(READY)
	$(BIN)/python examples/demo/run.py --out out/demo

test: $(READY)
	$(BIN)/python scripts/system_libraries.py --browser
	$(BIN)/python -m pytest $(ARGS)

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

fuzz: $(READY)
	$(BIN)/python -m tests.fuzz $(N) $(ARGS)

bench: $(READY)
	$(BIN)/implicit-warp bench

gallery: $(READY)
	$(BIN)/python docs/make_gallery.py $(ARGS)

clean:
	rm -rf out build dist *.egg-info .pytest_cache .ruff_cache .hypothesis
	find . -path ./.venv -prune -o -type d -name __pycache__ -print | xargs rm -rf

$(READY): setup.cfg pyproject.toml constraints.txt
	@python='$(PYTHON)'; \
	if [ -z "$$python" ] || ! "$$python" -c '$(SUPPORTED)'; then \
		echo 'implicit_warp needs Python 3.11, 3.12 or 3.13.' >&2; \
		echo "Tried: $${python:-python3, python3.13, python3.12, python3.11}." >&2; \
		echo 'Install one, or name it: make PYTHON=/path/to/python3.12' >&2; \
		exit 1; \
	fi; \
	set -ex; \
	"$$python" scripts/system_libraries.py; \
	"$$python" -m venv .venv
	$(BIN)/python -m pip install --disable-pip-version-check -c constraints.txt -e '.[test]'
	@touch $@

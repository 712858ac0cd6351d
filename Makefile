# All commands for users and developers. Each target creates the environment that it needs.
PYTHON := .venv/bin/python
HIR := .venv/bin/hir
DEMO := demo

.PHONY: demo test test-all test-gpu lint docs stability kill-test fuzz coverage mutation lower-bounds supply-chain readers bench materials paper-table ablations scaling clean setup setup-test help

help:
	@echo "make demo      reconstruct and export the sample capture"
	@echo "make test      lint, then every test that is not marked slow"
	@echo "make test-all  all tests but those of CUDA"
	@echo "make test-gpu  tests of a CUDA device"
	@echo "make lint      ruff check, ruff format --check, mypy"
	@echo "make docs      build the documentation site in build/docs"
	@echo "make parity    render exports in three.js, Babylon.js, Filament, Blender and Godot; write docs/engines/parity.md"
	@echo "make readers   open exports in assimp, trimesh, glTF-Transform, gltfpack and Blender; write docs/engines/readers.md"
	@echo "make stability  write the table of numerical edge cases, docs/stability.md"
	@echo "make kill-test  kill a small run at 50 random moments, resume it, compare all files"
	@echo "make fuzz      run every reader on mutated files for 10 minutes"
	@echo "make bench     measure every component against its reference; write docs/benchmarks.md and the table of README.md"
	@echo "make materials  render and run the materials benchmark, resumable (hours); add its figures to docs/benchmarks.md"
	@echo "make paper-table, ablations, scaling  experiments of the paper, resumable; write docs/studies/paper_experiments.md"
	@echo "make coverage  branch coverage of hir_core and hir_exporters"
	@echo "make mutation  mutation tests of materials, conventions and losses"
	@echo "make lower-bounds, make supply-chain   test the oldest dependencies; write an SBOM and list known vulnerabilities"
	@echo "make clean     remove .venv and the output of the demo"

setup:
	@tools/setup.sh run

setup-test:
	@tools/setup.sh test

demo: setup
	@$(HIR) reconstruct examples/sample_capture -o $(DEMO)/run --resume
	@$(HIR) export $(DEMO)/run -f glb -f usdz -f obj -o $(DEMO)/files -q
	@$(HIR) evaluate $(DEMO)/run --split test
	@echo
	@echo "files:   $(CURDIR)/$(DEMO)/files"
	@ls -1 $(DEMO)/files
	@echo "report:  $(CURDIR)/$(DEMO)/run/report.html"

test: lint
	@OMP_NUM_THREADS=1 $(PYTHON) -m pytest -n 2 --dist worksteal # two processes with one thread each, for two cores

test-all: setup-test # both processes shuffle with one seed, because they must collect the same order
	@OMP_NUM_THREADS=1 $(PYTHON) -m pytest -m "not gpu" -n 2 --dist worksteal --random-order --random-order-seed=$$(date +%s) --durations=30

test-gpu: setup-test # needs a CUDA device, and a PyTorch with CUDA in the environment
	@$(PYTHON) -m pytest -m gpu tests/devices tests/hir_core/testing

lint: setup-test
	@$(PYTHON) -m ruff check .
	@$(PYTHON) -m ruff format --check --quiet .
	@$(PYTHON) -m mypy

docs: setup-test
	@$(PYTHON) tools/write_reference.py
	@NO_MKDOCS_2_WARNING=1 $(PYTHON) -m mkdocs build --quiet
	@echo "documentation: $(CURDIR)/build/docs/index.html"

parity: setup-test
	@npm --prefix tools/parity ci --silent --no-fund --no-audit
	@[ -n "$$HIR_BLENDER_PYTHON" ] || [ -x .venv-blender/bin/python ] || tools/setup.sh blender || true
	@PYTHONPATH=tools $(PYTHON) -m parity

readers: setup-test
	@npm --prefix tools/readers ci --silent --no-fund --no-audit || true # a reader that is missing is written as not run
	@$(PYTHON) -m pip install --quiet --disable-pip-version-check --constraint requirements/ci.txt assimp-py coacd || true
	@[ -n "$$HIR_BLENDER_PYTHON" ] || [ -x .venv-blender/bin/python ] || tools/setup.sh blender || true
	@HIR_NODE_MODULES=$${HIR_NODE_MODULES:-$(CURDIR)/tools/node_modules} PYTHONPATH=tools $(PYTHON) -m readers

coverage: setup-test
	@$(PYTHON) -m pip install --quiet --disable-pip-version-check --constraint requirements/ci.txt coverage
	@OMP_NUM_THREADS=1 $(PYTHON) -m coverage run -m pytest -q
	@OMP_NUM_THREADS=1 $(PYTHON) -m coverage run -m pytest -q -m slow tests/hir_core/testing tests/hir_plugins/commands
	@$(PYTHON) -m coverage combine --quiet
	@$(PYTHON) -m coverage report --skip-covered --sort=cover

mutation: setup-test
	@$(PYTHON) -m pip install --quiet --disable-pip-version-check --constraint requirements/ci.txt mutmut
	@$(PYTHON) tools/mutation.py

lower-bounds: setup-test
	@$(PYTHON) tools/lower_bounds.py

supply-chain: setup-test
	@$(PYTHON) -m pip install --quiet --disable-pip-version-check --constraint requirements/ci.txt cyclonedx-bom pip-audit
	@$(PYTHON) tools/supply_chain.py

stability: setup-test
	@$(PYTHON) -m tests.stability.table

fuzz: setup-test
	@$(PYTHON) -m pip install --quiet --disable-pip-version-check --constraint requirements/ci.txt atheris || true # without atheris mutations are random
	@OMP_NUM_THREADS=1 $(PYTHON) tools/fuzz.py --seconds 600

kill-test: setup-test
	@OMP_NUM_THREADS=1 $(PYTHON) tools/kill_test.py --kills 50
	@OMP_NUM_THREADS=1 $(PYTHON) tools/kill_test.py --kills 10 --kind traced
	@OMP_NUM_THREADS=1 $(PYTHON) tools/kill_test.py --kills 10 --kind sfm

# fits are measured on the captures of HIR_SHARED; without these on the sample capture, which has no true mesh
CAPTURE = $(firstword $(wildcard $(or $(HIR_SHARED),../shared)/captures/spot) examples/sample_capture)

bench: setup-test
	@$(PYTHON) -m pip install --quiet --disable-pip-version-check -e '.[bench]'
	@$(HIR) bench shading reflectance geometry regularizers export initializers --capture $(CAPTURE) -o benchmarks/results -q > /dev/null
	@$(HIR) bench end-to-end --quick --capture $(CAPTURE) --workspace build/bench -o benchmarks/results -q > /dev/null
	@$(PYTHON) tools/write_benchmarks.py
	@echo "figures: $(CURDIR)/docs/benchmarks.md"

materials: setup-test
	@$(PYTHON) -m benchmarks.materials make build/materials
	@$(HIR) bench materials --materials build/materials --half both --mesh truth --regret --workspace build/bench -o benchmarks/results -q > /dev/null
	@$(PYTHON) tools/write_benchmarks.py
	@echo "figures: $(CURDIR)/docs/benchmarks.md"

CAPTURES = $(wildcard $(addprefix $(or $(HIR_SHARED),../shared)/captures/,spot avocado chair))
RUNS = $(addprefix build/bench/whole/,$(notdir $(CAPTURES)))

paper-table: setup-test
	@for c in $(CAPTURES); do r=build/bench/whole/$$(basename $$c); $(HIR) reconstruct $$c -o $$r --resume -q --set 'export=[]' \
	  && for s in test relight_0 relight_1; do [ ! -f $$c/transforms_$$s.json ] || $(HIR) evaluate $$r --split $$s -q > /dev/null; done; done
	@$(PYTHON) tools/write_benchmarks.py $(if $(RUNS),--runs $(RUNS))
	@$(PYTHON) -m benchmarks.experiments paper-table

ablations: setup-test
	@$(PYTHON) -m benchmarks.experiments images terms lights

scaling: setup-test
	@$(PYTHON) -m benchmarks.experiments scaling

clean:
	rm -rf .venv $(DEMO)

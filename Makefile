# Two commands do all the set-up on a fresh Debian or Ubuntu machine with Rust: make serve, make test.

CARGO_DENY_VERSION := 0.20.2
# The program that `make dist` and `make image` pack; it is built first, unless another is named.
BINARY ?= target/release/meshmend
VERSION = $(shell sed -n 's/^version = "\(.*\)"/\1/p' Cargo.toml | head -n 1)

.PHONY: serve test lint fmt clippy check-engine deny openapi check-openapi build bench bench-peers audit blender tools postgres check-api check-deploy page \
	check-page test-browser screenshots clients check-clients test-clients test-generators docs \
	pictures packed dist check-dist image check-image deploy-tools simulate check-model

## Install what is missing, build, and serve on 127.0.0.1:8080 with SQLite and a local folder. Uses an installed meshmend of this version
## instead of a build; `make serve BUILD=1` always builds.
serve: blender
	@BUILD=$(BUILD) sh scripts/serve.sh

## Install what the tests need and run them all.
test: tools blender postgres deploy-tools
	@if cargo nextest --version >/dev/null 2>&1; then \
		cargo nextest run --locked --features failpoints; \
	else \
		cargo test --locked --features failpoints; \
	fi
	@sh scripts/test-browser.sh
	@sh scripts/clients.sh test
	@sh scripts/generators.sh

lint: tools fmt clippy check-engine deny check-openapi check-page check-clients

fmt:
	cargo fmt --check

clippy:
	cargo clippy --locked --all-targets --features failpoints -- -D warnings

## The engine alone, as a library user builds it, and the command line without the service.
check-engine:
	cargo check --locked --lib
	cargo check --locked --features cli

## Licences, sources and duplicate versions of all dependencies.
deny:
	@cargo deny --version >/dev/null 2>&1 || cargo install --debug --locked cargo-deny --version $(CARGO_DENY_VERSION)
	cargo deny --log-level error check bans licenses sources
	cargo deny --log-level error --manifest-path clients/python/Cargo.toml --config deny.toml check bans licenses sources

## Known vulnerabilities; needs the advisory database from the network.
audit:
	cargo deny check advisories

## Write the OpenAPI document anew.
openapi:
	@. scripts/program.sh && build_program && $$MESHMEND_PROGRAM openapi > openapi/openapi.json.new
	mv openapi/openapi.json.new openapi/openapi.json

check-openapi:
	cargo test --locked --quiet --features failpoints --test cli -- --exact service::the_stored_openapi_document_is_up_to_date

## Build the page anew: src/web/page into src/web/dist.
page:
	@sh scripts/check-page.sh build

check-page:
	@sh scripts/check-page.sh

## The page in Chromium, which is installed for it if it is missing; a step of `make test`.
test-browser: tools
	@sh scripts/test-browser.sh

## Write the generated files of the clients: types from the OpenAPI document, and the synchronous Python client from the asynchronous one.
clients:
	@sh scripts/clients.sh generate

check-clients:
	@sh scripts/clients.sh check

## The clients against the built program; a step of `make test`.
test-clients: tools
	@sh scripts/clients.sh test

## The tables of the documentation, made of what the program says of itself.
docs:
	cargo test --locked --quiet --features failpoints --test docs -- --ignored --exact reference::write_tables

## The pictures of the documentation, drawn by the program.
pictures:
	cargo test --locked --quiet --features failpoints --test docs -- --ignored --exact pictures::write_pictures

## The README's pictures.
screenshots: tools
	@sh scripts/test-browser.sh screenshots

## Clients made by code generators from the OpenAPI document, against the built program; a step of `make test`.
test-generators: tools
	@sh scripts/generators.sh

## The served program against its OpenAPI document with schemathesis, which is installed for it; two minutes.
check-api: tools
	@sh scripts/check-api.sh

## docker/, deploy/ and .github/ with Helm's engine, hadolint, promtool, systemd-analyze, actionlint and Kubernetes' schemas, which are
## installed for it.
check-deploy:
	@sh scripts/check-deploy.sh

build:
	cargo build --release --locked --features service

packed: tools
	@[ "$(BINARY)" != target/release/meshmend ] || cargo build --release --locked --features service

## Everything that a release consists of, in dist/: program, symbols, Debian package, clients, crate, chart, bill of materials, checksums.
dist: packed
	@BINARY=$(BINARY) sh scripts/dist.sh

## Install and try each file in dist/, the Debian package in an empty Debian root.
check-dist:
	@sh scripts/check-dist.sh

## The images of docker/Dockerfile, with docker, podman or buildah, as archives in dist/.
image: packed
	@BINARY=$(BINARY) sh scripts/image.sh slim
	@BINARY=$(BINARY) sh scripts/image.sh full

## Start the root file systems of the images, read-only and as their user, and repair models in them.
check-image:
	@python3 scripts/check-image.py dist/meshmend-$(VERSION)-image-slim.tar slim
	@python3 scripts/check-image.py dist/meshmend-$(VERSION)-image.tar full

## What one API process, one worker, one PostgreSQL and one bucket carry, and jobs per second through the whole service; four minutes.
bench: tools postgres
	cargo bench --locked --features service --bench capacity
	cargo bench --locked --features service --bench jobs_per_second -- 100

## Large models: meshmend beside pymeshfix, MeshLib and manifold3d, where PEER_PYTHON (default python3) has them; it needs numpy.
bench-peers: build
	$${PEER_PYTHON:-python3} benches/peers/giants.py --program target/release/meshmend $(PEER_ARGS)

## The queue's protocol on a simulated fleet: 100,000 histories, about a minute of one core (opt-level 1). FLEET_SEED and FLEET_HISTORIES choose others.
simulate:
	FLEET_HISTORIES=$${FLEET_HISTORIES:-100000} FLEET_STORE_HISTORIES=$${FLEET_STORE_HISTORIES:-200} \
		cargo test --locked --features failpoints --test fleet -- simulation stores

## The queue's model with Spin, with all guards and without each.
check-model:
	@sh scripts/check-model.sh

## A Blender for tier 3: one on PATH, the distribution's package, or bpy in a private environment.
blender:
	@sh scripts/install-blender.sh

## What the build needs beside Rust: a C compiler, for SQLite.
tools:
	@sh scripts/install-tools.sh

## Helm's engine and linters, for the tests of deploy/ and for `make check-deploy`. Without them these tests are skipped.
deploy-tools:
	@sh scripts/install-deploy-tools.sh || echo "## THE CHART IS NOT TESTED: Helm's engine could not be installed ##"

## What tests of the PostgreSQL store make their clusters from.
postgres:
	@sh scripts/install-postgres.sh

#!/bin/sh
# Tests that common generators make working clients from the OpenAPI document: openapi-python-client, openapi-typescript, progenitor.
# Also lints the document. Installs what is missing. Without Python the script says so and passes.
set -eu

cd "$(dirname "$0")/.."
. scripts/packages.sh
. scripts/program.sh
mkdir -p "${CARGO_TARGET_DIR:-target}"
target=$(cd "${CARGO_TARGET_DIR:-target}" && pwd)
requirements=tests/generators/python/requirements.txt

say() { printf 'generators: %s\n' "$*" >&2; }
has_python() { python3 -c 'import sys, venv, ensurepip; sys.exit(sys.version_info < (3, 10))' >/dev/null 2>&1; }
has_node() { command -v npm >/dev/null 2>&1 && [ "$(node -p 'process.versions.node.split(".")[0]')" -ge 20 ]; }

has_python || install_packages python3 python3-venv || true
has_node || install_packages nodejs npm || true
has_python || { say "NOT TESTED: Python 3.10 or later with venv is missing"; exit 0; }

venv=$target/generators/venv-$(cksum <$requirements | cut -d ' ' -f 1)
if ! [ -f "$venv/is-installed" ]; then
    rm -rf "$target"/generators/venv-*
    mkdir -p "$target/generators"
    python3 -m venv "$venv"
    "$venv/bin/python" -m pip install --quiet --disable-pip-version-check --only-binary=:all: -r $requirements || {
        say "NOT TESTED: pip could not install $requirements"
        exit 0
    }
    touch "$venv/is-installed"
fi
if has_node; then
    (
        cd tests/generators/typescript
        cmp -s package-lock.json node_modules/.lock || { npm ci --silent --no-audit --no-fund >&2 && cp package-lock.json node_modules/.lock; }
    )
else
    say "TypeScript is NOT TESTED: node 20 or later is missing"
fi

build_program
GENERATORS_WORKSPACE=$target/generators
export MESHMEND_PROGRAM GENERATORS_WORKSPACE
PYTHONDONTWRITEBYTECODE=1 exec "$venv/bin/python" -m pytest -q -p no:cacheprovider tests/generators

#!/bin/sh
# The packages for Python and TypeScript: their generated files, their types, their tests. Without Python or node, the script prints a
# warning and succeeds.
#   clients.sh generate     writes the types from openapi/openapi.json, and the synchronous Python client from the asynchronous one
#   clients.sh check        fails if generated files are stale, if types don't agree, or if the Python package's Rust code has warnings
#   clients.sh test         builds the wheel, and runs both packages and their examples against the program; installs missing tools
set -eu

cd "$(dirname "$0")/.."
. scripts/packages.sh
. scripts/program.sh
verb=$1
target=${CARGO_TARGET_DIR:-target}
python=clients/python
shapes=$python/src/meshmend/shapes.py

say() { printf 'clients: %s\n' "$*" >&2; }

skip() {
    say "##################################################################"
    say "## A CLIENT WAS NOT LOOKED AT ($verb): $*"
    say "##################################################################"
}

has_python() { python3 -c 'import sys, venv, ensurepip; sys.exit(sys.version_info < (3, 10))' >/dev/null 2>&1; }
has_node() { command -v npm >/dev/null 2>&1 && [ "$(node -p 'process.versions.node.split(".")[0]')" -ge 20 ]; }

# The packages of requirements.txt in an environment of their own, made anew when they change.
environment() {
    mkdir -p "$target"
    venv=$(cd "$target" && pwd)/clients-$(cksum <$python/requirements.txt | cut -d ' ' -f 1)
    if ! [ -f "$venv/is-installed" ]; then
        rm -rf "$target"/clients-*
        python3 -m venv "$venv" && "$venv/bin/python" -m pip install --quiet --disable-pip-version-check --only-binary=:all: \
            -r $python/requirements.txt || return 1
        touch "$venv/is-installed"
    fi
}

packages() {
    cmp -s clients/typescript/package-lock.json clients/typescript/node_modules/.lock && return
    (cd clients/typescript && npm ci --silent --no-audit --no-fund >&2 && cp package-lock.json node_modules/.lock)
}

# The synchronous client, from the asynchronous one, in a folder.
synchronous() {
    "$venv/bin/python" scripts/sync-client.py "$1"
    "$venv/bin/ruff" format --quiet --config $python/pyproject.toml "$1"
}

# Builds the wheel as in development and installs it.
wheel() {
    rm -rf "$venv/wheels"
    "$venv/bin/maturin" build --quiet --locked --profile dev --manifest-path $python/Cargo.toml --target-dir "$(cd "$target" && pwd)" \
        --interpreter "$venv/bin/python" --out "$venv/wheels" >&2
    "$venv/bin/python" -m pip install --quiet --disable-pip-version-check --no-deps --force-reinstall "$venv"/wheels/*.whl
}

# generated FILE: the types for Python from the document.
generated() {
    "$venv/bin/datamodel-codegen" --input openapi/openapi.json --input-file-type openapi --output "$1" \
        --output-model-type typing.TypedDict --target-python-version 3.10 --enum-field-as-literal all --use-type-alias \
        --use-title-as-name --use-tuple-for-fixed-length-arrays --use-object-type --use-schema-description --use-field-description \
        --use-single-line-docstring --disable-timestamp --formatters builtin
}

for_python() {
    case $verb in
    generate)
        generated $shapes
        synchronous $python/src/meshmend/synchronous
        ;;
    check)
        generated "$venv/shapes.py"
        rm -rf "$venv/synchronous"
        synchronous "$venv/synchronous"
        for file in "$venv"/synchronous/*; do
            stale=$python/src/meshmend/synchronous/${file##*/}
            cmp -s "$file" "$stale" || { say "$stale is stale: run \`make clients\`"; exit 1; }
        done
        cargo fmt --check --manifest-path $python/Cargo.toml
        PYO3_PYTHON=$venv/bin/python cargo clippy --quiet --locked --manifest-path $python/Cargo.toml --target-dir "$target" -- -D warnings
        cmp -s $shapes "$venv/shapes.py" || { say "$shapes is stale: run \`make clients\`"; exit 1; }
        (cd $python && "$venv/bin/ruff" format --quiet --check . && "$venv/bin/ruff" check --quiet . && "$venv/bin/mypy" --no-error-summary \
            --cache-dir "$venv/mypy" src examples)
        ;;
    test)
        wheel
        (cd $python && PYTHONDONTWRITEBYTECODE=1 "$venv/bin/python" -m pytest)
        ;;
    esac
}

for_typescript() {
    (cd clients/typescript && npm run --silent "$verb") || {
        [ "$verb" != check ] || say "what is generated is written anew by \`make clients\`"
        exit 1
    }
}

if [ "$verb" = test ]; then
    has_python || install_packages python3 python3-venv || true
    has_node || install_packages nodejs npm || true
    build_program
    export MESHMEND_PROGRAM
fi
if ! has_python; then
    skip "Python 3.10 or later with its venv is missing"
elif ! environment; then
    skip "pip could not install what $python/requirements.txt names"
else
    for_python
fi
if ! has_node; then
    skip "node 20 or later is missing"
elif ! packages; then
    skip "npm could not install what clients/typescript/package-lock.json names"
else
    for_typescript
fi

#!/bin/sh
# The clients of Python and TypeScript: what is generated of them, their types, their tests. Where there is no Python or no node it says
# so, loudly, and passes: what is committed is taken as it is.
#   clients.sh generate     writes the types anew from openapi/openapi.json
#   clients.sh check        fails where they are stale, or where a client's types don't agree
#   clients.sh test         runs both clients and their examples against the built program; installs what is missing
set -eu

cd "$(dirname "$0")/.."
. scripts/packages.sh
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

# generated FILE: what the document makes of the types for Python.
generated() {
    "$venv/bin/datamodel-codegen" --input openapi/openapi.json --input-file-type openapi --output "$1" \
        --output-model-type typing.TypedDict --target-python-version 3.10 --enum-field-as-literal all --use-type-alias \
        --use-title-as-name --use-tuple-for-fixed-length-arrays --use-object-type --use-schema-description --use-field-description \
        --use-single-line-docstring --disable-timestamp --formatters builtin
}

for_python() {
    case $verb in
    generate) generated $shapes ;;
    check)
        generated "$venv/shapes.py"
        cmp -s $shapes "$venv/shapes.py" || { say "$shapes is stale: run \`make clients\`"; exit 1; }
        (cd $python && "$venv/bin/ruff" format --quiet --check . && "$venv/bin/ruff" check --quiet . && "$venv/bin/mypy" --no-error-summary \
            --cache-dir "$venv/mypy" src examples)
        ;;
    test) (cd $python && PYTHONDONTWRITEBYTECODE=1 PYTHONPATH=src "$venv/bin/python" -m pytest) ;;
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
    [ -n "${MESHMEND_PROGRAM:-}" ] || cargo build --locked --quiet --features failpoints
    MESHMEND_PROGRAM=${MESHMEND_PROGRAM:-$(cd "$target" && pwd)/debug/meshmend}
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

#!/bin/sh
# Asks the built program what its OpenAPI document promises, with schemathesis: first without keys, then with one that may do
# everything. Fails where an answer is a fault, is not documented or is not as documented.
set -eu

cd "$(dirname "$0")/.."
. scripts/program.sh
environment=.venv-api
# Of each of the two runs.
seconds=${MESHMEND_CHECK_API_SECONDS:-60}
seed=${MESHMEND_CHECK_API_SEED:-1}

say() { printf 'check-api: %s\n' "$*" >&2; }

if ! [ -f "$environment/is-installed" ]; then
    say "installing schemathesis into $environment"
    python3 -m venv "$environment"
    "$environment/bin/python" -m pip install --quiet --disable-pip-version-check --only-binary=:all: schemathesis==4.32.5
    touch "$environment/is-installed"
fi
build_program
program=$MESHMEND_PROGRAM
folder=$(mktemp -d)
process=""
# shellcheck disable=SC2086
trap '[ -z "$process" ] || kill $process 2>/dev/null || true; wait; rm -rf "$folder"' EXIT

# check NAME ARGUMENTS-OF-SERVE: schemathesis' own arguments are in $asking.
check() {
    name=$1
    shift
    say "$name"
    # Webhooks may go anywhere so that they can be made; nothing is delivered.
    "$program" serve --listen 127.0.0.1:0 --data-dir "$folder/$name" --blender /nonexistent --blender-warm-up false --log warn,meshmend::cli=info \
        --webhook-allow-private --no-webhooks "$@" 2>"$folder/$name.log" &
    process=$!
    tries=0
    until url=$(sed -n 's/.*listening on \(http[^, ]*\).*/\1/p' "$folder/$name.log") && [ -n "$url" ]; do
        tries=$((tries + 1))
        if [ "$tries" -gt 300 ] || ! kill -0 "$process" 2>/dev/null; then
            cat "$folder/$name.log" >&2
            exit 1
        fi
        sleep 0.1
    done
    failed=""
    SCHEMATHESIS_HOOKS=models PYTHONPATH=scripts/check-api PYTHONDONTWRITEBYTECODE=1 \
        "$environment/bin/schemathesis" --config-file scripts/check-api/schemathesis.toml run "$url/openapi.json" \
        --checks all --seed "$seed" --max-time "$seconds" ${key:+--header "Authorization: Bearer $key"} || failed=yes
    kill "$process"
    wait "$process" || true
    process=""
    if grep ' ERROR ' "$folder/$name.log" >&2; then failed=yes; fi
    [ -z "$failed" ] || exit 1
}

key=""
check open --auth open
key=$("$program" keys create --data-dir "$folder/keys" --scopes jobs:read,jobs:write,webhooks,tokens,metrics 2>/dev/null | tail -n 1)
check keys --auth keys
say "all is well"

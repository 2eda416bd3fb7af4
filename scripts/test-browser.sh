#!/bin/sh
# The page and the widget in a real browser: installs Chromium, node and the packages of tests/browser and examples/shop if they are missing, and runs the tests there
# against the built program. Where no browser can be installed it says so, loudly, and passes.
#   test-browser.sh                 the tests
#   test-browser.sh screenshots     makes docs/pictures anew
set -eu

cd "$(dirname "$0")/.."
. scripts/packages.sh
. scripts/program.sh

say() { printf 'test-browser: %s\n' "$*" >&2; }

skip() {
    say "##################################################################"
    say "## THE PAGE WAS NOT TESTED: $*"
    say "##################################################################"
    exit 0
}

browser() {
    for name in "${MESHMEND_BROWSER:-}" chromium chromium-browser google-chrome; do
        if [ -n "$name" ] && command -v "$name" >/dev/null 2>&1; then
            command -v "$name"
            return
        fi
    done
}

node_is_new() { command -v node >/dev/null 2>&1 && [ "$(node -p 'process.versions.node.split(".")[0]')" -ge 20 ]; }

packages=""
[ -n "$(browser)" ] || packages="$packages chromium"
command -v node >/dev/null 2>&1 || packages="$packages nodejs"
command -v npm >/dev/null 2>&1 || packages="$packages npm"
# The words of $packages are meant to be split.
# shellcheck disable=SC2086
[ -z "$packages" ] || install_packages $packages || skip "please install:$packages"
[ -n "$(browser)" ] || skip "there is no Chromium"
node_is_new || skip "node is older than 20"

for folder in tests/browser examples/shop; do
    if ! cmp -s "$folder/package-lock.json" "$folder/node_modules/.lock"; then
        (cd "$folder" && npm ci --silent --no-audit --no-fund >&2) || skip "npm could not install what $folder needs"
        cp "$folder/package-lock.json" "$folder/node_modules/.lock"
    fi
done
build_program
MESHMEND_BROWSER=$(browser)
export MESHMEND_PROGRAM MESHMEND_BROWSER
if [ "${1:-}" = screenshots ]; then
    exec node tests/browser/screenshots.mjs
fi
# One after the other: they measure times.
exec node --test --test-concurrency=1 tests/browser/*.test.mjs

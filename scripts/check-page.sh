#!/bin/sh
# Whether src/web/dist is what src/web/page makes, whether that is sound TypeScript, and its unit tests. Where there is no node the
# committed files are taken as they are.
set -eu

cd "$(dirname "$0")/../src/web/page"
if ! command -v npm >/dev/null 2>&1 || [ "$(node -p 'process.versions.node.split(".")[0]')" -lt 20 ]; then
    printf 'check-page: node 20 or later is missing: src/web/dist WAS NOT COMPARED with its sources\n' >&2
    exit 0
fi
if ! cmp -s package-lock.json node_modules/.lock; then
    npm ci --silent --no-audit --no-fund >&2
    cp package-lock.json node_modules/.lock
fi
if [ "${1:-}" = build ]; then
    exec npm run --silent build
fi
exec npm run --silent check

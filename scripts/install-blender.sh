#!/bin/sh
# Makes tier 3's program available: Blender on PATH, or else the distribution's package, or else the bpy module in a
# private environment. Does nothing where there is one already, and always succeeds: the service works without Blender.
set -u

cd "$(dirname "$0")/.." || exit 0
environment=.venv-blender

say() { printf 'install-blender: %s\n' "$*" >&2; }

if [ -n "${MESHMEND_BLENDER:-}" ]; then
    say "MESHMEND_BLENDER names $MESHMEND_BLENDER; nothing to install"
    exit 0
fi
if command -v blender >/dev/null 2>&1; then
    exit 0
fi
# Importing bpy takes seconds, so the mark of a finished installation is a file.
if [ -x "$environment/bin/python" ] && [ -f "$environment/bpy-is-installed" ]; then
    exit 0
fi

as_root() {
    if [ "$(id -u)" = 0 ]; then
        "$@"
    else
        sudo -n "$@"
    fi
}

can_be_root() {
    [ "$(id -u)" = 0 ] || { command -v sudo >/dev/null 2>&1 && sudo -n true 2>/dev/null; }
}

install_package() {
    command -v apt-get >/dev/null 2>&1 && can_be_root || return 1
    say "installing the package 'blender'"
    # env, since sudo does not pass the variable on.
    set -- apt-get install -y -qq --no-install-recommends blender
    as_root env DEBIAN_FRONTEND=noninteractive "$@" >/dev/null 2>&1 ||
        { as_root apt-get update -qq >/dev/null 2>&1 &&
            as_root env DEBIAN_FRONTEND=noninteractive "$@" >/dev/null; } || return 1
    command -v blender >/dev/null 2>&1 && blender --version >/dev/null 2>&1
}

# Each release of bpy is for one version of Python; pip picks the newest that a Python can take.
install_module() {
    for python in python3.13 python3.12 python3.11 python3.10 python3; do
        # A name on PATH may be a stand-in for a version that is not there.
        "$python" -c 'import venv, ensurepip' >/dev/null 2>&1 || continue
        rm -rf "$environment"
        "$python" -m venv "$environment" >/dev/null 2>&1 || continue
        say "trying bpy with $("$python" --version)"
        "$environment/bin/python" -m pip install --quiet --disable-pip-version-check --only-binary=:all: bpy \
            >/dev/null 2>&1 || continue
        # It may be installed and still lack a system library.
        if reason=$("$environment/bin/python" -c 'import bpy' 2>&1); then
            touch "$environment/bpy-is-installed"
            say "bpy $("$environment/bin/python" -c 'import bpy; print(bpy.app.version_string)' | tail -n 1) is in $environment"
            return 0
        fi
        say "bpy does not start: $(printf '%s\n' "$reason" | tail -n 1)"
    done
    rm -rf "$environment"
    return 1
}

install_package && exit 0
install_module && exit 0
say "WARNING: no Blender could be installed; tier 3 will be off. Install Blender 3.0 or later, or set MESHMEND_BLENDER."
exit 0

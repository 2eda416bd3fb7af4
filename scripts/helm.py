"""Helm's engine on a chart, without a cluster:

    helm.py lint CHART                                    prints what `helm lint --strict` says; fails if it warns
    helm.py render CHART RELEASE NAMESPACE [VALUES.json]  prints the objects as YAML documents; without values, the chart's own

Runs in the environment that scripts/install-deploy-tools.sh makes.
"""

import json
import sys

from helm_python import Chart, HelmError, lint


def main(verb, chart, release="meshmend", namespace="meshmend", values=None):
    if verb == "lint":
        report = lint(chart, strict=True)
        problems = [message for message in report["messages"] if message["severity"] > 1]
        if problems or report["errors"]:
            sys.exit(f"{problems} {report['errors']}")
        return
    given = {}
    if values is not None:
        with open(values, encoding="utf-8") as file:
            given = json.load(file)
    with Chart.load(chart) as loaded:
        try:
            loaded.validate_schema(given)
            rendered = loaded.render(given, name=release, namespace=namespace)
        except HelmError as error:
            sys.exit(str(error))
    for path, text in rendered.items():
        if path.endswith(".yaml") and text.strip():
            print(f"---\n{text}")


main(*sys.argv[1:])

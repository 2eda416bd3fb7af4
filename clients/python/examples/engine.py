"""Repairs a model on this machine, without a service: python engine.py broken.off repaired.stl"""

import sys

import meshmend

broken, repaired = sys.argv[1:]
try:
    result = meshmend.repair(broken, output="stl", max_tier=2, deadline_s=60)
except meshmend.InvalidModel as error:
    sys.exit(f"refused: {error.kind}: {error}")
print(f"{result.outcome}: {result.summary}")
print(f"{len(result.vertices)} vertices, {len(result.faces)} faces")
if result.is_printable:
    result.save(repaired)

"""Repairs a model: python repair.py http://127.0.0.1:8080 broken.off repaired.stl"""

import sys

from meshmend import Client

address, broken, repaired = sys.argv[1:]
client = Client(address)
job = client.repair(broken, {"output": "stl"})
print(f"{job.outcome}: {job.report['summary']}")
if job.is_printable:
    job.save(repaired)

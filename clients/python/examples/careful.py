"""Repairs a model with a key, progress, limits and handling of every error."""

import os
import sys

from meshmend import Client, JobFailed, JobTimeout, Problem, ProgressEvent


def show(progress: ProgressEvent) -> None:
    print(f"{progress['stage'] or 'waiting'} {progress['percent']} %", file=sys.stderr)


address, broken, repaired = sys.argv[1:]
try:
    with Client(address, os.environ.get("MESHMEND_API_KEY")) as client:
        job = client.repair(broken, {"max_tier": 2}, on_progress=show, timeout=300, metadata={"order": "1234"})
        print(job.outcome)
        if "model" in job.artifacts:
            job.save(repaired)
except Problem as problem:
    sys.exit(f"refused: {problem.code}: {problem.detail} (request {problem.request_id})")
except JobFailed as failed:
    sys.exit(f"failed: {failed}")
except JobTimeout:
    sys.exit("timeout: the job was canceled")

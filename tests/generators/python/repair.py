"""Repairs a model with a client that openapi-python-client generates.

Arguments: the service's address, the model, where the result goes.
"""

import sys
from io import BytesIO
from pathlib import Path

from generated import Client
from generated.api.jobs import get_artifact, get_job, submit_job
from generated.models import Job, OutputFormat, RepairJobOptions, RepairJobOptionsMode, Status, SubmitForm
from generated.types import File

address, given, result = sys.argv[1:]
client = Client(base_url=address, raise_on_unexpected_status=True)
model = File(payload=BytesIO(Path(given).read_bytes()), file_name="box.stl")
options = RepairJobOptions(mode=RepairJobOptionsMode.REPAIR, output=OutputFormat.STL)
job = submit_job.sync(client=client, body=SubmitForm(file=[model], options=options))
assert isinstance(job, Job), job
while job.status in (Status.QUEUED, Status.RUNNING):
    job = get_job.sync(job.id, client=client, wait=20)
    assert isinstance(job, Job), job
print(job.status, job.outcome)
repaired = get_artifact.sync(job.id, "model", client=client)
assert isinstance(repaired, File), repaired
Path(result).write_bytes(repaired.payload.read())

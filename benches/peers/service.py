"""A mesh repair service as it is usually written: FastAPI takes the upload, pymeshfix repairs it in the background.

A folder for each job, a dict for what is known of it. REPAIR_PROCESSES=0 repairs in the threads of BackgroundTasks, as most
tutorials have it; a number above that in a ProcessPoolExecutor of so many. With REPAIR_TIMEOUT_S each job has a process of its own,
so many at once, which is killed when its time is over.
"""

import asyncio
import os
import shutil
import sys
import tempfile
import uuid
from concurrent.futures import ProcessPoolExecutor
from contextlib import asynccontextmanager
from pathlib import Path

import pymeshfix
from fastapi import BackgroundTasks, FastAPI, HTTPException, UploadFile
from fastapi.responses import FileResponse

PROCESSES = int(os.environ.get("REPAIR_PROCESSES", "0"))
TIMEOUT = float(os.environ.get("REPAIR_TIMEOUT_S", "0"))
MEND_APART = "import pymeshfix, sys; pymeshfix.clean_from_file(sys.argv[1], sys.argv[2])"
DATA = Path(tempfile.mkdtemp(prefix="repair-"))

jobs: dict[str, str] = {}
pool: ProcessPoolExecutor | None = None
free: asyncio.Semaphore | None = None


@asynccontextmanager
async def lifespan(_: FastAPI):
    global pool, free
    free = asyncio.Semaphore(PROCESSES) if TIMEOUT else None
    pool = ProcessPoolExecutor(PROCESSES) if PROCESSES and not TIMEOUT else None
    yield
    if pool:
        pool.shutdown()
    shutil.rmtree(DATA)


app = FastAPI(lifespan=lifespan)


def mend(folder: Path) -> None:
    pymeshfix.clean_from_file(str(folder / "input.stl"), str(folder / "repaired.stl"))


def mend_here(job: str) -> None:
    jobs[job] = "running"
    try:
        mend(DATA / job)
        jobs[job] = "succeeded"
    except Exception:
        jobs[job] = "failed"


async def mend_in_pool(job: str) -> None:
    jobs[job] = "running"
    try:
        await asyncio.get_running_loop().run_in_executor(pool, mend, DATA / job)
        jobs[job] = "succeeded"
    except Exception:
        jobs[job] = "failed"


async def mend_apart(job: str) -> None:
    async with free:
        jobs[job] = "running"
        files = [str(DATA / job / name) for name in ("input.stl", "repaired.stl")]
        process = await asyncio.create_subprocess_exec(sys.executable, "-c", MEND_APART, *files)
        try:
            ended = await asyncio.wait_for(process.wait(), TIMEOUT)
            jobs[job] = "failed" if ended else "succeeded"
        except TimeoutError:
            process.kill()
            await process.wait()
            jobs[job] = "failed"


@app.post("/jobs", status_code=202)
def submit(file: UploadFile, tasks: BackgroundTasks) -> dict[str, str]:
    job = uuid.uuid4().hex
    folder = DATA / job
    folder.mkdir()
    with open(folder / "input.stl", "wb") as upload:
        shutil.copyfileobj(file.file, upload)
    jobs[job] = "queued"
    tasks.add_task(mend_apart if free else mend_in_pool if pool else mend_here, job)
    return {"id": job, "status": "queued"}


@app.get("/jobs/{job}")
async def status(job: str) -> dict[str, str]:
    if job not in jobs:
        raise HTTPException(404)
    return {"id": job, "status": jobs[job]}


@app.get("/jobs/{job}/result")
async def result(job: str) -> FileResponse:
    if jobs.get(job) != "succeeded":
        raise HTTPException(404)
    return FileResponse(DATA / job / "repaired.stl", media_type="model/stl")

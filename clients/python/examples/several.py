"""Repairs several models at once: python several.py http://127.0.0.1:8080 a.stl b.stl"""

import asyncio
import sys

from meshmend import AsyncClient


async def main(address: str, *paths: str) -> None:
    async with AsyncClient(address) as client:
        jobs = await asyncio.gather(*(client.repair(path, {"output": "stl"}) for path in paths))
        for path, job in zip(paths, jobs, strict=True):
            print(f"{path}: {job.outcome}")
            if job.is_printable:
                await job.save(f"{path}.repaired.stl")


asyncio.run(main(*sys.argv[1:]))

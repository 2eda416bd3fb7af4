"""A client of meshmend, which repairs broken 3D models."""

from . import shapes
from .client import Client
from .errors import Code, DamagedDownload, JobFailed, JobTimeout, MeshmendError, Problem
from .events import JobEvent, ProgressEvent
from .job import Job
from .model import File

__all__ = [
    "Client",
    "Code",
    "DamagedDownload",
    "File",
    "Job",
    "JobEvent",
    "JobFailed",
    "JobTimeout",
    "MeshmendError",
    "Problem",
    "ProgressEvent",
    "shapes",
]

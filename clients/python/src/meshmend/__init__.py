"""meshmend repairs broken 3D models.

`repair`, `inspect` and `compare` run the engine on this machine. `Client` and `AsyncClient` use a service.
"""

from . import shapes
from ._engine import __version__
from .asynchronous.client import AsyncClient
from .asynchronous.job import AsyncJob
from .comparison import Comparison
from .errors import (
    Cancellation,
    Code,
    DamagedDownload,
    DeadlineExceeded,
    EngineFailure,
    InvalidModel,
    InvalidOption,
    JobFailed,
    JobTimeout,
    MeshmendError,
    Problem,
)
from .events import JobEvent, ProgressEvent
from .inputs import ModelLike
from .model import File
from .operations import compare, inspect, repair
from .results import Inspection, Result
from .synchronous.client import Client
from .synchronous.job import Job

__all__ = [
    "AsyncClient",
    "AsyncJob",
    "Cancellation",
    "Client",
    "Code",
    "Comparison",
    "DamagedDownload",
    "DeadlineExceeded",
    "EngineFailure",
    "File",
    "Inspection",
    "InvalidModel",
    "InvalidOption",
    "Job",
    "JobEvent",
    "JobFailed",
    "JobTimeout",
    "MeshmendError",
    "ModelLike",
    "Problem",
    "ProgressEvent",
    "Result",
    "__version__",
    "compare",
    "inspect",
    "repair",
    "shapes",
]

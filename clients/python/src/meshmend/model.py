"""Files to send to the service. A retry reads the file again."""

from __future__ import annotations

import io
import os
from contextlib import AbstractContextManager, nullcontext
from typing import BinaryIO, TypeAlias, Union

#: A path, a file that is open for reading bytes, or the bytes.
File: TypeAlias = Union[str, "os.PathLike[str]", BinaryIO, bytes]


class Model:
    """A file to send, and its name."""

    def __init__(self, file: File, name: str | None) -> None:
        own: object = None
        if isinstance(file, (str, os.PathLike)):
            own = os.fspath(file)
        elif not isinstance(file, bytes):
            own = getattr(file, "name", None)
            # A retry reads the file again, so a stream that cannot seek is kept in memory.
            file = file if file.seekable() else file.read()
        self._file = file
        self.name = name or (os.path.basename(own) if isinstance(own, str) else "model")

    def open(self) -> AbstractContextManager[BinaryIO]:
        """Opens the file at its beginning."""
        if isinstance(self._file, bytes):
            return io.BytesIO(self._file)
        if isinstance(self._file, (str, os.PathLike)):
            return open(self._file, "rb")
        self._file.seek(0)
        # The caller closes the file.
        return nullcontext(self._file)

    def size(self) -> int:
        with self.open() as file:
            return file.seek(0, os.SEEK_END)

"""A file layer in which one operation fails, as SQLite's tests have it."""

from __future__ import annotations

import builtins
import errno
import io
import os
import shutil
from collections.abc import Callable
from typing import Any

import pytest

FAULTS = (errno.ENOSPC, errno.EIO, errno.EACCES)


class Faults:
    """A file layer in which the n-th operation fails, and all after it do where ``broken`` stays so."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, number: int, error: int, *, stays: bool) -> None:
        self.count = 0
        self.number, self.error, self.stays = number, error, stays
        real_open = builtins.open

        def failing_open(file: Any, mode: str = "r", *arguments: Any, **keywords: Any) -> Any:
            if not isinstance(file, int) and set(mode) & set("wxa+"):
                self.next(str(file))
                return _File(self, real_open(file, mode, *arguments, **keywords))
            return real_open(file, mode, *arguments, **keywords)

        monkeypatch.setattr("builtins.open", failing_open)
        for name in ("replace", "fsync", "mkdir"):
            monkeypatch.setattr(os, name, self.failing(getattr(os, name)))
        monkeypatch.setattr(shutil, "copymode", self.failing(shutil.copymode))

    def failing(self, real: Callable[..., Any]) -> Callable[..., Any]:
        def called(*arguments: Any, **keywords: Any) -> Any:
            self.next(str(arguments[0]))
            return real(*arguments, **keywords)

        return called

    def next(self, name: str) -> None:
        self.count += 1
        if self.count == self.number or (self.stays and self.count > self.number):
            raise OSError(self.error, os.strerror(self.error), name)


class _File(io.BufferedIOBase):
    """A file whose writes count."""

    def __init__(self, faults: Faults, file: Any) -> None:
        self._faults, self._file = faults, file

    def write(self, content: Any) -> int:
        self._faults.next(self._file.name)
        return self._file.write(content)

    def flush(self) -> None:
        if not self.closed:
            self._faults.next(self._file.name)
            self._file.flush()

    def close(self) -> None:
        if not self.closed:
            try:
                super().close()
            finally:
                self._file.close()

    def fileno(self) -> int:
        return self._file.fileno()

    def tell(self) -> int:
        return self._file.tell()

    def seek(self, offset: int, whence: int = 0) -> int:
        return self._file.seek(offset, whence)

    def readable(self) -> bool:
        return False

    def writable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

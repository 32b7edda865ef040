"""Work in a thread of its own; its failure is raised in the main thread."""

import threading
from typing import Self


class Worker(threading.Thread):
    """A thread that ends with the program, and keeps the error that it raised."""

    error: BaseException | None = None

    def run(self) -> None:
        """Do the work."""
        try:
            super().run()
        except BaseException as error:
            self.error = error

    def check(self) -> None:
        """Raise the error of the work, if there is one."""
        if self.error is not None:
            raise self.error


class Background:
    """Work that goes on until it is stopped; a context.

    Attributes
    ----------
    patience: longest wait for its end [s]; None: no limit
    """

    patience: float | None = None

    def __enter__(self) -> Self:
        """Begin."""
        self._stop = threading.Event()
        self._thread = Worker(target=self._run, name=type(self).__name__, daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        """End."""
        self._stop.set()
        self._thread.join(self.patience)

    def check(self) -> None:
        """Raise the error of the thread, if there is one."""
        self._thread.check()

    def _run(self) -> None:
        """Work until `_stop` is set."""
        raise NotImplementedError

"""Work in a thread of its own; its failure is raised in the main thread."""

import threading
from typing import Self


class Background:
    """Work that goes on until it is stopped; a context.

    Attributes
    ----------
    patience: longest wait for its end [s]; None: no limit
    """

    patience: float | None = None
    _error: BaseException | None = None

    def __enter__(self) -> Self:
        """Begin."""
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._work, name=type(self).__name__, daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        """End."""
        self._stop.set()
        self._thread.join(self.patience)

    def check(self) -> None:
        """Raise the error of the thread, if there is one."""
        if self._error is not None:
            raise self._error

    def _work(self) -> None:
        try:
            self._run()
        except BaseException as error:
            self._error = error

    def _run(self) -> None:
        """Work until `_stop` is set."""
        raise NotImplementedError

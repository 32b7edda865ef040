"""A thread whose failure is not lost."""

import threading


class Worker(threading.Thread):
    """A thread that ends with the program, and remembers what it raised."""

    error: BaseException | None = None

    def run(self) -> None:
        """Do the work."""
        try:
            super().run()
        except BaseException as error:
            self.error = error

    def check(self) -> None:
        """Raise what the work raised."""
        if self.error is not None:
            raise self.error

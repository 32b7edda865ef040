"""Errors a user can cause: one sentence each, exit code 2 on the command line."""


class UserError(ValueError):
    """What was asked for cannot be done; the message says what, where, and what is allowed."""


class SceneError(UserError):
    """A scene that is not valid."""


class FolderError(UserError):
    """A folder that cannot be written to."""


class CalibrateError(UserError):
    """Images that no camera can be calibrated from."""

"""Processes that work for one that waits."""

import signal

import cv2


def start_worker() -> None:
    """One thread of OpenCV a process; Ctrl-C is for the process that waits."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    cv2.setNumThreads(1)

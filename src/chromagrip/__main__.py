"""`python -m chromagrip` is `chromagrip`."""

from .cli import main

main()

"""Forces of a dome by free tractions of its skin: two soft layers tell them without an object."""

"""Forces of a dome by free tractions of its skin, which two moving layers of markers determine."""

"""Force reconstruction on the dome: contacts and free tractions; not built yet."""

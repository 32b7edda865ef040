"""What pictures of a dome of silicone can tell of forces: by a contact, and by free tractions."""

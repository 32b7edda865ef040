"""Storage of results: folders, tables, pictures, videos, rows and reports."""

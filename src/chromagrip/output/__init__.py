"""How results are kept: folders, tables, pictures, videos, rows and reports."""
